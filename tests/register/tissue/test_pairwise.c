/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/tissue/pairwise.h"

#include "tests/check.h"
#include "tests/register/draw.h"
#include "tests/register/tissue/drawn_tissue.h"
#include "tests/register/mounted.h"

#include <string.h>

/* Section 1 on section 0, whose motions are known. */
static double error_of(const struct gsn_affine *first, const struct gsn_affine *second,
                       struct gsn_tissue_match *ret_match, unsigned block)
{
    gsn_auto(gsn_tissue) a = drawn_section(block, 0, first, 0);
    gsn_auto(gsn_tissue) b = drawn_section(block, 1, second, 0);
    const struct gsn_affine back = gsn_affine_inverse(first);
    const struct gsn_affine truth = gsn_affine_compose(&back, second);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tissue_search(a, b, ret_match, &err), err);
    CHECK_NEAR(fabs(gsn_affine_det(&ret_match->a_to_b)), 1, 1e-9);
    return drawn_apart(&ret_match->a_to_b, &truth);
}

/* Cases 17 and 19: every rotation and both faces, without a start. */
TEST(a_section_is_laid_on_its_neighbour_however_it_was_mounted)
{
    struct draw_chance chance = { 1 };
    const size_t trials = mounted_trials(24);
    double worst = 0, sum = 0, predicted = 0;
    size_t sure = 0;

    for (size_t t = 0; t < trials; t++) {
        const struct gsn_affine first =
            drawn_motion(draw_uniform(&chance, 0, 6.28), 0, draw_uniform(&chance, -8, 8), 5);
        const struct gsn_affine second =
            drawn_motion(draw_uniform(&chance, 0, 6.28), t % 3 == 1, draw_uniform(&chance, -8, 8),
                         draw_uniform(&chance, -8, 8));
        struct gsn_tissue_match match;
        const double off = error_of(&first, &second, &match, (unsigned)(t % 7));

        worst = fmax(worst, off);
        sum += off * off / (double)trials;
        predicted +=
            (match.covariance[0][0] + match.covariance[1][1] + match.covariance[2][2] * 55 * 55) /
            (double)trials;
        sure += match.evidence > 1.5 * match.rival;
    }
    print_message("  %zu pairs: error %.3f cells root mean square, %.3f at worst; predicted %.3f\n",
                  trials, sqrt(sum), worst, sqrt(predicted));
    print_message("  %zu of them stand out\n", sure);
    CHECK(worst < 0.5);
    CHECK((double)sure >= 0.8 * (double)trials);
    CHECK(sqrt(predicted) > 0.4 * sqrt(sum) && sqrt(predicted) < 4 * sqrt(sum));
}

TEST(a_section_lies_on_itself)
{
    const struct gsn_affine first = drawn_motion(0.3, 0, 2, 1),
                            second = drawn_motion(2.4, 1, -3, 4);
    gsn_auto(gsn_tissue) a = drawn_section(1, 0, &first, 0);
    gsn_auto(gsn_tissue) b = drawn_section(1, 0, &second, 0);
    const struct gsn_affine back = gsn_affine_inverse(&first);
    const struct gsn_affine truth = gsn_affine_compose(&back, &second);
    struct gsn_tissue_match match;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tissue_search(a, b, &match, &err), err);
    CHECK(drawn_apart(&match.a_to_b, &truth) < 0.05);
    CHECK(match.back < 0.02);
}

TEST(the_stain_of_one_section_does_not_matter)
{
    const struct gsn_affine first = drawn_motion(0, 0, 0, 0), second = drawn_motion(1, 0, 2, 2);
    gsn_auto(gsn_plane) pale = drawn_tissue(4, 1, &second, 0);
    gsn_auto(gsn_tissue) a = drawn_section(4, 0, &first, 0);
    gsn_auto(gsn_tissue) b = NULL;
    struct gsn_tissue_match match;
    struct gsn_error err = { 0 };

    for (int i = 0; i < DRAWN_TISSUE_SIDE * DRAWN_TISSUE_SIDE; i++)
        pale->value[i] *= 0.3f;
    CHECK_OK(gsn_tissue_new(pale, 1, &b, &err), err);
    CHECK_OK(gsn_tissue_search(a, b, &match, &err), err);
    CHECK(drawn_apart(&match.a_to_b, &second) < 0.5);
}

TEST(a_picture_becomes_density_in_cells)
{
    gsn_auto(gsn_image) image = NULL;
    gsn_auto(gsn_plane) density = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(100, 80, 3, 8, &image, &err), err);
    memset(image->samples, 200, gsn_image_bytes(image));
    for (size_t y = 20; y < 30; y++)
        for (size_t x = 10 * 3; x < 20 * 3; x++)
            ((uint8_t *)image->samples)[y * 300 + x] = 20;
    CHECK_OK(gsn_tissue_reduce(image, 2.5, &density, &err), err);
    CHECK(density->width == 40 && density->height == 32);
    CHECK_NEAR(density->value[9 * 40 + 5], 3.0, 1e-4); /* a tenth in each of three channels */
    CHECK_NEAR(density->value[0], 0, 1e-6);
}

enum { BLOBS = 160 };

/* Blobs of tissue in a frame 300 wide, drawn into a picture of side x side pixels so that the
 * frame's point p lies at way(p) * side / 300, pixel centres at +0.5. */
static struct gsn_image *draw_blobs(uint32_t side, const struct gsn_affine *way)
{
    const double unit = side / 300.0;
    struct draw_chance chance = { 77 };
    gsn_auto_mem(float) od = gsn_alloc_array((size_t)side * side, sizeof *od);
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK(od);
    for (int k = 0; k < BLOBS; k++) {
        const double turn = draw_uniform(&chance, 0, 2 * M_PI);
        const double away = 95 * sqrt(draw_uniform(&chance, 0, 1));
        const double radius = unit * draw_uniform(&chance, 3, 12);
        const double dark = draw_uniform(&chance, 0.1, 0.5);
        const struct gsn_point p = { 150 + away * cos(turn), 150 + away * sin(turn) };
        const struct gsn_point q = gsn_affine_apply(way, p);
        const double x = q.x * unit, y = q.y * unit, far = 4 * radius;

        for (uint32_t v = (uint32_t)fmax(y - far, 0); v < fmin(y + far, side); v++)
            for (uint32_t u = (uint32_t)fmax(x - far, 0); u < fmin(x + far, side); u++)
                od[(size_t)v * side + u] +=
                    (float)(dark * exp(-(pow(u + 0.5 - x, 2) + pow(v + 0.5 - y, 2)) /
                                       (2 * radius * radius)));
    }
    CHECK_OK(gsn_image_new(side, side, 1, 16, &image, &err), err);
    for (size_t i = 0; i < (size_t)side * side; i++)
        ((uint16_t *)image->samples)[i] = (uint16_t)(60000 * pow(10, -(double)od[i]));
    return image;
}

/* As register/folder does: 250 cells along the side, whatever the side is. */
static struct gsn_tissue *tissue_of(const struct gsn_image *image)
{
    const double cell = fmax(1, image->width / 250.0);
    gsn_auto(gsn_plane) density = NULL;
    struct gsn_tissue *tissue = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tissue_reduce(image, cell, &density, &err), err);
    CHECK_OK(gsn_tissue_new(density, cell, &tissue, &err), err);
    return tissue;
}

/* Cells that were rounded to whole pixels and mapped back unrounded registered every section half a
 * pixel off, unless the side was a multiple of 250. */
TEST(pictures_of_any_side_are_laid_without_an_offset)
{
    static const uint32_t sides[] = { 300, 306, 500, 640, 700, 750, 1500 };
    static const double turns[] = { 0.8, 2.0, M_PI, 4.4 };
    const struct gsn_affine unmoved = { 1, 0, 0, 0, 1, 0 };

    for (size_t i = 0; i < sizeof sides / sizeof *sides; i++) {
        const double unit = sides[i] / 300.0;
        gsn_auto(gsn_image) first = draw_blobs(sides[i], &unmoved);
        gsn_auto(gsn_tissue) a = tissue_of(first);
        struct gsn_point sum = { 0, 0 };

        for (size_t k = 0; k < sizeof turns / sizeof *turns; k++) {
            const double c = cos(turns[k]), s = sin(turns[k]);
            const struct gsn_affine way = { c, -s, 150 - 150 * (c - s) + 3.3,
                                            s, c,  150 - 150 * (c + s) - 2.1 };
            gsn_auto(gsn_image) second = draw_blobs(sides[i], &way);
            gsn_auto(gsn_tissue) b = tissue_of(second);
            const struct gsn_point middle = { 150, 150 }, q = gsn_affine_apply(&way, middle);
            struct gsn_tissue_match match;
            struct gsn_error err = { 0 };
            struct gsn_point found;

            CHECK_OK(gsn_tissue_search(a, b, &match, &err), err);
            found = gsn_affine_apply(&match.a_to_b, (struct gsn_point){ 150 * unit, 150 * unit });
            CHECK(hypot(found.x - q.x * unit, found.y - q.y * unit) < 0.05);
            sum.x += found.x - q.x * unit;
            sum.y += found.y - q.y * unit;
        }
        print_message("  side %u: %.3f %.3f px in the mean of four turns\n", sides[i], sum.x / 4,
                      sum.y / 4);
    }
}

TEST(what_shows_no_tissue_is_refused)
{
    gsn_auto(gsn_plane) glass = NULL;
    gsn_auto(gsn_plane) small = NULL;
    gsn_auto(gsn_image) image = NULL;
    struct gsn_plane *density = NULL;
    struct gsn_tissue *tissue = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_plane_new(60, 60, &glass, &err), err);
    CHECK(gsn_tissue_new(glass, 1, &tissue, &err) == GSN_E_INPUT && tissue == NULL);
    CHECK(strcmp(err.text, "nothing but empty glass: no tissue to lay it by") == 0);
    CHECK_OK(gsn_plane_new(60, 12, &small, &err), err);
    CHECK(gsn_tissue_new(small, 1, &tissue, &err) == GSN_E_INPUT && tissue == NULL);
    CHECK(strcmp(err.text, "a section of 60 x 12 cells is too small to be laid") == 0);
    CHECK_OK(gsn_image_new(60, 30, 1, 8, &image, &err), err);
    CHECK(gsn_tissue_reduce(image, 2, &density, &err) == GSN_E_INPUT && density == NULL);
    CHECK(strcmp(err.text, "a picture of 60 x 30 pixels is too small to be laid") == 0);
}

static int search_once(const struct gsn_plane *plane, struct gsn_error *err)
{
    gsn_auto(gsn_tissue) a = NULL;
    struct gsn_tissue_match match;
    const int r = gsn_tissue_new(plane, 1, &a, err);

    return r < 0 ? r : gsn_tissue_search(a, a, &match, err);
}

static int reduce_once(const struct gsn_image *image, struct gsn_error *err)
{
    gsn_auto(gsn_plane) density = NULL;

    return gsn_tissue_reduce(image, 2, &density, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct gsn_affine unmoved = drawn_motion(0, 0, 0, 0);
    gsn_auto(gsn_plane) plane = drawn_tissue(1, 0, &unmoved, 0);
    gsn_auto(gsn_image) image = NULL;
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(search_once(plane, &err), err);
    CHECK_OK(gsn_image_new(64, 64, 3, 16, &image, &err), err);
    CHECK_EVERY_OOM(reduce_once(image, &err), err);
}
