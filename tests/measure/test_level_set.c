/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/level_set.h"

#include <string.h>

#include "tests/check.h"
#include "tests/measure/kuhn.h"

/* A domain of a cube of 2000 um and a region of 60^3 voxels of 24 um in it. */
static const double low[3] = { 0.0, 0.0, 0.0 }, high[3] = { 2000.0, 2000.0, 2000.0 };
static const double corner[3] = { 280.0, 280.0, 280.0 };
static const double middle = 1000.0;
static const unsigned cells[3] = { 4, 4, 4 };
static const double step = 24.0;

static struct gsn_mask *region_of(size_t n)
{
    return full_mask(corner, step * 60.0 / (double)n, n, n, n);
}

/* 1 - sum ((u - middle) / radius)^2: above t it is an ellipsoid of radii radius sqrt(1 - t). */
static struct quadric ellipsoid(double rx, double ry, double rz)
{
    const double radius[3] = { rx, ry, rz };
    struct quadric q = { 1.0, { 0.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };

    for (int a = 0; a < 3; a++) {
        q.constant -= middle * middle / (radius[a] * radius[a]);
        q.linear[a] = 2.0 * middle / (radius[a] * radius[a]);
        q.square[a] = -1.0 / (radius[a] * radius[a]);
    }
    return q;
}

static void check_ellipsoid(unsigned degree, double fraction, double rx, double ry, double rz)
{
    const struct quadric q = ellipsoid(rx, ry, rz);
    const double thresholds[3] = { 0.0, 0.5, 0.9 };
    gsn_auto(gsn_mask) region = region_of(20);
    struct gsn_volume_bound bound[3];
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, degree, fraction, &q, &kuhn, &err), err);
    CHECK_OK(gsn_level_set_volume(kuhn.spline, region, thresholds, 3, NULL, bound, &err), err);
    for (int t = 0; t < 3; t++) {
        const double truth = 4.0 / 3.0 * M_PI * rx * ry * rz * pow(1.0 - thresholds[t], 1.5);

        CHECK(bound[t].lower_um3 <= truth && truth <= bound[t].upper_um3);
        CHECK(bound[t].upper_um3 - bound[t].lower_um3 <=
              1e-3 * fmax(bound[t].upper_um3, 0.01 * pow(1440.0, 3)));
    }
    kuhn_done(&kuhn);
}

TEST(a_ball_lies_between_its_bounds)
{
    const double clouds[] = { 0.003, 0.015, 0.05, 0.15, 0.5 };

    check_ellipsoid(2, 0.05, 700.0, 700.0, 700.0);
    for (size_t k = 0; k < sizeof clouds / sizeof *clouds; k++)
        check_ellipsoid(3, clouds[k], 700.0, 700.0, 700.0);
}

TEST(an_ellipsoid_lies_between_its_bounds)
{
    check_ellipsoid(2, 0.05, 710.0, 300.0, 140.0);
}

TEST(the_gap_shrinks_to_0_6_or_less_when_the_cells_double)
{
    const struct quadric q = ellipsoid(700.0, 600.0, 500.0);
    const double threshold = 0.3, truth = 4.0 / 3.0 * M_PI * 2.1e8 * pow(0.7, 1.5);
    gsn_auto(gsn_mask) region = region_of(10);
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    double gap = 0.0;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &q, &kuhn, &err), err);
    for (size_t most = 4000; most <= 128000; most *= 2) {
        const struct gsn_level_set_options options = { .gap = 1e-12, .most_cells = most };
        struct gsn_volume_bound bound;
        double here;

        CHECK_OK(gsn_level_set_volume(kuhn.spline, region, &threshold, 1, &options, &bound, &err),
                 err);
        here = bound.upper_um3 - bound.lower_um3;
        CHECK(bound.lower_um3 <= truth && truth <= bound.upper_um3);
        CHECK(bound.cells <= 1000 + most && bound.cells > 1000 + most - 2);
        if (gap > 0.0)
            CHECK(here <= 0.6 * gap);
        gap = here;
    }
    kuhn_done(&kuhn);
}

TEST(a_half_space_is_exact)
{
    const struct quadric q = { 0.0, { 0.6, 0.0, 0.8 }, { 0.0, 0.0, 0.0 } };
    /* Through the middle, and cutting off a wedge of legs 300 / 0.6 and 300 / 0.8 at the far edge.
     */
    const double thresholds[2] = { 1.4 * middle, 1.4 * (middle + 720.0) - 300.0 };
    const double truth[2] = { 0.5 * pow(1440.0, 3), 0.5 * (300.0 / 0.6) * (300.0 / 0.8) * 1440.0 };

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_mask) region = region_of(30);
        struct gsn_volume_bound bound[2];
        struct gsn_error err = { 0 };
        struct kuhn kuhn;

        CHECK_OK(kuhn_new(low, high, cells, degree, 0.03, &q, &kuhn, &err), err);
        CHECK_OK(gsn_level_set_volume(kuhn.spline, region, thresholds, 2, NULL, bound, &err), err);
        for (int t = 0; t < 2; t++) {
            CHECK(bound[t].lower_um3 <= truth[t] && truth[t] <= bound[t].upper_um3);
            CHECK(bound[t].upper_um3 - bound[t].lower_um3 <= 1e-8 * truth[t]);
            /* No cell was cut: the tangent is the field. */
            CHECK(bound[t].cells == 27000);
        }
        kuhn_done(&kuhn);
    }
}

TEST(a_constant_is_all_or_nothing)
{
    const struct quadric q = { 0.37, { 0.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };
    const double thresholds[2] = { 0.3699, 0.3701 };
    gsn_auto(gsn_mask) region = region_of(12);
    struct gsn_volume_bound bound[2];
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &q, &kuhn, &err), err);
    CHECK_OK(gsn_level_set_volume(kuhn.spline, region, thresholds, 2, NULL, bound, &err), err);
    CHECK_NEAR(bound[0].lower_um3, pow(1440.0, 3), 0.0);
    CHECK_NEAR(bound[0].upper_um3, pow(1440.0, 3), 0.0);
    CHECK_NEAR(bound[1].lower_um3, 0.0, 0.0);
    CHECK_NEAR(bound[1].upper_um3, 0.0, 0.0);
    kuhn_done(&kuhn);
}

enum { THRESHOLDS = 3, POINTS = 3 };

/* Volumes of {s > t} in the region by 3^3 points per voxel: independent of all bounding. */
static void by_points(const struct gsn_spline *spline, const struct gsn_mask *region,
                      const double *threshold, double *ret_volume)
{
    const struct gsn_lattice *at = &region->at;
    const int points = POINTS * POINTS * POINTS;
    size_t hint = 0, above[THRESHOLDS] = { 0 };

    for (size_t i = 0; i < gsn_lattice_count(at); i++) {
        const struct gsn_vec3 c =
            gsn_lattice_centre(at, i % at->nx, i / at->nx % at->ny, i / at->nx / at->ny);

        for (int k = 0; k < points; k++) {
            const double u[3] = {
                c.x + ((k % POINTS + 0.5) / POINTS - 0.5) * at->step_um.x,
                c.y + ((k / POINTS % POINTS + 0.5) / POINTS - 0.5) * at->step_um.y,
                c.z + ((k / POINTS / POINTS + 0.5) / POINTS - 0.5) * at->step_um.z,
            };
            double value = 0.0;

            CHECK(gsn_spline_eval(spline, u, &hint, &value, NULL) == GSN_OK);
            for (int t = 0; t < THRESHOLDS; t++)
                above[t] += value > threshold[t];
        }
    }
    for (int t = 0; t < THRESHOLDS; t++)
        ret_volume[t] = (double)above[t] / points * gsn_lattice_voxel_um3(at);
}

TEST(random_splines_lie_between_their_bounds_and_thresholds_are_in_order)
{
    const double thresholds[THRESHOLDS] = { -0.2, 0.0, 0.2 };
    gsn_auto(gsn_mask) region = region_of(18);

    for (unsigned degree = 1; degree <= 3; degree++) {
        const struct gsn_level_set_options options = { .gap = 0.02, .most_cells = 150000 };
        struct gsn_volume_bound bound[THRESHOLDS];
        double estimate[THRESHOLDS];
        struct gsn_error err = { 0 };
        struct kuhn kuhn;

        CHECK_OK(kuhn_random(low, high, cells, degree, 0.03, 40 + degree, &kuhn, &err), err);
        CHECK_OK(gsn_level_set_volume(kuhn.spline, region, thresholds, THRESHOLDS, &options, bound,
                                      &err),
                 err);
        by_points(kuhn.spline, region, thresholds, estimate);
        for (int t = 0; t < THRESHOLDS; t++) {
            /* 157464 points, some 54^2 per sheet of surface between them: each sheet is off by much
             * less than the sqrt(4 54^2 / 12) of independent points, 2e-4 of all. */
            const double slack = 5e-4 * pow(1440.0, 3);

            CHECK_NEAR(bound[t].threshold, thresholds[t], 0.0);
            CHECK(bound[t].lower_um3 <= estimate[t] + slack);
            CHECK(estimate[t] - slack <= bound[t].upper_um3);
            if (degree < 3)
                CHECK(bound[t].upper_um3 - bound[t].lower_um3 <= 0.08 * bound[t].upper_um3);
            if (t > 0) {
                CHECK(bound[t].lower_um3 <= bound[t - 1].lower_um3);
                CHECK(bound[t].upper_um3 <= bound[t - 1].upper_um3);
            }
        }
        kuhn_done(&kuhn);
    }
}

TEST(a_spline_that_ends_sharply_at_the_boundary_lies_between_its_bounds)
{
    const struct quadric q = { 0.0, { 1e-3, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };
    const double thresholds[THRESHOLDS] = { 0.5, 1.0, 1.5 }, whole = pow(2000.0, 3);
    gsn_auto(gsn_mask) region = full_mask(low, 100.0, 20, 20, 20);
    struct gsn_volume_bound bound[THRESHOLDS];
    double estimate[THRESHOLDS];
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.02, &q, &kuhn, &err), err);
    CHECK_OK(gsn_level_set_volume(kuhn.spline, region, thresholds, THRESHOLDS, NULL, bound, &err),
             err);
    by_points(kuhn.spline, region, thresholds, estimate);
    for (int t = 0; t < THRESHOLDS; t++) {
        /* The value falls to 0 in the clouds at the faces alone, so it is at most the linear
         * one. */
        CHECK(bound[t].lower_um3 <= whole * (1.0 - thresholds[t] / 2.0));
        CHECK(bound[t].lower_um3 <= 1.03 * estimate[t] && bound[t].upper_um3 >= 0.97 * estimate[t]);
        CHECK(bound[t].upper_um3 - bound[t].lower_um3 <= 0.1 * whole);
    }
    kuhn_done(&kuhn);
}

TEST(the_parts_of_a_region_add_up)
{
    const struct quadric q = ellipsoid(700.0, 600.0, 500.0);
    /* One cell: the voxels as they are, so that the same is said of each voxel in both. */
    const struct gsn_level_set_options options = { .most_cells = 1 };
    const double threshold = 0.2;
    gsn_auto(gsn_mask) all = region_of(16);
    gsn_auto(gsn_mask) part = region_of(16);
    struct gsn_volume_bound whole, sum = { 0.0, 0.0, 0.0, 0 };
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &q, &kuhn, &err), err);
    CHECK_OK(gsn_level_set_volume(kuhn.spline, all, &threshold, 1, &options, &whole, &err), err);
    for (int k = 0; k < 2; k++) {
        struct gsn_volume_bound bound;

        for (size_t i = 0; i < gsn_lattice_count(&all->at); i++)
            part->inside[i] = (i % 3 == 0) == (k == 0);
        CHECK_OK(gsn_level_set_volume(kuhn.spline, part, &threshold, 1, &options, &bound, &err),
                 err);
        sum.lower_um3 += bound.lower_um3;
        sum.upper_um3 += bound.upper_um3;
        sum.cells += bound.cells;
    }
    CHECK_NEAR(sum.lower_um3, whole.lower_um3, 1e-11 * whole.upper_um3);
    CHECK_NEAR(sum.upper_um3, whole.upper_um3, 1e-11 * whole.upper_um3);
    CHECK(sum.cells == whole.cells);
    kuhn_done(&kuhn);
}

TEST(one_and_two_threads_give_the_same_bytes)
{
    const double thresholds[2] = { 0.0, 0.2 };
    gsn_auto(gsn_mask) region = region_of(24);
    struct gsn_volume_bound bound[2][2];
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_random(low, high, cells, 2, 0.03, 3, &kuhn, &err), err);
    memset(bound, 0, sizeof bound);
    for (unsigned threads = 1; threads <= 2; threads++) {
        const struct gsn_level_set_options options = { .threads = threads, .most_cells = 20000 };

        CHECK_OK(gsn_level_set_volume(kuhn.spline, region, thresholds, 2, &options,
                                      bound[threads - 1], &err),
                 err);
    }
    CHECK(memcmp(bound[0], bound[1], sizeof bound[0]) == 0);
    kuhn_done(&kuhn);
}

TEST(a_region_that_fills_the_domain_to_its_faces_is_fine)
{
    const struct quadric q = { 0.0, { 1.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };
    const double threshold = 500.0;
    gsn_auto(gsn_mask) region = full_mask(low, 100.0, 20, 20, 20);
    struct gsn_volume_bound bound;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &q, &kuhn, &err), err);
    CHECK_OK(gsn_level_set_volume(kuhn.spline, region, &threshold, 1, NULL, &bound, &err), err);
    CHECK_NEAR(bound.lower_um3, 6e9, 60.0);
    CHECK_NEAR(bound.upper_um3, 6e9, 60.0);
    kuhn_done(&kuhn);
}

static void check_refused(const struct kuhn *kuhn, const struct gsn_mask *region, double threshold,
                          const char *words)
{
    struct gsn_volume_bound bound = { 1.0, 2.0, 3.0, 4 };
    struct gsn_error err = { 0 };

    CHECK(gsn_level_set_volume(kuhn->spline, region, &threshold, 1, NULL, &bound, &err) ==
          GSN_E_INPUT);
    CHECK_NEAR(bound.lower_um3, 2.0, 0.0);
    CHECK(bound.cells == 4);
    if (!strstr(err.text, words))
        fail_msg("\"%s\" does not say \"%s\"", err.text, words);
}

TEST(regions_beyond_the_domain_and_thresholds_that_are_no_numbers_are_refused)
{
    const struct quadric q = { 0.0, { 1.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };
    const double beyond[3] = { 1900.0, 0.0, 0.0 }, far[3] = { 5000.0, 0.0, 0.0 };
    gsn_auto(gsn_mask) fine = region_of(4);
    gsn_auto(gsn_mask) out = full_mask(beyond, 40.0, 3, 3, 3);
    gsn_auto(gsn_mask) away = full_mask(far, 40.0, 3, 3, 3);
    gsn_auto(gsn_mask) empty = region_of(4);
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &q, &kuhn, &err), err);
    memset(empty->inside, 0, 64);
    check_refused(&kuhn, fine, NAN, "threshold 1 is not a number");
    check_refused(&kuhn, empty, 0.0, "empty");
    check_refused(&kuhn, out, 0.0, "voxel (2, 0, 0) of the region sticks out");
    check_refused(&kuhn, away, 0.0, "voxel (0, 0, 0) of the region sticks out");
    kuhn_done(&kuhn);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct quadric q = ellipsoid(700.0, 600.0, 500.0);
    const struct gsn_level_set_options options = { .threads = 1, .most_cells = 4000 };
    const double threshold = 0.2;
    gsn_auto(gsn_mask) region = region_of(6);
    struct gsn_volume_bound bound;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &q, &kuhn, &err), err);
    CHECK_EVERY_OOM(
        gsn_level_set_volume(kuhn.spline, region, &threshold, 1, &options, &bound, &err), err);
    kuhn_done(&kuhn);
}
