/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Serves one source for as long as it is there: looks, takes what is ready, answers requests,
 * waits. */
#ifndef GSN_SYSTEMD_INGEST_SERVE_SOURCE_H
#define GSN_SYSTEMD_INGEST_SERVE_SOURCE_H

#include "storage/store.h"
#include "systemd/service/config.h"
#include "systemd/service/heartbeat.h"

/* Opens the source and serves it until it is asked to stop or nothing will ever follow (GSN_OK).
 * Fails with GSN_E_NOTFOUND when its device is away, and with what else keeps it from being served;
 * its row in the store then says so too. err is not NULL. */
int gsn_serve_source(struct gsn_store *store, const struct gsn_config *config,
                     const struct gsn_config_source *source, struct gsn_heartbeat *heartbeat,
                     struct gsn_error *err);

#endif
