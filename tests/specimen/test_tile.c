/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/tile.h"

#include "pipeline/core/file.h"
#include "pipeline/decode/png_write.h"
#include "pipeline/specimen/process.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/stain_vectors.h"
#include "tests/check.h"
#include "tests/decode/make.h"
#include "tests/memory_file.h"
#include "tests/specimen/drawn_specimen.h"

#include <math.h>
#include <string.h>

/* A tile of WIDTH x HEIGHT pixels: glass, yellow tissue, and red tissue on the right half of it. */
enum { WIDTH = 120, HEIGHT = 90, LEFT = 30, MIDDLE = 70, RIGHT = 110, TOP = 15, BOTTOM = 75 };

static const char JOB[] = "{\"specimen\": \"t\", \"kind\": \"tile\", \"file\": \"t.png\", "
                          "\"reference\": \"m.png\", \"px_um\": 2, \"transfer\": \"linear\", "
                          "\"thresholds\": [0.5]}";

struct tile {
    struct gsn_protocol *protocol;
    struct gsn_specimen specimen;
    uint8_t *picture, *reference;
    size_t picture_size, reference_size;
};

static int open_tile(void *context, const char *sha256, int *ret_fd, struct gsn_error *err)
{
    const struct tile *tile = context;
    const int second = strcmp(sha256, "reference") == 0;

    return gsn_memory_file(second ? tile->reference : tile->picture,
                           second ? tile->reference_size : tile->picture_size, ret_fd, err);
}

static void paint(struct gsn_image *image, uint32_t x, uint32_t y)
{
    static const double white[3] = { 248, 244, 238 };
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    const int tissue = x >= LEFT && x < RIGHT && y >= TOP && y < BOTTOM;
    const double red = !tissue ? 0 : x >= MIDDLE ? 0.5 : 0.05;
    const double yellow = tissue ? 0.25 : 0;

    for (size_t c = 0; c < 3; c++)
        ((uint8_t *)image->samples)[((size_t)y * image->width + x) * 3 + c] =
            (uint8_t)(white[c] * pow(10, -red * dyes.red[c] - yellow * dyes.yellow[c]) + 0.5);
}

/* The reference's collagen begins at this column. */
static void tile_init(struct tile *tile, const char *job, uint32_t width, uint32_t from)
{
    gsn_auto(gsn_image) picture = NULL;
    gsn_auto(gsn_image) reference = NULL;
    struct gsn_error err = { 0 };

    *tile = (struct tile){ .protocol = drawn_protocol(job) };
    CHECK_OK(gsn_image_new(WIDTH, HEIGHT, 3, 8, &picture, &err), err);
    CHECK_OK(gsn_image_new(width, HEIGHT, 1, 8, &reference, &err), err);
    for (uint32_t y = 0; y < HEIGHT; y++)
        for (uint32_t x = 0; x < WIDTH; x++)
            paint(picture, x, y);
    for (uint32_t y = TOP; y < BOTTOM; y++)
        for (uint32_t x = from; x < RIGHT; x++)
            ((uint8_t *)reference->samples)[(size_t)y * width + x] = 255;
    CHECK_OK(gsn_png_encode(picture, &tile->picture, &tile->picture_size, &err), err);
    CHECK_OK(gsn_png_encode(reference, &tile->reference, &tile->reference_size, &err), err);
    tile->specimen = (struct gsn_specimen){ .protocol = tile->protocol,
                                            .picture_sha256 = "picture",
                                            .reference_sha256 = "reference",
                                            .baseline = { .name = "" },
                                            .key = "0",
                                            .open = open_tile,
                                            .context = tile };
}

static void tile_done(struct tile *tile)
{
    gsn_free(tile->picture);
    gsn_free(tile->reference);
    gsn_protocol_free(tile->protocol);
}
#define tile_auto __attribute__((cleanup(tile_done))) struct tile

static const struct gsn_specimen_options OPTIONS = { .mesher = "", .threads = 1 };

/* The map is the red half, 40 columns; the reference begins 10 columns later. */
TEST(the_dice_of_a_drawn_tile_is_that_of_its_rectangles)
{
    gsn_auto(gsn_tile) result = NULL;
    struct gsn_error err = { 0 };
    tile_auto tile;

    tile_init(&tile, JOB, WIDTH, MIDDLE + 10);
    CHECK_OK(gsn_tile_process(&tile.specimen, &OPTIONS, &result, &err), err);
    CHECK(result->compared && result->overlap.pixels == WIDTH * HEIGHT);
    CHECK(result->overlap.map_px == 40 * 60 && result->overlap.reference_px == 30 * 60);
    CHECK_NEAR(result->overlap.dice, 2 * 30.0 / (40 + 30), 1e-12);
    CHECK_NEAR(result->overlap.false_positive, 0.25, 1e-12);
    CHECK_NEAR(result->overlap.false_negative, 0, 0);
    CHECK_NEAR(result->collagen.area_fraction, 0.5, 1e-12);
    /* Tissue of one colour is rounded to a code the same way everywhere. */
    CHECK_NEAR(result->collagen.mean_density, (0.5 + 0.05) / 2 / gsn_dyes_builtin().full_red_od,
               0.01);
    CHECK_NEAR(result->px_um, 2, 0);
    CHECK(result->picture_count == 3);
}

TEST(without_a_reference_there_is_a_map_and_nothing_to_compare)
{
    gsn_auto(gsn_tile) result = NULL;
    struct gsn_error err = { 0 };
    tile_auto tile;

    tile_init(&tile, JOB, WIDTH, MIDDLE);
    tile.specimen.reference_sha256 = NULL;
    CHECK_OK(gsn_tile_process(&tile.specimen, &OPTIONS, &result, &err), err);
    CHECK(!result->compared && result->picture_count == 3);
    CHECK_NEAR(result->collagen.area_fraction, 0.5, 1e-12);
}

TEST(a_reference_of_another_size_is_refused)
{
    struct gsn_tile *result = NULL;
    struct gsn_error err = { 0 };
    tile_auto tile;

    tile_init(&tile, JOB, WIDTH + 1, MIDDLE);
    CHECK(gsn_tile_process(&tile.specimen, &OPTIONS, &result, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "the reference mask: ") == err.text && result == NULL);

    /* As a whole that is a report which says so. */
    gsn_auto(gsn_specimen_result) whole = NULL;

    CHECK_OK(gsn_specimen_process(&tile.specimen, &OPTIONS, &whole, &err), err);
    CHECK(whole->withheld && strstr(whole->message, "the reference mask: ") == whole->message);
}

TEST(the_report_of_a_tile_carries_its_dice)
{
    gsn_auto(gsn_specimen_result) whole = NULL;
    struct gsn_error err = { 0 };
    tile_auto tile;

    tile_init(&tile, JOB, WIDTH, MIDDLE + 10);
    CHECK_OK(gsn_specimen_process(&tile.specimen, &OPTIONS, &whole, &err), err);
    CHECK(!whole->withheld && strstr(whole->json, "\"dice\": 0.857142857") != NULL);
}

/* ---- nobody states anything --------------------------------------------------------------- */

/* A photograph of tissue that fills the picture but for a vacuole here and there, taken in this
 * light, of a stain this strong; quality 0: a PNG, else a JPEG. */
struct shot {
    double light, stain;
    int quality;
};

enum { SHOT = 384 };

/* Amounts of red and yellow, as optical densities: they vary by place, at 40 pixels and at 7. */
static void amounts(double x, double y, double *ret_red, double *ret_yellow)
{
    const int vacuole = hypot(fmod(x, 96) - 48, fmod(y, 96) - 48) < 11;
    const double slow = sin(x / 40) * cos(y / 33), fast = sin(x / 1.1) * sin(y / 1.3);

    *ret_red = vacuole ? 0 : 0.62 * (0.44 + 0.37 * slow + 0.06 * fast);
    *ret_yellow = vacuole ? 0 : 0.4 - 0.1 * slow + 0.04 * fast;
}

/* And what its mean density is. */
static double tile_shoot(struct tile *tile, const char *job, const struct shot *shot)
{
    static const double white[3] = { 0.84, 0.82, 0.78 };
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    gsn_auto(gsn_image) picture = NULL;
    struct gsn_error err = { 0 };
    double sum = 0, count = 0;

    *tile = (struct tile){ .protocol = drawn_protocol(job) };
    CHECK_OK(gsn_image_new(SHOT, SHOT, 3, 8, &picture, &err), err);
    for (uint32_t y = 0; y < SHOT; y++)
        for (uint32_t x = 0; x < SHOT; x++) {
            double red, yellow;

            amounts(x, y, &red, &yellow);
            sum += red / dyes.full_red_od;
            count += red > 0;
            for (size_t c = 0; c < 3; c++) {
                const double od = shot->stain * (red * dyes.red[c] + yellow * dyes.yellow[c]);
                const double light = fmin(shot->light * white[c] * pow(10, -od), 1);

                ((uint8_t *)picture->samples)[((size_t)y * SHOT + x) * 3 + c] =
                    (uint8_t)(255 * gsn_light_encode(GSN_LIGHT_SRGB, light) + 0.5);
            }
        }
    if (shot->quality) {
        const struct made made =
            make_jpeg(picture, &(struct jpeg_recipe){ .quality = shot->quality });

        tile->picture = made.bytes;
        tile->picture_size = made.size;
    } else {
        CHECK_OK(gsn_png_encode(picture, &tile->picture, &tile->picture_size, &err), err);
    }
    tile->specimen = (struct gsn_specimen){ .protocol = tile->protocol,
                                            .picture_sha256 = "picture",
                                            .baseline = { .name = "" },
                                            .key = "0",
                                            .open = open_tile,
                                            .context = tile };
    return shot->stain * sum / count;
}

static const char BARE[] = "{\"specimen\": \"t\", \"kind\": \"tile\", \"file\": \"t.png\"}";

static struct gsn_tile_density density_of(const struct shot *shot, double *ret_truth)
{
    gsn_auto(gsn_tile) result = NULL;
    struct gsn_error err = { 0 };
    tile_auto tile;

    *ret_truth = tile_shoot(&tile, BARE, shot);
    CHECK_OK(gsn_tile_process(&tile.specimen, &OPTIONS, &result, &err), err);
    return result->density;
}

/* Its interval holds the truth, too, though the white is that of its palest parts. */
TEST(exposure_and_compression_move_the_mean_by_three_per_cent_at_most_and_within_its_interval)
{
    static const struct shot shots[] = { { 1, 1, 0 },  { 0.9, 1, 0 }, { 1.1, 1, 0 },
                                         { 1, 1, 85 }, { 1, 1, 50 },  { 0.9, 1, 50 } };
    double truth;
    const struct gsn_tile_density first = density_of(&shots[0], &truth);

    CHECK(fabs(first.mean - truth) < 1.96 * first.error);
    for (size_t i = 0; i < sizeof shots / sizeof shots[0]; i++) {
        const struct gsn_tile_density now = density_of(&shots[i], &truth);

        print_message("  light %.1f, quality %d: %.4f +- %.4f (%.4f, %.4f, %.4f), truth %.4f\n",
                      shots[i].light, shots[i].quality, now.mean, 1.96 * now.error, now.by_white,
                      now.by_detail, now.by_vectors, truth);
        CHECK_NEAR(now.mean / first.mean, 1, 0.03);
        CHECK(fabs(now.mean - first.mean) < 1.96 * now.error);
        CHECK(fabs(now.mean - truth) < 1.96 * now.error);
    }
}

TEST(a_stronger_stain_reads_as_more_density_and_the_share_of_red_stays)
{
    double truth;
    const struct gsn_tile_density a = density_of(&(struct shot){ 1, 1, 0 }, &truth);
    const struct gsn_tile_density b = density_of(&(struct shot){ 1, 1.2, 0 }, &truth);

    CHECK_NEAR(b.mean / a.mean, 1.2, 0.03);
    CHECK_NEAR(b.yellow / a.yellow, 1.2, 0.03);
    CHECK_NEAR(b.red_share / a.red_share, 1, 0.01);
}

TEST(what_nobody_stated_is_called_assumed_and_what_somebody_did_stated)
{
    static const char stated[] = "{\"specimen\": \"t\", \"kind\": \"tile\", \"file\": \"t.png\", "
                                 "\"white\": [0.92, 0.91, 0.9], \"px_um\": 0.5, "
                                 "\"transfer\": \"srgb\", \"dyes\": \"builtin\"}";
    static const char *const bare_says[] = { "the palest part of the picture is the empty slide",
                                             "samples are coded as sRGB",
                                             "the dyes are those of the built-in table",
                                             "a stain 20 % stronger reads as 20 % more density",
                                             "not known; no figure here needs it",
                                             "van-gieson-gvp-1, assumed",
                                             "assumed to be the empty slide" };
    static const char *const stated_says[] = { "of 255, as stated in job.json",
                                               "0.5 um, as job.json states",
                                               "sRGB, as stated in job.json",
                                               "van-gieson-gvp-1, as stated in job.json" };
    const struct shot shot = { 1, 1, 0 };
    struct gsn_error err = { 0 };

    for (int i = 0; i < 2; i++) {
        gsn_auto(gsn_specimen_result) whole = NULL;
        tile_auto tile;

        (void)tile_shoot(&tile, i ? stated : BARE, &shot);
        CHECK_OK(gsn_specimen_process(&tile.specimen, &OPTIONS, &whole, &err), err);
        for (size_t k = 0; !i && k < sizeof bare_says / sizeof bare_says[0]; k++)
            CHECK(strstr(whole->json, bare_says[k]) != NULL);
        CHECK(!i == !strstr(whole->json, "as stated in job.json"));
        for (size_t k = 0; i && k < sizeof stated_says / sizeof stated_says[0]; k++)
            CHECK(strstr(whole->json, stated_says[k]) != NULL);
        CHECK(!i == (strstr(whole->json, "assumed, because nobody stated it") != NULL));
    }
}

static int tile_once(const struct tile *tile, struct gsn_error *err)
{
    gsn_auto(gsn_tile) result = NULL;

    return gsn_tile_process(&tile->specimen, &OPTIONS, &result, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    tile_auto tile;

    tile_init(&tile, JOB, WIDTH, MIDDLE);
    CHECK_EVERY_OOM(tile_once(&tile, &err), err);
}
