/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"
#include "pipeline/register/stack/resample_colour.h"

#include "tests/check.h"

#include <string.h>

static uint8_t code_of(const struct gsn_assembly_light *light, unsigned sample)
{
    return light->code[light->of_sample[sample] / 4];
}

TEST(a_picture_coded_by_srgb_keeps_its_codes)
{
    struct gsn_assembly_light light;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_assembly_light(GSN_LIGHT_SRGB, 8, &light, &err), err);
    for (unsigned i = 1; i < 256; i++)
        CHECK(code_of(&light, i) == i);
    CHECK(code_of(&light, 0) == 1); /* 0 means no data */
    gsn_assembly_light_done(&light);
    CHECK_OK(gsn_assembly_light(GSN_LIGHT_SRGB, 16, &light, &err), err);
    for (unsigned i = 1; i < 256; i++)
        CHECK(code_of(&light, 257 * i) == i);
    gsn_assembly_light_done(&light);
}

/* IEC 61966-2-1: half of the light is code 188. */
TEST(codes_in_proportion_to_light_become_srgb)
{
    struct gsn_assembly_light light;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_assembly_light(GSN_LIGHT_CODES_LINEAR, 8, &light, &err), err);
    for (unsigned i = 0; i < 256; i++)
        CHECK(light.of_sample[i] == 128 * i);
    CHECK(code_of(&light, 255) == 255 && code_of(&light, 128) == 188);
    gsn_assembly_light_done(&light);
}

static int make_light(struct gsn_error *err)
{
    struct gsn_assembly_light light;
    const int r = gsn_assembly_light(GSN_LIGHT_SRGB, 8, &light, err);

    if (r >= 0)
        gsn_assembly_light_done(&light);
    return r;
}

TEST(the_colours_follow_the_grid_when_it_is_cut)
{
    const struct gsn_lattice whole = { 5, 4, 3, { 10, 20, 12 }, { 8, 8, 24 } };
    const struct gsn_lattice part = { 2, 3, 1, { 26, 28, 36 }, { 8, 8, 24 } };
    struct gsn_assembly a = { .section_count = 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new(&whole, &a.grid, &err), err);
    CHECK_OK(gsn_assembly_place_colour(&a, &err), err);
    for (size_t i = 0; i < 3 * gsn_lattice_count(&whole); i++)
        a.colour->rgb[i] = (uint8_t)(i / 3);
    gsn_grid_free(a.grid);
    CHECK_OK(gsn_grid_new(&part, &a.grid, &err), err);
    CHECK_OK(gsn_assembly_crop_colour(&a, &err), err);
    CHECK(a.colour->at.nx == 2 && a.colour->at.ny == 3 && a.colour->at.nz == 1);
    for (size_t i = 0; i < 6; i++)
        CHECK(a.colour->rgb[3 * i] == 20 + 5 * (1 + i / 2) + 2 + i % 2);
    gsn_grid_free(a.grid);
    gsn_colour_grid_free(a.colour);
    CHECK_EVERY_OOM(make_light(&err), err);
}
