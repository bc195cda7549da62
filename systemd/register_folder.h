/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* `gieson-work register`: a plain folder of section pictures, as poses on stdout. */
#ifndef GSN_SYSTEMD_REGISTER_FOLDER_H
#define GSN_SYSTEMD_REGISTER_FOLDER_H

#include "pipeline/core/error.h"

#include <stddef.h>

struct gsn_register_request {
    const char *dir;
    const char *marks; /* six numbers, or NULL */
    const char *px_um; /* numbers as given, or NULL */
    const char *radius;
    int json;
};

/* Prints the poses; *ret_lost is the number of pictures without one. Fails as
 * gsn_folder_register(), and with GSN_E_INPUT for numbers that are none. */
int gsn_register_folder(const struct gsn_register_request *request, const char *decoder,
                        size_t *ret_lost, struct gsn_error *err);

#endif
