/* SPDX-License-Identifier: AGPL-3.0-or-later */
#ifndef GSN_REGISTER_TISSUE_PAIRWISE_H
#define GSN_REGISTER_TISSUE_PAIRWISE_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How one section lies on another, by their tissue alone.
 *
 * Where no marks were burnt, or a section lost them, neighbouring sections still show the same
 * tissue. A section is reduced to cells and split into bands, each of details half as large as the
 * next; coarse bands find the rotation, the fine ones place it. How much a band counts is measured,
 * not chosen: with rho the correlation of the two sections in it, its information is that of
 * rho^2 / (1 - rho^2), so texture that does not reach from one section to the next says nothing.
 *
 * What tissue cannot tell: a structure that slants through the block looks like a section that was
 * shifted. Chains of sections registered by tissue therefore drift, which laser marks do not
 * (pose_graph.h). Motions are affine maps that are rigid, mirrored in x where the two sections
 * lie on different faces: determinant 1 or -1. Lengths are the caller's, pixel centres at +0.5. */

/* One section made ready: opaque. */
struct gsn_tissue;

/* The total optical density of a picture in cells of cell x cell pixels (1 or more, need not be
 * whole), white as the brightest hundredth of its cells. gives: ret_density. Fails with
 * GSN_E_INPUT when fewer than 16 x 16 cells fit; GSN_E_NOMEM. */
int gsn_tissue_reduce(const struct gsn_image *image, double cell, struct gsn_plane **ret_density,
                      struct gsn_error *err);

/* The bands of a section. density: in square cells whose side is cell long; the corner of the first
 * is the origin. Cells that are NaN count as glass. borrows: density. gives: ret_tissue. Fails with
 * GSN_E_INPUT when there are fewer than 16 x 16 cells or nothing differs from glass; GSN_E_NOMEM.
 */
int gsn_tissue_new(const struct gsn_plane *density, double cell, struct gsn_tissue **ret_tissue,
                   struct gsn_error *err);

void gsn_tissue_free(struct gsn_tissue *tissue);

GSN_DEFINE_AUTO(gsn_tissue);

/* Where its detail lies: the centre, and the root mean square distance from it. */
struct gsn_point gsn_tissue_centre(const struct gsn_tissue *tissue);

double gsn_tissue_radius(const struct gsn_tissue *tissue);

/* How section a lies on section b. */
struct gsn_tissue_match {
    struct gsn_affine a_to_b;
    /* Of the pose, by the curvature: shift in x and y at a's centre, turn in radians about it, all
     * in a's frame. */
    double covariance[3][3];
    double back; /* root mean square, over a's tissue, of the distance between registering a on b
                    and b on a; the motion is the mean of both */
    double evidence; /* logarithm of the likelihood ratio against sections that share nothing */
    double rival;    /* the same of the best other rotation or face that was tried */
    double spread; /* standard deviation of their difference by chance; rival and spread are 0 when
                      nothing was searched */
};

/* Searches all rotations, both faces and all shifts. gives: ret_match. Fails with GSN_E_MARKERS
 * when no rotation fits; GSN_E_NOMEM. */
int gsn_tissue_search(const struct gsn_tissue *a, const struct gsn_tissue *b,
                      struct gsn_tissue_match *ret_match, struct gsn_error *err);

/* From a motion that is nearly right: within some cells of the coarsest band. */
int gsn_tissue_refine(const struct gsn_tissue *a, const struct gsn_tissue *b,
                      const struct gsn_affine *start, struct gsn_tissue_match *ret_match,
                      struct gsn_error *err);

/* The columns of a block of tissue: squares of a grid across it. */
enum { GSN_TISSUE_COLUMNS_SIDE = 8, GSN_TISSUE_COLUMNS = 64 };

/* How far each column by itself pulls a motion that is the best of all: shift in x and y at a's
 * centre and turn, in a's frame; 0 for one that shows nothing. What columns pull apart is how the
 * sections differ in shape, and tells the motion's true error (pose_graph.h). to_grid: of a's
 * lengths to the grid, whose squares are 1 long, from 0; what lies outside is its rim's. */
void gsn_tissue_pulls(const struct gsn_tissue *a, const struct gsn_tissue *b,
                      const struct gsn_affine *a_to_b, const struct gsn_affine *to_grid,
                      double ret_pull[GSN_TISSUE_COLUMNS][3]);

/* The same in the two coarsest bands alone, for an eighth of the cost. ret_evidence is 0 where
 * nothing fits, and the motion stays. */
void gsn_tissue_refine_coarse(const struct gsn_tissue *a, const struct gsn_tissue *b,
                              const struct gsn_affine *start, struct gsn_affine *ret_a_to_b,
                              double *ret_evidence);

/* How far apart two motions put tissue of this centre and radius of gyration, root mean square. */
double gsn_tissue_apart(struct gsn_point centre, double radius, const struct gsn_affine *p,
                        const struct gsn_affine *q);

#ifdef __cplusplus
}
#endif

#endif
