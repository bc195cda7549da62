/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What people decided where the pictures alone do not tell: how to cut sections that touch, which
 * of two scans counts, which slot a piece belongs to, that a panel is lost.
 *
 * One question has one answer, the last that was given; saying the same again changes nothing. The
 * audit log keeps every answer with who gave it and why. An answer asks for the panels it is about
 * and for the specimen's report. */
#ifndef GSN_STORAGE_DECISION_H
#define GSN_STORAGE_DECISION_H

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

#ifdef __cplusplus
}
#endif
#endif
