/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Exact values of what the reference path alone computes: second derivatives, derivatives by the
 * knots, finite segments, inserted vertices, power coefficients. */
#include "tests/model/golden.h"

#include "tests/check.h"
#include "tests/model/formula.h"

#include "pipeline/model/bpatch.h"
#include "pipeline/model/knots.h"
#include "pipeline/model/spline.h"

#include <string.h>

enum { FIRST_SECOND = 6 }; /* the column of sxx in spline.csv */

/* Second derivatives of s by its definition, also outside. */
static void formula_hessian(const struct golden_case *golden, const double u[3], double ret[6])
{
    memset(ret, 0, 6 * sizeof *ret);
    for (size_t t = 0; t < golden->mesh->tet_count; t++) {
        const uint32_t *id = gsn_dms_control_ids(golden->space, t);
        double value[GSN_DMS_MAX_FUNCTIONS], hessian[GSN_DMS_MAX_FUNCTIONS][6];

        formula_basis(golden->space, t, u, value, NULL, hessian);
        for (size_t f = 0; f < gsn_dms_functions(golden->space); f++) {
            for (int i = 0; i < 6; i++)
                ret[i] += golden->control[id[f]] * hessian[f][i];
        }
    }
}

static double largest_second(const struct golden_table *spline)
{
    double largest = 0;

    for (size_t i = 0; i < spline->rows * spline->columns; i++) {
        if (i % spline->columns >= FIRST_SECOND)
            largest = fmax(largest, fabs(spline->cell[i]));
    }
    return largest;
}

static void check_hessian(const struct golden_case *golden)
{
    struct golden_table points = golden_read(golden, "points");
    struct golden_table exact = golden_read(golden, "spline");
    gsn_auto(gsn_spline) spline = golden_spline(golden);
    const double tolerance = 1e-7 * largest_second(&exact);
    size_t hint = 0;

    for (size_t p = 0; p < points.rows; p++) {
        const double *u = golden_row(&points, p) + 2, *row = golden_row(&exact, p);
        double own[6], at[6] = { 99, 99, 99, 99, 99, 99 };
        const int found = gsn_spline_hessian(spline, u, &hint, at) == GSN_OK;

        formula_hessian(golden, u, own);
        for (int i = 0; i < 6; i++) {
            const double truth = golden->degree > 1 ? row[FIRST_SECOND + i] : 0;

            CHECK_NEAR(own[i], truth, tolerance);
            CHECK_NEAR(at[i], found ? truth : 99, tolerance);
        }
    }
    golden_done(&points);
    golden_done(&exact);
}

TEST(second_derivatives_are_exact_at_every_kind_of_point)
{
    golden_each("spline", check_hessian);
}

/* All derivatives by knots at one point, by the definition and, where there is data, by the
 * product, which must agree. */
static void find_knots(const struct golden_case *golden, const struct gsn_spline *spline,
                       const double u[3], double (*ret_total)[3])
{
    const size_t knots = golden->mesh->vertex_count * (golden->degree + 1);
    double(*own)[3] = gsn_alloc_array(knots, sizeof *own);
    size_t hint = 0;

    memset(ret_total, 0, knots * sizeof *ret_total);
    formula_knots(golden->space, golden->control, u, ret_total);
    if (gsn_knots_gradient_add(spline, u, &hint, 1, own) == GSN_OK) {
        for (size_t i = 0; i < 3 * knots; i++)
            CHECK_NEAR(own[i / 3][i % 3], ret_total[i / 3][i % 3], 1e-12);
    }
    gsn_free(own);
}

static void check_knots(const struct golden_case *golden)
{
    struct golden_table points = golden_read(golden, "points");
    struct golden_table exact = golden_read(golden, "knotderiv");
    gsn_auto(gsn_spline) spline = golden_spline(golden);
    const size_t knots = golden->mesh->vertex_count * (golden->degree + 1);
    double(*total)[3] = gsn_alloc_array(knots, sizeof *total);
    size_t last = SIZE_MAX;

    for (size_t i = 0; i < exact.rows; i++) {
        const double *row = golden_row(&exact, i);
        const size_t knot = (size_t)row[1] * (golden->degree + 1) + (size_t)row[2];

        if ((size_t)row[0] != last) {
            last = (size_t)row[0];
            find_knots(golden, spline, golden_row(&points, last) + 2, total);
        }
        for (int c = 0; c < 3; c++)
            CHECK_NEAR(total[knot][c], row[3 + c], 1e-10);
    }
    gsn_free(total);
    golden_done(&points);
    golden_done(&exact);
}

TEST(derivatives_by_the_knots_are_exact)
{
    golden_each("knotderiv", check_knots);
}

static void check_segments(const struct golden_case *golden)
{
    struct golden_table exact = golden_read(golden, "segments");
    gsn_auto(gsn_spline) spline = golden_spline(golden);

    for (size_t i = 0; i < exact.rows; i++) {
        const double *row = golden_row(&exact, i), *a = row + 1, *b = row + 4;
        const double length = hypot(hypot(b[0] - a[0], b[1] - a[1]), b[2] - a[2]);
        struct gsn_error err = { 0 };
        double integral;

        CHECK_OK(gsn_spline_segment(spline, a, b, &integral, &err), err);
        CHECK_NEAR(integral / length, row[7], 1e-10);
        CHECK_OK(gsn_spline_segment(spline, b, a, &integral, &err), err);
        CHECK_NEAR(integral / length, row[7], 1e-10);
    }
    golden_done(&exact);
}

TEST(integrals_along_finite_segments_are_exact)
{
    golden_each("segments", check_segments);
}

/* The control points of the four tetrahedra, and every value as it was. */
static void check_split(const struct golden_case *golden, const struct gsn_dms *space,
                        const double *control)
{
    struct golden_table exact = golden_read(golden, "refine_control");
    struct golden_table points = golden_read(golden, "points");
    struct golden_table values = golden_read(golden, "spline");

    for (size_t i = 0; i < exact.rows; i++) {
        const double *row = golden_row(&exact, i);
        const size_t tet = row[0] == 0 ? 0 : golden->mesh->tet_count - 1 + (size_t)row[0];

        CHECK_NEAR(control[gsn_dms_control_ids(space, tet)[golden_function(space, row + 1)]],
                   row[5], 1e-12);
    }
    for (size_t p = 0; p < points.rows; p++)
        CHECK_NEAR(formula_at(space, control, golden_row(&points, p) + 2, NULL),
                   golden_row(&values, p)[2], 1e-12);
    golden_done(&exact);
    golden_done(&points);
    golden_done(&values);
}

/* Sets with very large clouds may ask for what is no valid space. */
static void check_insertion(const struct golden_case *golden)
{
    struct golden_table knots = golden_read(golden, "refine_knots");
    gsn_auto(gsn_spline) spline = golden_spline(golden);
    gsn_auto(gsn_dms) space = NULL;
    double cloud[GSN_DMS_MAX_DEGREE + 1][3], *control = NULL;
    struct gsn_error err = { 0 };

    for (size_t l = 0; l < knots.rows; l++)
        memcpy(cloud[l], golden_row(&knots, l) + 1, sizeof cloud[l]);
    golden_done(&knots);
    if (gsn_insert_vertex(spline, 0, (const double(*)[3])cloud, &space, &control, &err) < 0) {
        print_message("refused: %s\n", err.text);
        CHECK(strstr(err.text, "smaller knot clouds are needed"));
        return;
    }
    check_split(golden, space, control);
    gsn_free(control);
}

TEST(an_inserted_vertex_gets_its_exact_control_points_and_changes_no_value)
{
    golden_each("refine_control", check_insertion);
}

static _Float128 power_of(_Float128 base, double exponent)
{
    _Float128 power = 1;

    for (int i = 0; i < (int)exponent; i++)
        power *= base;
    return power;
}

/* Far from the origin monomials cancel: at x = 1024 those of degree 3 by nine digits, all of which
 * a double would lose, so they are summed in four times its precision. */
static void check_power(const struct golden_case *golden)
{
    struct golden_table exact = golden_read(golden, "power");
    gsn_auto(gsn_spline) spline = golden_spline(golden);

    for (size_t t = 0; t < golden->mesh->tet_count; t++) {
        const uint32_t *v = golden->mesh->tet[t];
        double own[GSN_DMS_MAX_FUNCTIONS];
        struct gsn_barycentric frame;

        gsn_barycentric_init(&frame, golden->mesh->vertex[v[0]], golden->mesh->vertex[v[1]],
                             golden->mesh->vertex[v[2]], golden->mesh->vertex[v[3]]);
        gsn_spline_bernstein(spline, t, own);
        /* A polynomial is its values at the nodes of the Bernstein form. */
        for (size_t f = 0; f < gsn_dms_functions(golden->space); f++) {
            const uint8_t *beta = gsn_dms_beta(golden->space, f);
            _Float128 u[3] = { 0 }, truth = 0;
            double lambda[4];
            int listed = 0;

            for (int k = 0; k < 4; k++) {
                lambda[k] = (double)beta[k] / golden->degree;
                for (int c = 0; c < 3; c++)
                    u[c] += (_Float128)golden->mesh->vertex[v[k]][c] * beta[k] / golden->degree;
            }
            for (size_t i = 0; i < exact.rows; i++) {
                const double *row = golden_row(&exact, i);

                if ((size_t)row[0] != t)
                    continue;
                listed = 1;
                truth += exact.fine[i * exact.columns + 4] * power_of(u[0], row[1]) *
                         power_of(u[1], row[2]) * power_of(u[2], row[3]);
            }
            if (listed)
                CHECK_NEAR(gsn_bernstein_at(golden->degree, own, &frame, lambda, NULL),
                           (double)truth, 1e-12);
        }
    }
    golden_done(&exact);
}

TEST(the_polynomials_of_the_cores_have_their_exact_power_coefficients)
{
    golden_each("power", check_power);
}
