/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/region_border.h"

#include <math.h>

#include "tests/check.h"

static const struct gsn_lattice AT = {
    .nx = 40, .ny = 36, .nz = 28, .origin_um = { 7, -200, 30 }, .step_um = { 10, 10, 14 }
};
static const double MIDDLE[3] = { 202, -25, 219 };
static const double RADIUS = 140;

/* gives: the voxels whose centres lie in a ball; radius 0: all of the lattice. */
static struct gsn_mask *draw_ball(double radius)
{
    struct gsn_mask *mask = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_mask_new(&AT, &mask, &err), err);
    for (size_t i = 0; i < gsn_lattice_count(&AT); i++) {
        const struct gsn_vec3 c =
            gsn_lattice_centre(&AT, i % AT.nx, i / AT.nx % AT.ny, i / AT.nx / AT.ny);
        const double d[3] = { c.x - MIDDLE[0], c.y - MIDDLE[1], c.z - MIDDLE[2] };

        mask->inside[i] = radius == 0 || sqrt(gsn_dot3(d, d)) < radius;
    }
    return mask;
}

static struct gsn_border *make_border(double radius, unsigned threads)
{
    gsn_auto(gsn_mask) mask = draw_ball(radius);
    struct gsn_border *border = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_border_new(mask, threads, &border, &err), err);
    return border;
}

TEST(a_balls_border_is_round_to_a_fraction_of_a_voxel)
{
    gsn_auto(gsn_border) border = make_border(RADIUS, 1);
    double square = 0, worst = 0;
    int count = 0;

    for (int i = 0; i < 500; i++) {
        const double z = -1 + 2 * (i + 0.5) / 500, turn = i * 2.399963, flat = sqrt(1 - z * z);
        const double way[3] = { flat * cos(turn), flat * sin(turn), z };
        double low = 0, high = 1.4 * RADIUS, gradient[3], at[3];

        for (int step = 0; step < 40; step++) {
            const double r = (low + high) / 2;

            for (int c = 0; c < 3; c++)
                at[c] = MIDDLE[c] + r * way[c];
            *(gsn_border_at(border, at, NULL) > 0 ? &low : &high) = r;
        }
        (void)gsn_border_at(border, at, gradient);
        CHECK(-gsn_dot3(gradient, way) > 0.8 * sqrt(gsn_dot3(gradient, gradient)));
        square += (low - RADIUS) * (low - RADIUS);
        worst = fmax(worst, fabs(low - RADIUS));
        count++;
    }
    CHECK(sqrt(square / count) < 3 && worst < 7); /* of voxels of 10 x 10 x 14 */
}

TEST(a_full_lattice_ends_half_a_voxel_beyond_its_last_centres)
{
    gsn_auto(gsn_border) border = make_border(0, 1);
    const double low[3] = { 2, -205, 23 }, high[3] = { 402, 155, 415 };

    for (int c = 0; c < 3; c++)
        for (int side = 0; side < 2; side++) {
            double at[3] = { 200, 0, 200 };

            at[c] = side ? high[c] : low[c];
            CHECK(fabs(gsn_border_at(border, at, NULL)) < 1e-4);
            at[c] += side ? -15 : 15;
            CHECK(gsn_border_at(border, at, NULL) > 10);
            at[c] += side ? 1000 : -1000;
            CHECK(gsn_border_at(border, at, NULL) < -10);
        }
}

TEST(the_gradient_is_the_slope_between_points)
{
    gsn_auto(gsn_border) border = make_border(RADIUS, 1);
    const double at[3] = { 301.3, -12.2, 177.7 };
    double gradient[3];

    (void)gsn_border_at(border, at, gradient);
    for (int c = 0; c < 3; c++) {
        double before[3] = { at[0], at[1], at[2] }, behind[3] = { at[0], at[1], at[2] };

        before[c] -= 0.01;
        behind[c] += 0.01;
        CHECK(fabs((gsn_border_at(border, behind, NULL) - gsn_border_at(border, before, NULL)) /
                       0.02 -
                   gradient[c]) < 1e-6);
    }
}

TEST(any_number_of_threads_gives_the_same_distances)
{
    gsn_auto(gsn_border) one = make_border(RADIUS, 1);
    gsn_auto(gsn_border) three = make_border(RADIUS, 3);

    for (int i = 0; i < 1000; i++) {
        const double at[3] = { 0.4 * i, -200 + 0.35 * i, 20 + 0.39 * (i * 7 % 1000) };
        const double a = gsn_border_at(one, at, NULL), b = gsn_border_at(three, at, NULL);

        CHECK(!(a < b) && !(b < a));
    }
}

static int make_once(const struct gsn_mask *mask, struct gsn_error *err)
{
    gsn_auto(gsn_border) border = NULL;

    return gsn_border_new(mask, 1, &border, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_mask) mask = draw_ball(RADIUS);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(make_once(mask, &err), err);
}
