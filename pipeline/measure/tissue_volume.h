/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How much of a region's tissue is denser than a threshold, with an interval for the tissue.
 *
 * level_set.h bounds the volume of the fitted spline, which is biased where a threshold cuts the
 * falling side of the histogram: walls are blurred by the fit, and noise of the fit moves more
 * volume across the threshold one way than the other. Here the volume is estimated from the voxels
 * and corrected for both, and its spread is taken from what the sections, whose noise is
 * independent, leave beside the estimate. It is an interval at the stain as it was read: what the
 * stain as a whole may be off by is not in it. */
#ifndef GSN_MEASURE_TISSUE_VOLUME_H
#define GSN_MEASURE_TISSUE_VOLUME_H

#include "pipeline/core/grid.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_TISSUE_VOLUME_MOST_THRESHOLDS = 8 };

/* About 95 %: two standard deviations of texture noise, walls and unresolved structure together.
 * NaN: withheld. */
struct gsn_tissue_volume {
    double threshold;
    double estimate_um3, lower_um3, upper_um3;
};

struct gsn_tissue_volumes {
    double sigma_xy_um, sigma_z_um; /* of the smoothing kernel, as cross-validation asked for */
    double neighbours;              /* correlation of what neighbouring sections leave */
    double wall_share;              /* of the region's voxels, in holes without tissue */
    const char *withheld;           /* why nothing is given, a sentence; NULL: it is */
    struct gsn_tissue_volume volume[GSN_TISSUE_VOLUME_MOST_THRESHOLDS];
};

/* The grid's planes are sections, NaN where there is no data; its voxels whose centre lies in the
 * region count, and no figure is above the region's own volume. At most
 * GSN_TISSUE_VOLUME_MOST_THRESHOLDS thresholds. A volume whose half width passes 10 % is NaN; all
 * are, with the reason, below 8 sections, when neighbouring sections' noise is not independent, and
 * when there are too many voxels to hold. threads 0: all; the same bytes on any number. borrows:
 * everything. Fails with GSN_E_NOMEM. */
int gsn_tissue_volumes(const struct gsn_grid *grid, const struct gsn_mask *region,
                       const double *thresholds, size_t count, unsigned threads,
                       struct gsn_tissue_volumes *ret_volumes, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
