/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether the laid sections lie in the order of their numbers (register/order/sequence.h).
 *
 * While the panels are opened, each section's density is gathered in cells of the block; at the end
 * all are compared, and the held ones with those around them, for one may be the second mount of
 * the other. What is found is flags and sentences: proposals for a person. */
#ifndef GSN_PIPELINE_ASSEMBLY_ORDER_H
#define GSN_PIPELINE_ASSEMBLY_ORDER_H

#include "pipeline/pose_words.h"
#include "pipeline/register/order/sequence.h"
#include "pipeline/section_planes.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Compares all that was gathered; flags the sections. Where the tissue goes on through the panels
 * in another order than the job states ("row" for a snake, panels that were turned by half, two
 * panels that have each other's numbers), a->misordered says so, and single swaps are not looked
 * for: z is wrong, and no figure stands. gives: ret_sequence. Fails with GSN_E_NOMEM.
 */
int gsn_section_order_examine(struct gsn_section_planes *planes,
                              const struct gsn_protocol *protocol, struct gsn_assembly *a,
                              struct gsn_sequence **ret_sequence, struct gsn_error *err);

/* What a person is asked about one finding; sections are named PANEL.SLOT, with so many slots a
 * panel. */
void gsn_section_order_sentence(const struct gsn_sequence_finding *finding, unsigned slots,
                                char ret_sentence[GSN_POSE_SENTENCE]);

/* What the tissue could not have shown, in words; empty where it shows all that is looked for.
 * Returns whether there is anything to say. */
int gsn_section_order_blind_to_swaps(const struct gsn_sequence *sequence,
                                     char ret_sentence[GSN_POSE_SENTENCE]);
int gsn_section_order_blind_to_duplicates(const struct gsn_sequence *sequence,
                                          char ret_sentence[GSN_POSE_SENTENCE]);

#ifdef __cplusplus
}
#endif
#endif
