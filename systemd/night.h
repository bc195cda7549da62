/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which specimens changed since their last report: other panels, other settings, another baseline,
 * another version. */
#ifndef GSN_SYSTEMD_NIGHT_H
#define GSN_SYSTEMD_NIGHT_H

#include "storage/store.h"

/* Asks for the job of every specimen whose key (gsn_material_key()) is not that of its last report.
 * Those that wait, run or failed are left as they are: what failed would fail again as long as
 * nobody changed anything, and who changes something asks for the job. ret_count: how many were
 * asked for. A specimen whose job text cannot be read is left to its own job to say so. */
int gsn_night_ask(struct gsn_store *store, size_t *ret_count, struct gsn_error *err);

#endif
