/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Points of the plane and of space, and plane affine maps.
 *
 * The block frame is in micrometres: x right and y down as in the scan, z along the cutting
 * direction. Pixel coordinates have pixel centres at +0.5. */
#ifndef GSN_CORE_GEOM_H
#define GSN_CORE_GEOM_H

#include <math.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_point {
    double x, y;
};

static inline double gsn_point_distance(struct gsn_point a, struct gsn_point b)
{
    return hypot(a.x - b.x, a.y - b.y);
}

struct gsn_vec3 {
    double x, y, z;
};

/* x' = m00 x + m01 y + m02;  y' = m10 x + m11 y + m12. */
struct gsn_affine {
    double m00, m01, m02, m10, m11, m12;
};

struct gsn_point gsn_affine_apply(const struct gsn_affine *map, struct gsn_point p);
/* first, then second. */
struct gsn_affine gsn_affine_compose(const struct gsn_affine *first,
                                     const struct gsn_affine *second);
/* The caller guarantees a determinant other than 0. */
struct gsn_affine gsn_affine_inverse(const struct gsn_affine *map);
double gsn_affine_det(const struct gsn_affine *map);

struct gsn_vec3 gsn_vec3_make(double x, double y, double z);
struct gsn_vec3 gsn_vec3_sub(struct gsn_vec3 a, struct gsn_vec3 b);
struct gsn_vec3 gsn_vec3_cross(struct gsn_vec3 a, struct gsn_vec3 b);
double gsn_vec3_dot(struct gsn_vec3 a, struct gsn_vec3 b);
double gsn_vec3_length(struct gsn_vec3 a);

/* Three numbers in a row, such as a colour, as a vector. */
static inline double gsn_dot3(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline double gsn_length3(const double v[3])
{
    return sqrt(gsn_dot3(v, v));
}

/* ret is neither a nor b. */
static inline void gsn_cross3(const double a[3], const double b[3], double ret[3])
{
    for (int c = 0; c < 3; c++)
        ret[c] = a[(c + 1) % 3] * b[(c + 2) % 3] - a[(c + 2) % 3] * b[(c + 1) % 3];
}

#ifdef __cplusplus
}
#endif
#endif
