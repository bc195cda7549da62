/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where the knots go: small clouds around the vertices, in general position, valid, and outward on
 * the boundary. Directions come from the vertex number alone. */
#include "pipeline/model/dms_internal.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <string.h>

enum {
    MOST_ROUNDS = 60,  /* halvings before a mesh is given up */
    CLIMB_STEPS = 200, /* towards the common outward direction */
};

/* Fresh clouds keep well away from what gsn_dms_new() refuses. */
#define FRESH_FOLD_MARGIN 0.05
#define FRESH_WIDEST 0.9
/* Outward normals that leave a narrower cone than this (sine) have no usable common direction. */
#define NARROWEST 0.05

/* How one vertex's cloud is made. */
struct plan {
    double radius;
    double outward[3]; /* unit, or 0 for a cloud all around */
    double spread;     /* how far knots lean away from outward, as a tangent */
    uint64_t draw;     /* seeds the directions; the next one when these are not general */
    uint8_t shrink, redraw;
};

/* The finaliser of SplitMix64: well mixed bits of any number. */
static uint64_t mix_bits(uint64_t x)
{
    x += 0x9e3779b97f4a7c15u;
    x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9u;
    x = (x ^ x >> 27) * 0x94d049bb133111ebu;
    return x ^ x >> 31;
}

/* A number in [-1, 1). */
static double draw_number(uint64_t *state)
{
    *state = mix_bits(*state);
    return (double)(*state >> 11) * 0x1p-52 - 1;
}

static double length_of(const double v[3])
{
    return sqrt(gsn_dot(v, v));
}

static void make_unit(double v[3])
{
    const double size = length_of(v);

    for (int c = 0; c < 3; c++)
        v[c] /= size;
}

/* A direction evenly spread over the sphere, by rejection from the cube. */
static void draw_direction(uint64_t *state, double ret[3])
{
    double size;

    do {
        for (int c = 0; c < 3; c++)
            ret[c] = draw_number(state);
        size = length_of(ret);
    } while (size < 0.1 || size > 1);
    make_unit(ret);
}

/* Three perpendicular directions. */
static void draw_axes(uint64_t state, double ret[3][3])
{
    double along;

    draw_direction(&state, ret[0]);
    do {
        draw_direction(&state, ret[1]);
        along = gsn_dot(ret[0], ret[1]);
    } while (fabs(along) > 0.9);
    for (int c = 0; c < 3; c++)
        ret[1][c] -= along * ret[0][c];
    make_unit(ret[1]);
    gsn_cross(ret[0], ret[1], ret[2]);
}

static void place_knots(const struct gsn_tets *mesh, unsigned degree, const struct plan *plan,
                        double (*knot)[3])
{
    for (size_t i = 0; i < mesh->vertex_count; i++) {
        double axis[3][3];

        draw_axes(mix_bits(i) ^ plan[i].draw, axis);
        memcpy(knot[i * (degree + 1)], mesh->vertex[i], sizeof *knot);
        for (unsigned l = 1; l <= degree; l++) {
            double *to = knot[i * (degree + 1) + l];

            for (int c = 0; c < 3; c++)
                to[c] = plan[i].outward[c] + plan[i].spread * axis[l - 1][c];
            make_unit(to);
            for (int c = 0; c < 3; c++)
                to[c] = mesh->vertex[i][c] + plan[i].radius * to[c];
        }
    }
}

double gsn_dms_steepest(const struct gsn_tets *mesh, size_t tet)
{
    const uint32_t *v = mesh->tet[tet];
    struct gsn_barycentric frame;
    double rest[3], steepest;

    gsn_barycentric_init(&frame, mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]],
                         mesh->vertex[v[3]]);
    for (int c = 0; c < 3; c++)
        rest[c] = frame.row[0][c] + frame.row[1][c] + frame.row[2][c];
    steepest = length_of(rest);
    for (int k = 0; k < 3; k++)
        steepest = fmax(steepest, length_of(frame.row[k]));
    return steepest;
}

/* radius = fraction of the smallest altitude in the star. */
static void plan_radii(const struct gsn_tets *mesh, double fraction, struct plan *plan)
{
    for (size_t i = 0; i < mesh->vertex_count; i++)
        plan[i] = (struct plan){ .radius = DBL_MAX, .spread = 1 };
    for (size_t t = 0; t < mesh->tet_count; t++) {
        const double steepest = gsn_dms_steepest(mesh, t);

        for (int k = 0; k < 4; k++) {
            struct plan *at = &plan[mesh->tet[t][k]];

            at->radius = fmin(at->radius, fraction / steepest);
        }
    }
}

/* One step of Gilbert's algorithm for the point of a convex hull nearest the origin: moves x on the
 * segment towards the normal that is worst for it. That point, made a unit, is the direction that
 * fits the worst normal best. */
static void step_to_hull(double x[3], const double normal[3], double step)
{
    for (int c = 0; c < 3; c++)
        x[c] += step * (normal[c] - x[c]);
}

static double best_step(const double x[3], const double normal[3])
{
    double towards[3], size;

    gsn_subtract(normal, x, towards);
    size = gsn_dot(towards, towards);
    return size > 0 ? fmin(1, fmax(0, -gsn_dot(x, towards) / size)) : 0;
}

/* The outward unit normals of the boundary, face by face, and the vertices they belong to. */
struct outer_face {
    double normal[3];
    uint32_t vertex[3];
};

static size_t list_outer_faces(const struct gsn_tets *mesh, struct outer_face *ret_faces)
{
    size_t count = 0;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        const uint32_t *v = mesh->tet[t];
        struct gsn_barycentric frame;

        for (unsigned k = 0; k < 4; k++) {
            struct outer_face *face = &ret_faces[count];
            unsigned n = 0;

            if (mesh->neighbour[t][k] >= 0)
                continue;
            gsn_barycentric_init(&frame, mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]],
                                 mesh->vertex[v[3]]);
            for (int c = 0; c < 3; c++)
                face->normal[c] =
                    k ? -frame.row[k - 1][c] : frame.row[0][c] + frame.row[1][c] + frame.row[2][c];
            make_unit(face->normal);
            for (unsigned i = 0; i < 4; i++) {
                if (i != k)
                    face->vertex[n++] = v[i];
            }
            count++;
        }
    }
    return count;
}

/* Per vertex the normal that agrees least with its x. */
static void find_worst(const struct outer_face *face, size_t count, const struct plan *plan,
                       const double **worst, size_t vertices)
{
    memset(worst, 0, vertices * sizeof *worst);
    for (size_t i = 0; i < count; i++) {
        for (int n = 0; n < 3; n++) {
            const uint32_t v = face[i].vertex[n];

            if (!worst[v] ||
                gsn_dot(face[i].normal, plan[v].outward) < gsn_dot(worst[v], plan[v].outward))
                worst[v] = face[i].normal;
        }
    }
}

/* Turns the boundary clouds outward where all normals around a vertex allow it. */
static int plan_outward(const struct gsn_tets *mesh, struct plan *plan, struct gsn_error *err)
{
    gsn_auto_mem(struct outer_face) face = gsn_alloc_array(4 * mesh->tet_count, sizeof *face);
    gsn_auto_mem(const double *) worst = gsn_alloc_array(mesh->vertex_count, sizeof *worst);
    size_t count;

    if (!face || !worst)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the boundary");
    count = list_outer_faces(mesh, face);
    for (size_t i = 0; i < count; i++) {
        for (int n = 0; n < 3; n++)
            memcpy(plan[face[i].vertex[n]].outward, face[i].normal, sizeof face[i].normal);
    }
    for (int step = 0; step < CLIMB_STEPS; step++) {
        find_worst(face, count, plan, worst, mesh->vertex_count);
        for (size_t i = 0; i < mesh->vertex_count; i++) {
            if (worst[i])
                step_to_hull(plan[i].outward, worst[i], best_step(plan[i].outward, worst[i]));
        }
    }
    find_worst(face, count, plan, worst, mesh->vertex_count);
    for (size_t i = 0; i < mesh->vertex_count; i++) {
        const double size = length_of(plan[i].outward);
        const double margin = worst[i] && size > 0 ? gsn_dot(worst[i], plan[i].outward) / size : 0;

        if (margin > NARROWEST) {
            make_unit(plan[i].outward);
            plan[i].spread = 0.9 * margin;
        } else {
            memset(plan[i].outward, 0, sizeof plan[i].outward);
        }
    }
    return GSN_OK;
}

/* Marks the vertices whose clouds must change; returns how many tetrahedra ask for it, the last of
 * them in *ret_bad with its sentence in err. */
static size_t find_faults(const struct gsn_tets *mesh, const struct gsn_simplex_sets *sets,
                          const double (*knot)[3], struct plan *plan, size_t *ret_bad,
                          struct gsn_error *err)
{
    const size_t per_cloud = sets->degree + 1;
    size_t faults = 0;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        double own[GSN_SIMPLEX_MAX_KNOTS][3];
        struct gsn_dms_shape shape;
        int folds, special;

        for (size_t k = 0; k < 4; k++)
            memcpy(own[k * per_cloud], knot[mesh->tet[t][k] * per_cloud], per_cloud * sizeof *knot);
        folds = gsn_dms_shape_init(sets->degree, (const double(*)[3])own, FRESH_FOLD_MARGIN,
                                   FRESH_WIDEST, &shape, err) < 0;
        special = !gsn_dms_is_general(sets, (const double(*)[3])own);
        if (special && !err->text[0])
            (void)gsn_fail(err, GSN_E_MESH, "four of its knots lie in one plane");
        for (int k = 0; k < 4; k++) {
            plan[mesh->tet[t][k]].shrink |= (uint8_t)folds;
            plan[mesh->tet[t][k]].redraw |= (uint8_t)special;
        }
        if (folds || special) {
            *ret_bad = t;
            faults++;
        }
    }
    return faults;
}

static void amend_plan(struct plan *plan, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        if (plan[i].shrink)
            plan[i].radius /= 2;
        if (plan[i].redraw)
            plan[i].draw = mix_bits(plan[i].draw + 1);
        plan[i].shrink = plan[i].redraw = 0;
    }
}

int gsn_dms_clouds(const struct gsn_tets *mesh, unsigned degree, double fraction,
                   double (**ret_knots)[3], struct gsn_error *err)
{
    gsn_auto(gsn_simplex_sets) sets = NULL;
    gsn_auto_mem(struct plan) plan = NULL;
    double(*knot)[3] __attribute__((cleanup(gsn_auto_release))) = NULL;
    struct gsn_error why = { 0 };
    size_t bad = 0;
    int r;

    assert(mesh && ret_knots);

    if (degree < 1 || degree > GSN_DMS_MAX_DEGREE)
        return gsn_fail(err, GSN_E_INPUT, "degree %u: a simplex spline has degree 1 to %d", degree,
                        GSN_DMS_MAX_DEGREE);
    if (!(fraction > 0 && fraction <= 0.5))
        return gsn_fail(err, GSN_E_INPUT, "cloud size %g: it must be above 0 and at most 0.5",
                        fraction);
    r = gsn_simplex_sets_new(degree, &sets, err);
    if (r < 0)
        return r;
    plan = gsn_alloc_array(mesh->vertex_count, sizeof *plan);
    knot = gsn_alloc_array(mesh->vertex_count * (degree + 1), sizeof *knot);
    if (!plan || !knot)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu clouds", mesh->vertex_count);
    plan_radii(mesh, fraction, plan);
    r = plan_outward(mesh, plan, err);
    if (r < 0)
        return r;
    for (int round = 0; round < MOST_ROUNDS; round++) {
        place_knots(mesh, degree, plan, knot);
        if (find_faults(mesh, sets, (const double(*)[3])knot, plan, &bad, &why) == 0) {
            *ret_knots = gsn_steal(&knot);
            return GSN_OK;
        }
        amend_plan(plan, mesh->vertex_count);
    }
    return gsn_fail(err, GSN_E_MESH, "tetrahedron %zu: no valid knot clouds (%s)", bad, why.text);
}
