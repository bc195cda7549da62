/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the poses of a stack say to a person: what cannot be told on this block, what was allowed
 * for, and what someone has to look at. */
#ifndef GSN_PIPELINE_POSE_WORDS_H
#define GSN_PIPELINE_POSE_WORDS_H

#include "pipeline/assembly.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_POSE_SENTENCES = 8, GSN_POSE_SENTENCE = 480 };

/* One sentence for each thing to say about the whole stack; their number. */
size_t gsn_pose_sentences(const struct gsn_pose_summary *summary,
                          const struct gsn_strain_common *panel, enum gsn_strain_mode mode,
                          double interval_um,
                          char ret_sentence[GSN_POSE_SENTENCES][GSN_POSE_SENTENCE]);

/* What became of sections that were to be laid by their tissue. */
void gsn_refinement_sentence(const struct gsn_refinement *refinement,
                             char ret_sentence[GSN_POSE_SENTENCE]);

/* What laying a stack by its tissue alone cannot know; worst_um: the largest predicted error. */
void gsn_by_tissue_sentence(const struct gsn_by_tissue *by_tissue, double worst_um,
                            char ret_sentence[GSN_POSE_SENTENCE]);

/* Why a section whose marks contradict the stack is held, with the three poses on two marks. */
void gsn_pose_reason(const struct gsn_pose *pose, char ret_sentence[GSN_POSE_SENTENCE]);

/* What is between a section's marks and its neighbours' tissue. */
void gsn_tissue_sentence(const struct gsn_assembly_section *section,
                         char ret_sentence[GSN_POSE_SENTENCE]);

#ifdef __cplusplus
}
#endif
#endif
