/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/batch.h"

#include "tests/check.h"
#include "tests/model/kuhn.h"

#include "pipeline/model/bpatch.h"
#include "pipeline/model/face_correction.h"
#include "pipeline/model/spline_internal.h"

#include <string.h>

enum { TERMS = 4000, POINTS = 3000 };

static const size_t CUBES[3] = { 2, 2, 2 };

/* Points in and about the mesh: anywhere, on mesh planes, edges and vertices, at knots, nowhere. */
static double (*draw_points(const struct kuhn_made *made, size_t count))[3]
{
    double(*at)[3] = gsn_alloc_array(count, sizeof *at);
    const size_t knots =
        gsn_dms_mesh(made->space)->vertex_count * (gsn_dms_degree(made->space) + 1);
    uint64_t seed = 5;

    for (size_t i = 0; i < count; i++) {
        for (int c = 0; c < 3; c++) {
            const double x = -0.2 + 2.4 * draw(&seed);

            at[i][c] = i % 4 == 1 && draw(&seed) < 0.6 ? floor(x * 2) / 2 : x;
        }
        if (i % 8 == 2)
            memcpy(at[i], gsn_dms_knots(made->space)[(size_t)(draw(&seed) * (double)knots)],
                   sizeof *at);
    }
    at[count - 1][0] = NAN;
    at[count - 2][1] = INFINITY;
    at[count - 3][2] = -1e300;
    return at;
}

/* s and its gradient by definition, the sum of all functions; returns 0 outside. */
static int by_definition(const struct kuhn_made *made, const double u[3], size_t *hint,
                         double *ret_value, double ret_gradient[3])
{
    static struct gsn_dms_term term[TERMS];
    size_t count;

    if (!isfinite(u[0] + u[1] + u[2]) ||
        gsn_dms_basis(made->space, u, 1, hint, term, TERMS, &count) != GSN_OK)
        return 0;
    *ret_value = ret_gradient[0] = ret_gradient[1] = ret_gradient[2] = 0;
    for (size_t i = 0; i < count; i++) {
        const double control = gsn_spline_controls(made->spline)[term[i].control];

        *ret_value += control * term[i].value;
        for (int c = 0; c < 3; c++)
            ret_gradient[c] += control * term[i].gradient[c];
    }
    return 1;
}

/* The steepest slope a difference of 1 over the smallest cloud gives; rounding is relative to
 * it. */
static const double STEEP = 1e-9;

static void check_points(const struct kuhn_made *made)
{
    double(*at)[3] = draw_points(made, POINTS), value[POINTS], slope[POINTS][3];
    struct gsn_error err = { 0 };
    size_t hint = 0, outside = 0;

    CHECK_OK(
        gsn_spline_eval_many(made->spline, (const double(*)[3])at, POINTS, 1, value, slope, &err),
        err);
    for (size_t i = 0; i < POINTS; i++) {
        double truth, gradient[3];

        if (!by_definition(made, at[i], &hint, &truth, gradient)) {
            CHECK(isnan(value[i]) && isnan(slope[i][0]));
            outside++;
            continue;
        }
        CHECK_NEAR(value[i], truth, 1e-11);
        for (int c = 0; c < 3; c++)
            CHECK_NEAR(slope[i][c], gradient[c], STEEP);
    }
    CHECK(outside > POINTS / 10 && outside < POINTS / 2);
    gsn_free(at);
}

TEST(many_points_have_the_sum_of_all_functions_and_its_gradient)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        for (int own = 0; own < 2; own++) {
            for (int jitter = 0; jitter < 2; jitter++) {
                struct kuhn_made made = kuhn_make(kuhn_space(CUBES, 0.1 * jitter, degree, 0.2,
                                                             own ? GSN_DMS_OWN : GSN_DMS_SHARED));

                check_points(&made);
                kuhn_unmake(&made);
            }
        }
    }
}

TEST(one_point_has_what_it_has_among_many)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        struct kuhn_made made = kuhn_make(kuhn_space(CUBES, 0.1, degree, 0.2, GSN_DMS_SHARED));
        double(*at)[3] = draw_points(&made, POINTS), value[POINTS], slope[POINTS][3];
        struct gsn_error err = { 0 };
        size_t home = 0;

        CHECK_OK(gsn_spline_eval_many(made.spline, (const double(*)[3])at, POINTS, 1, value, slope,
                                      &err),
                 err);
        for (size_t i = 0; i < POINTS; i++) {
            double bernstein[GSN_DMS_MAX_FUNCTIONS], lambda[4], one, gradient[3], alone;
            struct gsn_barycentric frame;
            const uint32_t *v;

            if (isnan(value[i]))
                continue;
            CHECK(gsn_dms_locate(made.space, at[i], home, &home) == GSN_OK);
            v = made.space->mesh->tet[home];
            gsn_barycentric_init(&frame, made.space->mesh->vertex[v[0]],
                                 made.space->mesh->vertex[v[1]], made.space->mesh->vertex[v[2]],
                                 made.space->mesh->vertex[v[3]]);
            gsn_barycentric_at(&frame, at[i], lambda);
            gsn_spline_bernstein(made.spline, home, bernstein);
            alone = one = gsn_bernstein_at(degree, bernstein, &frame, lambda, gradient);
            gsn_spline_add_face_corrections(made.spline, home, at[i], &one, gradient);
            gsn_spline_add_face_corrections(made.spline, home, at[i], &alone, NULL);
            CHECK_NEAR(one, value[i], 1e-13);
            CHECK_NEAR(alone, one, 1e-14);
            for (int c = 0; c < 3; c++)
                CHECK_NEAR(gradient[c], slope[i][c], 1e-11);
        }
        gsn_free(at);
        kuhn_unmake(&made);
    }
}

TEST(rows_hold_the_sum_of_the_functions_of_each_control_point)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        for (int own = 0; own < 2; own++) {
            struct kuhn_made made =
                kuhn_make(kuhn_space(CUBES, 0.1, degree, 0.2, own ? GSN_DMS_OWN : GSN_DMS_SHARED));
            const size_t controls = gsn_dms_controls(made.space);
            gsn_auto_mem(double) truth = gsn_alloc_array(controls, sizeof *truth);
            double(*at)[3] = draw_points(&made, POINTS);
            static struct gsn_dms_term term[TERMS];
            size_t hint = 0;

            for (size_t i = 0; i < POINTS - 3; i++) {
                uint32_t id[TERMS];
                double value[TERMS], sum = 0;
                size_t count, terms;

                if (gsn_dms_basis(made.space, at[i], 0, &hint, term, TERMS, &terms) != GSN_OK)
                    continue;
                CHECK(gsn_face_correction_row(made.space, hint, at[i], TERMS, id, value, &count) ==
                      GSN_OK);
                for (size_t j = 0; j < terms; j++)
                    truth[term[j].control] += term[j].value;
                for (size_t j = 0; j < count; j++) {
                    CHECK(j == 0 || id[j - 1] < id[j]);
                    CHECK_NEAR(value[j], truth[id[j]], 1e-12);
                    truth[id[j]] = 0;
                    sum += value[j];
                }
                for (size_t j = 0; j < terms; j++) {
                    CHECK_NEAR(truth[term[j].control], 0, 1e-12);
                    truth[term[j].control] = 0;
                }
                CHECK(sum < 1 + 1e-12);
                if (count > 3)
                    CHECK(gsn_face_correction_row(made.space, hint, at[i], 3, id, value, &count) ==
                          GSN_E_LIMIT);
            }
            gsn_free(at);
            kuhn_unmake(&made);
        }
    }
}

TEST(threads_and_instruction_sets_give_the_same_bits)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        struct kuhn_made made = kuhn_make(kuhn_space(CUBES, 0.1, degree, 0.2, GSN_DMS_SHARED));
        double(*at)[3] = draw_points(&made, 3 * POINTS);
        static double value[2][3 * POINTS], slope[2][3 * POINTS][3];
        struct gsn_error err = { 0 };
        unsigned runs = 0;

        for (int isa = 0; isa < GSN_ISA_COUNT; isa++) {
            if (!gsn_kernels_for((enum gsn_isa)isa))
                continue;
            gsn_dms_use(made.space, gsn_kernels_for((enum gsn_isa)isa));
            for (unsigned threads = 1; threads <= 3; threads++, runs++) {
                const int at_first = runs == 0;

                CHECK_OK(gsn_spline_eval_many(made.spline, (const double(*)[3])at, 3 * POINTS,
                                              threads, value[!at_first], slope[!at_first], &err),
                         err);
                CHECK(at_first || memcmp(value[0], value[1], sizeof value[0]) == 0);
                CHECK(at_first || memcmp(slope[0], slope[1], sizeof slope[0]) == 0);
            }
        }
        gsn_free(at);
        kuhn_unmake(&made);
    }
}

TEST(no_points_have_no_values)
{
    struct kuhn_made made = kuhn_make(kuhn_space(CUBES, 0.1, 2, 0.2, GSN_DMS_SHARED));
    struct gsn_error err = { 0 };
    double value = 5;

    CHECK_OK(gsn_spline_eval_many(made.spline, NULL, 0, 1, &value, NULL, &err), err);
    CHECK(value == 5);
    kuhn_unmake(&made);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct kuhn_made made = kuhn_make(kuhn_space(CUBES, 0.1, 2, 0.2, GSN_DMS_SHARED));
    double(*at)[3] = draw_points(&made, POINTS), value[POINTS];
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(
        gsn_spline_eval_many(made.spline, (const double(*)[3])at, POINTS, 2, value, NULL, &err),
        err);
    gsn_free(at);
    kuhn_unmake(&made);
}
