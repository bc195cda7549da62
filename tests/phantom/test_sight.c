/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "pipeline/phantom/panel.h"
#include "pipeline/phantom/planning.h"
#include "pipeline/phantom/sight.h"

static struct gsn_phantom_plan plan_of(uint64_t seed, double px_um)
{
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make("S02", "L2", seed, px_um, &plan, &err), err);
    return plan;
}

static struct gsn_image *draw(const struct gsn_phantom_plan *plan, int panel)
{
    struct gsn_phantom_extent extent[GSN_PHANTOM_SLOTS];
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_panel_draw(plan, &plan->file[panel - 1], 0, &image, extent, &err), err);
    return image;
}

TEST(the_way_to_the_panel_undoes_the_way_to_the_block)
{
    const struct gsn_phantom_plan plan = plan_of(5, 10.58);

    for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++) {
        struct gsn_phantom_sight sight;

        gsn_phantom_sight_make(&plan, k, &sight);
        for (double y = -2000; y <= 2000; y += 400)
            for (double x = -2400; x <= 2400; x += 400) {
                const struct gsn_point block = { x, y };
                const struct gsn_point back =
                    gsn_phantom_sight_block(&sight, gsn_phantom_sight_panel(&sight, block));

                CHECK_NEAR(back.x, x, 1e-8);
                CHECK_NEAR(back.y, y, 1e-8);
            }
    }
}

/* Centre of darkness around p, as for the other levels: the disc has a red density of 0.57. */
static struct gsn_point dark_centre(const struct gsn_image *image, struct gsn_point p)
{
    const int reach = 8;
    double sum = 0, x_sum = 0, y_sum = 0;

    for (int y = (int)p.y - reach; y <= (int)p.y + reach; y++)
        for (int x = (int)p.x - reach; x <= (int)p.x + reach; x++) {
            const double code = fmax(gsn_image_at(image, (uint32_t)x, (uint32_t)y, 0), 1);
            const double weight = fmax(log10(235 / code) - 0.44, 0);

            sum += weight;
            x_sum += weight * (x + 0.5);
            y_sum += weight * (y + 0.5);
        }
    return (struct gsn_point){ x_sum / fmax(sum, 1e-9), y_sum / fmax(sum, 1e-9) };
}

TEST(marks_that_are_visible_are_in_the_picture)
{
    int checked = 0;

    for (int panel = 1; panel <= 2; panel++) {
        const struct gsn_phantom_plan plan = plan_of(7, 16);
        gsn_auto(gsn_image) image = draw(&plan, panel);

        for (int k = 12 * (panel - 1); k < 12 * panel; k++) {
            struct gsn_phantom_sight sight;

            gsn_phantom_sight_make(&plan, k, &sight);
            for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
                struct gsn_point p, found;

                if (*gsn_phantom_sight_mark(&sight, i, &p))
                    continue;
                found = dark_centre(image, p);
                CHECK_NEAR(found.x, p.x, 0.6);
                CHECK_NEAR(found.y, p.y, 0.6);
                checked++;
            }
        }
    }
    CHECK(checked > 50);
}

TEST(what_hides_a_mark_has_a_name)
{
    struct gsn_phantom_plan plan = plan_of(7, 16);
    struct gsn_phantom_section *s = &plan.section[3];
    struct gsn_phantom_sight sight;
    struct gsn_point p;

    plan.defects = 1;
    s->shows = 3;
    s->mark[0].missing = s->mark[1].missing = 0;
    gsn_phantom_sight_make(&plan, 3, &sight);
    (void)gsn_phantom_sight_mark(&sight, 0, &p);
    plan.defect[0] = (struct gsn_phantom_defect){
        .kind = GSN_PHANTOM_PEN,
        .k = 3,
        .width = 800,
        .count = 2,
        .point = { { p.x * 16 - 500, p.y * 16 }, { p.x * 16 + 500, p.y * 16 } },
    };
    CHECK(strcmp(gsn_phantom_sight_mark(&sight, 0, &p), "pen") == 0);
    CHECK(strcmp(gsn_phantom_sight_mark(&sight, 1, &p), "") == 0);
    s->mark[1].missing = 1;
    CHECK(strcmp(gsn_phantom_sight_mark(&sight, 1, &p), "missing") == 0);
    s->shows = -1;
    CHECK(strcmp(gsn_phantom_sight_mark(&sight, 1, &p), "empty_slot") == 0);

    /* A tear through the mark, and a fold that swallows it. */
    s->shows = 3;
    plan.defect[0] = (struct gsn_phantom_defect){ .kind = GSN_PHANTOM_TEAR, .k = 3, .slope = .1 };
    plan.defect[0].at = (struct gsn_point){ s->mark[0].centre.x + 20, s->mark[0].centre.y - 900 };
    gsn_phantom_sight_make(&plan, 3, &sight);
    CHECK(strcmp(gsn_phantom_sight_mark(&sight, 0, &p), "tear") == 0);
    plan.defect[0] = (struct gsn_phantom_defect){ .kind = GSN_PHANTOM_FOLD, .k = 3, .width = 200 };
    plan.defect[0].at.x = s->mark[1].centre.x - 400;
    s->mark[1].missing = 0;
    CHECK(strcmp(gsn_phantom_sight_mark(&sight, 1, &p), "fold") == 0);
}

/* Whether a pixel is what the batch's glass, the light and three deviations of noise allow. */
static int is_glass(const struct gsn_phantom_plan *plan, const struct gsn_image *image, uint32_t x,
                    uint32_t y)
{
    const double u = (x + 0.5) / plan->width - 0.55, v = (y + 0.5) / plan->height - 0.45;
    int glass = 1;

    for (uint32_t c = 0; c < 3; c++) {
        const double code = plan->batch[1].white[c] * (1 - 2 * .06 * (u * u + v * v));

        glass = glass && fabs(gsn_image_at(image, x, y, c) - code) < 3 * 1.5 + 0.5;
    }
    return glass;
}

/* Section 14 with one defect and with none, the same noise: the share of the region's pixels that
 * look otherwise, or that show glass. */
static double changed(struct gsn_phantom_plan plan, const struct gsn_phantom_defect *d,
                      int count_glass)
{
    struct gsn_phantom_sight sight;
    size_t region = 0, other = 0;
    gsn_auto(gsn_image) plain = NULL;
    gsn_auto(gsn_image) spoilt = NULL;

    plan.defects = 0;
    plain = draw(&plan, 2);
    gsn_phantom_sight_make(&plan, 14, &sight);
    plan.defects = 1;
    plan.defect[0] = *d;
    spoilt = draw(&plan, 2);
    for (uint32_t y = 0; y < plan.height; y++)
        for (uint32_t x = 0; x < plan.width; x++) {
            const struct gsn_point p = { x + 0.5, y + 0.5 };
            const struct gsn_point at = gsn_phantom_sight_block(&sight, p);
            int apart = 0;

            if (!gsn_phantom_in_region(gsn_phantom_geometry(),
                                       gsn_vec3_make(at.x, at.y, sight.section->z_um)))
                continue;
            for (uint32_t c = 0; c < 3; c++)
                apart |= gsn_image_at(plain, x, y, c) != gsn_image_at(spoilt, x, y, c);
            region++;
            other += (size_t)(count_glass ? is_glass(&plan, spoilt, x, y) : apart);
        }
    return (double)other / (double)region;
}

static double hidden(struct gsn_phantom_plan plan, const struct gsn_phantom_defect *d)
{
    struct gsn_phantom_sight sight;

    plan.defects = 1;
    plan.defect[0] = *d;
    gsn_phantom_sight_make(&plan, 14, &sight);
    return gsn_phantom_sight_hidden(&sight, d);
}

TEST(the_recorded_fraction_is_what_the_picture_hides)
{
    struct gsn_phantom_plan plan = plan_of(7, 32);
    const struct gsn_phantom_section *s = &plan.section[14];
    const struct gsn_point lesion = { 411, 646 };
    struct gsn_point p;
    struct gsn_phantom_defect d = { .k = 14 };

    for (int k = 12; k < 24; k++)
        plan.section[k].shows = k == 14 ? 14 : -1;
    p = gsn_affine_apply(&s->to_panel, lesion);

    d.kind = GSN_PHANTOM_PEN;
    d.width = 700;
    d.count = 2;
    d.point[0] = (struct gsn_point){ p.x * 32 - 600, p.y * 32 - 200 };
    d.point[1] = (struct gsn_point){ p.x * 32 + 500, p.y * 32 + 300 };
    CHECK_NEAR(hidden(plan, &d), changed(plan, &d, 0), 0.03); /* the soft border of the stroke */
    CHECK(hidden(plan, &d) > 0.2 && hidden(plan, &d) < 0.9);

    d = (struct gsn_phantom_defect){ .kind = GSN_PHANTOM_LOST_PIECE,
                                     .k = 14,
                                     .at = lesion,
                                     .count = 4,
                                     .point = { { -250, 0 }, { 0, -250 }, { 250, 0 }, { 0, 250 } },
                                     .place = { 3000, -3000 } };
    CHECK_NEAR(hidden(plan, &d), changed(plan, &d, 1), 0.005);
    CHECK(hidden(plan, &d) > 0.05);

    d = (struct gsn_phantom_defect){ .kind = GSN_PHANTOM_BUBBLE, .k = 14, .radius = 400 };
    d.at = (struct gsn_point){ p.x * 32, p.y * 32 };
    CHECK_NEAR(hidden(plan, &d), changed(plan, &d, 0), 0.06); /* the rim fades out */
}

/* A fold of width w across the middle of the region: of what lay from x0 on, w is double and 2 w
 * are swallowed. The region is a ring about the root; by its own mask, on a fine grid. */
TEST(a_fold_hides_three_times_its_width)
{
    const struct gsn_phantom_plan plan = plan_of(7, 16);
    const double z = gsn_phantom_section_z(gsn_phantom_geometry(), 14), x0 = 450, w = 100;
    const struct gsn_phantom_defect fold = {
        .kind = GSN_PHANTOM_FOLD, .k = 14, .at = { x0, 0 }, .width = w
    };
    size_t region = 0, lost = 0;

    for (double y = -600; y < 1700; y += 8)
        for (double x = -600; x < 1500; x += 8)
            if (gsn_phantom_in_region(gsn_phantom_geometry(), gsn_vec3_make(x, y, z))) {
                region++;
                lost += x >= x0 && x < x0 + 3 * w;
            }
    CHECK(lost > region / 10);
    CHECK_NEAR(hidden(plan, &fold), (double)lost / (double)region, 0.01);
}
