/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "pipeline/core/file.h"
#include "pipeline/phantom/texture.h"
#include "pipeline/phantom/tiles.h"

enum { SIDE = 300 };

static struct gsn_phantom_random draws(uint64_t section)
{
    return gsn_phantom_random_make(7, GSN_PHANTOM_STREAM_RED_TEXTURE, section, 0);
}

static double mean_product(const struct gsn_plane *a, const struct gsn_plane *b)
{
    const size_t count = (size_t)a->width * a->height;
    double sum = 0;

    for (size_t i = 0; i < count; i++)
        sum += (double)a->value[i] * (double)b->value[i];
    return sum / (double)count;
}

TEST(the_embedded_tiles_are_the_file)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size;

    CHECK_OK(gsn_file_read(TILES_FILE, 1 << 20, &bytes, &size, &err), err);
    CHECK(size == GSN_PHANTOM_TILES_SIZE);
    CHECK(memcmp(bytes, gsn_phantom_tiles, size) == 0);
}

/* 40 steps to a deviation of 1; the tiles were divided by their own standard deviation. */
TEST(each_tile_has_a_deviation_of_one)
{
    static const size_t bound[] = { 0, 180 * 170, GSN_PHANTOM_TILES_SIZE };

    for (int t = 0; t < GSN_PHANTOM_TILES; t++) {
        double sum = 0, square = 0;
        const double count = (double)(bound[t + 1] - bound[t]);

        for (size_t i = bound[t]; i < bound[t + 1]; i++) {
            const double v = gsn_phantom_tiles[i] / 40.0;

            sum += v;
            square += v * v;
        }
        CHECK_NEAR(sqrt(square / count - sum * sum / count / count), 1, 0.005);
    }
}

TEST(a_quilt_has_mean_zero_and_a_deviation_of_about_one)
{
    for (int tile = 0; tile < GSN_PHANTOM_TILES; tile++) {
        struct gsn_phantom_random random = draws(0);
        gsn_auto(gsn_plane) quilt = NULL;
        struct gsn_error err = { 0 };
        double mean = 0;

        CHECK_OK(gsn_phantom_quilt((enum gsn_phantom_tile)tile, SIDE, SIDE, &random, &quilt, &err),
                 err);
        for (size_t i = 0; i < SIDE * SIDE; i++)
            mean += (double)quilt->value[i] / (SIDE * SIDE);
        CHECK_NEAR(mean, 0, 0.01);
        CHECK_NEAR(sqrt(mean_product(quilt, quilt)), 1, 0.15);
    }
}

TEST(quilts_of_two_sections_do_not_correlate)
{
    struct gsn_phantom_random first = draws(0), second = draws(1);
    gsn_auto(gsn_plane) a = NULL;
    gsn_auto(gsn_plane) b = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_quilt(GSN_PHANTOM_T1, SIDE, SIDE, &first, &a, &err), err);
    CHECK_OK(gsn_phantom_quilt(GSN_PHANTOM_T1, SIDE, SIDE, &second, &b, &err), err);
    CHECK_NEAR(mean_product(a, b) / sqrt(mean_product(a, a) * mean_product(b, b)), 0, 0.05);
}

TEST(between_texels_the_texture_is_linear)
{
    float value[6] = { 0, 1, 2, 10, 11, 12 };
    const struct gsn_plane plane = { 3, 2, value };

    CHECK_NEAR(gsn_phantom_texture_at(&plane, 0.5, 0.5), 0, 1e-12);
    CHECK_NEAR(gsn_phantom_texture_at(&plane, 1.75, 1.25), 1.25 + 7.5, 1e-12);
    CHECK_NEAR(gsn_phantom_texture_at(&plane, -9, 99), 10, 1e-12);
    CHECK_NEAR(gsn_phantom_texture_at(&plane, 99, 99), 12, 1e-12);
}

static int quilt_once(struct gsn_error *err)
{
    struct gsn_phantom_random random = draws(0);
    gsn_auto(gsn_plane) quilt = NULL;

    return gsn_phantom_quilt(GSN_PHANTOM_T2, 64, 64, &random, &quilt, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(quilt_once(&err), err);
}
