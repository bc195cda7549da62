/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/decode/jpeg_write.h"

#include "pipeline/decode/decode.h"
#include "tests/check.h"
#include "tests/decode/make.h"

#include <string.h>

static const struct gsn_jpeg_style style = { .quality = 90, .smallest = 1 };
static const struct gsn_jpeg_style best = { .quality = 100, .px_um = 16, .orientation = 6 };

/* A slope of each colour: what JPEG keeps. */
static struct gsn_image *make_slope(uint32_t width, uint32_t height)
{
    struct gsn_image *const image = make_picture(width, height, 3, 8);
    uint8_t *const at = image->samples;

    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++) {
            at[3 * (y * width + x)] = (uint8_t)(40 + 200 * x / width);
            at[3 * (y * width + x) + 1] = (uint8_t)(30 + 180 * y / height);
            at[3 * (y * width + x) + 2] = (uint8_t)(200 - 100 * x / width);
        }
    return image;
}

TEST(what_is_written_is_read_back_within_three_codes)
{
    gsn_auto(gsn_image) image = make_slope(264, 251);
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };
    auto_made file = { 0 };
    int worst = 0;

    CHECK_OK(gsn_jpeg_encode(image, &style, &file.bytes, &file.size, &err), err);
    CHECK_OK(gsn_decode(file.bytes, file.size, NULL, &picture, &err), err);
    CHECK(picture->image->width == 264 && picture->image->height == 251);
    for (size_t i = 0; i < 3 * 264 * 251; i++) {
        const int off =
            ((const uint8_t *)picture->image->samples)[i] - ((const uint8_t *)image->samples)[i];

        worst = off > worst ? off : -off > worst ? -off : worst;
    }
    CHECK(worst <= 3);
    CHECK(file.size < 20000);
}

TEST(the_same_picture_gives_the_same_bytes)
{
    gsn_auto(gsn_image) image = make_picture(100, 80, 3, 8);
    struct gsn_error err = { 0 };
    auto_made once = { 0 };
    auto_made again = { 0 };

    CHECK_OK(gsn_jpeg_encode(image, &style, &once.bytes, &once.size, &err), err);
    CHECK_OK(gsn_jpeg_encode(image, &style, &again.bytes, &again.size, &err), err);
    CHECK(once.size == again.size && memcmp(once.bytes, again.bytes, once.size) == 0);
}

TEST(what_is_no_eight_bit_colour_picture_is_refused_and_the_output_stays_untouched)
{
    gsn_auto(gsn_image) wide = make_picture(10, 8, 3, 16);
    gsn_auto(gsn_image) grey = make_picture(10, 8, 1, 8);
    gsn_auto(gsn_image) none = make_picture(0, 8, 3, 8);
    struct gsn_error err = { 0 };
    uint8_t *bytes = NULL;
    size_t size = 5;

    CHECK(gsn_jpeg_encode(wide, &style, &bytes, &size, &err) == GSN_E_UNSUPPORTED);
    CHECK(gsn_jpeg_encode(grey, &style, &bytes, &size, &err) == GSN_E_UNSUPPORTED);
    CHECK(gsn_jpeg_encode(none, &style, &bytes, &size, &err) == GSN_E_INPUT);
    CHECK(bytes == NULL && size == 5);
}

/* xorshift32 in every sample, which no transform can shorten. */
static struct gsn_image *make_noise(uint32_t width, uint32_t height)
{
    struct gsn_image *const image = make_picture(width, height, 3, 8);
    uint32_t state = 1;

    for (size_t i = 0; i < gsn_image_bytes(image); i++) {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        ((uint8_t *)image->samples)[i] = (uint8_t)(state & 1 ? 255 : 0);
    }
    return image;
}

TEST(the_worst_picture_fits_too)
{
    for (uint32_t side = 2; side < 200; side += 33) {
        gsn_auto(gsn_image) image = make_noise(side, side);
        gsn_auto(gsn_picture) picture = NULL;
        struct gsn_error err = { 0 };
        auto_made file = { 0 };

        CHECK_OK(gsn_jpeg_encode(image, &best, &file.bytes, &file.size, &err), err);
        CHECK_OK(gsn_decode(file.bytes, file.size, NULL, &picture, &err), err);
        CHECK(picture->image->width == side && picture->image->height == side);
    }
}

static int encode_once(const struct gsn_image *image, struct gsn_error *err)
{
    auto_made file = { 0 };

    return gsn_jpeg_encode(image, &best, &file.bytes, &file.size, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_image) image = make_picture(200, 180, 3, 8);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(encode_once(image, &err), err);
}
