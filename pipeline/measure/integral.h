/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Integrals of a spline over what a person points at: a box of the region, the cut of a plane
 * through it, a segment, the whole domain. In um. */
#ifndef GSN_MEASURE_INTEGRAL_H
#define GSN_MEASURE_INTEGRAL_H

#include "pipeline/core/grid.h"
#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: the voxels of the region whose centre c has low <= c < high along each axis, on the same
 * lattice: boxes that share a face divide the region between them. Fails with GSN_E_INPUT when none
 * has, or a side is not finite; GSN_E_NOMEM. */
int gsn_region_in_box(const struct gsn_mask *region, const double low[3], const double high[3],
                      struct gsn_mask **ret_part, struct gsn_error *err);

struct gsn_plane_cut {
    double area_um2; /* of the plane in the region's voxels */
    double integral; /* of s over it, s times um^2; by area_um2 it is the mean */
};

/* The plane through point across normal (of any length > 0). In every voxel that it cuts, s is
 * integrated over the polygon by a rule that is exact for polynomials of degree 4. A voxel's face
 * in the plane belongs to the voxel that the normal points into. The same bytes on any number of
 * threads (0: all). Fails with GSN_E_INPUT when the plane misses the region, is none, or leaves the
 * mesh inside the region; GSN_E_NOMEM. */
int gsn_region_cut(const struct gsn_spline *spline, const struct gsn_mask *region,
                   const double point[3], const double normal[3], unsigned threads,
                   struct gsn_plane_cut *ret_cut, struct gsn_error *err);

/* The integral of s over all tetrahedra, s times um^3: volumes times exact means (equation (9));
 * and their volume. Fails as gsn_spline_tet_mean(). */
int gsn_domain_integral(const struct gsn_spline *spline, unsigned threads, double *ret_volume_um3,
                        double *ret_integral, struct gsn_error *err);

/* How long the segment from a to b runs inside the mesh. Where it runs along faces they count once.
 * Fails with GSN_E_NOMEM. */
int gsn_segment_inside(const struct gsn_tets *mesh, const double a[3], const double b[3],
                       double *ret_um, struct gsn_error *err);

/* The integral of s along those parts of the segment that lie in the region's voxels, s times um,
 * and their length. Fails as gsn_spline_segment() does; GSN_E_NOMEM. */
int gsn_region_segment(const struct gsn_spline *spline, const struct gsn_mask *region,
                       const double a[3], const double b[3], double *ret_um, double *ret_integral,
                       struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
