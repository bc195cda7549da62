/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/reconstruction.h"

#include "pipeline/stain/flat_field.h"
#include "tests/check.h"

#include <string.h>

static uint8_t code_of(const struct gsn_stack_light_table *light, unsigned sample)
{
    return light->code[light->of_sample[sample] / 4];
}

TEST(a_picture_coded_by_srgb_keeps_its_codes)
{
    struct gsn_stack_light_table light;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_stack_light_table(GSN_LIGHT_SRGB, 8, &light, &err), err);
    for (unsigned i = 1; i < 256; i++)
        CHECK(code_of(&light, i) == i);
    CHECK(code_of(&light, 0) == 1); /* 0 means no data */
    gsn_stack_light_table_done(&light);
    CHECK_OK(gsn_stack_light_table(GSN_LIGHT_SRGB, 16, &light, &err), err);
    for (unsigned i = 1; i < 256; i++)
        CHECK(code_of(&light, 257 * i) == i);
    gsn_stack_light_table_done(&light);
}

/* As any viewer shows them, and the contact sheet. */
TEST(codes_in_proportion_to_light_are_shown_as_they_are)
{
    struct gsn_stack_light_table light;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_stack_light_table(GSN_LIGHT_CODES_LINEAR, 8, &light, &err), err);
    for (unsigned i = 0; i < 256; i++)
        CHECK(light.of_sample[i] == 128 * i);
    for (unsigned i = 1; i < 256; i++)
        CHECK(code_of(&light, i) == i);
    gsn_stack_light_table_done(&light);
    /* IEC 61966-2-1: half of the light is code 188. */
    CHECK_OK(gsn_stack_light_table(GSN_LIGHT_PROFILE, 16, &light, &err), err);
    CHECK(code_of(&light, 32896) == 188);
    gsn_stack_light_table_done(&light);
}

static int make_light(struct gsn_error *err)
{
    struct gsn_stack_light_table light;
    const int r = gsn_stack_light_table(GSN_LIGHT_SRGB, 8, &light, err);

    if (r >= 0)
        gsn_stack_light_table_done(&light);
    return r;
}

TEST(the_colours_follow_the_grid_when_it_is_cut)
{
    const struct gsn_lattice whole = { 5, 4, 3, { 10, 20, 12 }, { 8, 8, 24 } };
    const struct gsn_lattice part = { 2, 3, 1, { 26, 28, 36 }, { 8, 8, 24 } };
    struct gsn_densities d = { .grid = NULL };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new(&whole, &d.grid, &err), err);
    CHECK_OK(gsn_colour_grid_new(&whole, &d.colour, &err), err);
    for (size_t i = 0; i < 3 * gsn_lattice_count(&whole); i++)
        d.colour->rgb[i] = (uint8_t)(i / 3);
    gsn_grid_free(d.grid);
    CHECK_OK(gsn_grid_new(&part, &d.grid, &err), err);
    CHECK_OK(gsn_densities_crop_colour(&d, &err), err);
    CHECK(d.colour->at.nx == 2 && d.colour->at.ny == 3 && d.colour->at.nz == 1);
    for (size_t i = 0; i < 6; i++)
        CHECK(d.colour->rgb[3 * i] == 20 + 5 * (1 + i / 2) + 2 + i % 2);
    gsn_grid_free(d.grid);
    gsn_colour_grid_free(d.colour);
    CHECK_EVERY_OOM(make_light(&err), err);
}
