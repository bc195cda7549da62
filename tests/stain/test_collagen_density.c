/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/collagen_density.h"

#include "tests/check.h"
#include "tests/stain/paint.h"

#include <string.h>

enum { WIDTH = 61, HEIGHT = 37, COUNT = 10007 };

static uint32_t next(uint32_t *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return *seed >> 8;
}

/* Densities of every kind: of each dye alone, of mixtures, below glass, beyond every mixture. */
static void draw_densities(float *const od[3])
{
    uint32_t seed = 11;

    for (size_t i = 0; i < COUNT; i++)
        for (int c = 0; c < 3; c++)
            od[c][i] = (float)(next(&seed) % 4096) / 2000.0F - 0.4F;
}

/* The volume that three vectors span. */
static double volume(const double a[3], const double b[3], const double c[3])
{
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
           a[2] * (b[0] * c[1] - b[1] * c[0]);
}

/* The amounts that make up a density, by Cramer's rule; where they cannot be honest, those of which
 * none is below 0. */
static double exact_red(const struct gsn_unmixer *mix, const double od[3])
{
    const double *red = mix->dye[0], *yellow = mix->dye[1], *dark = mix->dye[2];
    const double all = volume(red, yellow, dark), least = -0.25 * hypot(hypot(od[0], od[1]), od[2]);
    double amount[3] = { volume(od, yellow, dark) / all, volume(red, od, dark) / all,
                         volume(red, yellow, od) / all };

    if (amount[0] < 2 * least || amount[1] < least || amount[2] < least)
        gsn_unmixer_apply(mix, od, amount);
    return amount[0];
}

TEST(a_row_is_unmixed_as_each_pixel_is)
{
    static float red[COUNT], green[COUNT], blue[COUNT], amount[COUNT];
    float *const od[3] = { red, green, blue };
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_unmixer mix;
    struct gsn_collagen_weights weights;
    struct gsn_error err = { 0 };
    size_t far = 0;

    draw_densities(od);
    CHECK_OK(gsn_unmixer_init(&mix, &dyes, &err), err);
    weights = gsn_collagen_weights_of(&mix, dyes.full_red_od);
    gsn_collagen_row(&weights, red, green, blue, COUNT, amount);
    for (size_t i = 0; i < COUNT; i++) {
        const double pixel[3] = { red[i], green[i], blue[i] };
        const double exact = exact_red(&mix, pixel) / dyes.full_red_od;

        /* At the edge of what is honest, rounding decides. */
        far += fabs(exact - (double)amount[i]) > 5e-5;
    }
    CHECK(far <= COUNT / 2000);
}

static void draw_picture(struct gsn_image **ret_image, struct gsn_flat_field *glass)
{
    const double white[3] = { 240, 238, 236 };
    struct gsn_error err = { 0 };
    uint32_t seed = 5;

    CHECK_OK(gsn_image_new(WIDTH, HEIGHT, 3, 8, ret_image, &err), err);
    for (size_t i = 0; i < 3 * WIDTH * HEIGHT; i++)
        ((uint8_t *)(*ret_image)->samples)[i] = (uint8_t)(60 + next(&seed) % 160);
    CHECK_OK(gsn_flat_field_given(WIDTH, HEIGHT, GSN_LIGHT_CODES_LINEAR, white, glass, &err), err);
}

static void set(struct gsn_image *image, size_t x, size_t y, uint8_t r, uint8_t g, uint8_t b)
{
    uint8_t *pixel = (uint8_t *)image->samples + 3 * (y * WIDTH + x);

    pixel[0] = r;
    pixel[1] = g;
    pixel[2] = b;
}

/* Case 36. A sample at the end of its codes says "or beyond"; white on all three is bare glass. */
TEST(clipped_tissue_has_no_density_and_bare_glass_has)
{
    const struct gsn_pixel_box box = { 3, 2, 20, 10 };
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    gsn_auto(gsn_image) image = NULL;
    gsn_auto(gsn_od_reader) absorber = NULL;
    gsn_auto(gsn_collagen_reader) reader = NULL;
    gsn_auto(gsn_plane) density = NULL;
    gsn_auto(gsn_plane) thin = NULL;
    struct gsn_flat_field glass;
    struct gsn_error err = { 0 };
    size_t holes = 0;

    draw_picture(&image, &glass);
    set(image, 4, 2, 0, 90, 90);
    set(image, 5, 2, 255, 90, 90);
    set(image, 6, 2, 255, 255, 255);
    CHECK_OK(gsn_od_reader_new(image, &glass, &absorber, &err), err);
    CHECK_OK(gsn_collagen_reader_new(absorber, &dyes, &reader, &err), err);
    CHECK_OK(gsn_collagen_box(reader, &box, 1, &density, &err), err);
    CHECK(isnan(density->value[1]) && isnan(density->value[2]) && density->value[3] == 0);
    for (size_t i = 0; i < 200; i++)
        holes += isnan(density->value[i]) ? 1 : 0;
    CHECK(holes == 2);
    CHECK_OK(gsn_collagen_box(reader, &box, 3, &thin, &err), err);
    CHECK(thin->width == 20 && thin->height == 4);
    CHECK(memcmp(thin->value + 20, density->value + 60, 20 * sizeof(float)) == 0);
}

TEST(a_thin_plane_holds_single_pixels_of_the_picture)
{
    gsn_auto(gsn_image) image = NULL;
    struct gsn_plane *thin[3];
    struct gsn_flat_field glass;
    struct gsn_error err = { 0 };

    draw_picture(&image, &glass);
    glass.surface[1][1] = 0.01;
    glass.surface[1][3] = 0.03;
    glass.surface[1][5] = -0.02;
    for (unsigned apart = 1; apart <= 3; apart += 2) {
        CHECK_OK(gsn_od_thin(image, &glass, apart, thin, &err), err);
        CHECK(thin[0]->width == (WIDTH + apart - 1) / apart);
        CHECK(thin[0]->height == (HEIGHT + apart - 1) / apart);
        for (unsigned c = 0; c < 3; c++) {
            for (uint32_t i = 0; i < thin[c]->width * thin[c]->height; i++)
                CHECK_NEAR(thin[c]->value[i],
                           paint_density(image, &glass, i % thin[c]->width * apart,
                                         i / thin[c]->width * apart, c),
                           2e-6);
            gsn_plane_free(thin[c]);
        }
    }
}

static int read_once(const struct gsn_image *image, const struct gsn_flat_field *glass,
                     const struct gsn_dyes *dyes, struct gsn_error *err)
{
    const struct gsn_pixel_box box = { 0, 0, 9, 9 };
    gsn_auto(gsn_od_reader) absorber = NULL;
    gsn_auto(gsn_collagen_reader) reader = NULL;
    gsn_auto(gsn_plane) density = NULL;
    struct gsn_plane *thin[3];
    int r = gsn_od_reader_new(image, glass, &absorber, err);

    if (r >= 0)
        r = gsn_collagen_reader_new(absorber, dyes, &reader, err);
    if (r >= 0)
        r = gsn_collagen_box(reader, &box, 1, &density, err);
    if (r >= 0)
        r = gsn_od_thin(image, glass, 4, thin, err);
    for (int c = 0; c < 3 && r >= 0; c++)
        gsn_plane_free(thin[c]);
    return r;
}

TEST(dyes_that_are_too_alike_are_refused_and_no_memory_leaks)
{
    struct gsn_dyes dyes = gsn_dyes_builtin();
    gsn_auto(gsn_image) image = NULL;
    struct gsn_flat_field glass;
    struct gsn_error err = { 0 };

    draw_picture(&image, &glass);
    CHECK_EVERY_OOM(read_once(image, &glass, &dyes, &err), err);
    memcpy(dyes.yellow, dyes.red, sizeof dyes.red);
    CHECK(read_once(image, &glass, &dyes, &err) == GSN_E_STAIN);
    CHECK(strstr(err.text, "nearly the same colour"));
}

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

    CHECK_OK(gsn_collagen_compare(map, reference, &overlap, &err), err);
    CHECK_NEAR(overlap.dice, 2.0 * 2 / 7, 1e-15);
    CHECK_NEAR(overlap.false_positive, 0.5, 1e-15);
    CHECK_NEAR(overlap.false_negative, 1.0 / 3, 1e-15);
    CHECK(overlap.pixels == 8 && overlap.map_px == 4 && overlap.reference_px == 3);
    CHECK_OK(gsn_collagen_compare(map, map, &overlap, &err), err);
    CHECK_NEAR(overlap.dice, 1, 0);
    CHECK_OK(gsn_collagen_compare(map, nothing, &overlap, &err), err);
    CHECK_NEAR(overlap.dice, 0, 0);
    CHECK_NEAR(overlap.false_positive, 1, 0);
    CHECK_NEAR(overlap.false_negative, 0, 0);
    CHECK_OK(gsn_collagen_compare(nothing, nothing, &overlap, &err), err);
    CHECK_NEAR(overlap.dice, 1, 0);
}

TEST(a_reference_of_other_depth_or_colour_is_read_and_one_of_other_size_refused)
{
    gsn_auto(gsn_image) map = map_of("1100", 4);
    gsn_auto(gsn_image) deep = NULL;
    gsn_auto(gsn_image) narrow = map_of("110", 3);
    struct gsn_error err = { 0 };
    struct gsn_overlap overlap = { .pixels = 77 };

    CHECK(gsn_collagen_compare(map, narrow, &overlap, &err) == GSN_E_INPUT);
    assert_string_equal(err.text, "the mask is of 3 x 1 pixels, the picture of 4 x 1");
    CHECK(overlap.pixels == 77);
    CHECK_OK(gsn_image_new(4, 1, 3, 16, &deep, &err), err);
    ((uint16_t *)deep->samples)[1] = 32768; /* green of pixel 0 */
    ((uint16_t *)deep->samples)[4] = 32767; /* just too dark */
    CHECK_OK(gsn_collagen_compare(map, deep, &overlap, &err), err);
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
