/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/bench/plain.h"

#include "pipeline/model/bvh.h"
#include "pipeline/model/barycentric.h"
#include "pipeline/model/orient.h"
#include "tests/bench/bench.h"

#include <math.h>
#include <string.h>

/* The sets of more than four knots that the recursion meets below one V_beta: itself, 4 after one
 * step, 16 after two. Node i leads to nodes 4 i + 1 .. 4 i + 4. */
enum { MOST_KNOTS = 7, MOST_NODES = 21 };

/* A tetrahedron's barycentric coordinates and the least each takes at its knots, and the box around
 * them. */
struct cover {
    struct gsn_bvh_box box;
    struct gsn_barycentric frame;
    double low[4];
};

/* Only decides what is asked in vain, so it leans to asking. */
#define SLACK 1e-11

struct plain {
    const struct gsn_spline *spline;
    const struct gsn_dms *space;
    struct gsn_bvh *tree; /* of the boxes around the knots of each tetrahedron */
    struct cover *cover;  /* per tetrahedron */
    size_t nodes;         /* per function */
    uint8_t *largest;     /* W of each node of each function: a bit per knot of the set */
};

static double det(const double a[3], const double b[3], const double c[3], const double d[3])
{
    const double p[3] = { b[0] - a[0], b[1] - a[1], b[2] - a[2] };
    const double q[3] = { c[0] - a[0], c[1] - a[1], c[2] - a[2] };
    const double r[3] = { d[0] - a[0], d[1] - a[1], d[2] - a[2] };

    return p[0] * (q[1] * r[2] - q[2] * r[1]) + p[1] * (q[2] * r[0] - q[0] * r[2]) +
           p[2] * (q[0] * r[1] - q[1] * r[0]);
}

/* V_beta of function f; returns its number of knots. */
static size_t collect(const struct gsn_dms *space, size_t tet, size_t f,
                      const double *ret_knot[MOST_KNOTS])
{
    const double(*knots)[3] = gsn_dms_knots(space);
    const uint8_t *beta = gsn_dms_beta(space, f);
    size_t count = 0;

    for (size_t k = 0; k < 4; k++) {
        const size_t first = gsn_dms_mesh(space)->tet[tet][k] * (gsn_dms_degree(space) + 1);

        for (size_t l = 0; l <= beta[k]; l++)
            ret_knot[count++] = knots[first + l];
    }
    return count;
}

/* |det X_beta|. */
static double corners_det(const struct gsn_dms *space, size_t tet, size_t f)
{
    const double(*knots)[3] = gsn_dms_knots(space);
    const uint8_t *beta = gsn_dms_beta(space, f);
    const double *x[4];

    for (size_t k = 0; k < 4; k++)
        x[k] = knots[gsn_dms_mesh(space)->tet[tet][k] * (gsn_dms_degree(space) + 1) + beta[k]];
    return fabs(det(x[0], x[1], x[2], x[3]));
}

/* The best four so far; enough ends the search. */
struct best {
    double det, enough;
    uint8_t four;
};

static void choose(const double *const knot[], size_t count, struct best *best)
{
    for (size_t a = 0; a < count; a++) {
        for (size_t b = a + 1; b < count; b++) {
            for (size_t c = b + 1; c < count; c++) {
                for (size_t d = c + 1; d < count; d++) {
                    const double size = fabs(det(knot[a], knot[b], knot[c], knot[d]));

                    if (size <= best->det)
                        continue;
                    best->det = size;
                    best->four = (uint8_t)(1u << a | 1u << b | 1u << c | 1u << d);
                    if (size > best->enough)
                        return;
                }
            }
        }
    }
}

static uint8_t choose_largest(const double *const knot[], size_t count)
{
    struct best best = { .enough = INFINITY };

    choose(knot, count, &best);
    return best.four;
}

/* The threshold of "independent" is absolute, as public code has it. */
static uint8_t choose_first(const double *const knot[], size_t count)
{
    struct best best = { .enough = 1e-14 };

    choose(knot, count, &best);
    return best.four;
}

/* The set without one member. */
static void leave_out(const double *const knot[], size_t count, size_t member,
                      const double *ret_rest[])
{
    for (size_t i = 0, n = 0; i < count; i++) {
        if (i != member)
            ret_rest[n++] = knot[i];
    }
}

static void prepare(const double *const knot[], size_t count, uint8_t *largest, size_t node)
{
    const uint8_t four = choose_largest(knot, count);
    const double *rest[MOST_KNOTS - 1];
    size_t child = 4 * node + 1;

    largest[node] = four;
    for (size_t i = 0; count > 5 && i < count; i++) {
        if (!(four >> i & 1))
            continue;
        leave_out(knot, count, i, rest);
        prepare(rest, count - 1, largest, child++);
    }
}

/* Equation (1). u is inside when it lies on the same side of all four faces as the inside does;
 * it cannot lie on the other side of all of them. */
static double indicator(const double *const k[4], const double u[3])
{
    const int side = gsn_orient_side(k[0], k[1], k[2], u);

    if (side == 0 || gsn_orient_side(k[0], k[2], k[3], u) != side ||
        gsn_orient_side(k[0], k[3], k[1], u) != side ||
        gsn_orient_side(k[1], k[3], k[2], u) != side)
        return 0;
    return 1 / fabs(det(k[0], k[1], k[2], k[3]));
}

/* Equation (2). largest is NULL when W is found on the way. */
static double recurse(const double *const knot[], size_t count, const uint8_t *largest, size_t node,
                      const double u[3])
{
    const double *w[4], *rest[MOST_KNOTS - 1];
    size_t member[4], n = 0;
    double whole, sum = 0;
    uint8_t four;

    if (count == 4)
        return indicator(knot, u);
    four = largest ? largest[node] : choose_first(knot, count);
    for (size_t i = 0; i < count; i++) {
        if (four >> i & 1) {
            member[n] = i;
            w[n++] = knot[i];
        }
    }
    whole = det(w[0], w[1], w[2], w[3]);
    for (size_t j = 0; j < 4; j++) {
        const double *face[4] = { w[0], w[1], w[2], w[3] };
        double lambda;

        face[j] = u;
        lambda = det(face[0], face[1], face[2], face[3]) / whole;
        leave_out(knot, count, member[j], rest);
        sum += lambda * recurse(rest, count - 1, largest, 4 * node + 1 + j, u);
    }
    return sum;
}

/* Knot number i of the tetrahedron's 4 (degree + 1). */
static const double *knot_of(const struct gsn_dms *space, size_t tet, unsigned i)
{
    const unsigned per_cloud = gsn_dms_degree(space) + 1;

    return gsn_dms_knots(
        space)[gsn_dms_mesh(space)->tet[tet][i / per_cloud] * per_cloud + i % per_cloud];
}

static struct gsn_bvh_box knots_box(const struct gsn_dms *space, size_t tet)
{
    struct gsn_bvh_box box = { { INFINITY, INFINITY, INFINITY },
                               { -INFINITY, -INFINITY, -INFINITY } };

    for (unsigned i = 0; i < 4 * (gsn_dms_degree(space) + 1); i++) {
        for (int c = 0; c < 3; c++) {
            box.low[c] = fmin(box.low[c], knot_of(space, tet, i)[c]);
            box.high[c] = fmax(box.high[c], knot_of(space, tet, i)[c]);
        }
    }
    return box;
}

static struct cover cover_of(const struct gsn_dms *space, size_t tet)
{
    const unsigned per_cloud = gsn_dms_degree(space) + 1;
    struct cover cover = { .box = knots_box(space, tet) };

    gsn_barycentric_init(&cover.frame, knot_of(space, tet, 0), knot_of(space, tet, per_cloud),
                         knot_of(space, tet, 2 * per_cloud), knot_of(space, tet, 3 * per_cloud));
    for (unsigned i = 0; i < 4 * per_cloud; i++) {
        double lambda[4];

        gsn_barycentric_at(&cover.frame, knot_of(space, tet, i), lambda);
        for (int k = 0; k < 4; k++)
            cover.low[k] = fmin(cover.low[k], lambda[k]);
    }
    return cover;
}

struct plain *plain_new(const struct gsn_spline *spline)
{
    static const size_t NODES[GSN_DMS_MAX_DEGREE + 1] = { 0, 1, 5, MOST_NODES };
    const struct gsn_dms *space = gsn_spline_space(spline);
    const size_t tets = gsn_dms_mesh(space)->tet_count, functions = gsn_dms_functions(space);
    struct gsn_bvh_box *box = bench_alloc(tets, sizeof *box);
    struct plain *plain = bench_alloc(1, sizeof *plain);
    struct gsn_error err = { 0 };

    plain->spline = spline;
    plain->space = space;
    plain->nodes = NODES[gsn_dms_degree(space)];
    plain->cover = bench_alloc(tets, sizeof *plain->cover);
    plain->largest = bench_alloc(tets * functions * plain->nodes, 1);
    for (size_t t = 0; t < tets; t++) {
        plain->cover[t] = cover_of(space, t);
        box[t] = plain->cover[t].box;
        for (size_t f = 0; f < functions; f++) {
            const double *knot[MOST_KNOTS];
            const size_t count = collect(space, t, f, knot);

            prepare(knot, count, &plain->largest[(t * functions + f) * plain->nodes], 0);
        }
    }
    bench_need(gsn_bvh_new(box, tets, &plain->tree, &err), &err, "boxes");
    gsn_free(box);
    return plain;
}

void plain_free(struct plain *plain)
{
    if (!plain)
        return;
    gsn_bvh_free(plain->tree);
    gsn_free(plain->cover);
    gsn_free(plain->largest);
    gsn_free(plain);
}

static int box_holds(const struct gsn_bvh_box *box, const double u[3])
{
    for (int c = 0; c < 3; c++) {
        if (!(u[c] >= box->low[c] && u[c] <= box->high[c]))
            return 0;
    }
    return 1;
}

static int cover_holds(const struct cover *cover, const double u[3])
{
    double lambda[4];

    gsn_barycentric_at(&cover->frame, u, lambda);
    for (int k = 0; k < 4; k++) {
        if (lambda[k] < cover->low[k] - SLACK)
            return 0;
    }
    return 1;
}

/* Everything one tetrahedron contributes. */
static double eval_tet(const struct plain *plain, enum plain_choice choice, size_t tet,
                       const double u[3])
{
    const struct gsn_dms *space = plain->space;
    const size_t functions = gsn_dms_functions(space);
    const double *control = gsn_spline_controls(plain->spline);
    double sum = 0;

    for (size_t f = 0; f < functions; f++) {
        const uint8_t *largest = &plain->largest[(tet * functions + f) * plain->nodes];
        const double *knot[MOST_KNOTS];
        const size_t knots = collect(space, tet, f, knot);

        sum += control[gsn_dms_control_ids(space, tet)[f]] * corners_det(space, tet, f) *
               recurse(knot, knots, choice == PLAIN_FIRST ? NULL : largest, 0, u);
    }
    return sum;
}

/* A sum over what the tree finds. */
struct sum {
    const struct plain *plain;
    enum plain_choice choice;
    const double *u;
    double value;
};

static int add_tet(void *context, uint32_t tet)
{
    struct sum *sum = context;
    const struct cover *cover = &sum->plain->cover[tet];

    if (box_holds(&cover->box, sum->u) && (sum->choice == PLAIN_BOX || cover_holds(cover, sum->u)))
        sum->value += eval_tet(sum->plain, sum->choice, tet, sum->u);
    return 0;
}

double plain_eval(const struct plain *plain, enum plain_choice choice, const double u[3])
{
    struct sum sum = { .plain = plain, .choice = choice, .u = u };

    (void)gsn_bvh_at(plain->tree, u, add_tet, &sum);
    return sum.value;
}
