/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* On which side of a plane does a point lie? Answered exactly for any doubles whose products
 * neither overflow nor underflow.
 *
 * A floating point determinant settles nearly every question; only when it is smaller than its own
 * rounding bound is it recomputed in exact expansion arithmetic (Shewchuk, "Adaptive Precision
 * Floating-Point Arithmetic and Fast Robust Geometric Predicates", 1997). Simplex splines need
 * this: near mesh edges a single wrong sign costs not a rounding error but the whole value
 * (docs/MATH.md, section 9). */
#ifndef GSN_MODEL_ORIENT_H
#define GSN_MODEL_ORIENT_H

#ifdef __cplusplus
extern "C" {
#endif

/* A computed 3x3 determinant of coordinate differences larger than this many times its permanent
 * has the right sign: (7 + 56 e) e with e = 2^-53, rounded up. */
#define GSN_ORIENT_BOUND 1e-15

/* The sign -1, 0 or 1 of det[b - a, c - a, d - a]. */
int gsn_orient3d(const double a[3], const double b[3], const double c[3], const double d[3]);

/* The sign of det[b - a, c - a, u' - a] with u' = u + e (1,0,0) + e^2 (0,1,0) + e^3 (0,0,1) and
 * e -> 0+: the half-open rule. 0 only when a, b and c lie on one line. */
int gsn_orient_side(const double a[3], const double b[3], const double c[3], const double u[3]);

/* det[b - a, c - a, d - a] in twice the precision: right to its last digits however much of its
 * products cancels, up to 28 digits of them. What is divided by a small determinant needs that. */
double gsn_orient_value(const double a[3], const double b[3], const double c[3], const double d[3]);

/* The gradients of the barycentric coordinates 1, 2, 3 of a tetrahedron a, b, c, d in that
 * precision. The caller guarantees a determinant other than 0. */
void gsn_orient_rows(const double a[3], const double b[3], const double c[3], const double d[3],
                     double (*ret_row)[3]);

/* The sign of p_x q_y - p_y q_x. */
int gsn_orient_cross(const double p[2], const double q[2]);

#ifdef __cplusplus
}
#endif
#endif
