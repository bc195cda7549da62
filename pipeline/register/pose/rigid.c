/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: the planar Procrustes problem without scale, in closed form (Schoenemann 1966; Umeyama
 * 1991): both sets about their weighted centroids, and the angle whose cosine and sine are as the
 * sum of the dot products to the sum of the cross products.
 *
 * Fails where a set of points coincides, where every rotation fits equally badly, and where a
 * coordinate is not finite; these are told relative to the coordinates' own size. Cost: two passes
 * over the points. It is short because everything stands on it: correspondence, poses, strain. */
#include "pipeline/register/pose/rigid.h"

#include <assert.h>
#include <math.h>

/* A spread below this share of the coordinates themselves is rounding, not a triangle. */
static const double COINCIDING = 1e-12;

static struct gsn_point find_centroid(const struct gsn_point *p, const double *weight, size_t count)
{
    double sum = 0, x = 0, y = 0;

    for (size_t i = 0; i < count; i++) {
        const double w = weight ? weight[i] : 1;

        sum += w;
        x += w * p[i].x;
        y += w * p[i].y;
    }
    return (struct gsn_point){ x / sum, y / sum };
}

/* Weighted second moments about the centroids: of either set, and the two between them. */
struct moments {
    double from, onto, dot, cross, weight;
    double magnitude; /* largest squared distance of any point from the origin */
};

static struct moments moments_of(const struct gsn_point *from, struct gsn_point cf,
                                 const struct gsn_point *onto, struct gsn_point co,
                                 const double *weight, size_t count)
{
    struct moments m = { 0 };

    for (size_t i = 0; i < count; i++) {
        const double w = weight ? weight[i] : 1;
        const double fx = from[i].x - cf.x, fy = from[i].y - cf.y;
        const double ox = onto[i].x - co.x, oy = onto[i].y - co.y;

        m.weight += w;
        m.from += w * (fx * fx + fy * fy);
        m.onto += w * (ox * ox + oy * oy);
        m.dot += w * (fx * ox + fy * oy);
        m.cross += w * (fx * oy - fy * ox);
        m.magnitude = fmax(m.magnitude, from[i].x * from[i].x + from[i].y * from[i].y);
        m.magnitude = fmax(m.magnitude, onto[i].x * onto[i].x + onto[i].y * onto[i].y);
    }
    return m;
}

static double rms_left(const struct gsn_rigid *motion, const struct gsn_point *from,
                       const struct gsn_point *onto, const double *weight, size_t count)
{
    double sum = 0, squares = 0;

    for (size_t i = 0; i < count; i++) {
        const double w = weight ? weight[i] : 1;
        const struct gsn_point p = gsn_rigid_apply(motion, from[i]);
        const double dx = p.x - onto[i].x, dy = p.y - onto[i].y;

        sum += w;
        squares += w * (dx * dx + dy * dy);
    }
    return sqrt(squares / sum);
}

int gsn_rigid_fit(const struct gsn_point *from, const struct gsn_point *onto, const double *weight,
                  size_t count, struct gsn_rigid *ret_motion, double *ret_rms,
                  struct gsn_error *err)
{
    struct gsn_point cf, co;
    struct gsn_rigid motion;
    struct moments m;
    double length, floor;

    assert(from && onto && count >= 2 && ret_motion);

    cf = find_centroid(from, weight, count);
    co = find_centroid(onto, weight, count);
    m = moments_of(from, cf, onto, co, weight, count);
    if (!isfinite(m.from) || !isfinite(m.onto) || !isfinite(m.dot) || !isfinite(m.cross))
        return gsn_fail(err, GSN_E_MARKERS, "a mark's position is not finite");
    floor = COINCIDING * COINCIDING * m.weight * m.magnitude;
    if (m.from <= floor || m.onto <= floor)
        return gsn_fail(err, GSN_E_MARKERS,
                        "%zu marks coincide: the section's rotation cannot be told", count);
    length = hypot(m.dot, m.cross);
    if (length <= COINCIDING * sqrt(m.from * m.onto))
        return gsn_fail(err, GSN_E_MARKERS,
                        "the two sets of marks fit equally badly at every rotation");

    motion.cos = m.dot / length;
    motion.sin = m.cross / length;
    motion.dx = co.x - (motion.cos * cf.x - motion.sin * cf.y);
    motion.dy = co.y - (motion.sin * cf.x + motion.cos * cf.y);
    *ret_motion = motion;
    if (ret_rms)
        *ret_rms = rms_left(&motion, from, onto, weight, count);
    return GSN_OK;
}

struct gsn_point gsn_rigid_apply(const struct gsn_rigid *motion, struct gsn_point p)
{
    return (struct gsn_point){ motion->cos * p.x - motion->sin * p.y + motion->dx,
                               motion->sin * p.x + motion->cos * p.y + motion->dy };
}

struct gsn_affine gsn_rigid_to_affine(const struct gsn_rigid *motion, double px_um, int flipped)
{
    const double mirror = flipped ? -1 : 1;

    return (struct gsn_affine){ .m00 = mirror * px_um * motion->cos,
                                .m01 = -px_um * motion->sin,
                                .m02 = motion->dx,
                                .m10 = mirror * px_um * motion->sin,
                                .m11 = px_um * motion->cos,
                                .m12 = motion->dy };
}
