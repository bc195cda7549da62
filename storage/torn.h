/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A picture that came before it was whole: some scanners rest in the middle of a file for longer
 * than anybody waits. When the whole one comes under the same name, it takes the torn one's place.
 *
 * One picture is a torn beginning of another when all that differs between them is one stretch that
 * is zeros or missing in the first: its file was cut there, or made to its length and not filled
 * yet. Both stay as originals. */
#ifndef GSN_STORAGE_TORN_H
#define GSN_STORAGE_TORN_H

#include "storage/panel_log.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Whether one object is a torn beginning of another. Fails as reading does, GSN_E_NOTFOUND. */
int gsn_torn_compare(const struct gsn_store *store, const char *torn, const char *whole,
                     int *ret_is_torn, struct gsn_error *err);

/* For whole, a panel that is about to be put: when the specimen has a torn beginning of it under
 * the same file name, that row takes the bytes of whole, waits to be looked at again, and the torn
 * original becomes a scan that is kept. In a transaction. ret_panel: of the row; 0: there is none.
 */
int gsn_torn_replace(struct gsn_store *store, const struct gsn_panel_row *whole, int64_t now,
                     const char *actor, int64_t *ret_panel, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
