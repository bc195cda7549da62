/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The poses that a doubtful section may have, between the pipeline's record and the store's rows.
 */
#ifndef GSN_SYSTEMD_CANDIDATES_H
#define GSN_SYSTEMD_CANDIDATES_H

#include "pipeline/candidate.h"
#include "storage/candidate.h"

/* Fills a row for each candidate of the section in this slot (from 1); their number. The rows
 * borrow the list's texts. */
size_t gsn_candidates_to_rows(const struct gsn_candidates *list, int64_t slot,
                              struct gsn_candidate_row ret_rows[GSN_CANDIDATES]);
/* Those of one section, found among all rows of the specimen; none are laid. */
void gsn_candidates_from_rows(const struct gsn_candidate_rows *rows, int64_t panel_id, int64_t slot,
                              struct gsn_candidates *ret_list);

#endif
