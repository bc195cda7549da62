/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/tile.h"

#include "pipeline/decode/png_write.h"
#include "pipeline/core/file.h"
#include "tests/check.h"
#include "tests/pipeline/drawn_specimen.h"

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

    return gsn_file_from_bytes(second ? tile->reference : tile->picture,
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
    CHECK_OK(gsn_tile_work(&tile.specimen, &OPTIONS, &result, &err), err);
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
    CHECK_OK(gsn_tile_work(&tile.specimen, &OPTIONS, &result, &err), err);
    CHECK(!result->compared && result->picture_count == 3);
    CHECK_NEAR(result->collagen.area_fraction, 0.5, 1e-12);
}

TEST(a_reference_of_another_size_is_refused)
{
    struct gsn_tile *result = NULL;
    struct gsn_error err = { 0 };
    tile_auto tile;

    tile_init(&tile, JOB, WIDTH + 1, MIDDLE);
    CHECK(gsn_tile_work(&tile.specimen, &OPTIONS, &result, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "the reference mask: ") == err.text && result == NULL);

    /* As a whole that is a report which says so. */
    gsn_auto(gsn_specimen_result) whole = NULL;

    CHECK_OK(gsn_specimen_work(&tile.specimen, &OPTIONS, &whole, &err), err);
    CHECK(whole->withheld && strstr(whole->message, "the reference mask: ") == whole->message);
}

TEST(the_report_of_a_tile_carries_its_dice)
{
    gsn_auto(gsn_specimen_result) whole = NULL;
    struct gsn_error err = { 0 };
    tile_auto tile;

    tile_init(&tile, JOB, WIDTH, MIDDLE + 10);
    CHECK_OK(gsn_specimen_work(&tile.specimen, &OPTIONS, &whole, &err), err);
    CHECK(!whole->withheld && strstr(whole->json, "\"dice\": 0.857142857") != NULL);
}

static int tile_once(const struct tile *tile, struct gsn_error *err)
{
    gsn_auto(gsn_tile) result = NULL;

    return gsn_tile_work(&tile->specimen, &OPTIONS, &result, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    tile_auto tile;

    tile_init(&tile, JOB, WIDTH, MIDDLE);
    CHECK_EVERY_OOM(tile_once(&tile, &err), err);
}
