/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/image.h"

#include "tests/check.h"

#include <string.h>

/* 16 bit RGB with 2^32 - 1 pixels a side does not fit into 64 bits. */
static const uint32_t WIDEST = UINT32_MAX;

/* A place to point at, to see whether an output was touched. */
static int somewhere;

TEST(an_image_begins_black_and_knows_its_bytes)
{
    static const uint32_t kinds[][2] = { { 1, 8 }, { 3, 8 }, { 1, 16 }, { 3, 16 } };
    struct gsn_error err = { 0 };

    for (size_t k = 0; k < sizeof kinds / sizeof kinds[0]; k++) {
        const uint32_t channels = kinds[k][0], bits = kinds[k][1];
        gsn_auto(gsn_image) image = NULL;

        CHECK_OK(gsn_image_new(5, 3, channels, bits, &image, &err), err);
        CHECK(image->width == 5 && image->height == 3);
        CHECK(image->channels == channels && image->bits == bits);
        CHECK(gsn_image_bytes(image) == 15 * channels * bits / 8);
        for (size_t i = 0; i < gsn_image_bytes(image); i++)
            CHECK(((const uint8_t *)image->samples)[i] == 0);
    }
}

TEST(samples_of_eight_bits_lie_row_by_row_with_channels_interleaved)
{
    gsn_auto(gsn_image) image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(7, 5, 3, 8, &image, &err), err);
    for (unsigned i = 0; i < 7 * 5 * 3; i++)
        ((uint8_t *)image->samples)[i] = (uint8_t)(i + 100);
    for (uint32_t y = 0; y < 5; y++)
        for (uint32_t x = 0; x < 7; x++)
            for (uint32_t c = 0; c < 3; c++)
                CHECK(gsn_image_at(image, x, y, c) == y * 21 + x * 3 + c + 100);
}

TEST(samples_of_sixteen_bits_reach_the_whole_range)
{
    gsn_auto(gsn_image) image = NULL;
    struct gsn_error err = { 0 };
    uint16_t *samples;

    CHECK_OK(gsn_image_new(2, 2, 1, 16, &image, &err), err);
    samples = image->samples;
    samples[1] = 65535;
    samples[2] = 256;
    CHECK(gsn_image_at(image, 0, 0, 0) == 0);
    CHECK(gsn_image_at(image, 1, 0, 0) == 65535);
    CHECK(gsn_image_at(image, 0, 1, 0) == 256);
}

TEST(an_image_of_nothing_holds_nothing)
{
    gsn_auto(gsn_image) image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(0, 9, 3, 8, &image, &err), err);
    CHECK(gsn_image_bytes(image) == 0);
}

TEST(an_image_that_overflows_is_refused_and_the_output_stays)
{
    struct gsn_image *image = (struct gsn_image *)&somewhere;
    struct gsn_error err = { 0 };

    CHECK(gsn_image_new(WIDEST, WIDEST, 3, 16, &image, &err) == GSN_E_NOMEM);
    CHECK(image == (struct gsn_image *)&somewhere);
    assert_string_equal(err.text, "out of memory for an image of 4294967295 x 4294967295");
}

TEST(a_plane_begins_as_zeros)
{
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_plane_new(11, 13, &plane, &err), err);
    CHECK(plane->width == 11 && plane->height == 13);
    for (size_t i = 0; i < 11 * 13; i++)
        CHECK(plane->value[i] == 0.0F);
}

TEST(a_plane_that_overflows_is_refused_and_the_output_stays)
{
    struct gsn_plane *plane = (struct gsn_plane *)&somewhere;
    struct gsn_error err = { 0 };

    CHECK(gsn_plane_new(WIDEST, WIDEST, &plane, &err) == GSN_E_NOMEM);
    CHECK(plane == (struct gsn_plane *)&somewhere);
    CHECK(strstr(err.text, "4294967295 x 4294967295") != NULL);
}

static int make_both(struct gsn_error *err)
{
    gsn_auto(gsn_image) image = NULL;
    gsn_auto(gsn_plane) plane = NULL;
    const int r = gsn_image_new(4, 4, 3, 16, &image, err);

    return r < 0 ? r : gsn_plane_new(4, 4, &plane, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(make_both(&err), err);
}

TEST(freeing_nothing_is_fine)
{
    gsn_image_free(NULL);
    gsn_plane_free(NULL);
}
