/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How dense the collagen is: the mean over a region of voxels, and one figure per tetrahedron
 * ("MicroUnit") of the domain. Densities are in the unit of the spline, volumes in um^3.
 *
 * The mean over the region is the mean of s over the union of its voxel boxes, by the 2x2x2 Gauss
 * rule in every box: exact where s is one polynomial of degree <= 3, with errors of fourth order in
 * the voxel elsewhere (0.003 % measured on a field whose boundaries are 4 voxels wide). The
 * voxel-centre rule is computed beside it; the difference of the two says how well the voxels
 * resolve the field. */
#ifndef GSN_MEASURE_DENSITY_H
#define GSN_MEASURE_DENSITY_H

#include "pipeline/core/grid.h"
#include "pipeline/core/progress.h"
#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_region_density {
    double mean;         /* of s over the voxel boxes, 2x2x2 Gauss points each */
    double centres_mean; /* the same with one point per voxel, its centre */
    double volume_um3;   /* of the region: voxels times the volume of one */
    size_t voxels;
};

/* Mean density over the region; threads 0: all. borrows: spline, region, progress (may be NULL).
 * Fails with GSN_E_INPUT when the region is empty or a point of it lies outside the mesh (named by
 * voxel), GSN_E_NOMEM. The same bytes on any number of threads. */
int gsn_region_density(const struct gsn_spline *spline, const struct gsn_mask *region,
                       unsigned threads, const struct gsn_progress *progress,
                       struct gsn_region_density *ret_density, struct gsn_error *err);

/* Standard error of the mean over the region by what each section errs by itself, such as its
 * thickness, its place and its own stain; in the grid's unit. A section is a plane of constant z.
 *
 * Sections are taken to differ smoothly but for that: what one is off the middle of its two
 * neighbours has 3/2 of its variance (Gasser, Sroka and Jennen-Steinmetz, Biometrika 73, 1986),
 * weighed by voxels. NaN without three sections in a row. region has the grid's lattice, or another
 * one. borrows: both. */
double gsn_section_error(const struct gsn_grid *grid, const struct gsn_mask *region);

enum gsn_unit_state {
    GSN_UNIT_OK,
    GSN_UNIT_OUTSIDE, /* shares no volume with the region: its mean is not tissue */
    GSN_UNIT_NO_DATA, /* no sample in it: what the spline says there is interpolation only */
};

/* One tetrahedron. mean is over the whole tetrahedron, exact (equation (9)); NaN unless the state
 * is GSN_UNIT_OK. */
struct gsn_unit {
    double mean, volume_um3;
    double inside_share; /* part of the tetrahedron's volume in the region's voxel boxes, 0..1,
                            exact up to rounding */
    uint32_t samples;    /* as passed in */
    enum gsn_unit_state state;
};

enum { GSN_UNIT_BINS = 32 };

/* Over the units whose state is GSN_UNIT_OK; quartiles interpolate between order statistics
 * (position q (ok - 1)). With ok = 0 all figures are 0. */
struct gsn_units_summary {
    size_t ok, outside, no_data;
    double min, quartile1, median, quartile3, max;
    /* ok units per bin; bin b holds low + [b, b + 1) (high - low) / GSN_UNIT_BINS, what lies below
     * or above goes to the first or last bin. */
    double low, high;
    size_t bin[GSN_UNIT_BINS];
};

/* gives: one unit per tetrahedron of the spline's mesh. samples: tet_count counts as gsn_fit()
 * gives them, or NULL when every tetrahedron is to count as sampled (samples is then 0).
 * Fails with GSN_E_NOMEM, or as gsn_spline_tet_mean(). */
int gsn_units(const struct gsn_spline *spline, const struct gsn_mask *region,
              const uint32_t *samples, unsigned threads, struct gsn_unit **ret_units,
              struct gsn_error *err);

/* Histogram bins run from low to high (low < high), fixed by the caller so that specimens can be
 * compared. Fails with GSN_E_NOMEM. */
int gsn_units_summarise(const struct gsn_unit *units, size_t count, double low, double high,
                        struct gsn_units_summary *ret_summary, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
