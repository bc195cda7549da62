/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* GSL's error handler, switched off once (pthread_once) where it is GSL's own (GSL reference
 * manual, "Error Handling"). */
#include "pipeline/core/gsl_door.h"

#include <pthread.h>

#include <gsl/gsl_errno.h>

/* The one place that touches GSL's handler, which is the whole process's. NULL: nobody set one. */
static void replace_default_handler(void)
{
    gsl_error_handler_t *const of_host = gsl_set_error_handler_off();

    if (of_host)
        (void)gsl_set_error_handler(of_host);
}

void gsn_gsl_open(void)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;

    (void)pthread_once(&once, replace_default_handler);
}
