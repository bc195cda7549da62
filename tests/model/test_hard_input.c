/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Cells, points, lines, knots and numbers that are degenerate, far away or none at all: the right
 * value, or a refusal that leaves the outputs alone. */
#include "tests/check.h"
#include "tests/model/kuhn.h"

#include "pipeline/model/batch.h"
#include "pipeline/model/dms_internal.h"
#include "pipeline/model/knots.h"
#include "pipeline/model/resample.h"
#include "pipeline/model/spline.h"

#include <string.h>

static const size_t CUBES[3] = { 2, 2, 2 };

struct made {
    struct polynomial p;
    struct gsn_dms *space;
    struct gsn_spline *spline;
};

static struct made make_polynomial(unsigned degree)
{
    uint64_t seed = 65;
    struct made made = { .p = draw_polynomial(degree, &seed),
                         .space = kuhn_space(CUBES, 0.1, degree, 0.05, GSN_DMS_SHARED) };
    gsn_auto_mem(double) control = polynomial_controls(&made.p, made.space);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spline_new(made.space, control, &made.spline, &err), err);
    return made;
}

static void unmake(struct made *made)
{
    gsn_spline_free(made->spline);
    gsn_dms_free(made->space);
}

/* Exact for polynomials of degree up to 3: corners and centres of the faces. */
static double mean_by_points(const struct polynomial *p, const double cell[4][3])
{
    double sum = 0;

    for (int k = 0; k < 4; k++) {
        double centre[3] = { 0 };

        for (int j = 0; j < 4; j++) {
            for (int c = 0; c < 3; c++)
                centre[c] += j == k ? 0 : cell[j][c] / 3;
        }
        sum += polynomial_at(p, cell[k], NULL) / 40 + polynomial_at(p, centre, NULL) * 9 / 40;
    }
    return sum;
}

/* Down to no height at all: the mean of a polynomial, or the refusal of a flat cell. */
TEST(cells_as_flat_as_can_be_have_their_mean_or_are_refused)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        struct made made = make_polynomial(degree);
        double worst = 0;

        for (int i = 0; i <= 60; i++) {
            const double height = i == 60 ? 0 : ldexp(1, -i);
            const double cell[4][3] = {
                { 0.4, 0.3, 0.5 }, { 1.6, 0.5, 0.5 }, { 0.7, 1.5, 0.5 }, { 0.9, 0.8, 0.5 + height }
            };
            struct gsn_error err = { 0 };
            double mean = 99;
            const int r = gsn_spline_cell_mean(made.spline, cell, &mean, &err);

            if (r != GSN_OK) {
                CHECK(r == GSN_E_INPUT && strstr(err.text, "cell") != NULL && mean == 99);
                continue;
            }
            worst = fmax(worst, fabs(mean - mean_by_points(&made.p, cell)));
            CHECK_NEAR(mean, mean_by_points(&made.p, cell), degree < 3 ? 1e-9 : 1e-6);
        }
        print_message("flat cells n = %u: mean off by %.1e\n", degree, worst);
        unmake(&made);
    }
}

TEST(cells_without_volume_are_refused_and_the_output_stays_untouched)
{
    static const double cell[][4][3] = {
        { { 0.5, 0.5, 0.5 }, { 0.5, 0.5, 0.5 }, { 0.5, 0.5, 0.5 }, { 0.5, 0.5, 0.5 } },
        { { 0, 0, 0 }, { 1, 0, 0 }, { 2, 0, 0 }, { 1, 1, 1 } },
        { { 0, 0, 0.5 }, { 1, 0, 0.5 }, { 0, 1, 0.5 }, { 1, 1, 0.5 } },
        { { 1e9, 0, 0.5 }, { 1e9, 1, 0.5 }, { 1e9, 0, 1 }, { 1e9, 1, 1 } },
    };
    struct made made = make_polynomial(2);

    for (size_t i = 0; i < sizeof cell / sizeof *cell; i++) {
        struct gsn_error err = { 0 };
        double mean = 99;

        CHECK(gsn_spline_cell_mean(made.spline, cell[i], &mean, &err) == GSN_E_INPUT);
        CHECK(strstr(err.text, "flat") != NULL && mean == 99);
    }
    unmake(&made);
}

/* ---- what is no number, and what is far away ---- */

static const double NOWHERE[][3] = {
    { NAN, 1, 1 },
    { 1, NAN, 1 },
    { 1, 1, NAN },
    { NAN, NAN, NAN },
    { INFINITY, 1, 1 },
    { 1, -INFINITY, 1 },
    { 1, 1, INFINITY },
    { INFINITY, -INFINITY, NAN },
    { 1e9, 1, 1 },
    { 1, -1e9, 1 },
    { 1, 1, 1e9 },
    { 1e9, 1e9, 1e9 },
    { 1e300, 1, 1 },
    { 1, -1.7e308, 1 },
    { 1.7e308, 1.7e308, -1.7e308 },
};
enum { NOWHERES = sizeof NOWHERE / sizeof *NOWHERE, NOT_FINITE = 8 };

TEST(points_that_are_no_numbers_or_far_away_have_no_data)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        struct made made = make_polynomial(degree);

        for (size_t i = 0; i < NOWHERES; i++) {
            double value = 99, slope[3] = { 99, 99, 99 }, second[6] = { 99 },
                   total[1][3] = { { 99 } };
            struct gsn_dms_term term[1];
            size_t hint = 3, home = 77, count = 99;

            CHECK(gsn_spline_eval(made.spline, NOWHERE[i], &hint, &value, slope) ==
                  GSN_DMS_OUTSIDE);
            CHECK(gsn_dms_locate(made.space, NOWHERE[i], 0, &home) == GSN_DMS_OUTSIDE);
            CHECK(gsn_dms_basis(made.space, NOWHERE[i], 1, &hint, term, 1, &count) ==
                  GSN_DMS_OUTSIDE);
            CHECK(gsn_spline_hessian(made.spline, NOWHERE[i], &hint, second) == GSN_DMS_OUTSIDE);
            CHECK(gsn_knots_gradient_add(made.spline, NOWHERE[i], &hint, 1, total) ==
                  GSN_DMS_OUTSIDE);
            CHECK(value == 99 && slope[0] == 99 && second[0] == 99 && total[0][0] == 99);
            CHECK(home == 77 && count == 0 && hint == 3);
        }
        unmake(&made);
    }
}

TEST(among_many_points_those_that_are_no_numbers_spoil_no_others)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        struct made made = make_polynomial(degree);
        double at[20 * NOWHERES][3], value[20 * NOWHERES], slope[20 * NOWHERES][3];
        struct gsn_error err = { 0 };
        uint64_t seed = 66;

        for (size_t i = 0; i < 20 * NOWHERES; i++) {
            for (int c = 0; c < 3; c++)
                at[i][c] = i % 3 ? 2 * draw(&seed) : NOWHERE[i / 3 % NOWHERES][c];
        }
        for (int isa = 0; isa < GSN_ISA_COUNT; isa++) {
            if (!gsn_kernels_for((enum gsn_isa)isa))
                continue;
            gsn_dms_use(made.space, gsn_kernels_for((enum gsn_isa)isa));
            CHECK_OK(gsn_spline_eval_many(made.spline, (const double(*)[3])at, 20 * NOWHERES, 1,
                                          value, slope, &err),
                     err);
            for (size_t i = 0; i < 20 * NOWHERES; i++) {
                if (i % 3)
                    CHECK_NEAR(value[i], polynomial_at(&made.p, at[i], NULL), 1e-12);
                else if (!isnan(value[i]) || !isnan(slope[i][0]) || !isnan(slope[i][2]))
                    fail_msg("data at point %zu", i);
            }
        }
        unmake(&made);
    }
}

/* One voxel of a lattice so wide that all the others are far away. */
TEST(a_lattice_much_larger_than_the_mesh_has_the_value_where_it_meets_it)
{
    static const double step[] = { 1e3, 1e9, 1e15, 1e100, 1e300 };

    for (unsigned degree = 1; degree <= 3; degree++) {
        struct made made = make_polynomial(degree);

        for (size_t i = 0; i < sizeof step / sizeof *step; i++) {
            const struct gsn_lattice at = {
                5, 3, 4, { 0.75, 0.5, 0.25 }, { step[i], step[i], step[i] }
            };
            struct gsn_error err = { 0 };
            double value[60];

            CHECK_OK(gsn_spline_resample(made.spline, &at, 1, value, &err), err);
            CHECK_NEAR(value[0], polynomial_at(&made.p, (const double[]){ 0.75, 0.5, 0.25 }, NULL),
                       1e-12);
            for (int v = 1; v < 60; v++) {
                if (!isnan(value[v]))
                    fail_msg("data at voxel %d", v);
            }
        }
        unmake(&made);
    }
}

TEST(a_lattice_far_away_has_no_data)
{
    static const double from[] = { 1e9, -1e9, 1e100, -1e300 };
    struct made made = make_polynomial(2);

    for (size_t i = 0; i < sizeof from / sizeof *from; i++) {
        const struct gsn_lattice at = { 3, 2, 2, { from[i], 0.5, 0.25 }, { 0.1, 0.1, 0.1 } };
        struct gsn_error err = { 0 };
        double value[12];

        CHECK_OK(gsn_spline_resample(made.spline, &at, 1, value, &err), err);
        for (int v = 0; v < 12; v++) {
            if (!isnan(value[v]))
                fail_msg("data at voxel %d", v);
        }
    }
    unmake(&made);
}

TEST(cells_and_segments_that_are_no_numbers_are_refused)
{
    struct made made = make_polynomial(2);

    for (size_t i = 0; i < NOT_FINITE; i++) {
        const double end[3] = { 1, 1, 0.5 };

        for (int k = 0; k < 4; k++) {
            double cell[4][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } }, mean = 99;
            struct gsn_error err = { 0 };

            memcpy(cell[k], NOWHERE[i], sizeof cell[k]);
            CHECK(gsn_spline_cell_mean(made.spline, (const double(*)[3])cell, &mean, &err) ==
                  GSN_E_INPUT);
            CHECK(strstr(err.text, "finite") != NULL && mean == 99);
        }
        for (int turn = 0; turn < 2; turn++) {
            struct gsn_error err = { 0 };
            double integral = 99;

            CHECK(gsn_spline_segment(made.spline, turn ? end : NOWHERE[i], turn ? NOWHERE[i] : end,
                                     &integral, &err) == GSN_E_INPUT);
            CHECK(strstr(err.text, "finite") != NULL && integral == 99);
        }
    }
    unmake(&made);
}

TEST(lines_without_a_place_or_a_direction_have_no_integral)
{
    static const double wrong[][3] = { { 0, 0, 0 }, { NAN, 0, 1 }, { 1, INFINITY, 0 } };
    struct made made = make_polynomial(2);
    const double at[3] = { 1, 1, 1 }, along[3] = { 0.3, 0.4, 0.5 };

    for (size_t i = 0; i < 3; i++) {
        if (!isnan(gsn_spline_line(made.spline, at, wrong[i])) ||
            !isnan(gsn_spline_tet_line(made.spline, 0, at, wrong[i])))
            fail_msg("an integral along direction %zu", i);
    }
    for (size_t i = 0; i < NOT_FINITE; i++) {
        if (!isnan(gsn_spline_line(made.spline, NOWHERE[i], along)))
            fail_msg("an integral through point %zu", i);
    }
    unmake(&made);
}

TEST(the_length_of_a_direction_does_not_matter)
{
    static const double length[] = { 1e-300, 1e-200, 1e-9, 1e9, 1e200, 1e300 };
    struct made made = make_polynomial(2);
    const double at[3] = { 1, 0.9, 1.1 }, along[3] = { 0.3, 0.4, 0.5 };
    const double integral = gsn_spline_line(made.spline, at, along);

    CHECK(fabs(integral) > 1e-3);
    for (size_t i = 0; i < sizeof length / sizeof *length; i++) {
        const double d[3] = { along[0] * length[i], along[1] * length[i], along[2] * length[i] };

        CHECK_NEAR(gsn_spline_line(made.spline, at, d), integral, 1e-12);
    }
    unmake(&made);
}

TEST(lines_segments_and_cells_from_far_away_have_their_integrals)
{
    struct made made = make_polynomial(2);
    struct gsn_error err = { 0 };
    const double near[3] = { 0.9, 1.1, 0.7 }, far[3] = { 0.9, 1.1, 1e9 }, along[3] = { 0, 0, 1 };
    const double back[3] = { 0.9, 1.1, -1e9 }, beside[3] = { 1e9, 1.1, 0.7 };
    const double line = gsn_spline_line(made.spline, near, along);
    const double cell[4][3] = { { 1e9, 0, 0 }, { 1e9 + 1, 0, 0 }, { 1e9, 1, 0 }, { 1e9, 0, 1 } };
    double integral = 99, mean = 99;

    CHECK(fabs(line) > 1e-3);
    CHECK_NEAR(gsn_spline_line(made.spline, far, along), line, 1e-12);
    CHECK(gsn_spline_line(made.spline, beside, along) == 0);
    CHECK_OK(gsn_spline_segment(made.spline, back, far, &integral, &err), err);
    CHECK_NEAR(integral, line, 1e-10);
    CHECK_OK(
        gsn_spline_segment(made.spline, beside, (const double[]){ 1e9, -5, 3 }, &integral, &err),
        err);
    CHECK(integral == 0);
    CHECK_OK(gsn_spline_segment(made.spline, near, near, &integral, &err), err);
    CHECK(integral == 0);
    CHECK_OK(gsn_spline_cell_mean(made.spline, cell, &mean, &err), err);
    CHECK(mean == 0);
    unmake(&made);
}

/* A cell around everything: the integral is the sum over functions, int N = vol(X) / 10. */
TEST(a_cell_around_everything_holds_the_integrals_of_all_functions)
{
    static const double size[] = { 10, 1e3, 1e6, 1e9 };
    struct made made = make_polynomial(2);
    const struct gsn_tets *mesh = gsn_dms_mesh(made.space);
    double exact = 0;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (size_t f = 0; f < 10; f++) {
            const uint8_t *beta = gsn_dms_beta(made.space, f);
            const double *x[4];

            for (int k = 0; k < 4; k++)
                x[k] = gsn_dms_knots(made.space)[mesh->tet[t][k] * 3 + beta[k]];
            exact += gsn_spline_controls(made.spline)[gsn_dms_control_ids(made.space, t)[f]] *
                     gsn_det(x[0], x[1], x[2], x[3]) / 60;
        }
    }
    for (size_t i = 0; i < sizeof size / sizeof *size; i++) {
        const double s = size[i];
        const double cell[4][3] = {
            { -s, -s, -s }, { 3 * s, -s, -s }, { -s, 3 * s, -s }, { -s, -s, 3 * s }
        };
        struct gsn_error err = { 0 };
        double mean = 99;

        CHECK_OK(gsn_spline_cell_mean(made.spline, cell, &mean, &err), err);
        print_message("cell of %g: integral off by %.1e\n", s, mean * 64 * s * s * s / 6 - exact);
        CHECK_NEAR(mean * 64 * s * s * s / 6, exact, 1e-9);
    }
    unmake(&made);
}

TEST(knots_and_control_values_that_are_no_numbers_are_refused)
{
    static const double wrong[3] = { NAN, INFINITY, -INFINITY };

    for (int i = 0; i < 3; i++) {
        gsn_auto(gsn_dms) space = kuhn_space(CUBES, 0.1, 2, 0.05, GSN_DMS_SHARED);
        const size_t knots = gsn_dms_mesh(space)->vertex_count * 3;
        double(*knot)[3] = gsn_memdup(gsn_dms_knots(space), knots * sizeof *knot), *controls = NULL;
        gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
        double cloud[3][3] = { { 0.5, 0.25, 0.125 }, { 0.5, 0.25, 0.125 }, { 0.5, 0.25, 0.125 } };
        gsn_auto(gsn_spline) spline = NULL;
        struct gsn_dms *other = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
        cloud[i][1] = wrong[i];
        CHECK(gsn_insert_vertex(spline, 0, (const double(*)[3])cloud, &other, &controls, &err) < 0);
        CHECK(err.text[0] != 0 && other == NULL && controls == NULL);
        err = (struct gsn_error){ 0 };
        knot[4][i] = wrong[i];
        CHECK(gsn_dms_new(gsn_dms_mesh(space), 2, (const double(*)[3])knot, GSN_DMS_OWN, &other,
                          &err) == GSN_E_INPUT);
        CHECK(strstr(err.text, "finite") != NULL && other == NULL);
        gsn_spline_free(gsn_steal(&spline));
        err = (struct gsn_error){ 0 };
        control[3] = wrong[i];
        CHECK(gsn_spline_new(space, control, &spline, &err) == GSN_E_INPUT);
        CHECK(strstr(err.text, "finite") != NULL && spline == NULL);
        gsn_free(knot);
    }
}

TEST(cloud_sizes_out_of_range_are_refused)
{
    static const double wrong[] = { NAN, 0, -0.1, 0.6, INFINITY };
    gsn_auto(gsn_tets) mesh = kuhn_mesh(CUBES, 0.1);

    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        double(*knots)[3] = NULL;
        struct gsn_error err = { 0 };

        CHECK(gsn_dms_clouds(mesh, 2, wrong[i], &knots, &err) == GSN_E_INPUT);
        CHECK(strstr(err.text, "cloud size") != NULL && knots == NULL);
    }
}
