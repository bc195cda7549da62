/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/stack/resample_colour.h"

#include "tests/check.h"

#include <string.h>

enum { WIDTH = 90, HEIGHT = 70, STEPS = GSN_STACK_FULL_LIGHT / 4 + 1 };

/* Codes in proportion to light, kept as they are. */
static void even_light(uint16_t of_sample[256], uint8_t code[STEPS])
{
    for (unsigned i = 0; i < 256; i++)
        of_sample[i] = (uint16_t)(128 * i);
    for (unsigned i = 0; i < STEPS; i++)
        code[i] = (uint8_t)(i < 16 ? 1 : (4 * i + 66) / 128);
}

static struct gsn_image *noise(void)
{
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };
    uint32_t seed = 9;

    CHECK_OK(gsn_image_new(WIDTH, HEIGHT, 3, 8, &image, &err), err);
    for (size_t i = 0; i < 3 * WIDTH * HEIGHT; i++) {
        seed = seed * 1664525u + 1013904223u;
        ((uint8_t *)image->samples)[i] = (uint8_t)(seed >> 24);
    }
    return image;
}

/* Pixels of 8 um, turned around the middle of the picture, which is the block's origin. */
static struct gsn_stack_section turned(double angle)
{
    const double c = 8 * cos(angle), s = 8 * sin(angle);

    return (struct gsn_stack_section){ .serial = 1,
                                       .panel_to_block_um = { c, -s,
                                                              -c * WIDTH / 2 + s * HEIGHT / 2, s, c,
                                                              -s * WIDTH / 2 - c * HEIGHT / 2 },
                                       .width = WIDTH,
                                       .height = HEIGHT };
}

static struct gsn_lattice lattice(size_t side, double step_um)
{
    const double first = -0.5 * (double)(side - 1) * step_um;

    return (struct gsn_lattice){ side, side, 3, { first, first, 12 }, { step_um, step_um, 24 } };
}

static struct gsn_colour_grid *lay(const struct gsn_image *image,
                                   const struct gsn_stack_section *section,
                                   const struct gsn_lattice *at, unsigned threads)
{
    uint16_t of_sample[256];
    uint8_t code[STEPS];
    const struct gsn_stack_light light = { of_sample, code };
    struct gsn_colour_grid *grid = NULL;
    struct gsn_error err = { 0 };

    even_light(of_sample, code);
    CHECK_OK(gsn_colour_grid_new(at, &grid, &err), err);
    CHECK_OK(gsn_stack_resample_colour(section, image, &light, 24, threads, grid, &err), err);
    return grid;
}

/* The same by the book, in double precision, inside the picture. */
static double by_the_book(const struct gsn_image *image, struct gsn_point px, unsigned c)
{
    const double x = floor(px.x - 0.5), y = floor(px.y - 0.5);
    const double tx = px.x - 0.5 - x, ty = px.y - 0.5 - y;
    double sum = 0;

    for (int k = 0; k < 4; k++)
        sum += (k % 2 ? tx : 1 - tx) * (k / 2 ? ty : 1 - ty) *
               gsn_image_at(image, (uint32_t)x + (uint32_t)k % 2, (uint32_t)y + (uint32_t)k / 2, c);
    return sum;
}

TEST(a_turned_section_is_interpolated_between_its_pixels)
{
    const struct gsn_stack_section section = turned(0.7);
    const struct gsn_affine back = gsn_affine_inverse(&section.panel_to_block_um);
    const struct gsn_lattice at = lattice(41, 8);
    gsn_auto(gsn_image) image = noise();
    gsn_auto(gsn_colour_grid) grid = lay(image, &section, &at, 1);

    for (size_t i = 0; i < 41 * 41; i++) {
        const struct gsn_vec3 um = gsn_lattice_centre(&at, i % 41, i / 41, 1);
        const struct gsn_point px = gsn_affine_apply(&back, (struct gsn_point){ um.x, um.y });

        for (unsigned c = 0; c < 3; c++)
            CHECK_NEAR(grid->rgb[3 * (i + 41 * 41) + c], fmax(by_the_book(image, px, c), 1), 0.6);
    }
}

TEST(planes_of_other_sections_and_what_lies_beside_stay_without_data)
{
    const struct gsn_stack_section section = turned(0.3);
    const struct gsn_lattice at = lattice(201, 8);
    const size_t plane = 201 * 201;
    gsn_auto(gsn_image) image = noise();
    gsn_auto(gsn_colour_grid) grid = lay(image, &section, &at, 1);
    size_t seen = 0;

    for (size_t i = 0; i < 3 * plane; i++) {
        const uint8_t *rgb = grid->rgb + 3 * i;

        if (i / plane != 1)
            CHECK(rgb[0] == 0 && rgb[1] == 0 && rgb[2] == 0);
        else
            seen += rgb[0] > 0 && rgb[1] > 0 && rgb[2] > 0;
    }
    /* A voxel a pixel: as many as the picture has, but for its rim. */
    CHECK_NEAR((double)seen, WIDTH * HEIGHT, 80);
}

/* The short way and the table have to agree to the bit: samples of 16 bits go through the table. */
TEST(both_ways_and_all_numbers_of_threads_give_the_same_bytes)
{
    const struct gsn_stack_section section = turned(-1.1);
    const struct gsn_lattice at = lattice(120, 8);
    static uint16_t of_sample[1 << 16];
    uint8_t code[STEPS];
    const struct gsn_stack_light light = { of_sample, code };
    gsn_auto(gsn_image) image = noise();
    gsn_auto(gsn_image) wide = NULL;
    gsn_auto(gsn_colour_grid) one = lay(image, &section, &at, 1);
    gsn_auto(gsn_colour_grid) table = NULL;
    struct gsn_error err = { 0 };

    for (unsigned threads = 2; threads <= 5; threads += 3) {
        gsn_auto(gsn_colour_grid) many = lay(image, &section, &at, threads);

        CHECK(memcmp(one->rgb, many->rgb, 3 * gsn_lattice_count(&at)) == 0);
    }
    even_light(of_sample, code);
    CHECK_OK(gsn_image_new(WIDTH, HEIGHT, 3, 16, &wide, &err), err);
    for (size_t i = 0; i < 3 * WIDTH * HEIGHT; i++)
        ((uint16_t *)wide->samples)[i] = ((const uint8_t *)image->samples)[i];
    CHECK_OK(gsn_colour_grid_new(&at, &table, &err), err);
    CHECK_OK(gsn_stack_resample_colour(&section, wide, &light, 24, 1, table, &err), err);
    CHECK(memcmp(one->rgb, table->rgb, 3 * gsn_lattice_count(&at)) == 0);
}

/* A wave of so many voxels across, turned against both the pixels and the voxels. */
static double swing(double period_voxels, double voxel_px)
{
    const struct gsn_stack_section section = turned(0.5);
    const struct gsn_lattice at = lattice((size_t)(40 / voxel_px), 8 * voxel_px);
    const double k = 2 * M_PI / (period_voxels * voxel_px);
    gsn_auto(gsn_image) image = noise();
    uint8_t low = 255, high = 0;

    for (size_t i = 0; i < 3 * WIDTH * HEIGHT; i++) {
        const double x = (double)(i / 3 % WIDTH) + 0.5, y = (double)(i / 3 / WIDTH) + 0.5;

        ((uint8_t *)image->samples)[i] = (uint8_t)lround(128 + 100 * cos(k * (0.8 * x + 0.6 * y)));
    }
    gsn_auto(gsn_colour_grid) grid = lay(image, &section, &at, 1);

    for (size_t i = 3 * at.nx * at.ny; i < 6 * at.nx * at.ny; i++) {
        low = grid->rgb[i] < low ? grid->rgb[i] : low;
        high = grid->rgb[i] > high ? grid->rgb[i] : high;
    }
    return (high - low) / 200.0;
}

TEST(a_long_wave_is_kept_and_one_finer_than_a_voxel_vanishes)
{
    CHECK(swing(12, 1) > 0.93);
    CHECK(swing(12, 3) > 0.85);
    CHECK(swing(12, 4) > 0.85);
    /* A tent leaves sinc^2 along each axis: at most a tenth between one and two waves a voxel. */
    CHECK(swing(1.1, 3) < 0.1);
    CHECK(swing(1, 4) < 0.05);
    CHECK(swing(0.7, 4) < 0.06);
}

TEST(bad_sections_are_refused_and_the_output_stays_untouched)
{
    const struct gsn_lattice at = lattice(20, 8);
    struct gsn_stack_section outside = turned(0), flat = turned(0);
    uint16_t of_sample[256];
    uint8_t code[STEPS];
    const struct gsn_stack_light light = { of_sample, code };
    gsn_auto(gsn_image) image = noise();
    gsn_auto(gsn_colour_grid) grid = NULL;
    struct gsn_error err = { 0 };

    even_light(of_sample, code);
    outside.x = 1;
    flat.panel_to_block_um = (struct gsn_affine){ 1, 2, 0, 2, 4, 0 };
    CHECK_OK(gsn_colour_grid_new(&at, &grid, &err), err);
    CHECK(gsn_stack_resample_colour(&outside, image, &light, 24, 1, grid, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "the box of section 2 reaches outside its panel") == 0);
    CHECK(gsn_stack_resample_colour(&flat, image, &light, 24, 1, grid, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "the pose of section 2 cannot be undone") == 0);
    image->channels = 1;
    CHECK(gsn_stack_resample_colour(&outside, image, &light, 24, 1, grid, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "a grey picture has no colours to keep") == 0);
    for (size_t i = 0; i < 3 * gsn_lattice_count(&at); i++)
        CHECK(grid->rgb[i] == 0);
}

static int lay_once(const struct gsn_image *image, struct gsn_error *err)
{
    const struct gsn_stack_section section = turned(0.2);
    const struct gsn_lattice at = lattice(9, 8);
    uint16_t of_sample[256];
    uint8_t code[STEPS];
    const struct gsn_stack_light light = { of_sample, code };
    gsn_auto(gsn_colour_grid) grid = NULL;
    gsn_auto_mem(uint8_t) file = NULL;
    size_t size;
    int r = gsn_colour_grid_new(&at, &grid, err);

    even_light(of_sample, code);
    if (r >= 0)
        r = gsn_stack_resample_colour(&section, image, &light, 24, 1, grid, err);
    return r < 0 ? r : gsn_colour_grid_nrrd(grid, &file, &size, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_image) image = noise();
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(lay_once(image, &err), err);
}

TEST(the_file_says_what_it_holds)
{
    const struct gsn_lattice at = { 2, 1, 3, { -4, 5, 12 }, { 8, 8, 24 } };
    gsn_auto(gsn_colour_grid) grid = NULL;
    gsn_auto_mem(uint8_t) file = NULL;
    struct gsn_error err = { 0 };
    size_t size;
    char *end;

    CHECK_OK(gsn_colour_grid_new(&at, &grid, &err), err);
    memset(grid->rgb, 7, 18);
    CHECK_OK(gsn_colour_grid_nrrd(grid, &file, &size, &err), err);
    CHECK(memcmp(file, "NRRD0004\n", 9) == 0);
    end = memmem(file, size, "\n\n", 2);
    CHECK(end && end + 2 + 18 == (char *)file + size && end[2] == 7);
    *end = '\0';
    CHECK(strstr((char *)file, "\nsizes: 3 2 1 3\n"));
    CHECK(strstr((char *)file, "\nspace origin: (-4,5,12)\n"));
    CHECK(strstr((char *)file, "\nspace directions: none (8,0,0) (0,8,0) (0,0,24)\n"));
}
