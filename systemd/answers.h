/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What people decided, as the jobs need it. */
#ifndef GSN_SYSTEMD_ANSWERS_H
#define GSN_SYSTEMD_ANSWERS_H

#include "pipeline/examine.h"
#include "storage/decision.h"
#include "storage/panel_log.h"

/* gives: the answers about this panel's own picture, whose scan has this hash. An answer of an
 * unknown form is passed over: a newer program may have written it. Fails with GSN_E_NOMEM. */
int gsn_answers_read(const struct gsn_decision_rows *rows, int64_t number, const char *sha256,
                     struct gsn_panel_answer **ret_answers, size_t *ret_count,
                     struct gsn_error *err);

/* The hash of the scan of this panel number that was chosen, or NULL. borrows: rows. */
const char *gsn_answers_chosen(const struct gsn_decision_rows *rows, int64_t number);

/* The number of the pose that an answer chooses, from 1; 0: it chooses none. */
unsigned gsn_answers_pose(const char *answer);

#endif
