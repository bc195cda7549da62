/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The boundary layer of a tetrahedron: where functions of its neighbours reach in, and how far.
 *
 * Method: equation (10) of the paper: beside the polynomial of the tetrahedron a spline is an
 * average of coefficient differences with weights that are not negative, so their extremes bound
 * it. A bound that shrinks with the cell comes from the exact value at its centroid and from the
 * coefficients of the gradient of the difference, with 0 <= M <= 1 / |det W| (the header derives
 * it).
 *
 * Steps of making: the differences of all functions that reach the tetrahedron, their gradients,
 * the jumps across faces when control points are not shared, and the hull of the knots of each.
 * Steps of bounding: those hulls that separating planes do not keep from the cell, then the
 * extremes.
 *
 * Failure: GSN_E_NOMEM while making; bounds never fail, they get wide.
 * Cost: making, some hundred polar values a tetrahedron; bounding, a few planes a hull. */
#include "pipeline/measure/boundary_layer.h"

#include "pipeline/model/bpatch.h"
#include "pipeline/model/barycentric.h"
#include "pipeline/model/simplex_spline.h"

#include <math.h>
#include <string.h>

/* --- whether a hull of knots reaches a cell --- */

enum { STEPS = 12 };

/* Of the largest coordinate. */
static const double hull_margin = 4e-15;

/* Adds one knot to a hull; an empty one has count 0. */
static void add_to_hull(struct gsn_boundary_layer_hull *hull, const double knot[3])
{
    memcpy(hull->knot[hull->count], knot, sizeof hull->knot[0]);
    for (int a = 0; a < 3; a++) {
        hull->low[a] = hull->count > 0 ? fmin(hull->low[a], knot[a]) : knot[a];
        hull->high[a] = hull->count > 0 ? fmax(hull->high[a], knot[a]) : knot[a];
    }
    hull->count++;
}

/* The knot of the hull least far along a direction, less the corner of the cell furthest along it.
 * Returns the component of that along the direction: at least 0 when the direction separates. */
static double gap_along(const struct gsn_boundary_layer_hull *hull, const struct gsn_tet_cell *cell,
                        const double way[3], double ret_difference[3])
{
    double least = INFINITY, most = -INFINITY;
    const double *knot = hull->knot[0], *corner = cell->corner[0];

    for (unsigned i = 0; i < hull->count; i++) {
        const double at = gsn_dot(way, hull->knot[i]);

        if (at < least) {
            least = at;
            knot = hull->knot[i];
        }
    }
    for (int k = 0; k < 4; k++) {
        const double at = gsn_dot(way, cell->corner[k]);

        if (at > most) {
            most = at;
            corner = cell->corner[k];
        }
    }
    gsn_subtract(knot, corner, ret_difference);
    return gsn_dot(way, ret_difference);
}

static int way_separates(const struct gsn_boundary_layer_hull *hull,
                         const struct gsn_tet_cell *cell, const double way[3], double reach,
                         double ret_difference[3])
{
    return gap_along(hull, cell, way, ret_difference) >=
           -hull_margin * reach * sqrt(gsn_dot(way, way));
}

/* The faces of a tetrahedron as seen from outside or inside: where cells touch, only a face's own
 * plane tells. */
static int faces_separate(const struct gsn_boundary_layer_hull *hull,
                          const struct gsn_tet_cell *cell, double reach)
{
    for (int k = 0; k < 4; k++) {
        const double *a = cell->corner[(k + 1) % 4];
        double b[3], c[3], top[3], way[3], difference[3];

        gsn_subtract(cell->corner[(k + 2) % 4], a, b);
        gsn_subtract(cell->corner[(k + 3) % 4], a, c);
        gsn_subtract(a, cell->corner[k], top);
        gsn_cross(b, c, way);
        if (gsn_dot(way, top) < 0.0) {
            for (int i = 0; i < 3; i++)
                way[i] = -way[i];
        }
        if (way_separates(hull, cell, way, reach, difference))
            return 1;
    }
    return 0;
}

/* Gilbert's search for the shortest difference of a point of the hull and one of the cell; every
 * direction it tries may turn out to separate. */
static int search_separates(const struct gsn_boundary_layer_hull *hull,
                            const struct gsn_tet_cell *cell, double reach)
{
    double at[3], next[3];

    gsn_subtract(hull->knot[0], cell->corner[0], at);
    for (int step = 0; step < STEPS; step++) {
        double back[3], length, t;

        if (way_separates(hull, cell, at, reach, next))
            return gsn_dot(at, at) > 0.0;
        gsn_subtract(at, next, back);
        length = gsn_dot(back, back);
        if (!(length > 0.0))
            return 0;
        t = fmin(1.0, fmax(0.0, gsn_dot(at, back) / length));
        for (int i = 0; i < 3; i++)
            at[i] -= t * back[i];
    }
    return 0;
}

/* 0 only when a plane was found that has the two on different sides, where touching, and what may
 * be the rounding of touching, counts as different sides; what is lost by that is a layer of about
 * 1e-15 of the coordinates. */
static int hull_reaches(const struct gsn_boundary_layer_hull *hull, const struct gsn_tet_cell *cell)
{
    double reach = 0.0;

    for (int a = 0; a < 3; a++) {
        double low = INFINITY, high = -INFINITY;

        for (int k = 0; k < 4; k++) {
            low = fmin(low, cell->corner[k][a]);
            high = fmax(high, cell->corner[k][a]);
        }
        if (hull->low[a] >= high || hull->high[a] <= low)
            return 0;
        reach = fmax(reach, fmax(fmax(fabs(low), fabs(high)),
                                 fmax(fabs(hull->low[a]), fabs(hull->high[a]))));
    }
    return !faces_separate(hull, cell, reach) && !search_separates(hull, cell, reach);
}

/* --- making --- */

/* Values, coefficients and polar values are good to about 1e-14 of the largest control value; next
 * to knot planes 1e-12. */
static const double value_slack = 1e-11;

/* One tetrahedron that may act in the skin's. */
struct actor {
    uint32_t tet;
    struct gsn_tet_cell corner;
    double knot[4 * (GSN_DMS_MAX_DEGREE + 1)][3], d[GSN_DMS_MAX_FUNCTIONS];
};

struct cast {
    struct gsn_boundary_layer *skin;
    const struct gsn_dms *space;
    struct gsn_tet_cell home;
    struct actor *actor;
    size_t count;
    size_t value_room, slope_room;
};

static void gather_knots(const struct gsn_dms *space, size_t tet, double (*ret_knot)[3])
{
    const size_t cloud = gsn_dms_degree(space) + 1U;

    for (size_t k = 0; k < 4; k++)
        memcpy(ret_knot + k * cloud,
               gsn_dms_knots(space) + gsn_dms_mesh(space)->tet[tet][k] * cloud,
               cloud * sizeof *ret_knot);
}

/* Whether the boxes around the knots of a tetrahedron and around home overlap. */
static int is_near(const struct cast *cast, const double (*knot)[3])
{
    const unsigned knots = 4U * (cast->skin->degree + 1U);

    for (int a = 0; a < 3; a++) {
        double low = INFINITY, high = -INFINITY, least = INFINITY, most = -INFINITY;

        for (unsigned i = 0; i < knots; i++) {
            low = fmin(low, knot[i][a]);
            high = fmax(high, knot[i][a]);
        }
        for (int k = 0; k < 4; k++) {
            least = fmin(least, cast->home.corner[k][a]);
            most = fmax(most, cast->home.corner[k][a]);
        }
        if (low >= most || high <= least)
            return 0;
    }
    return 1;
}

static int is_own_control(const struct cast *cast, uint32_t control)
{
    const uint32_t *id = gsn_dms_control_ids(cast->space, cast->skin->tet);

    for (size_t f = 0; f < gsn_dms_functions(cast->space); f++) {
        if (id[f] == control)
            return 1;
    }
    return 0;
}

/* F_I at the knots t_{k,0..beta_k-1}. */
static double polar_of(const struct gsn_boundary_layer *skin, const double (*knot)[3],
                       const uint8_t beta[4])
{
    const double *arg[GSN_DMS_MAX_DEGREE];
    unsigned n = 0;

    for (unsigned k = 0; k < 4; k++) {
        for (unsigned l = 0; l < beta[k]; l++)
            arg[n++] = knot[k * (skin->degree + 1U) + l];
    }
    return gsn_bpatch_polar(skin->degree, (const double(*)[3])skin->knot, skin->control, arg);
}

/* The polar value at knots of its own is home's own control value: there d is 0 exactly. */
static void find_d(const struct cast *cast, struct actor *actor)
{
    struct gsn_boundary_layer *skin = cast->skin;
    const uint32_t *id = gsn_dms_control_ids(cast->space, actor->tet);

    for (size_t f = 0; f < gsn_dms_functions(cast->space); f++) {
        const double control = gsn_spline_controls(skin->spline)[id[f]];

        actor->d[f] = control;
        if (skin->whole) {
            const double polar =
                polar_of(skin, (const double(*)[3])actor->knot, gsn_dms_beta(cast->space, f));

            actor->d[f] = is_own_control(cast, id[f]) ? 0.0 : control - polar;
            skin->slack = fmax(skin->slack, value_slack * fabs(polar));
        }
        skin->slack = fmax(skin->slack, value_slack * fabs(control));
    }
}

static void find_actors(struct cast *cast, const uint32_t *near, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        struct actor *actor = &cast->actor[cast->count];

        actor->tet = near[i];
        gather_knots(cast->space, near[i], actor->knot);
        if (!is_near(cast, (const double(*)[3])actor->knot))
            continue;
        for (unsigned k = 0; k < 4; k++)
            memcpy(actor->corner.corner[k], actor->knot[k * (cast->skin->degree + 1U)],
                   sizeof actor->corner.corner[k]);
        find_d(cast, actor);
        cast->count++;
    }
}

static const struct actor *actor_of(const struct cast *cast, int32_t tet)
{
    for (size_t i = 0; i < cast->count; i++) {
        if ((int32_t)cast->actor[i].tet == tet)
            return &cast->actor[i];
    }
    return NULL;
}

/* The knots t_{k,0..beta_k} of all clouds but one (4: of all). */
static void hull_of(const struct gsn_boundary_layer *skin, const struct actor *actor,
                    const uint8_t beta[4], unsigned without,
                    struct gsn_boundary_layer_hull *ret_hull)
{
    ret_hull->count = 0;
    for (unsigned k = 0; k < 4; k++) {
        for (unsigned l = 0; k != without && l <= beta[k]; l++)
            add_to_hull(ret_hull, actor->knot[k * (skin->degree + 1U) + l]);
    }
}

/* The caller keeps value.d other than 0. */
static int keep_value(struct cast *cast, const struct gsn_boundary_layer_value *value,
                      struct gsn_error *err)
{
    struct gsn_boundary_layer *skin = cast->skin;

    if (!hull_reaches(&value->hull, &cast->home))
        return GSN_OK;
    if (skin->values == cast->value_room) {
        const size_t room = 2 * cast->value_room + 64;
        struct gsn_boundary_layer_value *grown =
            gsn_realloc_array(skin->value, room, sizeof *grown);

        if (!grown)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu functions", room);
        skin->value = grown;
        cast->value_room = room;
    }
    skin->value[skin->values++] = *value;
    return GSN_OK;
}

static int keep_slope(struct cast *cast, const struct gsn_boundary_layer_slope *slope,
                      struct gsn_error *err)
{
    struct gsn_boundary_layer *skin = cast->skin;

    if (!hull_reaches(&slope->hull, &cast->home))
        return GSN_OK;
    if (skin->slopes == cast->slope_room) {
        const size_t room = 2 * cast->slope_room + 64;
        struct gsn_boundary_layer_slope *grown =
            gsn_realloc_array(skin->slope, room, sizeof *grown);

        if (!grown)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu slopes", room);
        skin->slope = grown;
        cast->slope_room = room;
    }
    skin->slope[skin->slopes++] = *slope;
    return GSN_OK;
}

static int add_values(struct cast *cast, const struct actor *actor, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t f = 0; r == GSN_OK && f < gsn_dms_functions(cast->space); f++) {
        struct gsn_boundary_layer_value value = { .d = actor->d[f] };

        if (value.d < 0.0 || value.d > 0.0) {
            hull_of(cast->skin, actor, gsn_dms_beta(cast->space, f), 4, &value.hull);
            r = keep_value(cast, &value, err);
        }
    }
    return r;
}

/* G_g. */
static void mean_slope(const struct gsn_boundary_layer *skin, const struct actor *actor,
                       const uint8_t g[4], double ret_gradient[3])
{
    const unsigned cloud = skin->degree + 1U;
    struct gsn_barycentric frame;
    double at[4];

    gsn_barycentric_init(&frame, actor->knot[g[0]], actor->knot[cloud + g[1]],
                         actor->knot[2 * cloud + g[2]], actor->knot[3 * cloud + g[3]]);
    for (unsigned k = 0; k < 4; k++) {
        uint8_t beta[4];

        memcpy(beta, g, sizeof beta);
        beta[k]++;
        at[k] = actor->d[gsn_simplex_place(beta)];
    }
    for (int a = 0; a < 3; a++) {
        ret_gradient[a] = 0.0;
        for (int k = 0; k < 3; k++)
            ret_gradient[a] += skin->degree * (at[k + 1] - at[0]) * frame.row[k][a];
    }
}

static int add_means(struct cast *cast, const struct actor *actor, struct gsn_error *err)
{
    uint8_t g[4] = { (uint8_t)(cast->skin->degree - 1U), 0, 0, 0 };
    int r = GSN_OK;

    do {
        struct gsn_boundary_layer_slope slope = { .jump = 0 };

        mean_slope(cast->skin, actor, g, slope.gradient);
        hull_of(cast->skin, actor, g, 4, &slope.hull);
        if (gsn_dot(slope.gradient, slope.gradient) > 0.0)
            r = keep_slope(cast, &slope, err);
    } while (r == GSN_OK && gsn_simplex_next(g));
    return r;
}

/* The largest |det| of any four knots. */
static double largest_det(const struct gsn_boundary_layer_hull *hull)
{
    const double(*knot)[3] = hull->knot;
    double most = 0.0;

    for (unsigned a = 0; a < hull->count; a++) {
        for (unsigned b = a + 1; b < hull->count; b++) {
            for (unsigned c = b + 1; c < hull->count; c++) {
                for (unsigned d = c + 1; d < hull->count; d++)
                    most = fmax(most, fabs(gsn_det(knot[a], knot[b], knot[c], knot[d])));
            }
        }
    }
    return most;
}

/* d_beta less that of the other side of face k of a tetrahedron, where it is 0 when nothing there
 * acts; 0 when both sides share the control point. */
static double jump_of(const struct cast *cast, const struct actor *actor, unsigned k, size_t f)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(cast->space);
    const struct actor *other = actor_of(cast, mesh->neighbour[actor->tet][k]);
    uint8_t beta[4] = { 0, 0, 0, 0 };
    size_t place;

    if (!other)
        return actor->d[f];
    for (unsigned j = 0; j < 4; j++) {
        for (unsigned i = 0; i < 4; i++) {
            if (i != k && mesh->tet[actor->tet][i] == mesh->tet[other->tet][j])
                beta[j] = gsn_dms_beta(cast->space, f)[i];
        }
    }
    place = gsn_simplex_place(beta);
    if (gsn_dms_control_ids(cast->space, actor->tet)[f] ==
        gsn_dms_control_ids(cast->space, other->tet)[place])
        return 0.0;
    return actor->d[f] - other->d[place];
}

/* (b - a) x (c - a) of t_{j,beta_j}, j != k, towards corner k. */
static void face_normal(const struct gsn_boundary_layer *skin, const struct actor *actor,
                        const uint8_t beta[4], unsigned k, double ret_normal[3])
{
    const unsigned cloud = skin->degree + 1U;
    const unsigned i = (k + 1) % 4, j = (k + 2) % 4, l = (k + 3) % 4;
    const double *a = actor->knot[i * cloud + beta[i]];
    double b[3], c[3], top[3];

    gsn_subtract(actor->knot[j * cloud + beta[j]], a, b);
    gsn_subtract(actor->knot[l * cloud + beta[l]], a, c);
    gsn_subtract(actor->knot[k * cloud], a, top);
    gsn_cross(b, c, ret_normal);
    if (gsn_dot(ret_normal, top) < 0.0) {
        for (int x = 0; x < 3; x++)
            ret_normal[x] = -ret_normal[x];
    }
}

static int add_jump(struct cast *cast, const struct actor *actor, unsigned k, size_t f,
                    struct gsn_error *err)
{
    const uint8_t *beta = gsn_dms_beta(cast->space, f);
    const double jump = beta[k] > 0 ? 0.0 : jump_of(cast, actor, k, f);
    struct gsn_boundary_layer_slope slope = { .jump = 1 };
    double normal[3], det;

    if (!(jump < 0.0 || jump > 0.0))
        return GSN_OK;
    hull_of(cast->skin, actor, beta, k, &slope.hull);
    det = largest_det(&slope.hull);
    face_normal(cast->skin, actor, beta, k, normal);
    for (int a = 0; a < 3; a++)
        slope.gradient[a] = det > 0.0 ? cast->skin->degree * jump * normal[a] / det : INFINITY;
    return keep_slope(cast, &slope, err);
}

/* The terms of face k; a face inside the mesh is its lower tetrahedron's. */
static int add_jumps(struct cast *cast, const struct actor *actor, unsigned k,
                     struct gsn_error *err)
{
    const int32_t beyond = gsn_dms_mesh(cast->space)->neighbour[actor->tet][k];
    int r = GSN_OK;

    if (beyond >= 0 && beyond < (int32_t)actor->tet && actor_of(cast, beyond))
        return GSN_OK;
    for (size_t f = 0; r == GSN_OK && f < gsn_dms_functions(cast->space); f++)
        r = add_jump(cast, actor, k, f, err);
    return r;
}

static int add_actor(struct cast *cast, const struct actor *actor, struct gsn_error *err)
{
    int r = add_values(cast, actor, err);

    if (r == GSN_OK)
        r = add_means(cast, actor, err);
    for (unsigned k = 0; r == GSN_OK && k < 4; k++)
        r = add_jumps(cast, actor, k, err);
    return r;
}

static void begin_cast(struct cast *cast, size_t tet)
{
    struct gsn_boundary_layer *skin = cast->skin;
    const uint32_t *id = gsn_dms_control_ids(cast->space, tet);

    skin->tet = tet;
    skin->degree = gsn_dms_degree(cast->space);
    skin->whole = gsn_dms_is_whole(cast->space, tet);
    gather_knots(cast->space, tet, skin->knot);
    for (size_t f = 0; f < gsn_dms_functions(cast->space); f++)
        skin->control[f] = gsn_spline_controls(skin->spline)[id[f]];
    for (unsigned k = 0; k < 4; k++)
        memcpy(cast->home.corner[k], skin->knot[k * (skin->degree + 1U)],
               sizeof cast->home.corner[k]);
}

int gsn_boundary_layer_new(const struct gsn_spline *spline, size_t tet, const uint32_t *near,
                           size_t count, struct gsn_boundary_layer **ret_skin,
                           struct gsn_error *err)
{
    gsn_auto(gsn_boundary_layer) skin = gsn_alloc_array(1, sizeof *skin);
    gsn_auto_mem(struct actor) actor = gsn_alloc_array(count, sizeof *actor);
    struct cast cast = { .skin = skin, .space = gsn_spline_space(spline), .actor = actor };
    int r = GSN_OK;

    if (!skin || !actor)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", count);
    skin->spline = spline;
    begin_cast(&cast, tet);
    find_actors(&cast, near, count);
    for (size_t i = 0; r == GSN_OK && i < cast.count; i++)
        r = add_actor(&cast, &actor[i], err);
    if (r < 0)
        return r;
    *ret_skin = gsn_steal(&skin);
    return GSN_OK;
}

void gsn_boundary_layer_free(struct gsn_boundary_layer *skin)
{
    if (!skin)
        return;
    gsn_free(skin->value);
    gsn_free(skin->slope);
    gsn_free(skin);
}

/* --- bounding on cells --- */

/* Of a slope: more than its rounding. */
static const double slope_slack = 1e-11;
/* Of the largest coordinate: what counts as on a plane. */
static const double plane_margin = 4e-15;

/* Whether the cell lies on corner k's side of the plane through three knots, or touches it. */
static int is_inner(const double a[3], const double b[3], const double c[3], const double top[3],
                    const struct gsn_tet_cell *cell)
{
    double p[3], q[3], up[3], normal[3], size, sign;

    gsn_subtract(b, a, p);
    gsn_subtract(c, a, q);
    gsn_subtract(top, a, up);
    gsn_cross(p, q, normal);
    sign = gsn_dot(normal, up) < 0.0 ? -1.0 : 1.0;
    size = sqrt(gsn_dot(normal, normal));
    for (int k = 0; k < 4; k++) {
        double from[3], reach = 0.0;

        gsn_subtract(cell->corner[k], a, from);
        for (int i = 0; i < 3; i++)
            reach = fmax(reach, fmax(fabs(cell->corner[k][i]), fabs(a[i])));
        if (sign * gsn_dot(normal, from) < -plane_margin * reach * size)
            return 0;
    }
    return 1;
}

int gsn_boundary_layer_clear(const struct gsn_boundary_layer *skin, const struct gsn_tet_cell *cell)
{
    const unsigned n = skin->degree, cloud = n + 1U;

    for (unsigned k = 0; k < 4; k++) {
        const double(*a)[3] = skin->knot + (k + 1) % 4 * cloud;
        const double(*b)[3] = skin->knot + (k + 2) % 4 * cloud;
        const double(*c)[3] = skin->knot + (k + 3) % 4 * cloud;

        for (unsigned i = 0; i <= n; i++) {
            for (unsigned j = 0; i + j <= n; j++) {
                for (unsigned l = 0; i + j + l <= n; l++) {
                    if (!is_inner(a[i], b[j], c[l], skin->knot[k * cloud], cell))
                        return 0;
                }
            }
        }
    }
    return 1;
}

size_t gsn_boundary_layer_by_values(const struct gsn_boundary_layer *skin,
                                    const struct gsn_tet_cell *cell,
                                    struct gsn_boundary_layer_bound *ret_bound)
{
    size_t count = 0;

    *ret_bound = (struct gsn_boundary_layer_bound){ { 0.0 }, 0.0, 0.0 };
    for (size_t i = 0; i < skin->values; i++) {
        if (!hull_reaches(&skin->value[i].hull, cell))
            continue;
        ret_bound->low = fmin(ret_bound->low, skin->value[i].d);
        ret_bound->high = fmax(ret_bound->high, skin->value[i].d);
        count++;
    }
    ret_bound->low -= skin->slack;
    ret_bound->high += skin->slack;
    return count;
}

/* Whether the cell lies in a hull of four knots: there M, of degree 0, is 1/|det| all over. */
static int is_within(const struct gsn_boundary_layer_hull *hull, const struct gsn_tet_cell *cell)
{
    const double(*knot)[3] = hull->knot;
    int within = hull->count == 4;

    for (int k = 0; within && k < 4; k++)
        within = is_inner(knot[(k + 1) % 4], knot[(k + 2) % 4], knot[(k + 3) % 4], knot[k], cell);
    return within;
}

/* Between which vectors a gradient lies: means from low to high, plus jumps. */
struct range {
    double low[3], high[3], jump_low[3], jump_high[3];
};

static void widen_slope(struct range *range, const struct gsn_boundary_layer_slope *slope, int full)
{
    const double *gradient = slope->gradient;

    for (int a = 0; a < 3; a++) {
        const double low = fmin(0.0, gradient[a]), high = fmax(0.0, gradient[a]);

        if (slope->jump) {
            range->jump_low[a] += full ? gradient[a] : low;
            range->jump_high[a] += full ? gradient[a] : high;
        } else {
            range->low[a] = fmin(range->low[a], low);
            range->high[a] = fmax(range->high[a], high);
        }
    }
}

/* The means are of 0 too: what home's own functions, or none, bring. */
static void find_range(const struct gsn_boundary_layer *skin, const struct gsn_tet_cell *cell,
                       struct range *ret_range)
{
    *ret_range = (struct range){ .low = { 0.0 } };
    for (size_t i = 0; i < skin->slopes; i++) {
        const struct gsn_boundary_layer_slope *slope = &skin->slope[i];

        if (hull_reaches(&slope->hull, cell))
            widen_slope(ret_range, slope, slope->jump && is_within(&slope->hull, cell));
    }
    for (int a = 0; a < 3; a++) {
        ret_range->low[a] += ret_range->jump_low[a];
        ret_range->high[a] += ret_range->jump_high[a];
    }
}

/* From the value at the middle of the cell. Returns 0 when a slope has no bound. */
static int bound_slopes(const struct gsn_tet_cell *cell, const double middle[3], double value,
                        const struct range *range, struct gsn_boundary_layer_bound *ret_bound)
{
    double most = 0.0;

    for (int k = 0; k < 4; k++) {
        double swing = 0.0;

        ret_bound->corner[k] = value;
        for (int a = 0; a < 3; a++) {
            const double low = range->low[a], high = range->high[a];
            const double step = cell->corner[k][a] - middle[a];

            ret_bound->corner[k] += 0.5 * (low + high) * step;
            swing += (0.5 * (high - low) + slope_slack * fmax(fabs(low), fabs(high))) * fabs(step);
        }
        if (!isfinite(swing))
            return 0;
        most = fmax(most, swing);
    }
    ret_bound->low = -most;
    ret_bound->high = most;
    return 1;
}

int gsn_boundary_layer_by_slopes(const struct gsn_boundary_layer *skin,
                                 const struct gsn_tet_cell *cell,
                                 struct gsn_boundary_layer_bound *ret_bound)
{
    struct range range;
    struct gsn_boundary_layer_bound bound;
    double middle[3], value;
    const double *const arg[GSN_DMS_MAX_DEGREE] = { middle, middle, middle };
    size_t hint = skin->tet;

    for (int a = 0; a < 3; a++)
        middle[a] = 0.25 * (cell->corner[0][a] + cell->corner[1][a] + cell->corner[2][a] +
                            cell->corner[3][a]);
    if (gsn_spline_eval(skin->spline, middle, &hint, &value, NULL) != GSN_OK)
        return 0;
    if (skin->whole)
        value -= gsn_bpatch_polar(skin->degree, (const double(*)[3])skin->knot, skin->control, arg);
    find_range(skin, cell, &range);
    if (!bound_slopes(cell, middle, value, &range, &bound))
        return 0;
    bound.low -= skin->slack;
    bound.high += skin->slack;
    *ret_bound = bound;
    return 1;
}
