/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Doubtful sections as each of their candidates would lay them, in the block frame, with the
 * outline of the nearest section whose place is known: small pictures to choose by.
 *
 * Panels are opened one after the other, so what each shows is gathered as it comes, and drawn at
 * the end. */
#ifndef GSN_PIPELINE_CANDIDATE_SHEET_H
#define GSN_PIPELINE_CANDIDATE_SHEET_H

#include "pipeline/assembly.h"
#include "pipeline/scan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Opaque. */
struct gsn_candidate_sheet;

/* gives: an empty sheet; NULL when there is nothing to choose or no section to compare with. Fails
 * with GSN_E_NOMEM. */
int gsn_candidate_sheet_new(const struct gsn_assembly *a, struct gsn_candidate_sheet **ret_sheet,
                            struct gsn_error *err);
void gsn_candidate_sheet_free(struct gsn_candidate_sheet *sheet);
GSN_DEFINE_AUTO(gsn_candidate_sheet);

/* Takes what an opened panel of this number shows; sheet may be NULL. Fails with GSN_E_NOMEM. */
int gsn_candidate_sheet_look(struct gsn_candidate_sheet *sheet, const struct gsn_assembly *a,
                             const struct gsn_scan *scan, unsigned panel, struct gsn_error *err);
/* Draws the pictures into the assembly's sections; sheet may be NULL. Fails with GSN_E_NOMEM. */
int gsn_candidate_sheet_draw(struct gsn_candidate_sheet *sheet, struct gsn_assembly *a,
                             struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
