/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/collagen_density.h"
#include "tests/check.h"

#include <string.h>

#include "tests/stain/paint.h"

struct planes {
    struct gsn_plane *od[3];
};

static void planes_free(struct planes *planes)
{
    for (int c = 0; planes && c < 3; c++)
        gsn_plane_free(planes->od[c]);
    gsn_free(planes);
}
GSN_DEFINE_AUTO(planes);

static struct planes *planes_new(uint32_t width, uint32_t height)
{
    struct planes *planes = gsn_alloc_array(1, sizeof *planes);

    for (int c = 0; c < 3; c++)
        if (gsn_plane_new(width, height, &planes->od[c], NULL) < 0)
            fail();
    return planes;
}

static void mix(const struct gsn_dyes *dyes, const double amount[3], double od[3])
{
    for (int c = 0; c < 3; c++)
        od[c] = amount[0] * dyes->red[c] + amount[1] * dyes->yellow[c] + amount[2] * dyes->dark[c];
}

TEST(the_built_in_vectors_have_length_one_and_the_phantoms_direction)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();

    for (int c = 0; c < 3; c++) {
        static const double red[3] = { .239, .716, .655 };

        CHECK_NEAR(dyes.red[c] / dyes.red[0], red[c] / red[0], 1e-12);
    }
    CHECK_NEAR(hypot(hypot(dyes.dark[0], dyes.dark[1]), dyes.dark[2]), 1, 1e-14);
    CHECK_NEAR(hypot(hypot(dyes.yellow[0], dyes.yellow[1]), dyes.yellow[2]), 1, 1e-14);
    CHECK_NEAR(dyes.full_red_od, 0.62, 0);
}

TEST(every_mixture_of_the_three_dyes_is_recovered)
{
    static const double steps[] = { 0, 0.01, 0.3, 1.7 };
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_error err = { 0 };

    for (int i = 0; i < 64; i++) {
        const double amount[3] = { steps[i & 3], steps[i >> 2 & 3], steps[i >> 4 & 3] };
        double od[3], found[3];

        mix(&dyes, amount, od);
        CHECK_OK(gsn_unmix_one(od, &dyes, found, &err), err);
        for (int k = 0; k < 3; k++)
            CHECK_NEAR(found[k], amount[k], 1e-12);
    }
}

static double squared_distance(const struct gsn_dyes *dyes, const double amount[3],
                               const double od[3])
{
    double made[3], sum = 0;

    mix(dyes, amount, made);
    for (int c = 0; c < 3; c++)
        sum += (made[c] - od[c]) * (made[c] - od[c]);
    return sum;
}

/* Karush-Kuhn-Tucker: the slope of the distance is 0 along a dye in use and not falling along one
 * that is not. That holds at the minimum and nowhere else, because the problem is convex. */
TEST(what_no_mixture_explains_gets_the_nearest_one_without_negative_dyes)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_error err = { 0 };
    struct dice dice = { 11 };
    int seen[8] = { 0 };

    for (int n = 0; n < 20000; n++) {
        const double wish[3] = { dice_normal(&dice), dice_normal(&dice), dice_normal(&dice) };
        const double *const vector[3] = { dyes.red, dyes.yellow, dyes.dark };
        double od[3], found[3], made[3];

        mix(&dyes, wish, od);
        CHECK_OK(gsn_unmix_one(od, &dyes, found, &err), err);
        mix(&dyes, found, made);
        for (int k = 0; k < 3; k++) {
            double slope = 0;

            for (int c = 0; c < 3; c++)
                slope += (made[c] - od[c]) * vector[k][c];
            CHECK(found[k] >= 0);
            if (found[k] > 0)
                CHECK_NEAR(slope, 0, 1e-12);
            else
                CHECK(slope >= -1e-12);
        }
        CHECK(squared_distance(&dyes, found, od) <=
              squared_distance(&dyes, (const double[3]){ 0, 0, 0 }, od));
        seen[(wish[0] > 0) + 2 * (wish[1] > 0) + 4 * (wish[2] > 0)]++;
    }
    for (int i = 0; i < 8; i++)
        CHECK(seen[i] > 1000);
}

TEST(planes_hold_the_density_of_each_pixel)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    gsn_auto(planes) planes = planes_new(50, 70);
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    gsn_auto(gsn_plane) dark = NULL;
    gsn_auto(gsn_plane) share = NULL;
    struct gsn_error err = { 0 };
    struct dice dice = { 5 };
    double truth[3500][3];

    for (size_t i = 0; i < 3500; i++) {
        double od[3];

        for (int k = 0; k < 3; k++)
            truth[i][k] = i % 7 == (size_t)k ? 0 : dice_even(&dice);
        mix(&dyes, truth[i], od);
        for (int c = 0; c < 3; c++)
            planes->od[c]->value[i] = (float)od[c];
    }
    CHECK_OK(gsn_unmix(planes->od, &dyes, 2, &red, &yellow, &dark, &err), err);
    CHECK_OK(gsn_red_share(red, yellow, dark, &dyes, &share, &err), err);
    for (size_t i = 0; i < 3500; i++) {
        const double all = truth[i][0] + truth[i][1] + truth[i][2];

        /* The planes are float: 1e-7 of a density, times the condition of the dyes (about 10). */
        CHECK_NEAR(red->value[i], truth[i][0] / 0.62, 2e-6);
        CHECK_NEAR(yellow->value[i], truth[i][1], 2e-6);
        CHECK_NEAR(dark->value[i], truth[i][2], 2e-6);
        CHECK_NEAR(share->value[i], all > 0.15 ? truth[i][0] / all : 0, 2e-5);
    }
}

static struct gsn_plane *red_of(struct gsn_plane *const od[3], const struct gsn_dyes *dyes)
{
    struct gsn_plane *red = NULL;
    struct gsn_error err = { 0 };
    struct gsn_unmixer mixer;

    CHECK_OK(gsn_unmixer_init(&mixer, dyes, &err), err);
    CHECK_OK(gsn_plane_new(od[0]->width, od[0]->height, &red, &err), err);

    const struct gsn_collagen_weights weights = gsn_collagen_weights_of(&mixer, dyes->full_red_od);

    gsn_collagen_row(&weights, od[0]->value, od[1]->value, od[2]->value,
                     (size_t)red->width * red->height, red->value);
    return red;
}

/* Tissue whose yellow falls with its red, as picric acid does, stained by dyes that are turned from
 * those it is unmixed with: what comes out is a straight line over what is there, however the
 * vectors turned, and the amounts themselves where they did not. */
TEST(a_turned_vector_multiplies_red_and_adds_to_it)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct dice dice = { 6 };

    for (int draw = 0; draw < 200; draw++) {
        gsn_auto(planes) planes = planes_new(11, 1);
        double turn[GSN_DYE_ROTATIONS];

        for (int k = 0; k < GSN_DYE_ROTATIONS; k++)
            turn[k] = draw == 0 ? 0 : 2 * M_PI / 180 * fmax(fmin(dice_normal(&dice), 2), -2);

        const struct gsn_dyes turned = gsn_dyes_rotated(&dyes, turn);

        for (int i = 0; i <= 10; i++) {
            const double density = 0.1 * i;
            const double amount[3] = { 0.62 * density, 0.34 * (1 - 0.55 * density), 0.05 };
            double od[3];

            mix(&turned, amount, od);
            for (int c = 0; c < 3; c++)
                planes->od[c]->value[i] = (float)od[c];
        }
        gsn_auto(gsn_plane) red = red_of(planes->od, &dyes);
        const double slope = ((double)red->value[10] - (double)red->value[0]) / 10;

        for (int i = 0; i <= 10; i++)
            CHECK_NEAR((double)red->value[i], (double)red->value[0] + slope * i, 1e-5);
        if (draw == 0)
            CHECK_NEAR(slope, 0.1, 1e-5);
    }
}

/* Ink is no mixture of the dyes: blue, green and black strokes get no more red than before. */
TEST(what_is_no_mixture_of_the_dyes_is_unmixed_without_negative_amounts)
{
    const double ink[3][3] = { { 1.2, 0.8, 0.1 }, { 1.1, 0.2, 0.9 }, { 0.1, 1.5, 0.2 } };
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    gsn_auto(planes) planes = planes_new(3, 1);
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < 3; i++)
        for (int c = 0; c < 3; c++)
            planes->od[c]->value[i] = (float)ink[i][c];
    gsn_auto(gsn_plane) red = red_of(planes->od, &dyes);

    for (size_t i = 0; i < 3; i++) {
        const double od[3] = { (double)(float)ink[i][0], (double)(float)ink[i][1],
                               (double)(float)ink[i][2] };
        double amount[3];

        CHECK_OK(gsn_unmix_one(od, &dyes, amount, &err), err);
        CHECK_NEAR((double)red->value[i], amount[0] / dyes.full_red_od, 1e-6);
    }
}

TEST(dyes_that_cannot_be_told_apart_are_refused)
{
    struct gsn_dyes dyes = gsn_dyes_builtin();
    const double od[3] = { 0.1, 0.2, 0.3 };
    double found[3] = { -7, -7, -7 };
    struct gsn_error err = { 0 };

    memcpy(dyes.yellow, dyes.red, sizeof dyes.red);
    CHECK(gsn_unmix_one(od, &dyes, found, &err) == GSN_E_STAIN);
    dyes = gsn_dyes_builtin();
    for (int c = 0; c < 3; c++) /* halfway between the other two, so in their plane */
        dyes.dark[c] = dyes.red[c] + dyes.yellow[c];
    const double length = hypot(hypot(dyes.dark[0], dyes.dark[1]), dyes.dark[2]);
    for (int c = 0; c < 3; c++)
        dyes.dark[c] /= length;
    CHECK(gsn_unmix_one(od, &dyes, found, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "one plane"));
    dyes = gsn_dyes_builtin();
    dyes.red[0] = NAN;
    CHECK(gsn_unmix_one(od, &dyes, found, &err) == GSN_E_STAIN);
    dyes = gsn_dyes_builtin();
    dyes.full_red_od = 0;
    CHECK(gsn_unmix_one(od, &dyes, found, &err) == GSN_E_STAIN);
    CHECK_NEAR(found[0], -7, 0);
}

/* Mean density of a picture of log-normal dye amounts, seen by a camera of these bits. */
static double seen_density(const struct scan *scan, uint32_t bits, double od_mean, double gain)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    gsn_auto(gsn_image) image = NULL;
    gsn_auto(planes) planes = gsn_alloc_array(1, sizeof *planes);
    gsn_auto(gsn_plane) red = NULL;
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass;
    struct dice dice = { 42 }, unused = { 1 };
    double sum = 0;

    CHECK_OK(gsn_image_new(200, 200, 3, bits, &image, &err), err);
    for (uint32_t i = 0; i < 40000; i++) {
        /* Mean density of the channels: 0.54 of red, 0.52 of yellow, 0.58 of dark. */
        const double amount[3] = { gain * od_mean * exp(0.4 * dice_normal(&dice) - 0.08),
                                   0.6 * od_mean * exp(0.4 * dice_normal(&dice) - 0.08),
                                   0.2 * od_mean * exp(0.4 * dice_normal(&dice) - 0.08) };

        paint(image, i % 200, i / 200, scan, &dyes, amount, &unused);
    }
    CHECK_OK(gsn_flat_field_given(200, 200, scan->light, scan->white, &glass, &err), err);
    CHECK_OK(gsn_od_thin(image, &glass, 1, planes->od, &err), err);
    CHECK_OK(gsn_unmix(planes->od, &dyes, 2, &red, NULL, NULL, &err), err);
    for (size_t i = 0; i < 40000; i++)
        sum += red->value[i];
    return sum / 40000;
}

static double seen_loss(const struct scan *scan, uint32_t bits, double od_mean)
{
    return 100 *
           (1 - seen_density(scan, bits, od_mean, 0.8) / seen_density(scan, bits, od_mean, 1));
}

TEST(a_loss_of_a_fifth_is_reported_as_such_on_pale_medium_and_dark_slides)
{
    static const double mean[] = { 0.3, 0.7, 1.4 };
    const struct scan srgb = { GSN_LIGHT_SRGB, { 248, 244, 238 }, 0, 0 };
    const struct scan linear = { GSN_LIGHT_CODES_LINEAR, { 248, 244, 238 }, 0, 0 };

    for (int i = 0; i < 3; i++) {
        CHECK_NEAR(seen_loss(&srgb, 8, mean[i]), 20, 0.2);
        CHECK_NEAR(seen_loss(&linear, 16, mean[i]), 20, 0.02);
    }
}

TEST(the_density_of_no_light_is_finite)
{
    const struct scan scan = { GSN_LIGHT_CODES_LINEAR, { 250, 250, 250 }, 0, 0 };
    struct dice dice = { 1 };
    gsn_auto(gsn_image) image = paint_glass(30, 20, 8, &scan, &dice);
    gsn_auto(planes) planes = gsn_alloc_array(1, sizeof *planes);
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass;

    ((uint8_t *)image->samples)[4] = 0;
    CHECK_OK(gsn_flat_field_given(30, 20, scan.light, scan.white, &glass, &err), err);
    CHECK_OK(gsn_od_thin(image, &glass, 1, planes->od, &err), err);
    CHECK_NEAR(planes->od[1]->value[1], log10(500), 1e-6);
    CHECK_NEAR(planes->od[0]->value[1], 0, 1e-6);
}

TEST(one_and_two_threads_give_the_same_bytes)
{
    const struct scan scan = { GSN_LIGHT_SRGB, { 248, 244, 238 }, 0.1, 20 };
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct dice dice = { 3 };
    gsn_auto(gsn_image) image = paint_glass(131, 97, 8, &scan, &dice);
    gsn_auto(planes) planes = gsn_alloc_array(1, sizeof *planes);
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) again = NULL;
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass;

    CHECK_OK(gsn_flat_field_given(131, 97, scan.light, scan.white, &glass, &err), err);
    CHECK_OK(gsn_od_thin(image, &glass, 1, planes->od, &err), err);
    CHECK_OK(gsn_unmix(planes->od, &dyes, 1, &red, NULL, NULL, &err), err);
    CHECK_OK(gsn_unmix(planes->od, &dyes, 2, &again, NULL, NULL, &err), err);
    assert_memory_equal(red->value, again->value, 131 * 97 * sizeof(float));
}

TEST(pictures_and_planes_of_the_wrong_kind_are_refused)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    const double white[3] = { 250, 250, 250 };
    gsn_auto(gsn_image) grey = NULL;
    gsn_auto(gsn_image) colour = NULL;
    gsn_auto(planes) planes = planes_new(10, 10);
    gsn_auto(gsn_plane) odd = NULL;
    struct gsn_plane *od[3] = { NULL, NULL, NULL }, *red = NULL;
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass;
    double threshold = -7;

    CHECK_OK(gsn_image_new(10, 10, 1, 8, &grey, &err), err);
    CHECK_OK(gsn_image_new(10, 11, 3, 8, &colour, &err), err);
    CHECK_OK(gsn_plane_new(9, 10, &odd, &err), err);
    CHECK_OK(gsn_flat_field_given(10, 10, GSN_LIGHT_SRGB, white, &glass, &err), err);
    CHECK(gsn_od_thin(grey, &glass, 1, od, &err) == GSN_E_INPUT);
    CHECK(gsn_od_thin(colour, &glass, 1, od, &err) == GSN_E_INPUT);
    assert_string_equal(err.text, "the glass was measured on 10 x 10 pixels, not on 10 x 11");

    struct gsn_plane *const mixed[3] = { planes->od[0], odd, planes->od[2] };

    CHECK(gsn_unmix(mixed, &dyes, 1, &red, NULL, NULL, &err) == GSN_E_INPUT);
    CHECK(gsn_od_tissue(mixed, &glass, &red, &threshold, &err) == GSN_E_INPUT);
    CHECK(gsn_red_share(odd, planes->od[1], planes->od[2], &dyes, &red, &err) == GSN_E_INPUT);
    CHECK(od[0] == NULL && red == NULL);
    CHECK_NEAR(threshold, -7, 0);
}

TEST(the_tissue_threshold_lies_between_glass_and_the_palest_tissue)
{
    const struct scan scan = { GSN_LIGHT_CODES_LINEAR, { 248, 244, 238 }, 0, 1.5 };
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct dice dice = { 8 };
    gsn_auto(gsn_image) image = paint_glass(200, 100, 8, &scan, &dice);
    gsn_auto(planes) planes = gsn_alloc_array(1, sizeof *planes);
    gsn_auto(gsn_plane) total = NULL;
    gsn_auto(gsn_image) tissue = NULL;
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass;
    double threshold = 0;
    size_t wrong = 0;

    /* A quarter is tissue: half of that pale (0.12 yellow), half dark red with a burnt mark. */
    for (uint32_t y = 0; y < 100; y++)
        for (uint32_t x = 0; x < 50; x++)
            paint(image, x, y, &scan, &dyes,
                  x < 25 ? (const double[3]){ 0, 0.12, 0 }
                         : (const double[3]){ 0.6, 0.2, y < 10 ? 1.2 : 0 },
                  &dice);
    CHECK_OK(gsn_flat_field_estimate(image, scan.light, &glass, &err), err);
    CHECK_OK(gsn_od_thin(image, &glass, 1, planes->od, &err), err);
    CHECK_OK(gsn_od_tissue(planes->od, &glass, &total, &threshold, &err), err);
    CHECK_OK(gsn_plane_above(total, threshold, &tissue, &err), err);
    for (size_t i = 0; i < 20000; i++)
        wrong += (((uint8_t *)tissue->samples)[i] == 255) != (i % 200 < 50);
    CHECK(wrong <= 20); /* 0.1 % of the pixels */
}

static int whole_way(const struct gsn_image *image, struct gsn_error *err)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    const double white[3] = { 250, 250, 250 };
    gsn_auto(planes) planes = NULL;
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    gsn_auto(gsn_plane) dark = NULL;
    gsn_auto(gsn_plane) share = NULL;
    gsn_auto(gsn_plane) total = NULL;
    struct gsn_flat_field glass;
    double threshold;
    int r;

    planes = gsn_alloc_array(1, sizeof *planes);
    if (!planes)
        return GSN_E_NOMEM;
    r = gsn_flat_field_given(image->width, image->height, GSN_LIGHT_SRGB, white, &glass, err);
    if (r >= 0)
        r = gsn_od_thin(image, &glass, 1, planes->od, err);
    if (r >= 0)
        r = gsn_unmix(planes->od, &dyes, 1, &red, &yellow, &dark, err);
    if (r >= 0)
        r = gsn_red_share(red, yellow, dark, &dyes, &share, err);
    if (r >= 0)
        r = gsn_od_tissue(planes->od, &glass, &total, &threshold, err);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct scan scan = { GSN_LIGHT_SRGB, { 250, 250, 250 }, 0, 3 };
    struct dice dice = { 1 };
    gsn_auto(gsn_image) image = paint_glass(20, 20, 8, &scan, &dice);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(whole_way(image, &err), err);
}
