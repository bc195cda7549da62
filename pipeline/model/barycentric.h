/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Vectors as three doubles, and the barycentric coordinates of a tetrahedron. */
#ifndef GSN_MODEL_BARYCENTRIC_H
#define GSN_MODEL_BARYCENTRIC_H

#include "pipeline/model/orient.h"

#include <math.h>

#ifdef __cplusplus
extern "C" {
#endif

static inline void gsn_subtract(const double a[3], const double b[3], double ret[3])
{
    for (int c = 0; c < 3; c++)
        ret[c] = a[c] - b[c];
}

static inline void gsn_cross(const double a[3], const double b[3], double ret[3])
{
    ret[0] = a[1] * b[2] - a[2] * b[1];
    ret[1] = a[2] * b[0] - a[0] * b[2];
    ret[2] = a[0] * b[1] - a[1] * b[0];
}

static inline double gsn_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* det[b - a, c - a, d - a]. */
static inline double gsn_det(const double a[3], const double b[3], const double c[3],
                             const double d[3])
{
    double p[3], q[3], r[3], normal[3];

    gsn_subtract(b, a, p);
    gsn_subtract(c, a, q);
    gsn_subtract(d, a, r);
    gsn_cross(p, q, normal);
    return gsn_dot(normal, r);
}

/* lambda_k(u) = row[k - 1] . (u - origin) for k = 1, 2, 3; lambda_0 is what is left to 1. So
 * row[k - 1] is the gradient of lambda_k. */
struct gsn_barycentric {
    double origin[3], row[3][3];
};

/* A determinant smaller than this share of the product of its edges has lost digits that slivers
 * cannot spare: then the rows are computed in twice the precision. */
#define GSN_BARYCENTRIC_FLAT 0x1p-9

/* The caller guarantees a determinant other than 0. */
static inline void gsn_barycentric_init(struct gsn_barycentric *frame, const double a[3],
                                        const double b[3], const double c[3], const double d[3])
{
    double edge[3][3], det, size = 1;

    gsn_subtract(b, a, edge[0]);
    gsn_subtract(c, a, edge[1]);
    gsn_subtract(d, a, edge[2]);
    for (int k = 0; k < 3; k++) {
        frame->origin[k] = a[k];
        gsn_cross(edge[(k + 1) % 3], edge[(k + 2) % 3], frame->row[k]);
    }
    det = gsn_dot(frame->row[0], edge[0]);
    for (int k = 0; k < 3; k++)
        size *= fabs(edge[k][0]) + fabs(edge[k][1]) + fabs(edge[k][2]);
    if (!(fabs(det) > GSN_BARYCENTRIC_FLAT * size)) {
        gsn_orient_rows(a, b, c, d, frame->row);
        return;
    }
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < 3; i++)
            frame->row[k][i] /= det;
    }
}

static inline void gsn_barycentric_at(const struct gsn_barycentric *frame, const double u[3],
                                      double ret_lambda[4])
{
    double d[3];

    gsn_subtract(u, frame->origin, d);
    for (int k = 0; k < 3; k++)
        ret_lambda[k + 1] = gsn_dot(frame->row[k], d);
    ret_lambda[0] = 1 - ret_lambda[1] - ret_lambda[2] - ret_lambda[3];
}

#ifdef __cplusplus
}
#endif
#endif
