/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "pipeline/stain/segment.h"

/* One row of pixels. */
static struct gsn_plane *plane_of(const float *values, uint32_t count)
{
    struct gsn_plane *plane = NULL;

    if (gsn_plane_new(count, 1, &plane, NULL) < 0)
        fail();
    memcpy(plane->value, values, count * sizeof *values);
    return plane;
}

static struct gsn_image *map_of(const char *digits, uint32_t width)
{
    struct gsn_image *map = NULL;

    if (gsn_image_new(width, (uint32_t)strlen(digits) / width, 1, 8, &map, NULL) < 0)
        fail();
    for (size_t i = 0; digits[i]; i++)
        ((uint8_t *)map->samples)[i] = digits[i] == '1' ? 255 : 0;
    return map;
}

TEST(otsu_cuts_between_two_classes)
{
    float values[1000];

    for (size_t i = 0; i < 1000; i++)
        values[i] = (i < 700 ? 0.1f : 0.9f) + 0.0001f * (float)(i % 100);
    CHECK(gsn_otsu(values, 1000) > 0.11 && gsn_otsu(values, 1000) < 0.9);
    /* Equally good cuts: the middle of the gap. */
    CHECK_NEAR(gsn_otsu(values, 1000), 0.505, 0.01);
    CHECK(gsn_otsu(values, 0) != gsn_otsu(values, 0)); /* NaN */
    CHECK_NEAR(gsn_otsu(values, 1), 0.1f, 0);
}

TEST(otsu_of_a_ramp_is_its_middle)
{
    float values[4096];

    for (size_t i = 0; i < 4096; i++)
        values[i] = (float)i / 4095;
    CHECK_NEAR(gsn_otsu(values, 4096), 0.5, 1.0 / 512);
}

TEST(the_map_and_its_figures_follow_from_the_densities)
{
    static const float density[6] = { 0.1f, 0.2f, 0.7f, 0.9f, 5, 0.5f };
    gsn_auto(gsn_plane) plane = plane_of(density, 6);
    gsn_auto(gsn_image) tissue = map_of("111101", 6); /* the 5 is dirt beside the tissue */
    gsn_auto(gsn_image) map = NULL;
    struct gsn_error err = { 0 };
    struct gsn_collagen figures;

    CHECK_OK(gsn_collagen_map(plane, plane, tissue, 0.5, &map, &figures, &err), err);
    assert_memory_equal(map->samples, ((uint8_t[]){ 0, 0, 255, 255, 0, 0 }), 6);
    CHECK(figures.tissue_px == 5 && figures.collagen_px == 2);
    CHECK_NEAR(figures.area_fraction, 0.4, 1e-15);
    CHECK_NEAR(figures.mean_density, 2.4 / 5, 1e-7);
    CHECK_NEAR(figures.mean_inside, 0.8, 1e-7);
    CHECK_NEAR(figures.threshold, 0.5, 0);
}

TEST(without_a_threshold_otsu_finds_it_in_the_tissue_alone)
{
    float share[200], density[200];
    gsn_auto(gsn_image) tissue = NULL;
    gsn_auto(gsn_image) map = NULL;
    struct gsn_error err = { 0 };
    struct gsn_collagen figures;

    CHECK_OK(gsn_image_new(200, 1, 1, 8, &tissue, &err), err);
    for (size_t i = 0; i < 200; i++) {
        ((uint8_t *)tissue->samples)[i] = i < 100 ? 255 : 0;
        share[i] = i < 60 ? 0.2f : i < 100 ? 0.6f : 90;
        density[i] = 1;
    }

    gsn_auto(gsn_plane) by = plane_of(share, 200);
    gsn_auto(gsn_plane) plane = plane_of(density, 200);

    CHECK_OK(gsn_collagen_map(by, plane, tissue, NAN, &map, &figures, &err), err);
    CHECK_NEAR(figures.threshold, 0.4, 0.002);
    CHECK_NEAR(figures.area_fraction, 0.4, 1e-15);
    CHECK_NEAR(figures.mean_density, 1, 1e-7);
}

TEST(no_tissue_wrong_sizes_and_holes_in_the_numbers_are_refused)
{
    static const float density[4] = { 0.1f, NAN, 0.7f, 0.9f };
    gsn_auto(gsn_plane) plane = plane_of(density, 4);
    gsn_auto(gsn_plane) shorter = plane_of(density, 3);
    gsn_auto(gsn_image) none = map_of("0000", 4);
    gsn_auto(gsn_image) narrow = map_of("111", 3);
    gsn_auto(gsn_image) around = map_of("1011", 4);
    struct gsn_image *map = NULL;
    struct gsn_error err = { 0 };
    struct gsn_collagen figures = { .tissue_px = 77 };

    CHECK(gsn_collagen_map(plane, plane, none, 0.5, &map, &figures, &err) == GSN_E_STAIN);
    assert_string_equal(err.text, "there is no tissue in this picture");
    CHECK(gsn_collagen_map(plane, plane, narrow, 0.5, &map, &figures, &err) == GSN_E_INPUT);
    CHECK(gsn_collagen_map(plane, shorter, NULL, 0.5, &map, &figures, &err) == GSN_E_INPUT);
    CHECK(gsn_collagen_map(plane, plane, NULL, 0.5, &map, &figures, &err) == GSN_E_INPUT);
    assert_string_equal(err.text, "the density of pixel (1, 0) is not a number");
    CHECK(map == NULL && figures.tissue_px == 77);
    CHECK_OK(gsn_collagen_map(plane, plane, around, 0.95, &map, &figures, &err), err);
    CHECK(figures.mean_inside != figures.mean_inside); /* NaN */
    gsn_image_free(map);
}

TEST(overlap_has_its_closed_forms)
{
    gsn_auto(gsn_image) map = map_of("11110000", 4);
    gsn_auto(gsn_image) reference = map_of("00111000", 4);
    gsn_auto(gsn_image) nothing = map_of("00000000", 4);
    struct gsn_error err = { 0 };
    struct gsn_overlap overlap;

    CHECK_OK(gsn_mask_compare(map, reference, &overlap, &err), err);
    CHECK_NEAR(overlap.dice, 2.0 * 2 / 7, 1e-15);
    CHECK_NEAR(overlap.false_positive, 0.5, 1e-15);
    CHECK_NEAR(overlap.false_negative, 1.0 / 3, 1e-15);
    CHECK(overlap.pixels == 8 && overlap.map_px == 4 && overlap.reference_px == 3);
    CHECK_OK(gsn_mask_compare(map, map, &overlap, &err), err);
    CHECK_NEAR(overlap.dice, 1, 0);
    CHECK_OK(gsn_mask_compare(map, nothing, &overlap, &err), err);
    CHECK_NEAR(overlap.dice, 0, 0);
    CHECK_NEAR(overlap.false_positive, 1, 0);
    CHECK_NEAR(overlap.false_negative, 0, 0);
    CHECK_OK(gsn_mask_compare(nothing, nothing, &overlap, &err), err);
    CHECK_NEAR(overlap.dice, 1, 0);
}

TEST(a_reference_of_other_depth_or_colour_is_read_and_one_of_other_size_refused)
{
    gsn_auto(gsn_image) map = map_of("1100", 4);
    gsn_auto(gsn_image) deep = NULL;
    gsn_auto(gsn_image) narrow = map_of("110", 3);
    struct gsn_error err = { 0 };
    struct gsn_overlap overlap = { .pixels = 77 };

    CHECK(gsn_mask_compare(map, narrow, &overlap, &err) == GSN_E_INPUT);
    assert_string_equal(err.text, "the mask is of 3 x 1 pixels, the picture of 4 x 1");
    CHECK(overlap.pixels == 77);
    CHECK_OK(gsn_image_new(4, 1, 3, 16, &deep, &err), err);
    ((uint16_t *)deep->samples)[1] = 32768; /* green of pixel 0 */
    ((uint16_t *)deep->samples)[4] = 32767; /* just too dark */
    CHECK_OK(gsn_mask_compare(map, deep, &overlap, &err), err);
    CHECK(overlap.reference_px == 1 && overlap.both_px == 1);
}

static int map_once(const struct gsn_plane *plane, struct gsn_error *err)
{
    gsn_auto(gsn_image) map = NULL;
    gsn_auto(gsn_image) above = NULL;
    struct gsn_collagen figures;
    const int r = gsn_plane_above(plane, 0.5, &above, err);

    return r < 0 ? r : gsn_collagen_map(plane, plane, above, NAN, &map, &figures, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    static const float density[4] = { 0.1f, 0.2f, 0.7f, 0.9f };
    gsn_auto(gsn_plane) plane = plane_of(density, 4);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(map_once(plane, &err), err);
}
