/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Sections that their marks lay, held against the tissue of their neighbours
 * (register/tissue/pose_check.h), and those that marks do not lay, laid by it (register/tissue/pose_graph.h).
 *
 * A section that its marks lay elsewhere than its neighbours' tissue does is flagged
 * "tissue-disagrees" and treated as one without marks, unless a person chose them.
 *
 * A section with no mark, with marks that could be others or that contradict the stack is laid
 * where the sections around it put it, which their marks hold. It is used, flagged "by-tissue", as
 * one that a person should look at; where tissue cannot tell either it stays held. Of spots that
 * could be one mark or another, those are its marks that lay it as its tissue does, when no others
 * come near; the pose stays the tissue's. Two spots that leave more than one pose open are asked
 * about: where the tissue surely lies elsewhere, they were not the section's marks. */
#ifndef GSN_PIPELINE_ASSEMBLY_TISSUE_H
#define GSN_PIPELINE_ASSEMBLY_TISSUE_H

#include "pipeline/assembly.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Lays what it can; needs a stack that the marks solved, and does nothing otherwise. The panels are
 * opened once more, made small. Fails with GSN_E_NOMEM,
 * GSN_E_IO and as gsn_scan_survey() does. */
int gsn_assembly_lay_by_tissue(const struct gsn_specimen *specimen,
                               const struct gsn_specimen_options *options, struct gsn_assembly *a,
                               struct gsn_error *err);

/* How many were laid so. */
size_t gsn_assembly_by_tissue(const struct gsn_assembly *a);

#ifdef __cplusplus
}
#endif
#endif
