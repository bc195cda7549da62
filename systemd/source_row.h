/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The row in which a source says how it is, for people who look at the bench. Rows are for eyes:
 * what changes fast is written twice a second at most. */
#ifndef GSN_SYSTEMD_SOURCE_ROW_H
#define GSN_SYSTEMD_SOURCE_ROW_H

#include "storage/store.h"

#include <stdint.h>

/* keeps: store, name and address. */
struct gsn_source_row {
    struct gsn_store *store;
    const char *name, *address;
    char device[160];
    /* what was written last */
    char state[16], message[400];
    int64_t written_ms;
};

/* A store that cannot take it now gets the next one. */
void gsn_source_row_say(struct gsn_source_row *row, const char *state, const char *message);

/* How far the item is that is being received; not written in the first moments of a copy. */
void gsn_source_row_progress(struct gsn_source_row *row, const char *item, int64_t began_ms,
                             uint64_t done, uint64_t total);

#endif
