/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/model/golden.h"

#include "tests/check.h"
#include "tests/model/formula.h"

#include "pipeline/model/spline.h"

#include <string.h>

/* Exact N of every function (tetrahedron by tetrahedron) at one point. */
static double *exact_basis(const struct golden_case *golden, const struct golden_table *basis,
                           size_t point)
{
    const size_t functions = gsn_dms_functions(golden->space);
    double *exact = gsn_alloc_array(golden->mesh->tet_count * functions, sizeof *exact);

    assert_non_null(exact);
    for (size_t i = 0; i < basis->rows; i++) {
        const double *row = golden_row(basis, i);

        if ((size_t)row[0] == point)
            exact[(size_t)row[1] * functions + golden_function(golden->space, row + 2)] = row[6];
    }
    return exact;
}

/* Whatever the walk, the pruning and the cores decide: every tetrahedron asked by itself. */
static void check_recurrence(const struct golden_case *golden)
{
    struct golden_table points = golden_read(golden, "points");
    struct golden_table basis = golden_read(golden, "basis");
    struct golden_table spline = golden_read(golden, "spline");
    const size_t functions = gsn_dms_functions(golden->space);
    const double steepest = golden_steepest(&spline);

    for (size_t p = 0; p < points.rows; p++) {
        double *exact = exact_basis(golden, &basis, p);
        double s = 0, slope[3] = { 0 };

        for (size_t t = 0; t < golden->mesh->tet_count; t++) {
            double value[GSN_DMS_MAX_FUNCTIONS], gradient[GSN_DMS_MAX_FUNCTIONS][3];

            formula_basis(golden->space, t, golden_row(&points, p) + 2, value, gradient, NULL);
            for (size_t f = 0; f < functions; f++) {
                const double control = golden->control[t * functions + f];

                CHECK_NEAR(value[f], exact[t * functions + f], 1e-12);
                s += control * value[f];
                for (int c = 0; c < 3; c++)
                    slope[c] += control * gradient[f][c];
            }
        }
        CHECK_NEAR(s, golden_row(&spline, p)[2], 1e-12);
        for (int c = 0; c < 3; c++)
            CHECK_NEAR(slope[c], golden_row(&spline, p)[3 + c], 1e-10 * steepest);
        gsn_free(exact);
    }
    golden_done(&points);
    golden_done(&basis);
    golden_done(&spline);
}

TEST(every_function_has_its_exact_value_and_slope_at_every_kind_of_point)
{
    golden_each("basis", check_recurrence);
}

static void check_basis(const struct golden_case *golden)
{
    struct golden_table points = golden_read(golden, "points");
    struct golden_table basis = golden_read(golden, "basis");
    const size_t functions = gsn_dms_functions(golden->space);
    const size_t all = golden->mesh->tet_count * functions;
    size_t hint = 0;

    for (size_t p = 0; p < points.rows; p++) {
        double *exact = exact_basis(golden, &basis, p), *own = gsn_alloc_array(all, sizeof *own);
        struct gsn_dms_term term[1000];
        size_t count = 0;

        assert_non_null(own);
        if (gsn_dms_basis(golden->space, golden_row(&points, p) + 2, 0, &hint, term, 1000,
                          &count) == GSN_DMS_OUTSIDE) {
            CHECK(count == 0);
            CHECK(strcmp(points.kind[p], "inside") != 0);
        } else {
            CHECK(strcmp(points.kind[p], "outside") != 0);
            for (size_t i = 0; i < count; i++) {
                own[term[i].tet * functions + term[i].function] = term[i].value;
                CHECK(term[i].control == term[i].tet * functions + term[i].function);
                CHECK(i == 0 || term[i - 1].tet * functions + term[i - 1].function <
                                    term[i].tet * functions + term[i].function);
            }
            for (size_t i = 0; i < all; i++)
                CHECK_NEAR(own[i], exact[i], 1e-12);
        }
        gsn_free(own);
        gsn_free(exact);
    }
    golden_done(&points);
    golden_done(&basis);
}

TEST(the_basis_at_a_point_of_the_mesh_lists_exactly_what_lives_there)
{
    golden_each("basis", check_basis);
}

static void check_core(const struct golden_case *golden)
{
    struct golden_table core = golden_read(golden, "core");

    for (size_t i = 0; i < core.rows; i++) {
        const double *row = golden_row(&core, i);
        double delta[4];

        gsn_dms_core(golden->space, (size_t)row[0], delta);
        for (int k = 0; k < 4; k++)
            CHECK_NEAR(delta[k], row[2 + k], 1e-14);
    }
    golden_done(&core);
}

TEST(the_core_is_the_exact_one)
{
    golden_each("core", check_core);
}

static void check_values(const struct golden_case *golden)
{
    struct golden_table points = golden_read(golden, "points");
    struct golden_table exact = golden_read(golden, "spline");
    gsn_auto(gsn_spline) spline = golden_spline(golden);
    const double steepest = golden_steepest(&exact);
    size_t hint = 0;

    for (size_t p = 0; p < points.rows; p++) {
        const double *u = golden_row(&points, p) + 2, *row = golden_row(&exact, p);
        double value = 99, alone = 99, slope[3] = { 99, 99, 99 };

        if (gsn_spline_eval(spline, u, &hint, &value, slope) == GSN_DMS_OUTSIDE) {
            CHECK(value == 99 && slope[0] == 99);
            continue;
        }
        CHECK(gsn_spline_eval(spline, u, &hint, &alone, NULL) == GSN_OK);
        CHECK(alone == value);
        CHECK_NEAR(value, row[2], 1e-12);
        for (int c = 0; c < 3; c++)
            CHECK_NEAR(slope[c], row[3 + c], 1e-10 * steepest);
    }
    golden_done(&points);
    golden_done(&exact);
}

TEST(the_spline_has_its_exact_value_and_gradient)
{
    golden_each("spline", check_values);
}

static void check_bernstein(const struct golden_case *golden)
{
    struct golden_table exact = golden_read(golden, "bernstein");
    gsn_auto(gsn_spline) spline = golden_spline(golden);

    for (size_t i = 0; i < exact.rows; i++) {
        const double *row = golden_row(&exact, i);
        double own[GSN_DMS_MAX_FUNCTIONS];

        gsn_spline_bernstein(spline, (size_t)row[0], own);
        CHECK_NEAR(own[golden_function(golden->space, row + 1)], row[5], 1e-12);
    }
    golden_done(&exact);
}

TEST(the_polynomials_of_the_cores_are_exact)
{
    golden_each("bernstein", check_bernstein);
}

static void check_lines(const struct golden_case *golden)
{
    struct golden_table exact = golden_read(golden, "lines");
    gsn_auto(gsn_spline) spline = golden_spline(golden);

    for (size_t i = 0; i < exact.rows; i++) {
        const double *row = golden_row(&exact, i), *d = row + 4;
        const double length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        double sum = 0;

        CHECK_NEAR(gsn_spline_line(spline, row + 1, d), row[7] * length, 1e-10);
        for (size_t t = 0; t < golden->mesh->tet_count; t++)
            sum += gsn_spline_tet_line(spline, t, row + 1, d);
        CHECK_NEAR(sum, row[7] * length, 1e-10);
    }
    golden_done(&exact);
}

TEST(whole_line_integrals_are_exact)
{
    golden_each("lines", check_lines);
}

static void check_cells(const struct golden_case *golden)
{
    static const int orders[3][4] = { { 0, 1, 2, 3 }, { 3, 1, 0, 2 }, { 2, 3, 1, 0 } };
    const double tolerance = golden->degree == 3 ? 1e-7 : 1e-10;
    struct golden_table exact = golden_read(golden, "cells");
    gsn_auto(gsn_spline) spline = golden_spline(golden);
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < exact.rows; i++) {
        const double *row = golden_row(&exact, i);
        double mean;

        for (int o = 0; o < 3; o++) {
            double cell[4][3];

            for (int k = 0; k < 4; k++)
                memcpy(cell[k], row + 2 + 3 * orders[o][k], sizeof cell[k]);
            CHECK_OK(gsn_spline_cell_mean(spline, (const double(*)[3])cell, &mean, &err), err);
            CHECK_NEAR(mean, row[15], tolerance);
        }
        for (size_t t = 0; t < golden->mesh->tet_count; t++) {
            int same = 1;

            for (int k = 0; k < 4; k++)
                same = same && memcmp(golden->mesh->vertex[golden->mesh->tet[t][k]],
                                      row + 2 + 3 * k, 3 * sizeof *row) == 0;
            if (!same)
                continue;
            CHECK_OK(gsn_spline_tet_mean(spline, t, &mean, &err), err);
            CHECK_NEAR(mean, row[15], tolerance);
        }
    }
    golden_done(&exact);
}

TEST(means_over_cells_are_exact_also_when_faces_lie_in_knot_planes)
{
    golden_each("cells", check_cells);
}
