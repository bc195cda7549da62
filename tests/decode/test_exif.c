/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include "pipeline/decode/exif.h"
#include "tests/decode/make.h"

#include <string.h>

TEST(orientation_resolution_and_colours_are_read_in_either_byte_order)
{
    for (int big_endian = 0; big_endian < 2; big_endian++) {
        const struct exif_recipe recipe = {
            .big_endian = big_endian, .orientation = 6, .dots_per_cm = 625, .colour_space = 1
        };
        struct gsn_exif exif;
        uint8_t block[128];

        CHECK(gsn_exif_read(block, make_exif(&recipe, block), &exif));
        CHECK(exif.orientation == 6 && exif.is_srgb);
        CHECK_NEAR(exif.unit_um / exif.per_unit_x, 16, 1e-12);
        CHECK_NEAR(exif.unit_um / exif.per_unit_y, 16, 1e-12);
    }
}

TEST(an_orientation_that_does_not_exist_states_nothing)
{
    static const unsigned wrong[] = { 0, 9, 255, 65535 };

    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        struct gsn_exif exif;
        uint8_t block[128];

        CHECK(gsn_exif_read(
            block, make_exif(&(struct exif_recipe){ .orientation = wrong[i] }, block), &exif));
        CHECK(exif.orientation == 1);
        CHECK(exif.per_unit_x <= 0 && !exif.is_srgb);
    }
}

/* Each length gets memory of its own, so that ASan sees a byte read too far. */
TEST(a_block_cut_anywhere_is_read_within_its_bounds)
{
    const struct exif_recipe recipe = { .orientation = 8, .dots_per_cm = 625, .colour_space = 1 };
    uint8_t block[128];
    const size_t whole = make_exif(&recipe, block);

    for (size_t size = 0; size < whole; size++) {
        gsn_auto_mem(uint8_t) part = gsn_memdup(block, size);
        struct gsn_exif exif;

        CHECK(part);
        if (!gsn_exif_read(part, size, &exif))
            CHECK(exif.orientation == 1);
    }
}

TEST(offsets_beyond_the_block_are_refused)
{
    const struct exif_recipe recipe = { .orientation = 8 };
    uint8_t block[128];
    const size_t size = make_exif(&recipe, block);
    struct gsn_exif exif;

    memset(block + 4, 0xff, 4); /* the first directory at 4 GiB */
    CHECK(!gsn_exif_read(block, size, &exif));
    CHECK(exif.orientation == 1);
    (void)make_exif(&recipe, block);
    memset(block + 8, 0xff, 2); /* 65535 entries */
    CHECK(!gsn_exif_read(block, size, &exif));
}
