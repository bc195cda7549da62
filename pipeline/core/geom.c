/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Plane affine maps and vectors of space, in closed form; the inverse is the adjugate over the
 * determinant. */
#include "pipeline/core/geom.h"

#include <assert.h>
#include <math.h>

struct gsn_point gsn_affine_apply(const struct gsn_affine *map, struct gsn_point p)
{
    return (struct gsn_point){ .x = map->m00 * p.x + map->m01 * p.y + map->m02,
                               .y = map->m10 * p.x + map->m11 * p.y + map->m12 };
}

struct gsn_affine gsn_affine_compose(const struct gsn_affine *first,
                                     const struct gsn_affine *second)
{
    const struct gsn_affine *a = first, *b = second;

    return (struct gsn_affine){ .m00 = b->m00 * a->m00 + b->m01 * a->m10,
                                .m01 = b->m00 * a->m01 + b->m01 * a->m11,
                                .m02 = b->m00 * a->m02 + b->m01 * a->m12 + b->m02,
                                .m10 = b->m10 * a->m00 + b->m11 * a->m10,
                                .m11 = b->m10 * a->m01 + b->m11 * a->m11,
                                .m12 = b->m10 * a->m02 + b->m11 * a->m12 + b->m12 };
}

double gsn_affine_det(const struct gsn_affine *map)
{
    return map->m00 * map->m11 - map->m01 * map->m10;
}

struct gsn_affine gsn_affine_inverse(const struct gsn_affine *map)
{
    const double det = gsn_affine_det(map);
    struct gsn_affine inverse;

    assert(det != 0);
    inverse = (struct gsn_affine){
        .m00 = map->m11 / det, .m01 = -map->m01 / det, .m10 = -map->m10 / det, .m11 = map->m00 / det
    };
    inverse.m02 = -(inverse.m00 * map->m02 + inverse.m01 * map->m12);
    inverse.m12 = -(inverse.m10 * map->m02 + inverse.m11 * map->m12);
    return inverse;
}

struct gsn_vec3 gsn_vec3_make(double x, double y, double z)
{
    return (struct gsn_vec3){ .x = x, .y = y, .z = z };
}

struct gsn_vec3 gsn_vec3_sub(struct gsn_vec3 a, struct gsn_vec3 b)
{
    return gsn_vec3_make(a.x - b.x, a.y - b.y, a.z - b.z);
}

struct gsn_vec3 gsn_vec3_cross(struct gsn_vec3 a, struct gsn_vec3 b)
{
    return gsn_vec3_make(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

double gsn_vec3_dot(struct gsn_vec3 a, struct gsn_vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

double gsn_vec3_length(struct gsn_vec3 a)
{
    return sqrt(gsn_vec3_dot(a, a));
}
