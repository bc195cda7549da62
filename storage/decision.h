/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What people decided where the pictures alone do not tell: how to cut sections that touch, which
 * of two scans counts, which slot a piece belongs to, that a panel is lost.
 *
 * One question has one answer, the last that was given; saying the same again changes nothing. The
 * audit log keeps every answer with who gave it and why. An answer asks for the panels it is about
 * and for the specimen's report. */
#ifndef GSN_STORAGE_DECISION_H
#define GSN_STORAGE_DECISION_H

#include "storage/panel_log.h"
#include "storage/store.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Texts are never NULL. */
struct gsn_decision_row {
    int64_t number;     /* of the panel, from 1 */
    int64_t slot;       /* from 1 in the panel's order; 0: the panel as a whole */
    const char *answer; /* "cut", "hold", "slot 5", "dismiss", "first 5", "use <sha256>", "lost",
                           "as-set", "as-marked",
                           "pose 2 of <sha256> up|down X,Y X,Y X,Y" (px; "-": no such mark) */
    double x_px, y_px;  /* the middle of what it is about, on the upright picture; NaN: nothing */
    const char *actor, *reason;
    int64_t time;
};

struct gsn_decision_rows {
    size_t count;
    struct gsn_decision_row *at;
};

void gsn_decision_rows_free(struct gsn_decision_rows *rows);

GSN_DEFINE_AUTO(gsn_decision_rows);

/* In one transaction: the answer in place of an earlier one, a line of the audit log, and the jobs
 * that rest on it. An empty answer takes the earlier one back. ret_again: 1 when that was the
 * answer already; then nothing is written. Fails with GSN_E_NOTFOUND when there is no such
 * specimen. */
int gsn_decision_put(struct gsn_store *store, const char *specimen,
                     const struct gsn_decision_row *row, int *ret_again, struct gsn_error *err);

/* gives: those of one specimen, by panel and slot. */
int gsn_decision_list(struct gsn_store *store, int64_t specimen_id,
                      struct gsn_decision_rows **ret_rows, struct gsn_error *err);

/* The poses that doubtful sections may have, beside the sections' rows: what a person is shown, and
 * chooses from with a decision.
 *
 * They are of the panel as it was last looked at: gsn_section_replace() drops them. Errors come
 * when the whole stack has been solved. Pixels as in panel_log.h. */

struct gsn_candidate_row {
    int64_t panel_id, slot;      /* slot from 1 */
    int64_t number;              /* from 1, in the section's order */
    int64_t chosen;              /* 1: by a person */
    int64_t mirrored;            /* against the triangle by which its spots are called marks */
    int64_t flipped, rotated180; /* 0 or 1; as it lies in the block */
    double share;                /* how likely, of the section's; NaN: not told */
    double error_um;             /* predicted; NaN: not known yet */
    const char *differs;         /* what it rests on, or is other than in the first */
    struct gsn_fiducial_row marker[GSN_ROW_MARKS];
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
