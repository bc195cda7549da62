/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/knots.h"

#include "tests/check.h"
#include "tests/model/formula.h"
#include "tests/model/kuhn.h"

#include "pipeline/model/dms_internal.h"
#include "pipeline/model/orient.h"

#include <string.h>

enum { MIDDLE = 13 }; /* the one inner vertex */

static const size_t SMALL[3] = { 2, 2, 2 };

static size_t knots_of(const struct gsn_dms *space)
{
    return gsn_dms_mesh(space)->vertex_count * (gsn_dms_degree(space) + 1);
}

static void check_sum(struct gsn_dms *made, uint64_t *seed)
{
    gsn_auto(gsn_dms) space = made;
    gsn_auto(gsn_spline) spline = random_spline(space, seed);
    const size_t knots = knots_of(space);
    double(*total)[3] = gsn_alloc_array(knots, sizeof *total);
    size_t hint = 0;

    for (size_t t = 0; t < gsn_dms_mesh(space)->tet_count; t++) {
        double u[3], slope[3], sum[3] = { 0 }, size = 1;

        draw_in_skins(gsn_dms_mesh(space), t, seed, u);
        (void)formula_at(space, gsn_spline_controls(spline), u, slope);
        memset(total, 0, knots * sizeof *total);
        CHECK(gsn_knots_gradient_add(spline, u, &hint, -2, total) == GSN_OK);
        for (size_t i = 0; i < knots; i++) {
            for (int c = 0; c < 3; c++) {
                sum[c] += total[i][c];
                size = fmax(size, fabs(total[i][c]));
            }
        }
        for (int c = 0; c < 3; c++)
            CHECK_NEAR(sum[c], 2 * slope[c], 1e-10 * size);
    }
    gsn_free(total);
}

TEST(moving_all_knots_moves_the_spline)
{
    uint64_t seed = 81;

    for (unsigned degree = 1; degree <= 3; degree++) {
        check_sum(kuhn_space(SMALL, 0.2, degree, 0.1, GSN_DMS_SHARED), &seed);
        check_sum(kuhn_space(SMALL, 0.2, degree, 0.1, GSN_DMS_OWN), &seed);
        check_sum(shrunk_space(SMALL, 0.2, degree, 0, GSN_DMS_OWN), &seed);
        check_sum(shrunk_space(SMALL, 0.2, degree, 1e-3, GSN_DMS_SHARED), &seed);
        check_sum(flat_space(SMALL, 0.2, degree, 1e-4, GSN_DMS_SHARED), &seed);
    }
}

/* gives: the space with these knots and the mesh that has their first ones for vertices. */
static int space_of(const struct gsn_dms *old, const double (*knots)[3], struct gsn_dms **ret_space,
                    struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(old);
    double(*vertex)[3] = gsn_alloc_array(mesh->vertex_count, sizeof *vertex);
    gsn_auto(gsn_tets) moved = NULL;
    int r;

    for (size_t i = 0; i < mesh->vertex_count; i++)
        memcpy(vertex[i], knots[i * (gsn_dms_degree(old) + 1)], sizeof *vertex);
    r = gsn_tets_new((const double(*)[3])vertex, mesh->vertex_count,
                     (const uint32_t(*)[4])mesh->tet, mesh->tet_count, &moved, err);
    if (r == GSN_OK)
        r = gsn_dms_new(moved, gsn_dms_degree(old), knots, old->sharing, ret_space, err);
    gsn_free(vertex);
    return r;
}

/* s(u) after one coordinate of one knot has moved by step. */
static double moved(const struct gsn_spline *spline, const double u[3], size_t knot, int axis,
                    double step)
{
    const struct gsn_dms *old = gsn_spline_space(spline);
    double(*knots)[3] = gsn_memdup(gsn_dms_knots(old), knots_of(old) * sizeof *knots);
    gsn_auto(gsn_dms) space = NULL;
    struct gsn_error err = { 0 };

    knots[knot][axis] += step;
    CHECK_OK(space_of(old, (const double(*)[3])knots, &space, &err), err);
    gsn_free(knots);
    return formula_at(space, gsn_spline_controls(spline), u, NULL);
}

/* As smooth in the knots as in u: where the two halves of a difference disagree for degree 1, a
 * knot plane lies between. */
static void check_differences(unsigned degree, enum gsn_dms_sharing sharing, uint64_t *seed)
{
    const double h = 1e-5;
    gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0.2, degree, 0.2, sharing);
    gsn_auto(gsn_spline) spline = random_spline(space, seed);
    double(*total)[3] = gsn_alloc_array(knots_of(space), sizeof *total);
    size_t hint = 0, compared = 0, all = 0;

    for (int i = 0; i < 12; i++) {
        double u[3], here;

        for (int c = 0; c < 3; c++)
            u[c] = gsn_dms_mesh(space)->vertex[MIDDLE][c] + 0.4 * (2 * draw(seed) - 1) * draw(seed);
        here = formula_at(space, gsn_spline_controls(spline), u, NULL);
        memset(total, 0, knots_of(space) * sizeof *total);
        CHECK(gsn_knots_gradient_add(spline, u, &hint, 1, total) == GSN_OK);
        for (unsigned l = 0; l <= degree; l++) {
            const size_t knot = MIDDLE * (degree + 1) + l;
            const double size =
                1 + fabs(total[knot][0]) + fabs(total[knot][1]) + fabs(total[knot][2]);

            for (int c = 0; c < 3; c++) {
                const double up = (moved(spline, u, knot, c, h) - here) / h;
                const double down = (here - moved(spline, u, knot, c, -h)) / h;

                all++;
                if (fabs(up - down) > 1e-2 * size)
                    continue;
                compared++;
                CHECK_NEAR(total[knot][c], (up + down) / 2, 1e-3 * size);
            }
        }
    }
    CHECK(compared > 0.9 * (double)all);
    gsn_free(total);
}

TEST(derivatives_by_a_knot_are_the_limit_of_differences)
{
    uint64_t seed = 83;

    for (unsigned degree = 1; degree <= 3; degree++) {
        check_differences(degree, GSN_DMS_OWN, &seed);
        check_differences(degree, GSN_DMS_SHARED, &seed);
    }
}

/* sum delta of a tetrahedron from its definition; cloud has its four clouds. */
static double sum_delta(unsigned degree, const double (*const cloud[4])[3])
{
    struct gsn_barycentric frame;
    double delta = 0;

    gsn_barycentric_init(&frame, *cloud[0], *cloud[1], *cloud[2], *cloud[3]);
    for (unsigned k = 0; k < 4; k++) {
        double most = 0, lambda[4];

        for (unsigned i = 0; i < 4 * (degree + 1); i++) {
            gsn_barycentric_at(&frame, cloud[i / (degree + 1)][i % (degree + 1)], lambda);
            if (i / (degree + 1) != k)
                most = fmax(most, lambda[k]);
        }
        delta += most;
    }
    return delta;
}

/* Exactly, from the definition: no X_beta, |beta| <= n, folds, and some core is left. Every X_beta
 * then holds the core, and is no smaller. */
static void check_valid(const struct gsn_tets *mesh, unsigned degree, const double (*knots)[3])
{
    for (size_t t = 0; t < mesh->tet_count; t++) {
        const double(*cloud[4])[3];
        double delta, whole;

        for (int k = 0; k < 4; k++)
            cloud[k] = (const double(*)[3])knots[mesh->tet[t][k] * (degree + 1)];
        delta = sum_delta(degree, cloud);
        whole = gsn_det(*cloud[0], *cloud[1], *cloud[2], *cloud[3]);
        CHECK(delta < 1);
        for (unsigned i = 0; i < 256; i++) {
            const double *x[4];
            unsigned sum = 0;

            for (unsigned k = 0; k < 4; k++)
                sum += i >> 2 * k & 3;
            if (sum > degree)
                continue;
            for (unsigned k = 0; k < 4; k++)
                x[k] = cloud[k][i >> 2 * k & 3];
            CHECK(gsn_orient3d(x[0], x[1], x[2], x[3]) > 0);
            CHECK(gsn_det(x[0], x[1], x[2], x[3]) >= (1 - 1e-9) * pow(1 - delta, 3) * whole);
        }
    }
}

TEST(moves_inside_the_barrier_never_fold_a_tetrahedron_or_empty_a_core)
{
    uint64_t seed = 85;

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) start = kuhn_space(SMALL, 0.2, degree, 0.1, GSN_DMS_SHARED);
        const struct gsn_tets *mesh = gsn_dms_mesh(start);
        double(*knots)[3] = gsn_memdup(gsn_dms_knots(start), knots_of(start) * sizeof *knots);
        struct gsn_dms *end = NULL;
        struct gsn_error err = { 0 };
        size_t taken = 0, refused = 0;

        for (int i = 0; i < 2000; i++) {
            const size_t knot = (size_t)(draw(&seed) * (double)knots_of(start));
            const double old[3] = { knots[knot][0], knots[knot][1], knots[knot][2] };

            for (int c = 0; c < 3; c++)
                knots[knot][c] += 0.3 * (2 * draw(&seed) - 1);
            if (space_of(start, (const double(*)[3])knots, &end, &err) == GSN_OK) {
                check_valid(mesh, degree, (const double(*)[3])knots);
                gsn_dms_free(end);
                end = NULL;
                taken++;
                continue;
            }
            CHECK(err.code == GSN_E_MESH && strstr(err.text, "tetrahedr"));
            memcpy(knots[knot], old, sizeof old);
            refused++;
        }
        CHECK(!end && taken > 100 && refused > 100);
        gsn_free(knots);
    }
}

enum { SAMPLES = 150 };

struct sample {
    double u[3], f;
};

/* The sum of squares over the samples and, unless NULL, its gradient by the knots. */
static double objective(const struct gsn_spline *spline, const struct sample *sample,
                        double (*ret_gradient)[3])
{
    size_t hint = 0;
    double sum = 0;

    if (ret_gradient)
        memset(ret_gradient, 0, knots_of(gsn_spline_space(spline)) * sizeof *ret_gradient);
    for (int i = 0; i < SAMPLES; i++) {
        double value;

        CHECK(gsn_spline_eval(spline, sample[i].u, &hint, &value, NULL) == GSN_OK);
        sum += (value - sample[i].f) * (value - sample[i].f);
        if (ret_gradient)
            CHECK(gsn_knots_gradient_add(spline, sample[i].u, &hint, 2 * (value - sample[i].f),
                                         ret_gradient) == GSN_OK);
    }
    return sum;
}

/* The objective after a step against the gradient, INFINITY beyond the barrier. Boundary vertices
 * stay, so that no sample falls out of the domain. */
static double after_step(const struct gsn_spline *spline, const struct sample *sample,
                         const double (*gradient)[3], double step, double (*ret_knots)[3])
{
    const struct gsn_dms *old = gsn_spline_space(spline);
    const unsigned per_cloud = gsn_dms_degree(old) + 1;
    gsn_auto(gsn_dms) space = NULL;
    gsn_auto(gsn_spline) next = NULL;
    struct gsn_error err = { 0 };

    memcpy(ret_knots, gsn_dms_knots(old), knots_of(old) * sizeof *ret_knots);
    for (size_t i = 0; i < per_cloud; i++) {
        for (int c = 0; c < 3; c++)
            ret_knots[MIDDLE * per_cloud + i][c] -= step * gradient[MIDDLE * per_cloud + i][c];
    }
    if (space_of(old, (const double(*)[3])ret_knots, &space, &err) != GSN_OK)
        return INFINITY;
    CHECK_OK(gsn_spline_new(space, gsn_spline_controls(spline), &next, &err), err);
    return objective(next, sample, NULL);
}

TEST(the_gradient_foretells_how_the_sum_of_squares_falls)
{
    uint64_t seed = 87;

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0.2, degree, 0.2, GSN_DMS_OWN);
        gsn_auto(gsn_spline) spline = random_spline(space, &seed);
        struct sample sample[SAMPLES];
        const size_t knots = knots_of(space);
        double(*gradient)[3] = gsn_alloc_array(knots, sizeof *gradient);
        double(*next)[3] = gsn_alloc_array(knots, sizeof *next);
        double before, after, square = 0, step;

        for (int i = 0; i < SAMPLES; i++) {
            for (int c = 0; c < 3; c++)
                sample[i].u[c] = 0.5 + draw(&seed);
            sample[i].f = sin(3 * sample[i].u[0]) * sample[i].u[1] - sample[i].u[2];
        }
        before = objective(spline, sample, gradient);
        for (size_t i = MIDDLE * (degree + 1); i < (MIDDLE + 1) * (degree + 1); i++)
            square += gsn_dot(gradient[i], gradient[i]);
        step = 1e-6 / sqrt(square);
        after = after_step(spline, sample, (const double(*)[3])gradient, step, next);
        CHECK_NEAR((before - after) / (step * square), 1, 1e-2);
        /* And a long step is cut back until it falls and stays inside. */
        for (step = 1 / sqrt(square);
             !(after_step(spline, sample, (const double(*)[3])gradient, step, next) < before);)
            step /= 2;
        CHECK(step * sqrt(square) > 1e-4);
        gsn_free(gradient);
        gsn_free(next);
    }
}

TEST(where_there_is_no_data_nothing_is_added)
{
    const double strange[5][3] = {
        { NAN, 1, 1 }, { 1, INFINITY, 1 }, { 1, 1, -1e300 }, { 1e9, 1e9, 1e9 }, { 1, 1, 2.001 }
    };
    uint64_t seed = 89;
    gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0.2, 2, 0.05, GSN_DMS_SHARED);
    gsn_auto(gsn_spline) spline = random_spline(space, &seed);
    double(*total)[3] = gsn_alloc_array(knots_of(space), sizeof *total);

    for (int i = 0; i < 5; i++) {
        size_t hint = 7;

        CHECK(gsn_knots_gradient_add(spline, strange[i], &hint, 1, total) == GSN_DMS_OUTSIDE);
        CHECK(hint == 7);
        for (size_t k = 0; k < 3 * knots_of(space); k++)
            CHECK(total[k / 3][k % 3] == 0);
    }
    gsn_free(total);
}
