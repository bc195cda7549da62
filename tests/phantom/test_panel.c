/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "pipeline/phantom/panel.h"
#include "pipeline/phantom/planning.h"

/* One panel and the plan it was drawn from. */
struct drawn {
    struct gsn_phantom_plan plan;
    int panel;
    struct gsn_image *image;
    struct gsn_phantom_extent extent[GSN_PHANTOM_SLOTS];
};

static void drawn_done(struct drawn *drawn)
{
    gsn_image_free(drawn->image);
}

#define auto_drawn __attribute__((cleanup(drawn_done))) struct drawn

static struct drawn draw(const char *specimen, const char *level, uint64_t seed, double px_um,
                         int panel, unsigned threads)
{
    struct drawn drawn = { .panel = panel };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make(specimen, level, seed, px_um, &drawn.plan, &err), err);
    CHECK_OK(gsn_phantom_panel_draw(&drawn.plan, &drawn.plan.file[panel - 1], threads, &drawn.image,
                                    drawn.extent, &err),
             err);
    return drawn;
}

static const struct gsn_phantom_section *section_of(const struct drawn *drawn, int slot)
{
    return &drawn->plan.section[(drawn->panel - 1) * GSN_PHANTOM_SLOTS + slot];
}

/* Centre of the dark disc near p, weighted by how far red light is below what stain can do: the
 * disc has a red density of 0.57, stain and nuclei together stay below 0.45. */
static struct gsn_point dark_centre(const struct gsn_image *image, struct gsn_point p)
{
    const int reach = 9;
    double sum = 0, x_sum = 0, y_sum = 0;

    for (int y = (int)p.y - reach; y <= (int)p.y + reach; y++)
        for (int x = (int)p.x - reach; x <= (int)p.x + reach; x++) {
            const double code = fmax(gsn_image_at(image, (uint32_t)x, (uint32_t)y, 0), 1);
            const double weight = fmax(log10(248 / code) - 0.47, 0);

            sum += weight;
            x_sum += weight * (x + 0.5);
            y_sum += weight * (y + 0.5);
        }
    return (struct gsn_point){ x_sum / sum, y_sum / sum };
}

static void check_marks(const struct drawn *drawn)
{
    for (int slot = 0; slot < GSN_PHANTOM_SLOTS; slot++)
        for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
            const struct gsn_point truth = gsn_affine_apply(&section_of(drawn, slot)->to_panel,
                                                            gsn_phantom_geometry()->mark[i]);
            const struct gsn_point found = dark_centre(drawn->image, truth);

            CHECK_NEAR(found.x, truth.x, 0.3);
            CHECK_NEAR(found.y, truth.y, 0.3);
        }
}

TEST(dark_discs_lie_where_the_truth_says)
{
    auto_drawn ideal = draw("S02", "L0", 1, 16, 2, 0);
    auto_drawn bench = draw("S02", "L1", 1, 16, 2, 0);

    check_marks(&ideal);
    check_marks(&bench);
}

/* Optical density of red c_red and yellow c_yel, by the specification's own numbers. */
static double plain_density(double c_red, double c_yel, int channel)
{
    static const double red[3] = { .239, .716, .655 }, yellow[3] = { .357, .326, .875 };

    return c_red * red[channel] / sqrt(.239 * .239 + .716 * .716 + .655 * .655) +
           c_yel * yellow[channel] / sqrt(.357 * .357 + .326 * .326 + .875 * .875);
}

static const double GLASS[3] = { 248, 244, 238 };

/* Dentine has no nuclei: D = .55, F = 1. Checks every pixel that is nothing else. */
TEST(dentine_is_the_closed_form_at_level_0)
{
    auto_drawn drawn = draw("S02", "L0", 1, 16, 5, 0);
    double code[3];
    size_t checked = 0;

    for (int c = 0; c < 3; c++)
        code[c] = GLASS[c] * pow(10, -plain_density(.62 * .55, .34 * (1 - .55 * .55), c));
    for (uint32_t y = 0; y < drawn.plan.height; y++)
        for (uint32_t x = 0; x < drawn.plan.width; x++) {
            const int column = (int)((x * 16.0 - 4200) / 8000), row = (int)(y * 16.0 / 8000);
            const int slot = 4 * (row > 2 ? 2 : row) + (column > 3 ? 3 : column);
            const struct gsn_point at = gsn_phantom_material(
                section_of(&drawn, slot), 16, (struct gsn_point){ x + 0.5, y + 0.5 });
            struct gsn_phantom_field field;

            if (hypot(at.x, at.y) > 800)
                continue;
            gsn_phantom_field_at(gsn_phantom_geometry(),
                                 gsn_vec3_make(at.x, at.y, section_of(&drawn, slot)->z_um), &field);
            if (field.layer[GSN_PHANTOM_DENT] < 1)
                continue;
            for (uint32_t c = 0; c < 3; c++)
                CHECK_NEAR(gsn_image_at(drawn.image, x, y, c), code[c], 0.501);
            checked++;
        }
    CHECK(checked > 10000);
}

/* Connective tissue: D = .2 and Poisson(.6) sixths of a nucleus. The mean over 12 x 400 pixels is
 * the expectation within 1 code (its standard error is about 0.2). */
TEST(connective_tissue_is_the_closed_form_on_average_at_level_0)
{
    static const double nucleus[3] = { .52, .60, .61 };
    const double length = sqrt(.52 * .52 + .60 * .60 + .61 * .61);
    auto_drawn drawn = draw("S00", "L0", 4, 16, 1, 0);

    for (uint32_t c = 0; c < 3; c++) {
        double expected = 0, share = exp(-.6), mean = 0;

        for (int n = 0; n < 30; n++, share *= .6 / n)
            expected += share * pow(10, -.45 * fmin(1, n / 6.0) * nucleus[c] / length);
        expected *= GLASS[c] * pow(10, -plain_density(.62 * .20, .34 * (1 - .55 * .20), (int)c));
        for (int slot = 0; slot < GSN_PHANTOM_SLOTS; slot++) {
            const struct gsn_point p = gsn_affine_apply(&section_of(&drawn, slot)->to_panel,
                                                        (struct gsn_point){ -1900, 0 });

            for (int i = 0; i < 400; i++)
                mean += gsn_image_at(drawn.image, (uint32_t)p.x + (uint32_t)(i % 20),
                                     (uint32_t)p.y + (uint32_t)(i / 20), c) /
                        4800.0;
        }
        CHECK_NEAR(mean, expected, 1);
    }
}

TEST(glass_is_white_at_level_0_and_noisy_at_level_1)
{
    auto_drawn ideal = draw("S00", "L0", 1, 16, 1, 0);
    auto_drawn bench = draw("S00", "L1", 1, 16, 1, 0);

    for (uint32_t c = 0; c < 3; c++) {
        double sum = 0, square = 0;

        /* Between the first two columns of sections, in the middle row of the panel. */
        for (uint32_t i = 0; i < 10000; i++) {
            const uint32_t x = 715 + i % 100, y = 730 + i / 100;
            const double code = gsn_image_at(bench.image, x, y, c);

            CHECK(gsn_image_at(ideal.image, x, y, c) == (unsigned)GLASS[c]);
            sum += code;
            square += code * code;
        }
        /* f = .02: 1 - .04 ((.333 - .55)^2 + (.5 - .45)^2) at that place. */
        CHECK_NEAR(sum / 10000, GLASS[c] * (1 - .04 * (.217 * .217 + .05 * .05)), 0.1);
        CHECK_NEAR(sqrt(square / 10000 - sum * sum / 1e8), sqrt(1.2 * 1.2 + 1 / 12.0), 0.05);
    }
}

/* Area of |x/a|^3 + |y/b|^3 <= 1: 4 a b gamma(4/3)^2 / gamma(5/3); the outline's waves add less
 * than a hundredth. */
TEST(the_extent_holds_the_whole_section)
{
    auto_drawn drawn = draw("S00", "L1", 1, 16, 3, 0);
    const double mm2 = 4 * 2.6 * 2.05 * pow(tgamma(4 / 3.0), 2) / tgamma(5 / 3.0);

    for (int slot = 0; slot < GSN_PHANTOM_SLOTS; slot++) {
        const struct gsn_phantom_extent *e = &drawn.extent[slot];
        const struct gsn_point c = section_of(&drawn, slot)->centre_px;

        CHECK_NEAR((double)e->area_px * 256e-6, mm2, 0.01 * mm2);
        CHECK_NEAR(e->x + e->width / 2.0, c.x, 3);
        CHECK_NEAR(e->y + e->height / 2.0, c.y, 3);
        CHECK_NEAR(e->width, 2 * 2650 / 16.0, 12);
    }
}

TEST(a_panel_is_the_same_with_any_number_of_threads_and_another_with_another_seed)
{
    auto_drawn one = draw("S02", "L1", 7, 24, 3, 1);
    auto_drawn two = draw("S02", "L1", 7, 24, 3, 2);
    auto_drawn other = draw("S02", "L1", 8, 24, 3, 2);
    const size_t size = gsn_image_bytes(one.image);

    CHECK(memcmp(one.image->samples, two.image->samples, size) == 0);
    CHECK(memcmp(one.extent, two.extent, sizeof one.extent) == 0);
    CHECK(memcmp(one.image->samples, other.image->samples, size) != 0);
}

TEST(a_stronger_stain_darkens_tissue_and_leaves_glass_alone)
{
    auto_drawn plain = draw("S02", "L1", 7, 32, 3, 0);
    auto_drawn strong = draw("S03", "L1", 7, 32, 3, 0);
    const struct gsn_phantom_extent *e = &plain.extent[5];
    const size_t row = 3 * (size_t)plain.plan.width;
    size_t darker = 0;

    /* The lowest rows hold no section: the same glass, the same noise. */
    CHECK(memcmp((uint8_t *)plain.image->samples + row * 760,
                 (uint8_t *)strong.image->samples + row * 760, row * 15) == 0);
    for (uint32_t i = 0; i < e->width; i++) {
        const uint32_t x = e->x + i, y = e->y + e->height / 2;

        CHECK(gsn_image_at(strong.image, x, y, 2) <= gsn_image_at(plain.image, x, y, 2) + 1);
        darker += gsn_image_at(strong.image, x, y, 2) < gsn_image_at(plain.image, x, y, 2);
    }
    CHECK(darker > e->width * 9 / 10);
}

static int draw_once(const struct gsn_phantom_plan *plan, struct gsn_error *err)
{
    struct gsn_phantom_extent extent[GSN_PHANTOM_SLOTS];
    gsn_auto(gsn_image) image = NULL;

    return gsn_phantom_panel_draw(plan, &plan->file[0], 1, &image, extent, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    /* The panel's two, and the nine of the first section with texture; the others are alike. */
    enum { DIFFERENT = 2 + 9 };
    struct gsn_phantom_plan ideal, bench;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make("S02", "L0", 1, 48, &ideal, &err), err);
    CHECK_OK(gsn_phantom_plan_make("S02", "L1", 1, 48, &bench, &err), err);
    CHECK_EVERY_OOM(draw_once(&ideal, &err), err);
    for (size_t n = 1; n <= DIFFERENT; n++) {
        int r;

        gsn_check_fail_allocation(n);
        r = draw_once(&bench, &err);
        CHECK(gsn_check_allocations() >= n);
        gsn_check_fail_allocation(0);
        CHECK(r == GSN_E_NOMEM);
    }
}
