/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The service in one line, as `systemctl status` shows it:
 * "2 sources ready, 1 away; 3 jobs waiting". */
#ifndef GSN_SYSTEMD_STATUS_TEXT_H
#define GSN_SYSTEMD_STATUS_TEXT_H

#include "storage/store.h"

#include <stddef.h>

enum { GSN_STATUS_INTAKE = 1, GSN_STATUS_QUEUE = 2 };

/* parts: what this service does. */
int gsn_status_text(struct gsn_store *store, unsigned parts, char *ret_text, size_t size,
                    struct gsn_error *err);

#endif
