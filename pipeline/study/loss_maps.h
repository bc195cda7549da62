/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where groups lost collagen, over animals: the loss in each cell of the base mesh. */
#ifndef GSN_STUDY_LOSS_MAPS_H
#define GSN_STUDY_LOSS_MAPS_H

#include "pipeline/report/text.h"
#include "pipeline/study/study.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Fills the study's maps from the places of its specimens; its comparisons are there. Fails with
 * GSN_E_NOMEM. */
int gsn_study_map_losses(struct gsn_study *study, struct gsn_error *err);

/* The part of the page that shows them; nothing where there are none. */
void gsn_study_add_maps(struct gsn_report_text *text, const struct gsn_study *study);

#ifdef __cplusplus
}
#endif
#endif
