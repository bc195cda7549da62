/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include "pipeline/decode/decode.h"
#include "pipeline/decode/png_write.h"
#include "tests/decode/make.h"

#include <string.h>

TEST(what_is_written_is_read_back_bit_for_bit)
{
    static const uint32_t widths[] = { 1, 2, 17, 256 };

    for (unsigned i = 0; i < 8; i++) {
        gsn_auto(gsn_image) image = make_picture(widths[i / 2], 33, i % 2 ? 3 : 1, 8);
        gsn_auto(gsn_picture) picture = NULL;
        struct gsn_error err = { 0 };
        auto_made file = { 0 };

        CHECK_OK(gsn_png_encode(image, &file.bytes, &file.size, &err), err);
        CHECK_OK(gsn_decode(file.bytes, file.size, NULL, &picture, &err), err);
        CHECK(same_picture(picture->image, image));
    }
}

TEST(the_same_picture_gives_the_same_bytes_and_no_time)
{
    gsn_auto(gsn_image) image = make_picture(100, 80, 3, 8);
    struct gsn_error err = { 0 };
    auto_made once = { 0 };
    auto_made again = { 0 };

    CHECK_OK(gsn_png_encode(image, &once.bytes, &once.size, &err), err);
    CHECK_OK(gsn_png_encode(image, &again.bytes, &again.size, &err), err);
    CHECK(once.size == again.size && memcmp(once.bytes, again.bytes, once.size) == 0);
    CHECK(memmem(once.bytes, once.size, "tIME", 4) == NULL);
    CHECK(memmem(once.bytes, once.size, "tEXt", 4) == NULL);
}

TEST(what_is_no_eight_bit_picture_is_refused_and_the_output_stays_untouched)
{
    gsn_auto(gsn_image) wide = make_picture(10, 8, 3, 16);
    gsn_auto(gsn_image) none = make_picture(0, 8, 3, 8);
    struct gsn_error err = { 0 };
    uint8_t *bytes = NULL;
    size_t size = 5;

    CHECK(gsn_png_encode(wide, &bytes, &size, &err) == GSN_E_UNSUPPORTED);
    CHECK(gsn_png_encode(none, &bytes, &size, &err) == GSN_E_INPUT);
    CHECK(bytes == NULL && size == 5);
}

static int encode_once(const struct gsn_image *image, struct gsn_error *err)
{
    auto_made file = { 0 };

    return gsn_png_encode(image, &file.bytes, &file.size, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_image) image = make_picture(100, 80, 3, 8);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(encode_once(image, &err), err);
}
