/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a region of interest holds: the spline fitted to its voxels and every figure and picture
 * that is made from it. Sections and imported volumes meet here. */
#ifndef GSN_SPECIMEN_ANALYSIS_H
#define GSN_SPECIMEN_ANALYSIS_H

#include "pipeline/core/colour_grid.h"
#include "pipeline/core/grid.h"
#include "pipeline/core/progress.h"
#include "pipeline/measure/bone.h"
#include "pipeline/measure/density.h"
#include "pipeline/measure/level_set.h"
#include "pipeline/measure/tissue_volume.h"
#include "pipeline/model/domain.h"
#include "pipeline/model/refine.h"
#include "pipeline/specimen/protocol.h"
#include "pipeline/stain/normalisation.h"

enum { GSN_ANALYSIS_THRESHOLDS = 8, GSN_ANALYSIS_PICTURES = 8 };

struct gsn_png_picture {
    const char *id, *title;
    char caption[320];
    uint8_t *png; /* owned */
    size_t size;
    uint32_t width, height;
};

struct gsn_analysis {
    struct gsn_dms *space;           /* owned */
    struct gsn_spline *spline;       /* owned */
    struct gsn_spline *colour[3];    /* owned; red, green, blue as light, 0..1; NULL: no colours */
    struct gsn_domain_report domain; /* what the mesh follows */
    struct gsn_adapt_report fit;     /* its arrays are owned */
    double tolerance;
    size_t over_tolerance; /* tetrahedra whose rms residual is above the tolerance */
    double coverage;       /* share of the region's voxels that have data, 0..1 */
    struct gsn_region_density density;
    double section_error;   /* of the mean density, by what each section errs by itself; NaN */
    double plane_error;     /* the same of one section in a cell of the base mesh; NaN */
    struct gsn_unit *units; /* owned; one per tetrahedron */
    struct gsn_units_summary summary;
    size_t bound_count;
    struct gsn_volume_bound
        bound[GSN_ANALYSIS_THRESHOLDS];  /* threshold: as the protocol means it */
    struct gsn_tissue_volumes tissue;    /* of sections, for the thresholds of bound */
    struct gsn_bone bone;                /* above the density of above_threshold */
    int has_bone;                        /* 0: too many voxels to measure it in */
    double above_threshold, above_share; /* area figure: share of sampled voxels above it */
    double low, high;                    /* ends of the pictures' colour scale */
    const char *unit;                    /* of the values */
    size_t picture_count;
    struct gsn_png_picture picture[GSN_ANALYSIS_PICTURES];
};

struct gsn_analysis_options {
    const char *mesher; /* path of gieson-mesh */
    unsigned threads;   /* 0: all */
    const struct gsn_progress *progress;
    const struct gsn_colour_grid *colour; /* on the same lattice: fitted, and shown beside it; NULL:
                                             none */
    /* How densities that the protocol's thresholds are meant in read here, gain * density + offset:
     * those of the baseline, in this specimen's stain. All zeros: as they are. */
    struct gsn_gain_offset scale;
    const struct gsn_grid *shown; /* what the cuts show beside the model; NULL: the grid itself */
};

/* gives: fit, figures and pictures of the region in this volume.
 *
 * Voxels of the grid whose centre lies in the region and that have data are the samples. The grid
 * and the region may have different lattices. Fails with GSN_E_WITHHELD when the region is not
 * covered well enough to say anything (less than half of it has data), and as gsn_adapt() and the
 * measures do. borrows: everything. */
int gsn_analyse(const struct gsn_grid *grid, const struct gsn_mask *region,
                const struct gsn_protocol *protocol, const struct gsn_analysis_options *options,
                struct gsn_analysis **ret_analysis, struct gsn_error *err);
void gsn_analysis_free(struct gsn_analysis *analysis);
GSN_DEFINE_AUTO(gsn_analysis);

#endif
