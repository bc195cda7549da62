/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/fiducial/colour.h"
#include "pipeline/register/fiducial/correspondence.h"

#include "tests/check.h"
#include "tests/register/draw_picture.h"

enum { SIDE = 420 };
static const double PX = 5, RADIUS = 16;
static const struct gsn_triangle_prior PRIOR = {
    .mark_um = { { -600, -250 }, { 500, -400 }, { 100, 550 } }
};

static float value[3 * SIDE * SIDE];

static struct gsn_point place(int i)
{
    return (struct gsn_point){ SIDE / 2 + 0.3 * i + PRIOR.mark_um[i].x / PX,
                               SIDE / 2 - 0.2 * i + PRIOR.mark_um[i].y / PX };
}

/* Three marks, and so many spots that are none. */
static void draw_section(struct gsn_image *image, double alpha, int decoys, uint64_t seed)
{
    struct draw_chance chance = { seed };

    draw_tissue_picture(value, SIDE, SIDE, 200, &chance);
    for (int i = 0; i < GSN_FIDUCIALS + decoys; i++) {
        struct draw_spot spot = { .radius = RADIUS, .alpha = i == 0 ? alpha : 0.96, .cut = NAN };

        spot.centre = i < GSN_FIDUCIALS ? place(i)
                                        : (struct gsn_point){ draw_uniform(&chance, 120, 300),
                                                              draw_uniform(&chance, 190, 240) };
        for (int k = 0; k < 4; k++)
            spot.lobe[k / 2][k % 2] = 0.02 * draw_normal(&chance);
        if (i >= GSN_FIDUCIALS)
            spot.radius = draw_uniform(&chance, 8, 20);
        draw_spot_on(value, SIDE, SIDE, &spot);
    }
    draw_codes(value, image, 3, &chance);
}

static struct gsn_colour_candidates *find(const struct gsn_image *image)
{
    struct gsn_colour_candidates *spots = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_colour_candidates_find(image, PX, &spots, &err), err);
    for (size_t i = 0; i < spots->candidates.count; i++)
        CHECK_OK(gsn_colour_candidates_localise(spots, i, &err), err);
    return spots;
}

/* Squared error of the three marks; all must be found. */
static double squares_of(const struct gsn_colour_candidates *spots, double *claimed)
{
    struct gsn_fiducial marks[GSN_FIDUCIALS];
    double sum = 0, runner_up;

    gsn_fiducials_match(&spots->candidates, &PRIOR, marks, NULL, NULL, &runner_up);
    CHECK(runner_up < 0.5);
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        CHECK(marks[i].found);
        sum += pow(marks[i].px.x - place(i).x, 2) + pow(marks[i].px.y - place(i).y, 2);
        *claimed += marks[i].cov_xx + marks[i].cov_yy;
    }
    return sum;
}

/* The dyes differ by a hundred codes from place to place; the marks are found as if by 3 codes of
 * noise in a plane of a few tens of codes' contrast. Case 22: up to six spots that are none. */
TEST(marks_in_changing_tissue_are_found_among_other_spots)
{
    gsn_auto(gsn_image) image = NULL;
    struct gsn_error err = { 0 };
    double squares = 0, claimed = 0;

    CHECK_OK(gsn_image_new(SIDE, SIDE, 3, 8, &image, &err), err);
    for (int n = 0; n < 14; n++) {
        gsn_auto(gsn_colour_candidates) spots = NULL;

        draw_section(image, 0.96, n % 7, (uint64_t)n + 1);
        spots = find(image);
        squares += squares_of(spots, &claimed);
    }
    print_message("  rms per axis %.4f px, claimed %.4f px\n", sqrt(squares / 84),
                  sqrt(claimed / 84));
    CHECK(sqrt(squares / 84) < 0.05);
    CHECK(sqrt(claimed / squares) > 0.5 && sqrt(claimed / squares) < 2);
}

TEST(a_mark_that_is_half_burnt_in_is_found)
{
    gsn_auto(gsn_image) image = NULL;
    struct gsn_error err = { 0 };
    double squares = 0, claimed = 0;

    CHECK_OK(gsn_image_new(SIDE, SIDE, 3, 16, &image, &err), err);
    for (int n = 0; n < 6; n++) {
        gsn_auto(gsn_colour_candidates) spots = NULL;

        draw_section(image, 0.5, 0, (uint64_t)n + 40);
        spots = find(image);
        squares += squares_of(spots, &claimed);
    }
    CHECK(sqrt(squares / 36) < 0.1);
}

TEST(the_tissue_is_centred_where_it_lies)
{
    gsn_auto(gsn_image) image = NULL;
    gsn_auto(gsn_colour_candidates) spots = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(SIDE, SIDE, 3, 8, &image, &err), err);
    draw_section(image, 0.96, 0, 7);
    spots = find(image);
    CHECK_NEAR(spots->candidates.tissue_px.x, SIDE / 2.0, 8);
    CHECK_NEAR(spots->candidates.tissue_px.y, SIDE / 2.0, 8);
}

/* Dark things that a search from afar takes for spots, about the middle of a picture. */
static double corner(double dx, double dy)
{
    return dx < 0 && dy < 0 ? 40 : 220;
}

static double crescent(double dx, double dy)
{
    return hypot(dx, dy) < RADIUS && hypot(dx - 10, dy) > 14 ? 40 : 220;
}

static double smudge(double dx, double dy)
{
    return fmin(40 + 4.5 * hypot(dx, dy), 220);
}

TEST(what_is_no_disc_loses_its_score_and_its_place_stays)
{
    double (*const shapes[])(double, double) = { corner, crescent, smudge };

    for (int k = 0; k < 3; k++) {
        gsn_auto(gsn_image) image = NULL;
        gsn_auto(gsn_colour_candidates) spots = NULL;
        struct gsn_error err = { 0 };
        struct gsn_fiducial before;

        CHECK_OK(gsn_image_new(240, 240, 1, 8, &image, &err), err);
        for (int i = 0; i < 240 * 240; i++)
            ((uint8_t *)image->samples)[i] = (uint8_t)shapes[k](i % 240 - 120, i / 240 - 120);
        CHECK_OK(gsn_colour_candidates_find(image, PX, &spots, &err), err);
        CHECK(spots->candidates.count == 1);
        before = spots->candidates.mark[0];
        CHECK(before.score > 0.5);
        CHECK_OK(gsn_colour_candidates_localise(spots, 0, &err), err);
        CHECK(spots->candidates.mark[0].score == 0);
        CHECK(spots->candidates.mark[0].px.x == before.px.x &&
              spots->candidates.mark[0].px.y == before.px.y);
    }
}

TEST(a_pixel_size_that_is_none_is_refused)
{
    gsn_auto(gsn_image) image = NULL;
    struct gsn_colour_candidates *spots = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(40, 40, 1, 8, &image, &err), err);
    CHECK(gsn_colour_candidates_find(image, 0, &spots, &err) == GSN_E_INPUT);
    CHECK(gsn_colour_candidates_find(image, 60, &spots, &err) == GSN_E_INPUT);
    CHECK(spots == NULL);
}

static int find_once(const struct gsn_image *image, struct gsn_error *err)
{
    gsn_auto(gsn_colour_candidates) spots = NULL;
    int r = gsn_colour_candidates_find(image, PX, &spots, err);

    for (size_t i = 0; r >= 0 && i < spots->candidates.count; i++)
        r = gsn_colour_candidates_localise(spots, i, err);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_image) image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(SIDE, SIDE, 3, 8, &image, &err), err);
    draw_section(image, 0.96, 1, 5);
    CHECK_EVERY_OOM(find_once(image, &err), err);
}
