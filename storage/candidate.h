/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The poses that doubtful sections may have, beside the sections' rows: what a person is shown, and
 * chooses from with a decision.
 *
 * They are of the panel as it was last looked at: gsn_section_replace() drops them. Errors come
 * when the whole stack has been solved. Pixels as in panel_log.h. */
#ifndef GSN_STORAGE_CANDIDATE_H
#define GSN_STORAGE_CANDIDATE_H

#include "storage/panel_log.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_candidate_row {
    int64_t panel_id, slot;      /* slot from 1 */
    int64_t number;              /* from 1, in the section's order */
    int64_t chosen;              /* 1: by a person */
    int64_t mirrored;            /* against the triangle by which its spots are called marks */
    int64_t flipped, rotated180; /* 0 or 1; as it lies in the block */
    double share;                /* how likely, of the section's; NaN: not told */
    double error_um;             /* predicted; NaN: not known yet */
    const char *differs;         /* what it rests on, or is other than in the first */
    struct gsn_marker_row marker[GSN_ROW_MARKS];
};

struct gsn_candidate_rows {
    size_t count;
    struct gsn_candidate_row *at;
};

void gsn_candidate_rows_free(struct gsn_candidate_rows *rows);
GSN_DEFINE_AUTO(gsn_candidate_rows);

/* Puts these in place of all candidates of the panel's sections; panel_id and number are not read,
 * rows of one slot follow each other in the order of their numbers. In one transaction, or in the
 * caller's. Fails with GSN_E_NOTFOUND when the panel has no section in such a slot, and then the
 * old ones are still there. */
int gsn_candidate_replace(struct gsn_store *store, int64_t panel_id,
                          const struct gsn_candidate_row *rows, size_t count,
                          struct gsn_error *err);
/* gives: those of all sections of a specimen, by panel, slot, number. */
int gsn_candidate_list(struct gsn_store *store, int64_t specimen_id,
                       struct gsn_candidate_rows **ret_rows, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
