/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include "pipeline/phantom/calibration.h"
#include "pipeline/phantom/planning.h"

static struct gsn_phantom_plan plan_of(const char *specimen, const char *level, double px_um)
{
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make(specimen, level, 7, px_um, &plan, &err), err);
    return plan;
}

TEST(five_patches_of_three_millimetres_lie_side_by_side_on_the_glass)
{
    static const double px_um[] = { 8, 10.58, 16, 48 };

    for (size_t n = 0; n < sizeof px_um / sizeof *px_um; n++) {
        const struct gsn_phantom_plan plan = plan_of("S02", "L2", px_um[n]);

        for (int i = 0; i < GSN_PHANTOM_PATCHES; i++) {
            const struct gsn_phantom_patch p = gsn_phantom_patch_of(&plan, i);

            CHECK_NEAR(p.density, .25 * i, 0);
            CHECK_NEAR(p.width * plan.px_um, 3000, plan.px_um / 2);
            CHECK_NEAR(p.height * plan.px_um, 3000, plan.px_um / 2);
            CHECK(p.x * plan.px_um > 4200 && p.x + p.width < plan.width);
            CHECK(p.y + p.height < plan.height);
            if (i > 0)
                CHECK(p.x > gsn_phantom_patch_of(&plan, i - 1).x + p.width);
        }
    }
}

/* Mean code of a patch, and what the specification's formula says for its middle: the light is
 * smooth enough for that. */
static void check_patch(const struct gsn_phantom_plan *plan, const struct gsn_image *image,
                        int batch, int i)
{
    const struct gsn_phantom_patch p = gsn_phantom_patch_of(plan, i);
    const struct gsn_phantom_batch *b = &plan->batch[batch - 1];
    const double u = (p.x + p.width / 2.0) / plan->width - .55;
    const double v = (p.y + p.height / 2.0) / plan->height - .45;
    const double light = 1 - 2 * plan->level.illumination * (u * u + v * v);
    const double red = b->red_gain * .62 * p.density;
    const double yellow = b->yellow_gain * .34 * (1 - .55 * p.density);

    for (uint32_t c = 0; c < 3; c++) {
        const double od = red * b->dye[GSN_PHANTOM_RED][c] + yellow * b->dye[GSN_PHANTOM_YELLOW][c];
        double sum = 0;

        for (uint32_t y = p.y; y < p.y + p.height; y++)
            for (uint32_t x = p.x; x < p.x + p.width; x++)
                sum += gsn_image_at(image, x, y, c);
        CHECK_NEAR(sum / p.width / p.height, b->white[c] * light * pow(10, -od), 0.15);
    }
}

TEST(a_patch_shows_its_density_in_the_stain_of_its_batch)
{
    const struct gsn_phantom_plan plan = plan_of("S02", "L2", 16);

    for (int batch = 1; batch <= GSN_PHANTOM_PANELS; batch += 2) {
        gsn_auto(gsn_image) image = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_phantom_calibration_draw(&plan, batch, 0, &image, &err), err);
        for (int i = 0; i < GSN_PHANTOM_PATCHES; i++)
            check_patch(&plan, image, batch, i);
    }
}

/* S04 is stained .85 and 1.20 times S02 and nothing else, so its red is .85 of it at D = 1, where
 * the yellow that is left is .45 of it. */
TEST(another_stain_shows_on_the_patches)
{
    const struct gsn_phantom_plan plain = plan_of("S02", "L2", 16),
                                  other = plan_of("S04", "L2", 16);

    for (int batch = 1; batch <= GSN_PHANTOM_PANELS; batch++) {
        const struct gsn_phantom_batch *b = &plain.batch[batch - 1];
        double od[3];

        CHECK_NEAR(other.batch[batch - 1].red_gain / b->red_gain, .85, 1e-12);
        CHECK_NEAR(other.batch[batch - 1].yellow_gain / b->yellow_gain, 1.2, 1e-12);
        gsn_phantom_patch_od(&other, batch, 4, od);
        for (int c = 0; c < 3; c++)
            CHECK_NEAR(od[c],
                       .85 * .62 * b->red_gain * b->dye[GSN_PHANTOM_RED][c] +
                           1.2 * .34 * .45 * b->yellow_gain * b->dye[GSN_PHANTOM_YELLOW][c],
                       1e-12);
    }
}

TEST(where_all_batches_are_alike_nothing_is_written)
{
    const struct gsn_phantom_plan plan = plan_of("S02", "L1", 16);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_calibration_write(&plan, 0, "/dev/null/nowhere", &err), err);
}

TEST(a_folder_that_cannot_be_made_is_reported)
{
    const struct gsn_phantom_plan plan = plan_of("S02", "L2", 48);
    struct gsn_error err = { 0 };

    CHECK(gsn_phantom_calibration_write(&plan, 0, "/dev/null/nowhere", &err) == GSN_E_IO);
}

static int draw_once(const struct gsn_phantom_plan *plan, struct gsn_error *err)
{
    gsn_auto(gsn_image) image = NULL;

    return gsn_phantom_calibration_draw(plan, 1, 1, &image, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct gsn_phantom_plan plan = plan_of("S02", "L2", 48);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(draw_once(&plan, &err), err);
}
