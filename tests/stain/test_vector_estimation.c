/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <stdio.h>
#include <string.h>

#include "pipeline/core/file.h"
#include "pipeline/stain/collagen_density.h"
#include "pipeline/stain/vector_estimation.h"
#include "tests/stain/paint.h"

static double degrees(const double a[3], const double b[3])
{
    return acos(fmin(a[0] * b[0] + a[1] * b[1] + a[2] * b[2], 1)) * 180 / M_PI;
}

static void unit(double v[3])
{
    const double length = hypot(hypot(v[0], v[1]), v[2]);

    for (int c = 0; c < 3; c++)
        v[c] /= length;
}

/* Patches of pure red, pure yellow and mixtures, with nuclei on one pixel in ten. */
static struct gsn_image *paint_slide(const struct scan *scan, const struct gsn_dyes *dyes)
{
    struct gsn_image *image = NULL;
    struct dice dice = { 21 };

    if (gsn_image_new(200, 200, 3, 8, &image, NULL) < 0)
        return NULL;
    for (uint32_t y = 0; y < 200; y++) {
        for (uint32_t x = 0; x < 200; x++) {
            const double share = fmin(fmax(1.3 * dice_even(&dice) - 0.15, 0), 1);
            const double all = 0.3 + 0.5 * dice_even(&dice);
            const double dark = dice_even(&dice) < 0.1 ? 0.5 : 0;

            paint(image, x, y, scan, dyes,
                  (const double[3]){ all * share, all * (1 - share), dark }, &dice);
        }
    }
    return image;
}

static int densities(const struct gsn_image *image, const struct scan *scan,
                     struct gsn_plane *ret_od[3], struct gsn_error *err)
{
    struct gsn_flat_field glass;
    int r =
        gsn_flat_field_given(image->width, image->height, scan->light, scan->white, &glass, err);

    if (r >= 0)
        r = gsn_od_thin(image, &glass, 1, ret_od, err);
    return r;
}

static void planes_free(struct gsn_plane *od[3])
{
    for (int c = 0; c < 3; c++)
        gsn_plane_free(od[c]);
}

/* Densities of this noise; the glass of the picture is not needed for more. */
static struct gsn_stain_sample *sampled(struct gsn_plane *const od[3], const struct gsn_image *mask,
                                        enum gsn_light light)
{
    const struct gsn_flat_field glass = { .light = light,
                                          .white = { 248, 244, 238 },
                                          .noise_od = 0.003 };
    struct gsn_stain_sample *sample = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_stain_sample_new(&sample, &err), err);
    CHECK_OK(gsn_stain_sample_add(sample, od, mask, &glass, &err), err);
    return sample;
}

/* Amounts that vary by factors. */
static struct gsn_image *paint_log_normal(const struct scan *scan, const struct gsn_dyes *dyes)
{
    struct gsn_image *image = NULL;
    struct dice dice = { 23 };

    if (gsn_image_new(200, 200, 3, 8, &image, NULL) < 0)
        return NULL;
    for (uint32_t i = 0; i < 200 * 200; i++)
        paint(image, i % 200, i / 200, scan, dyes,
              (const double[3]){ 0.4 * exp(0.45 * dice_normal(&dice)),
                                 0.3 * exp(0.45 * dice_normal(&dice)),
                                 0.07 * exp(0.6 * dice_normal(&dice)) },
              &dice);
    return image;
}

/* Turned by about 5 and 4 degrees. */
static struct gsn_dyes turned_bath(void)
{
    struct gsn_dyes truth = gsn_dyes_builtin();

    truth.red[0] += 0.09;
    unit(truth.red);
    truth.yellow[1] -= 0.07;
    unit(truth.yellow);
    return truth;
}

/* What is found, no farther off than it says. */
static struct gsn_dyes_fit find_turned(struct gsn_image *(*painter)(const struct scan *,
                                                                    const struct gsn_dyes *))
{
    const struct scan scan = { GSN_LIGHT_SRGB, { 248, 244, 238 }, 0, 1 };
    const struct gsn_dyes_prior prior = gsn_dyes_prior_builtin(GSN_LIGHT_SRGB);
    const struct gsn_dyes truth = turned_bath();
    struct gsn_plane *od[3] = { NULL, NULL, NULL };
    gsn_auto(gsn_stain_sample) sample = NULL;
    struct gsn_error err = { 0 };
    struct gsn_dyes_fit fit;

    CHECK(degrees(truth.red, prior.dyes.red) > 4 && degrees(truth.yellow, prior.dyes.yellow) > 3);

    gsn_auto(gsn_image) image = painter(&scan, &truth);

    CHECK_OK(densities(image, &scan, od, &err), err);
    sample = sampled(od, NULL, scan.light);
    CHECK_OK(gsn_dyes_estimate(sample, &prior, &fit, &err), err);
    CHECK(degrees(fit.dyes.red, truth.red) < 2 * fit.deviation_deg[0]);
    CHECK(degrees(fit.dyes.yellow, truth.yellow) < 2 * fit.deviation_deg[1]);
    CHECK(degrees(fit.dyes.dark, truth.dark) < 2 * fit.deviation_deg[2]);
    CHECK(fit.deviation_deg[0] < 4 && fit.deviation_deg[1] < 4);
    CHECK_NEAR(fit.moved_deg[0], degrees(fit.dyes.red, prior.dyes.red), 1e-9);
    CHECK_NEAR(fit.dyes.full_red_od, prior.dyes.full_red_od, 0);
    CHECK(fit.pixels >= 1000 && fit.classes >= 1 && fit.strays < 0.02);
    planes_free(od);
    return fit;
}

/* Every pixel a mixture, so that no pixel shows a dye. */
TEST(where_amounts_are_log_normal_the_slides_own_vectors_are_found)
{
    const struct gsn_dyes_fit fit = find_turned(paint_log_normal);
    const struct gsn_dyes truth = turned_bath();

    CHECK(degrees(fit.dyes.red, truth.red) < 3);
    CHECK(degrees(fit.dyes.yellow, truth.yellow) < 3);
    CHECK(fit.worth > 50);
}

/* Pixels of no dark dye, and ends of pure red and pure yellow, are no log-normal tissue. */
TEST(where_amounts_are_not_log_normal_pixels_count_for_little_and_the_error_says_so)
{
    const struct gsn_dyes_fit other = find_turned(paint_log_normal);
    const struct gsn_dyes_fit fit = find_turned(paint_slide);

    CHECK(fit.worth < other.worth / 4);
    CHECK(fit.deviation_deg[0] > other.deviation_deg[0]);
    CHECK(fit.deviation_deg[1] > other.deviation_deg[1]);
}

/* With nothing to go by the answer is the prior: one class of one amount says nothing of hue. */
TEST(what_the_slide_does_not_show_stays_as_the_protocol_states_it)
{
    const struct scan scan = { GSN_LIGHT_SRGB, { 248, 244, 238 }, 0, 1 };
    const struct gsn_dyes_prior prior = gsn_dyes_prior_builtin(GSN_LIGHT_SRGB);
    struct gsn_plane *od[3] = { NULL, NULL, NULL };
    gsn_auto(gsn_stain_sample) sample = NULL;
    gsn_auto(gsn_image) image = NULL;
    struct gsn_error err = { 0 };
    struct dice dice = { 4 };
    struct gsn_dyes_fit fit;

    CHECK_OK(gsn_image_new(100, 100, 3, 8, &image, &err), err);
    for (uint32_t i = 0; i < 10000; i++)
        paint(image, i % 100, i / 100, &scan, &prior.dyes, (const double[3]){ 0.4, 0.3, 0.1 },
              &dice);
    CHECK_OK(densities(image, &scan, od, &err), err);
    sample = sampled(od, NULL, scan.light);
    CHECK_OK(gsn_dyes_estimate(sample, &prior, &fit, &err), err);
    for (int k = 0; k < 3; k++) {
        CHECK(fit.moved_deg[k] < fit.deviation_deg[k]);
        CHECK(fit.deviation_deg[k] > 4 && fit.deviation_deg[k] < 7.5); /* of sqrt 2 times 5 */
    }
    planes_free(od);
}

/* All over the vectors that dyes can have, their borders too. */
TEST(vectors_that_differ_little_turn_the_same_ways)
{
    for (int i = 0; i <= 90; i += 3)
        for (int j = 0; j <= 90; j += 3) {
            const double a = i * M_PI / 180, b = j * M_PI / 180;
            double v[2][3] = { { sin(a) * cos(b), sin(a) * sin(b), cos(a) } }, way[2][2][3];

            for (int c = 0; c < 3; c++) {
                memcpy(v[1], v[0], sizeof v[1]);
                v[1][c] += 0.02;
                unit(v[1]);
                for (int k = 0; k < 2; k++)
                    gsn_dyes_tangents(v[k], way[k]);
                for (int k = 0; k < 2; k++) {
                    CHECK_NEAR(degrees(way[0][k], way[1][k]), 0, 2.5);
                    CHECK_NEAR(degrees(way[0][k], v[0]), 90, 1e-6);
                }
                CHECK_NEAR(degrees(way[0][0], way[0][1]), 90, 1e-6);
            }
        }
}

TEST(a_turn_keeps_the_length_and_the_angle)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();

    for (int m = 0; m < GSN_DYE_ROTATIONS; m++) {
        double turn[GSN_DYE_ROTATIONS] = { 0 };

        turn[m] = 0.05;
        const struct gsn_dyes there = gsn_dyes_rotated(&dyes, turn);
        const double moved[3] = { degrees(there.red, dyes.red), degrees(there.yellow, dyes.yellow),
                                  degrees(there.dark, dyes.dark) };

        for (int k = 0; k < 3; k++)
            CHECK_NEAR(moved[k], k == m / 2 ? atan(0.05) * 180 / M_PI : 0, 1e-6);
    }
}

TEST(the_mask_decides_which_pixels_speak)
{
    const struct scan scan = { GSN_LIGHT_CODES_LINEAR, { 248, 244, 238 }, 0, 1 };
    const struct gsn_dyes_prior prior = gsn_dyes_prior_builtin(GSN_LIGHT_CODES_LINEAR);
    struct gsn_plane *od[3] = { NULL, NULL, NULL };
    gsn_auto(gsn_image) image = paint_slide(&scan, &prior.dyes);
    gsn_auto(gsn_image) mask = NULL;
    gsn_auto(gsn_stain_sample) none = NULL;
    gsn_auto(gsn_stain_sample) half = NULL;
    gsn_auto(gsn_stain_sample) clean = NULL;
    struct gsn_plane *unspoilt[3] = { NULL, NULL, NULL };
    struct gsn_error err = { 0 };
    struct gsn_dyes_fit fit = { .pixels = 77 }, of_clean;
    struct gsn_stain_look look;

    CHECK_OK(densities(image, &scan, unspoilt, &err), err);
    /* The lower half becomes pen ink, which the mask leaves out. */
    for (uint32_t i = 100 * 200 * 3; i < 200 * 200 * 3; i++)
        ((uint8_t *)image->samples)[i] = (uint8_t[3]){ 40, 60, 190 }[i % 3];
    CHECK_OK(densities(image, &scan, od, &err), err);
    CHECK_OK(gsn_image_new(200, 200, 1, 8, &mask, &err), err);
    none = sampled(od, mask, scan.light);
    CHECK(gsn_dyes_estimate(none, &prior, &fit, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "only 0 pixels are stained"));
    CHECK(fit.pixels == 77);
    memset(mask->samples, 255, 100 * 200);
    half = sampled(od, mask, scan.light);
    CHECK_OK(gsn_stain_look(half, &look, &err), err);
    CHECK_OK(gsn_dyes_estimate(half, &prior, &fit, &err), err);
    clean = sampled(unspoilt, mask, scan.light);
    CHECK_OK(gsn_dyes_estimate(clean, &prior, &of_clean, &err), err);
    CHECK(fit.pixels == of_clean.pixels);
    CHECK(memcmp(&fit.dyes, &of_clean.dyes, sizeof fit.dyes) == 0);
    CHECK(memcmp(fit.covariance, of_clean.covariance, sizeof fit.covariance) == 0);
    for (int k = 0; k < 3; k++)
        CHECK(fit.moved_deg[k] < 2 * fit.deviation_deg[k]);
    planes_free(od);
    planes_free(unspoilt);
}

/* Three hundredths of green pen, as much of black, and JPEG's like: pixels of neither. */
TEST(a_little_pen_does_not_make_it_another_stain)
{
    const struct scan scan = { GSN_LIGHT_CODES_LINEAR, { 248, 244, 238 }, 0, 1 };
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_plane *od[3] = { NULL, NULL, NULL };
    gsn_auto(gsn_image) image = paint_slide(&scan, &dyes);
    gsn_auto(gsn_stain_sample) sample = NULL;
    struct gsn_stain_look look;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < 200 * 200; i++)
        for (size_t c = 0; c < 3 && i % 100 < 6; c++)
            ((uint8_t *)image->samples)[3 * i + c] =
                i % 2 ? (const uint8_t[3]){ 20, 130, 70 }[c] : (uint8_t)30;
    CHECK_OK(densities(image, &scan, od, &err), err);
    sample = sampled(od, NULL, scan.light);
    CHECK_OK(gsn_stain_look(sample, &look, &err), err);
    CHECK(look.red > 0.2 && look.red < 0.95 && look.yellow > 0.2 && look.yellow < 0.95);
    planes_free(od);
}

/* Tissue like bone and ligament in a bath of so much of each dye. */
static struct gsn_image *paint_bath(const struct scan *scan, const struct gsn_dyes *dyes,
                                    const double strength[3])
{
    struct gsn_image *image = NULL;
    struct dice dice = { 31 };

    if (gsn_image_new(200, 200, 3, 8, &image, NULL) < 0)
        return NULL;
    for (uint32_t i = 0; i < 200 * 200; i++) {
        const double density = i % 200 < 80 ? 0.3 : 0.85;
        const double grain[2] = { exp(0.2 * dice_normal(&dice)), exp(0.2 * dice_normal(&dice)) };

        paint(image, i % 200, i / 200, scan, dyes,
              (const double[3]){ strength[0] * 0.62 * density * grain[0],
                                 strength[1] * 0.34 * (1 - 0.55 * density) * grain[1],
                                 strength[2] * 0.2 },
              &dice);
    }
    return image;
}

static int look_at_bath(const struct gsn_dyes *dyes, const double strength[3],
                        struct gsn_stain_look *ret_look, struct gsn_error *err)
{
    const struct scan scan = { GSN_LIGHT_CODES_LINEAR, { 248, 244, 238 }, 0, 1 };
    gsn_auto(gsn_image) image = paint_bath(&scan, dyes, strength);
    struct gsn_plane *od[3] = { NULL, NULL, NULL };
    gsn_auto(gsn_stain_sample) sample = NULL;
    int r = densities(image, &scan, od, err);

    CHECK_OK(r, *err);
    sample = sampled(od, NULL, scan.light);
    planes_free(od);
    return gsn_stain_look(sample, ret_look, err);
}

/* Where yellow is strong, blue is absorbed most everywhere. */
TEST(a_bath_of_much_yellow_and_little_red_is_van_gieson_still)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    const double baths[][3] = { { 1, 1, 0 }, { 0.7, 1.6, 0 }, { 0.85, 1.2, 1 }, { 1.4, 0.7, 0 } };

    for (size_t k = 0; k < sizeof baths / sizeof baths[0]; k++) {
        struct gsn_stain_look look;
        struct gsn_error err = { 0 };

        CHECK_OK(look_at_bath(&dyes, baths[k], &look, &err), err);
        CHECK(look.red > 0.5);
    }
}

/* Picric acid as in the built-in vectors, and as pure as a spectrophotometer has it. */
TEST(without_fuchsin_it_is_not_van_gieson)
{
    struct gsn_dyes pure = gsn_dyes_builtin();

    pure.yellow[0] = 0.02;
    pure.yellow[1] = 0.06;
    unit(pure.yellow);

    const struct gsn_dyes dyes[] = { gsn_dyes_builtin(), pure };

    for (size_t k = 0; k < 4; k++) {
        struct gsn_stain_look look = { .red = -7 };
        struct gsn_error err = { 0 };

        CHECK(look_at_bath(&dyes[k / 2], (const double[3]){ 0, 1.5, (double)(k % 2) }, &look,
                           &err) == GSN_E_STAIN);
        assert_non_null(strstr(err.text, "absorb green as acid fuchsin"));
        CHECK_NEAR(look.red, -7, 0);
    }
}

/* A picture as PPM or PGM (one byte per sample). */
static struct gsn_image *read_pnm(const char *path)
{
    struct gsn_error err = { 0 };
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_image *image = NULL;
    unsigned width = 0, height = 0, top = 0;
    size_t size = 0;
    char kind = 0;
    int start = 0;

    CHECK_OK(gsn_file_read(path, 400000, &bytes, &size, &err), err);
    CHECK(sscanf((const char *)bytes, "P%c %u %u %u%n", &kind, &width, &height, &top, &start) == 4);
    CHECK_OK(gsn_image_new(width, height, kind == '6' ? 3 : 1, 8, &image, &err), err);
    CHECK((size_t)start + 1 + gsn_image_bytes(image) == size);
    memcpy(image->samples, bytes + start + 1, gsn_image_bytes(image));
    return image;
}

TEST(real_picrosirius_is_segmented_like_its_authors_did)
{
    const struct scan scan = { GSN_LIGHT_SRGB, { 255, 245, 234 }, 0, 0 };
    gsn_auto(gsn_image) image = read_pnm(GSN_FIXTURES "/stain/picrosirius.ppm");
    gsn_auto(gsn_image) mask = read_pnm(GSN_FIXTURES "/stain/picrosirius_mask.pgm");
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    gsn_auto(gsn_plane) dark = NULL;
    gsn_auto(gsn_plane) share = NULL;
    gsn_auto(gsn_image) map = NULL;
    struct gsn_plane *od[3] = { NULL, NULL, NULL };
    const struct gsn_dyes_prior prior = gsn_dyes_prior_builtin(GSN_LIGHT_SRGB);
    gsn_auto(gsn_stain_sample) sample = NULL;
    struct gsn_stain_look look;
    struct gsn_error err = { 0 };
    struct gsn_collagen figures;
    struct gsn_overlap overlap;
    struct gsn_dyes_fit fit;
    double apart;

    CHECK_OK(densities(image, &scan, od, &err), err);
    sample = sampled(od, NULL, scan.light);
    CHECK_OK(gsn_stain_fits(sample, &prior.dyes, &apart, &err), err);
    print_message("picrosirius: %.1f degrees from Van Gieson\n", apart);
    CHECK_OK(gsn_stain_look(sample, &look, &err), err);
    CHECK_OK(gsn_dyes_estimate(sample, &prior, &fit, &err), err);
    print_message("picrosirius: dyes moved by %.1f, %.1f, %.1f degrees, known to %.1f, %.1f, %.1f; "
                  "%zu classes, strays %.3f\n",
                  fit.moved_deg[0], fit.moved_deg[1], fit.moved_deg[2], fit.deviation_deg[0],
                  fit.deviation_deg[1], fit.deviation_deg[2], fit.classes, fit.strays);
    CHECK_OK(gsn_unmix(od, &fit.dyes, 2, &red, &yellow, &dark, &err), err);
    CHECK_OK(gsn_red_share(red, yellow, dark, &fit.dyes, &share, &err), err);
    CHECK_OK(gsn_collagen_map(share, red, NULL, NAN, &map, &figures, &err), err);
    CHECK_OK(gsn_collagen_compare(map, mask, &overlap, &err), err);
    print_message("picrosirius: Dice %.3f, area %.3f against %.3f\n", overlap.dice,
                  (double)overlap.map_px / (double)overlap.pixels,
                  (double)overlap.reference_px / (double)overlap.pixels);
    CHECK(overlap.dice > 0.85);
    planes_free(od);
}

/* Case 44. */
TEST(real_haematoxylin_and_eosin_is_refused)
{
    const struct scan scan = { GSN_LIGHT_SRGB, { 245, 240, 245 }, 0, 0 };
    gsn_auto(gsn_image) image = read_pnm(GSN_FIXTURES "/stain/he.ppm");
    struct gsn_plane *od[3] = { NULL, NULL, NULL };
    gsn_auto(gsn_stain_sample) sample = NULL;
    struct gsn_stain_look look = { .red = -7 };
    const struct gsn_dyes builtin = gsn_dyes_builtin();
    double apart = -7;
    struct gsn_error err = { 0 };

    CHECK_OK(densities(image, &scan, od, &err), err);
    sample = sampled(od, NULL, scan.light);
    CHECK(gsn_stain_look(sample, &look, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "does not look like Van Gieson"));
    CHECK_NEAR(look.red, -7, 0);
    CHECK(gsn_stain_fits(sample, &builtin, &apart, &err) == GSN_E_STAIN);
    print_message("haematoxylin and eosin: %s\n", err.text);
    assert_non_null(strstr(err.text, "does not look like Van Gieson: half of its stained pixels"));
    CHECK_NEAR(apart, -7, 0);
    planes_free(od);
}

TEST(planes_and_masks_of_other_sizes_are_refused)
{
    const struct gsn_dyes_prior prior = gsn_dyes_prior_builtin(GSN_LIGHT_CODES_LINEAR);
    struct gsn_dyes_fit fit;
    struct gsn_plane *od[3] = { NULL, NULL, NULL };
    const struct gsn_flat_field glass = { .white = { 248, 244, 238 } };
    gsn_auto(gsn_stain_sample) sample = NULL;
    gsn_auto(gsn_image) mask = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_stain_sample_new(&sample, &err), err);
    for (uint32_t c = 0; c < 3; c++)
        CHECK_OK(gsn_plane_new(10, 10 + c / 2, &od[c], &err), err);
    CHECK_OK(gsn_image_new(10, 9, 1, 8, &mask, &err), err);
    CHECK(gsn_stain_sample_add(sample, od, NULL, &glass, &err) == GSN_E_INPUT);
    gsn_plane_free(od[2]);
    od[2] = NULL;
    CHECK_OK(gsn_plane_new(10, 10, &od[2], &err), err);
    CHECK(gsn_stain_sample_add(sample, od, mask, &glass, &err) == GSN_E_INPUT);
    CHECK(gsn_dyes_estimate(sample, &prior, &fit, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "only 0 pixels are stained"));
    planes_free(od);
}

static int infer_once(struct gsn_plane *const od[3], struct gsn_error *err)
{
    const struct gsn_flat_field glass = { .light = GSN_LIGHT_SRGB, .white = { 248, 244, 238 } };
    const struct gsn_dyes_prior prior = gsn_dyes_prior_builtin(GSN_LIGHT_SRGB);
    gsn_auto(gsn_stain_sample) sample = NULL;
    struct gsn_stain_look look;
    struct gsn_dyes_fit fit;
    int r = gsn_stain_sample_new(&sample, err);

    if (r >= 0)
        r = gsn_stain_sample_add(sample, od, NULL, &glass, err);
    if (r >= 0)
        r = gsn_stain_look(sample, &look, err);
    return r < 0 ? r : gsn_dyes_estimate(sample, &prior, &fit, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct scan scan = { GSN_LIGHT_SRGB, { 248, 244, 238 }, 0, 1 };
    const struct gsn_dyes start = gsn_dyes_builtin();
    gsn_auto(gsn_image) image = paint_slide(&scan, &start);
    struct gsn_plane *od[3] = { NULL, NULL, NULL };
    struct gsn_error err = { 0 };

    CHECK_OK(densities(image, &scan, od, &err), err);
    CHECK_EVERY_OOM(infer_once(od, &err), err);
    planes_free(od);
}
