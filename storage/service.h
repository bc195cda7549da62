/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Who serves a store: locks on DIR/giesond.lock that end with the process that took them.
 *
 * A service that was killed leaves no lock, so readers can say whether panels come in and whether
 * the queue is worked; and no two services take in the same panels. */
#ifndef GSN_STORAGE_SERVICE_H
#define GSN_STORAGE_SERVICE_H

#include "pipeline/core/error.h"

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_service {
    GSN_SERVICE_INTAKE, /* panels come in */
    GSN_SERVICE_QUEUE,  /* jobs are worked */
};

/* gives: a descriptor; the service is there until it is closed or its process ends. Programs that
 * the process starts do not hold it.
 *
 * Fails with GSN_E_BUSY when another process is that service, GSN_E_IO. */
int gsn_service_take(const char *dir, enum gsn_service service, int *ret_lock,
                     struct gsn_error *err);

/* Whether somebody is that service now; takes no lock itself. Fails with GSN_E_IO. */
int gsn_service_is_there(const char *dir, enum gsn_service service, int *ret_there,
                         struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
