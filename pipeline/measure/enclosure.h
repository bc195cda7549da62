/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a spline can be on an axis-aligned box: a linear function plus an interval, guaranteed.
 *
 * Where one tetrahedron's functions are alone the spline is its polynomial, bounded by its tensor
 * Bernstein coefficients. Elsewhere the value at the centre is exact and the gradient is bounded by
 * the gradient coefficients that reach the box (see local_polynomial.h). Both get better as boxes
 * get smaller, the first with the square of the size, the second in proportion. Where the gradient
 * says nothing (control points that are not shared, boundary clouds that point inward) the
 * polynomials of all tetrahedra touched and their residual bounds are used. */
#ifndef GSN_MEASURE_ENCLOSURE_H
#define GSN_MEASURE_ENCLOSURE_H

#include "pipeline/measure/local_polynomial.h"

#ifdef __cplusplus
extern "C" {
#endif

/* All pieces of a spline. */
struct gsn_local_polynomials {
    const struct gsn_spline *spline;
    size_t count;
    struct gsn_local_polynomial *piece;
    struct gsn_local_polynomial_slope *slope;
    int shared;   /* whether neighbours agree on the control values of their common face */
    double slack; /* more than the rounding of s anywhere */
};

/* gives; keeps spline. threads 0: all. Fails with GSN_E_NOMEM. */
int gsn_local_polynomials_new(const struct gsn_spline *spline, unsigned threads,
                              struct gsn_local_polynomials **ret_pieces, struct gsn_error *err);
void gsn_local_polynomials_free(struct gsn_local_polynomials *pieces);
GSN_DEFINE_AUTO(gsn_local_polynomials);

/* On the box, s lies between linear + low and linear + high, and between least and most. After
 * gsn_enclosure_hull() only the last two are set. bent says that the interval is mostly the bend of
 * one polynomial, and not what smaller boxes escape. */
struct gsn_enclosure {
    struct gsn_local_polynomial_linear linear;
    double low, high;
    double least, most;
    int bent;
};

/* tet: count tetrahedra, among them all whose functions reach the box. Cheap: by the coefficients
 * of the tetrahedra touched. *ret_deepest: which holds the box's centre; the caller guarantees that
 * one does. */
void gsn_enclosure_hull(const struct gsn_local_polynomials *pieces, const uint32_t *tet,
                        size_t count, const struct gsn_aabb *box, struct gsn_enclosure *ret_bracket,
                        uint32_t *ret_deepest);
/* Sets the rest. */
void gsn_enclosure_tighten(const struct gsn_local_polynomials *pieces, const uint32_t *tet,
                           size_t count, const struct gsn_aabb *box, uint32_t deepest,
                           struct gsn_enclosure *bracket);

#ifdef __cplusplus
}
#endif
#endif
