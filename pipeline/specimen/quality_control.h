/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Quality control: which of the sections of a panel lose what to defects, and how much of the
 * region of interest with it; and under which conditions the panels of a specimen were cut, stained
 * and scanned, as they themselves show it: the lamp by the blank glass, the bath by the dyes, the
 * knife by all dyes together, the scanner's dust by what every panel shares. */
#ifndef GSN_SPECIMEN_QUALITY_CONTROL_H
#define GSN_SPECIMEN_QUALITY_CONTROL_H

#include "pipeline/specimen/density_stack.h"
#include "pipeline/specimen/scan.h"
#include "pipeline/stain/artefact/detection.h"
#include "pipeline/stain/stain_vectors.h"

/* ---- defects ---- */

/* gives: the sections of a panel without their marks, as 8-bit grey of the size of the scan's
 * thinned densities: what may be asked for its dyes, for labels and most ink lie elsewhere. marks:
 * one for each section. Fails with GSN_E_NOMEM. borrows: all. */
int gsn_masking_tissue(const struct gsn_scan *scan, unsigned panel, const struct gsn_poses *poses,
                       const struct gsn_section_marks *marks, struct gsn_image **ret_tissue,
                       struct gsn_error *err);

/* gives: the labels of the panel's sections (stain/artefact/detection.h), in their order. Ink is
 * what neither `dyes` nor, where all sections show it, the panel's own tissue explains.
 * ret_figures: room for as many sections as there are. borrows: all. Fails as
 * gsn_artefact_find(). */
int gsn_masking_label(const struct gsn_scan *scan, const struct gsn_dyes *dyes, unsigned panel,
                      unsigned threads, const struct gsn_poses *poses,
                      const struct gsn_section_marks *marks,
                      struct gsn_artefact_labels **ret_labels,
                      struct gsn_artefact_figures *ret_figures, struct gsn_error *err);

/* The same, kept: fills `masked` of the panel's sections, adds a flag for each reason but the halos
 * of the marks, which every section has, and leaves the shares of the region to
 * gsn_masking_region(). */
int gsn_masking_find(const struct gsn_scan *scan, const struct gsn_dyes *dyes, unsigned panel,
                     unsigned threads, const struct gsn_poses *poses,
                     struct gsn_densities *densities, struct gsn_artefact_labels **ret_labels,
                     struct gsn_error *err);

/* Which of the labels' sections section i is; it lies on that panel and has a box. */
size_t gsn_masking_index(const struct gsn_poses *poses, size_t i);

/* Counts, for each posed section of the panel, what share of its part of the region is masked,
 * voxel by voxel. Nothing where region is NULL. */
void gsn_masking_region(const struct gsn_artefact_labels *labels, unsigned panel,
                        double interval_um, const struct gsn_mask *region,
                        const struct gsn_poses *poses, struct gsn_densities *densities);

/* The same where the region is known only after the stack was made: the share of each section's
 * part of the region that has no density, whatever the reason. */
void gsn_masking_gaps(double interval_um, const struct gsn_mask *region,
                      const struct gsn_poses *poses, struct gsn_densities *densities);

/* ---- conditions ---- */

/* Looks at one panel: fills lamp, tone and turn of it and the tones of its sections, and adds to
 * the map of dust, all in cells of about 20 um. panel: one of densities'. Fails with GSN_E_STAIN as
 * gsn_unmix() and with GSN_E_NOMEM. borrows: scan, labels. */
int gsn_quality_measure_panel(const struct gsn_scan *scan, const struct gsn_artefact_labels *labels,
                              const struct gsn_poses *poses, struct gsn_stack_panel *panel,
                              struct gsn_densities *densities, struct gsn_error *err);

/* After the last panel: says which sections are thicker or thinner than those beside them, and
 * takes the density behind the scanner's dust out of the stack. region: or NULL. Fails with
 * GSN_E_NOMEM. */
int gsn_quality_judge(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                      const struct gsn_poses *poses, struct gsn_densities *densities,
                      struct gsn_error *err);

struct gsn_quality_sentences {
    size_t count;
    char **sentence; /* owned */
};

/* One sentence for each thing that somebody has to do something about.
 * Fails with GSN_E_NOMEM; what was said until then is there. */
int gsn_quality_sentences(const struct gsn_poses *poses, const struct gsn_densities *densities,
                          const struct gsn_protocol *protocol, struct gsn_quality_sentences *words);
void gsn_quality_sentences_done(struct gsn_quality_sentences *words);

#endif
