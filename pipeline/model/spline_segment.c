/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/spline_segment.h"

#include "pipeline/model/dms_internal.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* A crossing beside a knot triangle by less than this share of the segment cuts, too: a cut too
 * many costs time, one too few is an error. */
#define SLACK 1e-9
/* Parameters of the whole segment are known to this. */
#define NEAR_ENOUGH 1e-15
/* Beyond, that is too much in terms of the mesh. */
#define FARTHEST 1e12

/* The part of a straight way that counts, in parameters of start + t * along. */
struct way {
    double start[3], along[3], from, to;
};

/* The box around some knots. */
struct extent {
    double low[3], high[3];
};

static struct extent extent_of(const double (*knot)[3], size_t count)
{
    struct extent extent;

    memcpy(extent.low, knot[0], sizeof extent.low);
    memcpy(extent.high, knot[0], sizeof extent.high);
    for (size_t i = 1; i < count; i++) {
        for (int c = 0; c < 3; c++) {
            extent.low[c] = fmin(extent.low[c], knot[i][c]);
            extent.high[c] = fmax(extent.high[c], knot[i][c]);
        }
    }
    return extent;
}

/* Shortens the way to its part in a box, and by slack less; returns 0 when there is none. */
static int clip(struct way *way, const struct extent *extent, double slack)
{
    for (int c = 0; c < 3; c++) {
        double in, out;

        if (way->along[c] == 0) {
            if (way->start[c] < extent->low[c] || way->start[c] > extent->high[c])
                return 0;
            continue;
        }
        in = (extent->low[c] - way->start[c]) / way->along[c];
        out = (extent->high[c] - way->start[c]) / way->along[c];
        way->from = fmax(way->from, fmin(in, out) - slack);
        way->to = fmin(way->to, fmax(in, out) + slack);
    }
    return way->from < way->to;
}

static void point_at(const struct way *way, double t, double ret[3])
{
    for (int c = 0; c < 3; c++)
        ret[c] = way->start[c] + t * way->along[c];
}

/* Whether the way crosses the triangle of three knots, or nearly so, and where. */
static int crosses(const struct way *way, const struct gsn_simplex_set *triple,
                   const double (*knot)[3], double *ret_t)
{
    double normal[3], to[3], corner[3][3], here[3], height, slope, near;
    struct extent extent;

    gsn_simplex_normal(triple, knot, normal, NULL);
    gsn_subtract(knot[triple->member[0]], way->start, to);
    height = gsn_dot(normal, to);
    slope = gsn_dot(normal, way->along);
    if (slope == 0 || !(height / slope > way->from && height / slope < way->to))
        return 0;
    *ret_t = height / slope;
    point_at(way, *ret_t, here);
    for (int i = 0; i < 3; i++)
        memcpy(corner[i], knot[triple->member[i]], sizeof corner[i]);
    extent = extent_of((const double(*)[3])corner, 3);
    near = SLACK * (fabs(way->along[0]) + fabs(way->along[1]) + fabs(way->along[2]));
    for (int c = 0; c < 3; c++) {
        if (here[c] < extent.low[c] - near || here[c] > extent.high[c] + near)
            return 0;
    }
    return 1;
}

/* The ends of the pieces between knot triangles, ascending; returns their number. */
static size_t cut(const struct way *way, const struct gsn_simplex_sets *sets,
                  const double (*knot)[3], double ret_end[GSN_SIMPLEX_MAX_TRIPLES + 2])
{
    size_t count = 0;

    ret_end[count++] = way->from;
    for (size_t s = sets->first[3]; s < sets->first[2]; s++) {
        size_t at = count;
        double t;

        if (!crosses(way, &sets->set[s], knot, &t))
            continue;
        for (; ret_end[at - 1] > t; at--)
            ret_end[at] = ret_end[at - 1];
        ret_end[at] = t;
        count++;
    }
    ret_end[count++] = way->to;
    return count;
}

/* What one tetrahedron contributes at one point of the way. */
struct share {
    const struct gsn_simplex_sets *sets;
    const double (*knot)[3];
    uint16_t pick[GSN_SIMPLEX_MAX_LARGE];
    double control[GSN_DMS_MAX_FUNCTIONS];
};

static double share_at(const struct share *share, const struct way *way, double t)
{
    double u[3], value[GSN_DMS_MAX_FUNCTIONS], sum = 0;

    point_at(way, t, u);
    gsn_simplex_basis(share->sets, share->knot, share->pick, u, 0, value, NULL);
    for (size_t f = 0; f < share->sets->functions; f++)
        sum += share->control[f] * value[f];
    return sum;
}

/* Gauss's rule: the middle for degree 1, two points for degrees 2 and 3. */
static double piece(const struct share *share, const struct way *way, double from, double to)
{
    const double middle = (from + to) / 2, half = (to - from) / 2, off = half / sqrt(3);

    if (share->sets->degree == 1)
        return 2 * half * share_at(share, way, middle);
    return half * (share_at(share, way, middle - off) + share_at(share, way, middle + off));
}

/* The integral over t of what one tetrahedron contributes. */
static double tet_part(const struct gsn_spline *spline, size_t tet, const struct way *whole)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const uint32_t *id = gsn_dms_control_ids(space, tet);
    struct way way = *whole;
    struct share share = { .sets = space->sets };
    double knot[GSN_SIMPLEX_MAX_KNOTS][3], end[GSN_SIMPLEX_MAX_TRIPLES + 2], sum = 0;
    struct extent extent;
    size_t ends;

    gsn_dms_gather(space, tet, knot);
    extent = extent_of((const double(*)[3])knot, 4 * (space->degree + 1));
    if (!clip(&way, &extent, 0))
        return 0;
    share.knot = (const double(*)[3])knot;
    gsn_simplex_pick(space->sets, share.knot, share.pick);
    for (size_t f = 0; f < gsn_dms_functions(space); f++)
        share.control[f] = gsn_spline_controls(spline)[id[f]];
    ends = cut(&way, space->sets, share.knot, end);
    for (size_t i = 1; i < ends; i++) {
        if (end[i - 1] < end[i])
            sum += piece(&share, &way, end[i - 1], end[i]);
    }
    return sum;
}

static double length_of(const double v[3])
{
    return hypot(hypot(v[0], v[1]), v[2]);
}

/* a + t (b - a) with a single rounding, or nearly so, however far away a and b are: the products
 * and sums carry their rounding errors along (Dekker 1971, Knuth). */
static double along(double a, double b, double t)
{
    const double d = b - a, back = d + a;
    const double d_low = (b - back) + (a - (back - d)); /* d + d_low is b - a exactly */
    const double step = t * d, step_low = fma(t, d, -step) + t * d_low;
    const double sum = a + step, part = sum - a;

    return sum + ((a - (sum - part)) + (step - part) + step_low);
}

/* The part of the segment near the box, begun again as a way of its own. The ends lie on the
 * segment but for a rounding of their own small coordinates, and outside the box if anything, so
 * that nothing is lost and no far end spoils what is near. */
static int approach(const double a[3], const double b[3], const struct extent *extent,
                    struct way *ret_way)
{
    struct way way = { .from = 0, .to = 1 };

    memcpy(way.start, a, sizeof way.start);
    gsn_subtract(b, a, way.along);
    if (!clip(&way, extent, NEAR_ENOUGH))
        return 0;
    for (int c = 0; c < 3; c++) {
        ret_way->start[c] = along(a[c], b[c], way.from);
        ret_way->along[c] = along(a[c], b[c], way.to) - ret_way->start[c];
    }
    ret_way->from = 0;
    ret_way->to = 1;
    return 1;
}

static int check_ends(const double a[3], const double b[3], const struct extent *extent,
                      struct gsn_error *err)
{
    double across[3], span[3];

    for (int c = 0; c < 3; c++) {
        if (!isfinite(a[c]) || !isfinite(b[c]))
            return gsn_fail(err, GSN_E_INPUT, "end %c of the segment is not finite",
                            isfinite(a[c]) ? 'b' : 'a');
        across[c] = extent->high[c] - extent->low[c];
        span[c] = fabs(a[c] - extent->low[c]) + fabs(b[c] - extent->low[c]);
    }
    if (!(length_of(span) < FARTHEST * length_of(across)))
        return gsn_fail(err, GSN_E_INPUT,
                        "an end of the segment is more than %.0e times farther away than the mesh "
                        "is large",
                        FARTHEST);
    return GSN_OK;
}

int gsn_spline_segment(const struct gsn_spline *spline, const double a[3], const double b[3],
                       double *ret_integral, struct gsn_error *err)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const struct extent extent =
        extent_of(gsn_dms_knots(space), mesh->vertex_count * (space->degree + 1));
    struct way way;
    double sum = 0;
    int r;

    assert(ret_integral);

    r = check_ends(a, b, &extent, err);
    if (r < 0)
        return r;
    if (approach(a, b, &extent, &way)) {
        for (size_t t = 0; t < mesh->tet_count; t++)
            sum += tet_part(spline, t, &way);
        sum *= length_of(way.along);
    }
    *ret_integral = sum;
    return GSN_OK;
}
