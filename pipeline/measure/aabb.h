/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Axis-aligned boxes against half-spaces, tetrahedra and triangles: how much, and whether at all.
 * A box is given by its centre and its three half edges. */
#ifndef GSN_MEASURE_AABB_H
#define GSN_MEASURE_AABB_H

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_aabb {
    double centre[3], half[3];
};

/* Share, 0..1, of the cube [-1,1]^3 on which value + slope . t > 0; closed form, relative error of
 * the smaller of both parts about 1e-14. */
double gsn_aabb_share_above(double value, const double slope[3]);

/* Volume that a box and a tetrahedron (either orientation) have in common. */
double gsn_aabb_tet_volume(const struct gsn_aabb *box, const double corner[4][3]);

/* Whether a triangle meets the box, by the thirteen separating axes; touching counts. */
int gsn_aabb_meets_triangle(const struct gsn_aabb *box, const double corner[3][3]);

#ifdef __cplusplus
}
#endif
#endif
