/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the caller of a PTP source has not been told yet of the device's objects. */
#ifndef GSN_ACQUIRE_PTP_NEWS_H
#define GSN_ACQUIRE_PTP_NEWS_H

#include "acquire/ptp_table.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Appends an event for each object that is ready, began to wait, is left or went, and for each
 * notice. device: NULL while it is away. Fails with GSN_E_NOMEM. */
int gsn_ptp_tell_objects(const struct gsn_ptp_table *table, const struct gsn_ptp_device *device,
                         struct gsn_source_events *events, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
