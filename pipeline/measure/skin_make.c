/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/skin.h"

#include <math.h>
#include <string.h>

#include "pipeline/measure/skin_hull.h"
#include "pipeline/model/bpatch.h"
#include "pipeline/model/simplex_spline.h"

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
    struct gsn_skin *skin;
    const struct gsn_dms *space;
    struct gsn_tet_cell home;
    struct actor *actor;
    size_t count;
    size_t value_room, slope_room;
};

static void gather(const struct gsn_dms *space, size_t tet, double (*ret_knot)[3])
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
static double polar_of(const struct gsn_skin *skin, const double (*knot)[3], const uint8_t beta[4])
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
    struct gsn_skin *skin = cast->skin;
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
        gather(cast->space, near[i], actor->knot);
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
static void hull_of(const struct gsn_skin *skin, const struct actor *actor, const uint8_t beta[4],
                    unsigned without, struct gsn_skin_hull *ret_hull)
{
    ret_hull->count = 0;
    for (unsigned k = 0; k < 4; k++) {
        for (unsigned l = 0; k != without && l <= beta[k]; l++)
            gsn_skin_hull_add(ret_hull, actor->knot[k * (skin->degree + 1U) + l]);
    }
}

/* The caller keeps value.d other than 0. */
static int keep_value(struct cast *cast, const struct gsn_skin_value *value, struct gsn_error *err)
{
    struct gsn_skin *skin = cast->skin;

    if (!gsn_skin_hull_reaches(&value->hull, &cast->home))
        return GSN_OK;
    if (skin->values == cast->value_room) {
        const size_t room = 2 * cast->value_room + 64;
        struct gsn_skin_value *grown = gsn_realloc_array(skin->value, room, sizeof *grown);

        if (!grown)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu functions", room);
        skin->value = grown;
        cast->value_room = room;
    }
    skin->value[skin->values++] = *value;
    return GSN_OK;
}

static int keep_slope(struct cast *cast, const struct gsn_skin_slope *slope, struct gsn_error *err)
{
    struct gsn_skin *skin = cast->skin;

    if (!gsn_skin_hull_reaches(&slope->hull, &cast->home))
        return GSN_OK;
    if (skin->slopes == cast->slope_room) {
        const size_t room = 2 * cast->slope_room + 64;
        struct gsn_skin_slope *grown = gsn_realloc_array(skin->slope, room, sizeof *grown);

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
        struct gsn_skin_value value = { .d = actor->d[f] };

        if (value.d < 0.0 || value.d > 0.0) {
            hull_of(cast->skin, actor, gsn_dms_beta(cast->space, f), 4, &value.hull);
            r = keep_value(cast, &value, err);
        }
    }
    return r;
}

/* G_g. */
static void mean_slope(const struct gsn_skin *skin, const struct actor *actor, const uint8_t g[4],
                       double ret_gradient[3])
{
    const unsigned cloud = skin->degree + 1U;
    struct gsn_frame frame;
    double at[4];

    gsn_frame_init(&frame, actor->knot[g[0]], actor->knot[cloud + g[1]],
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
        struct gsn_skin_slope slope = { .jump = 0 };

        mean_slope(cast->skin, actor, g, slope.gradient);
        hull_of(cast->skin, actor, g, 4, &slope.hull);
        if (gsn_dot(slope.gradient, slope.gradient) > 0.0)
            r = keep_slope(cast, &slope, err);
    } while (r == GSN_OK && gsn_simplex_next(g));
    return r;
}

/* The largest |det| of any four knots. */
static double largest_det(const struct gsn_skin_hull *hull)
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
static void face_normal(const struct gsn_skin *skin, const struct actor *actor,
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
    struct gsn_skin_slope slope = { .jump = 1 };
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

static void begin(struct cast *cast, size_t tet)
{
    struct gsn_skin *skin = cast->skin;
    const uint32_t *id = gsn_dms_control_ids(cast->space, tet);

    skin->tet = tet;
    skin->degree = gsn_dms_degree(cast->space);
    skin->whole = gsn_dms_is_whole(cast->space, tet);
    gather(cast->space, tet, skin->knot);
    for (size_t f = 0; f < gsn_dms_functions(cast->space); f++)
        skin->control[f] = gsn_spline_controls(skin->spline)[id[f]];
    for (unsigned k = 0; k < 4; k++)
        memcpy(cast->home.corner[k], skin->knot[k * (skin->degree + 1U)],
               sizeof cast->home.corner[k]);
}

int gsn_skin_new(const struct gsn_spline *spline, size_t tet, const uint32_t *near, size_t count,
                 struct gsn_skin **ret_skin, struct gsn_error *err)
{
    gsn_auto(gsn_skin) skin = gsn_alloc_array(1, sizeof *skin);
    gsn_auto_mem(struct actor) actor = gsn_alloc_array(count, sizeof *actor);
    struct cast cast = { .skin = skin, .space = gsn_spline_space(spline), .actor = actor };
    int r = GSN_OK;

    if (!skin || !actor)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", count);
    skin->spline = spline;
    begin(&cast, tet);
    find_actors(&cast, near, count);
    for (size_t i = 0; r == GSN_OK && i < cast.count; i++)
        r = add_actor(&cast, &actor[i], err);
    if (r < 0)
        return r;
    *ret_skin = gsn_steal(&skin);
    return GSN_OK;
}

void gsn_skin_free(struct gsn_skin *skin)
{
    if (!skin)
        return;
    gsn_free(skin->value);
    gsn_free(skin->slope);
    gsn_free(skin);
}
