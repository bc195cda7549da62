/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Seams: what the knot clouds of a face add to the polynomials on its two sides.
 *
 * Let c_g^I(u), |g| = n - r, be the value after r steps of the B-patch recurrence of tetrahedron I
 * (bpatch.h) with all arguments u, and p_I = c_0^I its polynomial. Expanding every N by Micchelli's
 * recurrence with W = X_g for as long as the set has all four clouds leaves, everywhere in space,
 *
 *     s(u) = sum_I p_I(u) [u in I]
 *          + sum_f sum_g (c_g^I(u) - c_g^J(u)) plane_g(u) M(u | T_g),      1 <= |g| <= n,
 *
 * f = (i,j,k) the faces, I and J the tetrahedra on their sides, g the multi-indices on i, j, k,
 * T_g = {t_i,0..g_i, t_j,0..g_j, t_k,0..g_k}, and plane_g(u) = det[t_j,gj - t_i,gi,
 * t_k,gk - t_i,gi, u - t_i,gi] taken positive on the side of I. Where there is no J its part is
 * left out. With shared control points c_g^I = c_g^J for |g| = n, so that |g| stays below n.
 *
 * So s is one polynomial at u's own tetrahedron, corrected by those faces whose T_g hold u: thin
 * prisms around the faces. T_g has |g| + 3 knots, and M is of degree |g| - 1: at n = 2 the
 * corrections are three indicator functions of tetrahedra of knots.
 *
 * Which side of a knot plane a point lies on is decided in floating point where the value exceeds
 * its rounding error, and exactly elsewhere (orient.h). */
#ifndef GSN_MODEL_FACE_CORRECTION_H
#define GSN_MODEL_FACE_CORRECTION_H

#include "pipeline/model/dms_internal.h"
#include "pipeline/model/kernels.h"
#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A face, where its knots lie, and the prism that holds all of them. Plain memory. */
struct gsn_prism {
    size_t tet;         /* I, the one with the smaller number */
    unsigned corner;    /* of I, opposite the face */
    int64_t other;      /* J, or -1 */
    unsigned top;       /* greatest |g| */
    uint32_t vertex[3]; /* i < j < k */
    double side;        /* 1 or -1: of I's last vertex in the direction (j - i) x (k - i) */
    double size;        /* no knot is farther from the origin */
    double origin[3], turn[3][3]; /* the axes of the face: along i j, in its plane, normal */
    double at[3][2 * GSN_FACE_CORRECTION_MAX_KNOTS]; /* knots in these axes, then offsets from
                                                        vertices */
    /* Affine functions of d = u - origin: plane . (d, 1). u is in the prism when all of inside are
     * >= 0. Cloud m is clear, sets without it vanish at u, where clear[m] > 0. */
    double inside[5][4], clear[3][4];
};

/* The prism of the face opposite corner of tet. Returns 0, leaving ret_prism undefined, when the
 * face has nothing to add inside the mesh, or belongs to the tetrahedron on its other side. */
int gsn_prism_init(const struct gsn_dms *space, size_t tet, unsigned corner,
                   struct gsn_prism *ret_prism);

/* A bit per cloud that is not clear at u, or -1 when u is not in the prism. */
int gsn_prism_at(const struct gsn_prism *prism, const double u[3]);

/* A prism with all that its kernels need. Large: keep one per thread. borrows prism and space. */
struct gsn_face_correction {
    struct gsn_face_correction_data data;
    const struct gsn_face_correction_tables *tables;
    const struct gsn_kernels *kernels;
    const struct gsn_prism *prism;
    const double *knot[GSN_FACE_CORRECTION_MAX_KNOTS];
    unsigned degree;
    int all; /* prepared for points that are not clear of all clouds */
    double det[GSN_FACE_CORRECTION_MAX_LEAVES];
    uint8_t base[GSN_FACE_CORRECTION_MAX_NODES]; /* the leaf that is W */
};

/* control holds the control values of the space, or is NULL when only weights are wanted. */
void gsn_face_correction_init(struct gsn_face_correction *seam, const struct gsn_dms *space,
                              const struct gsn_prism *prism, const double *control);

/* Adds what the face has at count points to value and, unless slope is NULL, its gradient to
 * slope. The points are u[0][i], u[1][i], u[2][i]; all lie in the prism, and no cloud outside
 * unclear is unclear at any of them. */
void gsn_face_correction_add(struct gsn_face_correction *seam, unsigned unclear,
                             const double *const u[3], size_t count, double *value,
                             double *const slope[3]);

/* The number of T_g, in the order (1,0,0), (0,1,0), (0,0,1), (2,0,0), (1,1,0), (1,0,1), ... */
size_t gsn_face_correction_sets(unsigned top);

/* Prepares for points that are not clear of all clouds; the calls below do so themselves. */
void gsn_face_correction_complete(struct gsn_face_correction *seam);

/* plane_g M(T_g) at one point, all of them; positive on the side of (j - i) x (k - i). */
void gsn_face_correction_weights(struct gsn_face_correction *seam, unsigned unclear,
                                 const double u[3],
                                 double ret_weight[GSN_FACE_CORRECTION_MAX_SETS]);

/* The integral of what the face adds, over a tetrahedral cell of positive volume whose corners are
 * given in the axes of the mesh. On each tetrahedron of four knots the face adds a polynomial, so
 * the sum over them of the integral over its part in the cell is exact. */
double gsn_face_correction_integral(struct gsn_face_correction *seam, const double (*corner)[3]);

/* Seams at single points: which faces have something to add at u, and what it all sums to. */

/* Calls visit for every face whose seam may not vanish at u, by the tetrahedron with the smaller
 * number and its corner opposite the face, ascending, and for others; u lies in tetrahedron home.
 *
 * In the core of home there are none. Where only the corner opposite a face is not clear of its
 * cloud, on both sides of the face, there is but that face: the other faces of the two lie beyond
 * their knots, so the functions of the two sum to one, and as none is negative no others live. */
void gsn_face_correction_each(const struct gsn_dms *space, size_t home, const double u[3],
                              void (*visit)(void *context, size_t tet, unsigned corner),
                              void *context);

/* Adds what the faces have at u to the value of the polynomial of home and, unless it is NULL, to
 * its gradient. */
void gsn_spline_add_face_corrections(const struct gsn_spline *spline, size_t home,
                                     const double u[3], double *value, double *gradient);

/* All control points that s(u) depends on, ascending, and what a unit of each adds to it: with
 * adj_g the derivative of s(u) with respect to c_g (above) of one tetrahedron, adj_0 = 1 at home,
 * the weights of its faces on both their sides, and
 *
 *     adj_{g+e_j} += lambda_j(u | X_g) adj_g,      |g| = 0..n-1,      N_beta = adj_beta.
 *
 * Returns GSN_OK, or GSN_E_LIMIT when there are more than room. */
int gsn_face_correction_row(const struct gsn_dms *space, size_t home, const double u[3],
                            size_t room, uint32_t *ret_control, double *ret_value,
                            size_t *ret_count);

/* The jumps of a face: D_g(u) = side (c_g^I(u) - c_g^J(u)) as polynomials (above). */

/* All of them for 1 <= |g| <= top, g in the order of gsn_face_correction_weights(), each by its
 * monomials 1, x, y, z, xx, xy, xz, yy, yz, zz in the axes of the face, as far as its degree n -
 * |g| goes. */
void gsn_face_correction_jumps(const struct gsn_dms *space, const struct gsn_prism *prism,
                               const double *control, double *ret_poly);

#ifdef __cplusplus
}
#endif
#endif
