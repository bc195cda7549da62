/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel/reduce.h"

#include "tests/check.h"

#include <string.h>

TEST(cells_are_about_fifty_micrometres)
{
    CHECK(gsn_panel_step(5) == 10 && gsn_panel_step(10.6) == 4 && gsn_panel_step(24) == 2);
    CHECK(gsn_panel_step(26) == 1 && gsn_panel_step(900) == 1 && gsn_panel_step(1e-9) == 1000);
}

/* A plane is its own mean wherever it is sampled evenly: every size of cell shows it exactly, to
 * the rounding of 16 bits. */
TEST(a_ramp_stays_a_ramp)
{
    for (unsigned bits = 8; bits <= 16; bits += 8)
        for (unsigned step = 1; step <= 12; step++) {
            gsn_auto(gsn_image) image = NULL;
            gsn_auto(gsn_image) small = NULL;
            struct gsn_error err = { 0 };
            const double one = bits == 8 ? 257 : 1;

            CHECK_OK(gsn_image_new(62, 50, 3, bits, &image, &err), err);
            for (uint32_t i = 0; i < 62 * 50 * 3; i++) {
                const uint32_t x = i / 3 % 62, y = i / 186;
                const unsigned code = 2 * x + y + 20 * (i % 3);

                if (bits == 8)
                    ((uint8_t *)image->samples)[i] = (uint8_t)code;
                else
                    ((uint16_t *)image->samples)[i] = (uint16_t)code;
            }
            CHECK_OK(gsn_panel_reduce(image, step, &small, &err), err);
            CHECK(small->bits == 16 && small->channels == 3);
            CHECK(small->width == 62 / step && small->height == 50 / step);
            for (uint32_t y = 0; y < small->height; y++)
                for (uint32_t x = 0; x < small->width; x++)
                    for (unsigned c = 0; c < 3; c++) {
                        const double middle = (step - 1) / 2.0;
                        const double code = 2 * (x * step + middle) + (y * step + middle) + 20 * c;

                        /* Taps stand on whole pixels, at most half a pixel off. */
                        CHECK_NEAR(gsn_image_at(small, x, y, c), one * code, one * 1.5 + 0.5);
                    }
        }
}

TEST(a_panel_smaller_than_a_cell_is_refused)
{
    gsn_auto(gsn_image) image = NULL;
    struct gsn_image *small = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(30, 9, 3, 8, &image, &err), err);
    CHECK(gsn_panel_reduce(image, 10, &small, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "a panel of 30 x 9 pixels is too small to be split") == 0);
    CHECK(small == NULL);
}

static int reduce_once(const struct gsn_image *image, struct gsn_error *err)
{
    gsn_auto(gsn_image) small = NULL;

    return gsn_panel_reduce(image, 3, &small, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_image) image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(30, 30, 3, 8, &image, &err), err);
    CHECK_EVERY_OOM(reduce_once(image, &err), err);
}
