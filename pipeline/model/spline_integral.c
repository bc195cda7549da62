/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Integrals of a spline: means over tetrahedra, ray integrals along whole lines, and along
 * segments.
 *
 * Method, each with its section of docs/MATH.md: the mean over a tetrahedron of the mesh is the
 * mean of its polynomial, which is the mean of the Bernstein coefficients, and what the faces
 * around add (13); over any other cell, the mean recurrence of every tetrahedron that reaches it
 * (5, equation (9) corrected); along a whole line, simplex splines projected along it (4, equations
 * (7) and (8)); along a segment, Gauss's rule between the points where it crosses knot triangles
 * (4).
 *
 * All are exact up to rounding: no step size, no sampling.
 * Failure: GSN_E_NOMEM, and GSN_E_INPUT for an end of a segment that is too far away or not finite;
 * an impossible line is NaN. Cost: a tetrahedron of the mesh one closed form a function; a cell
 * every tetrahedron that the search tree finds; a line or a segment all tetrahedra of the mesh. */
#include "pipeline/model/bpatch.h"
#include "pipeline/model/dms_internal.h"
#include "pipeline/model/face_correction.h"
#include "pipeline/model/orient.h"
#include "pipeline/model/simplex_mean.h"
#include "pipeline/model/simplex_spline.h"
#include "pipeline/model/spline.h"
#include "pipeline/model/spline_internal.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* --- mean over a tetrahedron of the mesh --- */

/* The mean of a spline over a tetrahedron of its mesh: that of its polynomial, and what the seams
 * of the faces around add. */

/* Whether a plane of the prism has the whole cell beyond it. */
static int cell_misses(const struct gsn_prism *prism, const double (*corner)[3])
{
    double d[4][3];

    for (int k = 0; k < 4; k++)
        gsn_subtract(corner[k], prism->origin, d[k]);
    for (int i = 0; i < 5; i++) {
        int beyond = 0;

        for (int k = 0; k < 4; k++)
            beyond += gsn_dot(prism->inside[i], d[k]) + prism->inside[i][3] < 0;
        if (beyond == 4)
            return 1;
    }
    return 0;
}

/* What the faces that belong to one tetrahedron add to the integral over the cell. */
static double faces_of(const struct gsn_spline *spline, size_t tet, const double (*corner)[3])
{
    double sum = 0;

    for (unsigned k = 0; k < 4; k++) {
        struct gsn_prism prism;
        struct gsn_face_correction seam;

        if (!gsn_prism_init(spline->space, tet, k, &prism) || cell_misses(&prism, corner))
            continue;
        gsn_face_correction_init(&seam, spline->space, &prism, spline->control);
        sum += gsn_face_correction_integral(&seam, corner);
    }
    return sum;
}

int gsn_spline_tet_mean(const struct gsn_spline *spline, size_t tet, double *ret_mean,
                        struct gsn_error *err)
{
    const struct gsn_tets *mesh = spline->space->mesh;
    const size_t functions = gsn_dms_functions(spline->space);
    double corner[4][3], mean = 0, seams = 0;
    struct gsn_sorted_batch ascent;
    struct gsn_bvh_box box;

    if (tet >= mesh->tet_count)
        return gsn_fail(err, GSN_E_INPUT, "tetrahedron %zu of %zu", tet, mesh->tet_count);
    for (size_t f = 0; f < functions; f++)
        mean += spline->bernstein[tet * functions + f];
    for (int k = 0; k < 4; k++)
        memcpy(corner[k], mesh->vertex[mesh->tet[tet][k]], sizeof corner[k]);
    box = gsn_bvh_box_around((const double(*)[3])corner, 4);
    gsn_sorted_batch_begin(&ascent);
    do {
        (void)gsn_bvh_meeting(spline->space->tree, &box, gsn_sorted_batch_add, &ascent);
        for (size_t i = 0; i < ascent.count; i++)
            seams += faces_of(spline, ascent.item[i], (const double(*)[3])corner);
    } while (gsn_sorted_batch_next(&ascent));
    *ret_mean = mean / (double)functions + seams / gsn_tets_volume(mesh, tet);
    return GSN_OK;
}

/* --- mean over any cell --- */

/* Means of a spline over tetrahedral cells. */

/* A cell, and what the tetrahedra visited so far have in it. */
struct visit {
    const struct gsn_spline *spline;
    const double (*corner)[3];
    struct gsn_bvh_box box;
    double mean;
};

/* Per corner the clouds k with lambda_k > delta_k; returns those that all corners have. */
static unsigned clear_of(const struct gsn_dms *space, size_t tet, const double (*corner)[3],
                         unsigned ret_clear[4])
{
    unsigned common = GSN_DMS_ALL;
    struct gsn_dms_shape shape;

    gsn_dms_shape_of(space, tet, &shape);
    for (int i = 0; i < 4; i++) {
        double lambda[4];

        gsn_barycentric_at(&shape.frame, corner[i], lambda);
        ret_clear[i] = gsn_dms_clear(&shape, lambda);
        common &= ret_clear[i];
    }
    return common;
}

/* The mean of a polynomial over a tetrahedron is that of its Bernstein coefficients. */
static double core_mean(const struct gsn_spline *spline, size_t tet, const double (*knot)[3],
                        const double (*corner)[3])
{
    const struct gsn_dms *space = spline->space;
    const double *at[4] = { corner[0], corner[1], corner[2], corner[3] };
    double control[GSN_DMS_MAX_FUNCTIONS], coefficient[GSN_DMS_MAX_FUNCTIONS], sum = 0;

    gsn_spline_gather(spline, tet, control);
    gsn_bpatch_bernstein(space->degree, knot, control, at, coefficient);
    for (size_t f = 0; f < gsn_dms_functions(space); f++)
        sum += coefficient[f];
    return sum / (double)gsn_dms_functions(space);
}

/* Functions that have no part in the cell keep a mean of 0. */
static void pieces_means(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                         const uint16_t *pick, const struct gsn_simplex_cell *cell,
                         double *ret_mean)
{
    for (size_t f = 0; f < sets->functions; f++) {
        ret_mean[f] = 0;
        if (!gsn_simplex_cell_misses(cell, sets->set[f].mask))
            ret_mean[f] = gsn_simplex_mean_by_pieces(sets, knot, pick, cell, f);
    }
}

static void add_tet(struct visit *visit, uint32_t tet)
{
    const struct gsn_dms *space = visit->spline->space;
    const struct gsn_simplex_sets *sets = space->sets;
    const unsigned knots = 4 * (space->degree + 1);
    const uint32_t *id = gsn_dms_control_ids(space, tet);
    double mean[GSN_DMS_MAX_FUNCTIONS], own[GSN_SIMPLEX_MAX_KNOTS][3];
    const double(*knot)[3] = (const double(*)[3])own;
    uint16_t pick[GSN_SIMPLEX_MAX_LARGE];
    struct gsn_simplex_cell cell;
    struct gsn_bvh_box box;
    double flat = 6 * GSN_ORIENT_BOUND;
    unsigned clear[4];

    gsn_dms_gather(space, tet, own);
    box = gsn_bvh_box_around(knot, knots);
    if (!gsn_bvh_box_meets(&box, &visit->box))
        return;
    if (clear_of(space, tet, visit->corner, clear) == GSN_DMS_ALL) {
        visit->mean += core_mean(visit->spline, tet, knot, visit->corner);
        return;
    }
    /* A determinant that rounding alone can make has six products, each at most this box. */
    for (int c = 0; c < 3; c++)
        flat *= box.high[c] - box.low[c];
    gsn_simplex_cell_init(&cell, visit->corner, knot, space->degree);
    if (gsn_simplex_cell_misses(&cell, (1u << knots) - 1))
        return;
    memcpy(cell.clear, clear, sizeof clear);
    if (gsn_simplex_pick(sets, knot, pick) > flat || gsn_dms_is_general(sets, knot))
        gsn_simplex_mean(sets, knot, pick, &cell, mean);
    else
        pieces_means(sets, knot, pick, &cell, mean);
    for (size_t f = 0; f < sets->functions; f++)
        visit->mean += visit->spline->control[id[f]] * mean[f] *
                       fabs(gsn_simplex_det(&sets->set[sets->corners[f]], knot));
}

int gsn_spline_cell_mean(const struct gsn_spline *spline, const double cell[4][3], double *ret_mean,
                         struct gsn_error *err)
{
    struct visit visit = { .spline = spline, .corner = cell, .box = gsn_bvh_box_around(cell, 4) };
    struct gsn_sorted_batch ascent;

    for (int i = 0; i < 4; i++) {
        for (int c = 0; c < 3; c++) {
            if (!isfinite(cell[i][c]))
                return gsn_fail(err, GSN_E_INPUT, "corner %d of the cell is not finite", i);
        }
    }
    if (gsn_orient3d(cell[0], cell[1], cell[2], cell[3]) == 0 ||
        gsn_det(cell[0], cell[1], cell[2], cell[3]) == 0)
        return gsn_fail(err, GSN_E_INPUT, "the cell is flat");
    gsn_sorted_batch_begin(&ascent);
    do {
        (void)gsn_bvh_meeting(spline->space->tree, &visit.box, gsn_sorted_batch_add, &ascent);
        for (size_t i = 0; i < ascent.count; i++)
            add_tet(&visit, ascent.item[i]);
    } while (gsn_sorted_batch_next(&ascent));
    *ret_mean = visit.mean;
    return GSN_OK;
}

/* --- integral along a whole line --- */

/* Integrals of a spline along whole lines. */

/* A line as two planes through it: a point's distances from them are its place in the picture. The
 * start is moved along the line beside the mesh, to where all tetrahedra agree on it. */
struct sight {
    double start[3], along[3], axis[2][3];
};

/* Any length will do, but 0; NaN when there is no direction. */
static void make_direction(double v[3])
{
    const double most = fmax(fabs(v[0]), fmax(fabs(v[1]), fabs(v[2])));
    double size;

    for (int c = 0; c < 3; c++)
        v[c] = most > 0 ? v[c] / most : NAN;
    size = sqrt(gsn_dot(v, v));
    for (int c = 0; c < 3; c++)
        v[c] /= size;
}

/* Returns 0 when p or d is no place or direction. */
static int sight_init(struct sight *sight, const struct gsn_dms *space, const double p[3],
                      const double d[3])
{
    const struct gsn_bvh_box *bounds = gsn_bvh_bounds(space->tree);
    double beside[3] = { 0, 0, 0 }, to[3], shift;
    double *along = sight->along;
    int least = 0;

    for (int c = 0; c < 3; c++) {
        if (!isfinite(p[c]) || !isfinite(d[c]))
            return 0;
        along[c] = d[c];
    }
    make_direction(along);
    for (int c = 0; c < 3; c++) {
        to[c] = (bounds->low[c] + bounds->high[c]) / 2 - p[c];
        if (fabs(along[c]) < fabs(along[least]))
            least = c;
    }
    shift = gsn_dot(to, along);
    for (int c = 0; c < 3; c++)
        sight->start[c] = p[c] + shift * along[c];
    if (!isfinite(shift) || !isfinite(sight->start[0] + sight->start[1] + sight->start[2]))
        return 0;
    beside[least] = 1;
    gsn_cross(along, beside, sight->axis[0]);
    make_direction(sight->axis[0]);
    gsn_cross(along, sight->axis[0], sight->axis[1]);
    return 1;
}

/* Whether all points lie on one side of the line, in the picture. */
static int is_beside(const double (*seen)[2], size_t count)
{
    unsigned sides = 15;

    for (size_t i = 0; i < count; i++)
        sides &= (seen[i][0] < 0) | (seen[i][0] > 0) << 1 | (seen[i][1] < 0) << 2 |
                 (seen[i][1] > 0) << 3;
    return sides != 0;
}

static double tet_line(const struct gsn_spline *spline, const struct sight *sight, size_t tet)
{
    const struct gsn_dms *space = spline->space;
    const struct gsn_simplex_sets *sets = space->sets;
    const uint32_t *id = gsn_dms_control_ids(space, tet);
    double knot[GSN_SIMPLEX_MAX_KNOTS][3], seen[GSN_SIMPLEX_MAX_KNOTS][2];
    double integral[GSN_DMS_MAX_FUNCTIONS], sum = 0;

    gsn_dms_gather(space, tet, knot);
    for (unsigned i = 0; i < 4 * (space->degree + 1); i++) {
        double to[3];

        gsn_subtract(knot[i], sight->start, to);
        seen[i][0] = gsn_dot(to, sight->axis[0]);
        seen[i][1] = gsn_dot(to, sight->axis[1]);
    }
    if (is_beside((const double(*)[2])seen, 4 * (space->degree + 1)) ||
        !gsn_simplex_line(sets, (const double(*)[2])seen, integral))
        return 0;
    for (size_t f = 0; f < sets->functions; f++) {
        if (integral[f] != 0)
            sum += spline->control[id[f]] * integral[f] *
                   fabs(gsn_simplex_det(&sets->set[sets->corners[f]], (const double(*)[3])knot));
    }
    return sum;
}

double gsn_spline_tet_line(const struct gsn_spline *spline, size_t tet, const double p[3],
                           const double d[3])
{
    struct sight sight;

    return sight_init(&sight, spline->space, p, d) ? tet_line(spline, &sight, tet) : NAN;
}

double gsn_spline_line(const struct gsn_spline *spline, const double p[3], const double d[3])
{
    struct gsn_sorted_batch ascent;
    struct sight sight;
    double sum = 0;

    if (!sight_init(&sight, spline->space, p, d))
        return NAN;
    gsn_sorted_batch_begin(&ascent);
    do {
        (void)gsn_bvh_along(spline->space->tree, sight.start, sight.along, gsn_sorted_batch_add,
                            &ascent);
        for (size_t i = 0; i < ascent.count; i++)
            sum += tet_line(spline, &sight, ascent.item[i]);
    } while (gsn_sorted_batch_next(&ascent));
    return sum;
}

/* --- integral along a segment --- */

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
static int clip_way(struct way *way, const struct extent *extent, double slack)
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
static int crosses_triangle(const struct way *way, const struct gsn_simplex_set *triple,
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
static size_t cut_way(const struct way *way, const struct gsn_simplex_sets *sets,
                      const double (*knot)[3], double ret_end[GSN_SIMPLEX_MAX_TRIPLES + 2])
{
    size_t count = 0;

    ret_end[count++] = way->from;
    for (size_t s = sets->first[3]; s < sets->first[2]; s++) {
        size_t at = count;
        double t;

        if (!crosses_triangle(way, &sets->set[s], knot, &t))
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
static double integrate_piece(const struct share *share, const struct way *way, double from,
                              double to)
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
    if (!clip_way(&way, &extent, 0))
        return 0;
    share.knot = (const double(*)[3])knot;
    gsn_simplex_pick(space->sets, share.knot, share.pick);
    for (size_t f = 0; f < gsn_dms_functions(space); f++)
        share.control[f] = gsn_spline_controls(spline)[id[f]];
    ends = cut_way(&way, space->sets, share.knot, end);
    for (size_t i = 1; i < ends; i++) {
        if (end[i - 1] < end[i])
            sum += integrate_piece(&share, &way, end[i - 1], end[i]);
    }
    return sum;
}

static double length_of(const double v[3])
{
    return hypot(hypot(v[0], v[1]), v[2]);
}

/* a + t (b - a) with a single rounding, or nearly so, however far away a and b are: the products
 * and sums carry their rounding errors along (Dekker 1971, Knuth). */
static double interpolate_along(double a, double b, double t)
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
static int approach_box(const double a[3], const double b[3], const struct extent *extent,
                        struct way *ret_way)
{
    struct way way = { .from = 0, .to = 1 };

    memcpy(way.start, a, sizeof way.start);
    gsn_subtract(b, a, way.along);
    if (!clip_way(&way, extent, NEAR_ENOUGH))
        return 0;
    for (int c = 0; c < 3; c++) {
        ret_way->start[c] = interpolate_along(a[c], b[c], way.from);
        ret_way->along[c] = interpolate_along(a[c], b[c], way.to) - ret_way->start[c];
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
    if (approach_box(a, b, &extent, &way)) {
        for (size_t t = 0; t < mesh->tet_count; t++)
            sum += tet_part(spline, t, &way);
        sum *= length_of(way.along);
    }
    *ret_integral = sum;
    return GSN_OK;
}
