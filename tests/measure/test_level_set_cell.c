/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/level_set_cell.h"

#include <string.h>

#include "pipeline/measure/tet_cut.h"
#include "tests/check.h"
#include "tests/measure/kuhn.h"

/* A domain of a cube of 2000 um and cells in it. */
static const double low[3] = { 0.0, 0.0, 0.0 }, high[3] = { 2000.0, 2000.0, 2000.0 };
static const double middle = 1000.0;
static const unsigned cells[3] = { 3, 3, 3 };
/* Not along any axis, through some twenty tetrahedra. */
static const double skew[4][3] = { { 310.0, 270.0, 350.0 },
                                   { 1810.0, 420.0, 290.0 },
                                   { 530.0, 1790.0, 610.0 },
                                   { 760.0, 650.0, 1830.0 } };
/* The same, two fifths the size. */
static const double small[4][3] = { { 630.0, 570.0, 750.0 },
                                    { 1230.0, 630.0, 726.0 },
                                    { 718.0, 1178.0, 854.0 },
                                    { 810.0, 722.0, 1342.0 } };
/* Holds the ball of radius 400 about the middle; the ball that touches its faces has 577. */
static const double large[4][3] = {
    { 0.0, 0.0, 0.0 }, { 2000.0, 2000.0, 0.0 }, { 2000.0, 0.0, 2000.0 }, { 0.0, 2000.0, 2000.0 }
};

static double volume_of(const double cell[4][3])
{
    struct gsn_tet_cell tet;

    memcpy(tet.corner, cell, sizeof tet.corner);
    return gsn_tet_cell_volume(&tet);
}

/* Radius^2 less the square of the distance from the middle, over radius^2. */
static struct quadric ball(double radius)
{
    struct quadric q = { 1.0, { 0.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };

    for (int a = 0; a < 3; a++) {
        q.constant -= middle * middle / (radius * radius);
        q.linear[a] = 2.0 * middle / (radius * radius);
        q.square[a] = -1.0 / (radius * radius);
    }
    return q;
}

static struct gsn_volume_bound bound_of(const struct kuhn *kuhn, const double cell[4][3],
                                        double threshold, double gap, size_t most_cells)
{
    const struct gsn_level_set_cell_options options = { gap, most_cells };
    struct gsn_volume_bound bound = { 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_level_set_cell(kuhn->spline, cell, threshold, &options, &bound, &err), err);
    CHECK(bound.lower_um3 >= 0.0 && bound.lower_um3 <= bound.upper_um3);
    return bound;
}

TEST(a_share_cut_by_a_plane_equals_the_spline_formula)
{
    /* The divided difference sum_k max(0, v_k)^3 / prod_j (v_k - v_j), for distinct values. */
    const double value[5][4] = { { 1.0, -2.0, -3.0, -4.5 },
                                 { 1.0, 2.5, -3.0, -4.0 },
                                 { -2.0, 4.0, 1.5, -1.0 },
                                 { 3.0, 1.0, -0.5, 2.0 },
                                 { -0.001, 1.0, 2.0, -3.0 } };

    for (int i = 0; i < 5; i++) {
        double share = 0.0, flipped[4];

        for (int k = 0; k < 4; k++) {
            double term = value[i][k] > 0.0 ? pow(value[i][k], 3) : 0.0;

            for (int j = 0; j < 4; j++)
                term /= j == k ? 1.0 : value[i][k] - value[i][j];
            share += term;
            flipped[k] = -value[i][k];
        }
        CHECK_NEAR(gsn_tet_share_above(value[i]), share, 1e-14);
        CHECK_NEAR(gsn_tet_share_above(flipped), 1.0 - share, 1e-14);
    }
}

TEST(a_half_space_is_exact)
{
    /* x + y + z > t at the corner at 0 of a cell with legs 900: what is left of it is similar. */
    const double corner[4][3] = { { 400.0, 500.0, 600.0 },
                                  { 1300.0, 500.0, 600.0 },
                                  { 400.0, 1400.0, 600.0 },
                                  { 400.0, 500.0, 1500.0 } };
    const struct quadric q = { 0.0, { 1.0, 1.0, 1.0 }, { 0.0, 0.0, 0.0 } };

    for (unsigned degree = 1; degree <= 3; degree++) {
        struct gsn_error err = { 0 };
        struct kuhn kuhn;

        CHECK_OK(kuhn_new(low, high, cells, degree, 0.03, &q, &kuhn, &err), err);
        for (double reach = 0.1; reach < 1.0; reach += 0.2) {
            const double truth = volume_of(corner) * (1.0 - pow(reach, 3));
            const struct gsn_volume_bound bound =
                bound_of(&kuhn, corner, 1500.0 + 900.0 * reach, 0.0, 0);

            CHECK(bound.lower_um3 <= truth && truth <= bound.upper_um3);
            CHECK(bound.upper_um3 - bound.lower_um3 <= 1e-8 * truth);
        }
        kuhn_done(&kuhn);
    }
}

TEST(a_ball_lies_between_its_bounds)
{
    const struct quadric q = ball(400.0);

    for (unsigned degree = 2; degree <= 3; degree++) {
        struct gsn_error err = { 0 };
        struct kuhn kuhn;

        CHECK_OK(kuhn_new(low, high, cells, degree, 0.05, &q, &kuhn, &err), err);
        for (double threshold = 0.0; threshold < 0.9; threshold += 0.4) {
            const double truth = 4.0 / 3.0 * M_PI * 6.4e7 * pow(1.0 - threshold, 1.5);
            const struct gsn_volume_bound bound = bound_of(&kuhn, large, threshold, 1e-2, 0);

            CHECK(bound.lower_um3 <= truth && truth <= bound.upper_um3);
            CHECK(bound.upper_um3 - bound.lower_um3 <=
                  1e-2 * fmax(bound.upper_um3, 0.01 * volume_of(large)));
        }
        kuhn_done(&kuhn);
    }
}

TEST(the_gap_shrinks_to_0_6_or_less_when_the_cells_double)
{
    const struct quadric q = ball(400.0);
    const double truth = 4.0 / 3.0 * M_PI * 6.4e7 * pow(0.7, 1.5);
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    double gap = 0.0;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &q, &kuhn, &err), err);
    for (size_t most = 2000; most <= 16000; most *= 2) {
        const struct gsn_volume_bound bound = bound_of(&kuhn, large, 0.3, 1e-12, most);
        const double here = bound.upper_um3 - bound.lower_um3;

        CHECK(bound.lower_um3 <= truth && truth <= bound.upper_um3 && bound.cells == most);
        if (gap > 0.0)
            CHECK(here <= 0.6 * gap);
        gap = here;
    }
    kuhn_done(&kuhn);
}

TEST(bounds_of_a_part_and_of_the_rest_hold_the_whole_volume)
{
    const double whole = volume_of(small);

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_spline) negative = NULL;
        struct gsn_error err = { 0 };
        struct gsn_volume_bound above, below;
        struct kuhn kuhn, flipped;
        double control[4096];

        CHECK_OK(kuhn_random(low, high, cells, degree, 0.04, 7, &kuhn, &err), err);
        for (size_t c = 0; c < gsn_dms_controls(kuhn.space); c++)
            control[c] = -gsn_spline_controls(kuhn.spline)[c];
        CHECK_OK(gsn_spline_new(kuhn.space, control, &negative, &err), err);
        flipped = kuhn;
        flipped.spline = negative;
        above = bound_of(&kuhn, small, 0.1, 0.02, 4000);
        print_message("degree %u: width %.2g of the cell, %zu parts\n", degree,
                      (above.upper_um3 - above.lower_um3) / whole, above.cells);
        below = bound_of(&flipped, small, -0.1, 0.02, 4000);
        CHECK(above.lower_um3 + below.lower_um3 <= whole * (1.0 + 1e-12));
        CHECK(above.upper_um3 + below.upper_um3 >= whole * (1.0 - 1e-12));
        kuhn_done(&kuhn);
    }
}

/* The share of the cell's points that are above: a lattice of them in a cube, folded. */
static double share_by_points(const struct gsn_spline *spline, const double cell[4][3],
                              double threshold)
{
    enum { STEPS = 40 };
    size_t hint = 0, above = 0;

    for (int i = 0; i < STEPS * STEPS * STEPS; i++) {
        const double x = (i % STEPS + 0.5) / STEPS, y = (i / STEPS % STEPS + 0.5) / STEPS;
        const double z = (i / STEPS / STEPS + 0.5) / STEPS;
        const double least = fmin(x, fmin(y, z)), most = fmax(x, fmax(y, z));
        const double share[4] = { 1.0 - most, most - (x + y + z - least - most),
                                  x + y + z - least - most - least, least };
        double u[3], value;

        for (int a = 0; a < 3; a++)
            u[a] = share[0] * cell[0][a] + share[1] * cell[1][a] + share[2] * cell[2][a] +
                   share[3] * cell[3][a];
        if (gsn_spline_eval(spline, u, &hint, &value, NULL) == GSN_OK)
            above += value > threshold;
    }
    return (double)above / (STEPS * STEPS * STEPS);
}

/* Points are good to about the share that the surface cuts of the lattice's cells, by chance up or
 * down: much less than 0.5 %. */
static void check_by_points(const struct kuhn *kuhn, double threshold, double width)
{
    const double whole = volume_of(small);
    const double share = share_by_points(kuhn->spline, small, threshold);
    const struct gsn_volume_bound bound = bound_of(kuhn, small, threshold, 1e-3, 8000);

    print_message("  %.4f..%.4f, by points %.4f\n", bound.lower_um3 / whole,
                  bound.upper_um3 / whole, share);
    CHECK(bound.lower_um3 / whole <= share + 0.005 && bound.upper_um3 / whole >= share - 0.005);
    CHECK(bound.upper_um3 - bound.lower_um3 <= width * whole);
}

TEST(random_splines_lie_between_their_bounds)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        struct gsn_error err = { 0 };
        struct kuhn kuhn;

        CHECK_OK(kuhn_random(low, high, cells, degree, 0.03, 11, &kuhn, &err), err);
        for (double threshold = -0.2; threshold < 0.3; threshold += 0.2)
            check_by_points(&kuhn, threshold, 0.5);
        kuhn_done(&kuhn);
    }
}

TEST(a_spline_that_ends_sharply_at_the_boundary_lies_between_its_bounds)
{
    const struct quadric q = { 0.0, { 1e-3, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };
    /* x runs from 0 to 2000 and the cell up to the faces of the domain. */
    const double corner[4][3] = {
        { 0.0, 0.0, 0.0 }, { 2000.0, 0.0, 0.0 }, { 0.0, 2000.0, 0.0 }, { 0.0, 0.0, 2000.0 }
    };
    struct gsn_error err = { 0 };
    struct gsn_volume_bound bound;
    struct kuhn kuhn;

    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.02, &q, &kuhn, &err), err);
    bound = bound_of(&kuhn, corner, 1.0, 1e-3, 8000);
    CHECK(bound.lower_um3 <= volume_of(corner) / 8.0);
    CHECK(bound.upper_um3 >= share_by_points(kuhn.spline, corner, 1.0) * 0.97 * volume_of(corner));
    CHECK(bound.upper_um3 - bound.lower_um3 <= 0.1 * volume_of(corner));
    kuhn_done(&kuhn);
}

TEST(cells_of_the_mesh_and_cells_that_fill_the_domain_to_its_faces_are_fine)
{
    const struct quadric q = { 0.0, { 1.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };
    const struct gsn_tets *mesh;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    double sum = 0.0;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &q, &kuhn, &err), err);
    mesh = gsn_dms_mesh(kuhn.space);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        double corner[4][3];

        for (int k = 0; k < 4; k++)
            memcpy(corner[k], mesh->vertex[mesh->tet[t][k]], sizeof corner[k]);
        sum += bound_of(&kuhn, (const double(*)[3])corner, 500.0, 1e-6, 0).upper_um3;
    }
    CHECK_NEAR(sum, 6e9, 600.0);
    kuhn_done(&kuhn);
}

TEST(the_order_of_the_corners_does_not_matter)
{
    const struct quadric q = ball(400.0);
    const double turned[4][3] = {
        { 0.0, 2000.0, 2000.0 }, { 2000.0, 2000.0, 0.0 }, { 0.0, 0.0, 0.0 }, { 2000.0, 0.0, 2000.0 }
    };
    struct gsn_error err = { 0 };
    struct gsn_volume_bound one, other;
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &q, &kuhn, &err), err);
    one = bound_of(&kuhn, large, 0.2, 0.01, 0);
    other = bound_of(&kuhn, turned, 0.2, 0.01, 0);
    CHECK(one.lower_um3 <= other.upper_um3 && other.lower_um3 <= one.upper_um3);
    CHECK_NEAR(one.upper_um3, other.upper_um3, 0.01 * one.upper_um3);
    kuhn_done(&kuhn);
}

static void check_refused(const struct kuhn *kuhn, const double cell[4][3], double threshold,
                          const char *words)
{
    struct gsn_volume_bound bound = { 1.0, 2.0, 3.0, 4 };
    struct gsn_error err = { 0 };

    CHECK(gsn_level_set_cell(kuhn->spline, cell, threshold, NULL, &bound, &err) == GSN_E_INPUT);
    CHECK_NEAR(bound.lower_um3, 2.0, 0.0);
    CHECK(bound.cells == 4);
    if (!strstr(err.text, words))
        fail_msg("\"%s\" does not say \"%s\"", err.text, words);
}

TEST(cells_that_are_flat_or_leave_the_mesh_and_what_is_no_number_are_refused)
{
    const struct quadric q = { 0.0, { 1.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };
    double cell[4][3];
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &q, &kuhn, &err), err);
    check_refused(&kuhn, skew, NAN, "threshold is not a number");
    check_refused(&kuhn, skew, INFINITY, "threshold is not a number");
    memcpy(cell, skew, sizeof cell);
    cell[2][1] = NAN;
    check_refused(&kuhn, (const double(*)[3])cell, 0.0, "corner 3 of the cell is not a point");
    cell[2][1] = 2001.0;
    cell[2][0] = 2100.0;
    check_refused(&kuhn, (const double(*)[3])cell, 0.0, "sticks out of the mesh");
    for (int k = 0; k < 4; k++)
        cell[k][0] = skew[k][0] + 1e9;
    check_refused(&kuhn, (const double(*)[3])cell, 0.0, "sticks out of the mesh with 1 of");
    memcpy(cell, skew, sizeof cell);
    cell[2][1] = 1e300;
    check_refused(&kuhn, (const double(*)[3])cell, 0.0, "too large");
    for (int a = 0; a < 3; a++)
        cell[2][a] = 0.3 * skew[0][a] + 0.3 * skew[1][a] + 0.4 * skew[3][a];
    check_refused(&kuhn, (const double(*)[3])cell, 0.0, "flat");
    memcpy(cell[2], skew[0], sizeof cell[2]);
    check_refused(&kuhn, (const double(*)[3])cell, 0.0, "flat");
    kuhn_done(&kuhn);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct gsn_level_set_cell_options options = { 0.0, 200 };
    struct gsn_volume_bound bound;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_random(low, high, cells, 2, 0.05, 5, &kuhn, &err), err);
    CHECK_EVERY_OOM(gsn_level_set_cell(kuhn.spline, small, 0.0, &options, &bound, &err), err);
    kuhn_done(&kuhn);
}
