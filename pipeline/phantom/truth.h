/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the operator types (job.json, region.mhd) and what the phantom knows (truth/). */
#ifndef GSN_PHANTOM_TRUTH_H
#define GSN_PHANTOM_TRUTH_H

#include "pipeline/core/grid.h"
#include "pipeline/phantom/check.h"
#include "pipeline/phantom/panel.h"
#include "pipeline/phantom/plan.h"
#include "pipeline/phantom/section.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The grid of the truth volumes: 16 x 16 um over the whole block, z on the sections. */
struct gsn_lattice gsn_phantom_truth_lattice(const struct gsn_phantom_geometry *g);
/* The part of it that holds the region of interest and a border of two voxels. */
struct gsn_lattice gsn_phantom_region_lattice(const struct gsn_phantom_geometry *g);

/* give: the region of interest, and D at the depth A in bone gain times as dense, at the
 * voxel centres of a lattice. */
int gsn_phantom_region_mask(const struct gsn_phantom_geometry *g, const struct gsn_lattice *at,
                            struct gsn_mask **ret_mask, struct gsn_error *err);
int gsn_phantom_density_grid(const struct gsn_phantom_geometry *g, const struct gsn_lattice *at,
                             double depth, double gain, unsigned threads,
                             struct gsn_grid **ret_grid, struct gsn_error *err);

/* The sums over the region that belong to a specimen, and its loss against the block as defined, of
 * these sums or of those of any other specimen: a control that is denser has lost less than none. A
 * specimen has a lesion or bone of its own density, not both. */
int gsn_phantom_truth_sums(const struct gsn_phantom_geometry *g,
                           const struct gsn_phantom_specimen *s, unsigned threads,
                           struct gsn_phantom_sums *ret_sums, struct gsn_error *err);
double gsn_phantom_truth_loss(const struct gsn_phantom_specimen *s,
                              const struct gsn_phantom_sums *sums);

/* Writes job.json, region.mhd and region.raw into folder. */
int gsn_phantom_write_job(const struct gsn_phantom_plan *plan, const char *folder,
                          struct gsn_error *err);

/* Writes truth.json, sections.csv, markers.csv, defects.csv, loss.csv, roi.mhd/.raw, and with
 * with_density also density.mhd/.raw (20 MB), into folder. extent is by section. */
int gsn_phantom_write_truth(const struct gsn_phantom_plan *plan,
                            const struct gsn_phantom_extent extent[GSN_PHANTOM_SECTIONS],
                            int with_density, unsigned threads, const char *folder,
                            struct gsn_error *err);

/* The tables of the truth alone: sections.csv, markers.csv, defects.csv and, where sections were
 * handled, decoys.csv and warp_kNNN.csv. extent is by section. */
int gsn_phantom_tables_write(const struct gsn_phantom_plan *plan,
                             const struct gsn_phantom_extent extent[GSN_PHANTOM_SECTIONS],
                             const char *folder, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
