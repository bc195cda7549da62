/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The defects of one panel in the conductor's terms: which of an assembly's sections lose what, and
 * how much of the region of interest with it. */
#ifndef GSN_PIPELINE_MASKING_H
#define GSN_PIPELINE_MASKING_H

#include "pipeline/assembly.h"
#include "pipeline/scan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: the sections of a panel without their marks, as 8-bit grey of the size of the scan's
 * thinned densities: what may be asked for its dyes, for labels and most ink lie elsewhere. Fails
 * with GSN_E_NOMEM. borrows: scan, assembly. */
int gsn_masking_tissue(const struct gsn_scan *scan, unsigned panel,
                       const struct gsn_assembly *assembly, struct gsn_image **ret_tissue,
                       struct gsn_error *err);

/* gives: the labels of the panel's sections (stain/artefact/detection.h), in the assembly's order,
 * and says nothing in the assembly. Ink is what neither `dyes` nor, where all sections show it, the
 * panel's own tissue explains. ret_figures: room for as many sections as the assembly has. borrows:
 * scan, dyes, assembly. Fails as gsn_artefact_find(). */
int gsn_masking_label(const struct gsn_scan *scan, const struct gsn_dyes *dyes, unsigned panel,
                      unsigned threads, const struct gsn_assembly *assembly,
                      struct gsn_artefact_labels **ret_labels,
                      struct gsn_artefact_figures *ret_figures, struct gsn_error *err);

/* The same, and says it: fills `masked` of its sections in the
 * assembly, adds a flag for each reason but the halos of the marks, which every section has, and
 * leaves the shares of the region to gsn_masking_region(). borrows: scan, dyes. Fails as
 * gsn_artefact_find(). */
int gsn_masking_find(const struct gsn_scan *scan, const struct gsn_dyes *dyes, unsigned panel,
                     unsigned threads, struct gsn_assembly *assembly,
                     struct gsn_artefact_labels **ret_labels, struct gsn_error *err);

/* Which of the labels' sections the assembly's section i is; it lies on that panel and has a box.
 */
size_t gsn_masking_index(const struct gsn_assembly *assembly, size_t i);

/* Counts, for each posed section of the panel, what share of its part of the region is masked, by
 * the voxels of the assembly's region. Nothing without a region. */
void gsn_masking_region(const struct gsn_artefact_labels *labels, unsigned panel,
                        double interval_um, struct gsn_assembly *assembly);

/* The same where the region is known only after the stack was made: the share of each section's
 * part of the region that has no density, whatever the reason. */
void gsn_masking_gaps(double interval_um, struct gsn_assembly *assembly);

#ifdef __cplusplus
}
#endif
#endif
