/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "pipeline/core/mem.h"
#include "pipeline/phantom/overlay.h"
#include "pipeline/phantom/planning.h"

enum { WIDE = 2300, HIGH = 1560 };

/* An empty glass of the full size at 16 um and the plan of one defect on it. */
struct scene {
    struct gsn_phantom_plan plan;
    struct gsn_phantom_glass glass;
};

static void scene_done(struct scene *scene)
{
    gsn_free(scene->glass.od);
}

#define auto_scene __attribute__((cleanup(scene_done))) struct scene

static struct scene scene_of(const struct gsn_phantom_defect *defect, float od)
{
    struct scene scene = { .glass = { WIDE, HIGH, 16, NULL } };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make("S02", "L2", 1, 16, &scene.plan, &err), err);
    for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++)
        scene.plan.section[k].decoys = 0;
    scene.plan.defects = defect ? 1 : 0;
    if (defect)
        scene.plan.defect[0] = *defect;
    scene.glass.od = gsn_alloc_array((size_t)WIDE * HIGH, 3 * sizeof(float));
    CHECK(scene.glass.od);
    for (size_t i = 0; i < 3 * (size_t)WIDE * HIGH; i++)
        scene.glass.od[i] = od;
    CHECK_OK(gsn_phantom_overlay_draw(&scene.plan, 1, &scene.glass, &err), err);
    return scene;
}

static double od_at(const struct scene *scene, double x_um, double y_um, int c)
{
    return (double)
        scene->glass.od[3 * ((size_t)(y_um / 16) * WIDE + (size_t)(x_um / 16)) + (size_t)c];
}

TEST(a_red_pen_is_200_20_40_on_blank_glass)
{
    const struct gsn_phantom_defect pen = {
        .kind = GSN_PHANTOM_PEN,
        .width = 800,
        .count = 2,
        .point = { { 8000, 4000 }, { 10000, 4000 } },
    };
    auto_scene scene = scene_of(&pen, 0);
    const double white[3] = { 248, 244, 238 }, ink[3] = { 200, 20, 40 };

    for (int c = 0; c < 3; c++) {
        CHECK_NEAR(white[c] * pow(10, -od_at(&scene, 9000, 4300, c)), ink[c], 1e-3);
        CHECK_NEAR(od_at(&scene, 9000, 4460, c), 0, 0);
    }
}

/* Far from its rim, where the blur finds the same density on all sides, a bubble takes a quarter of
 * it away; on the rim the grey is .35, and it falls off by three pixels. */
TEST(a_bubble_is_pale_within_a_grey_rim)
{
    const struct gsn_phantom_defect bubble = { .kind = GSN_PHANTOM_BUBBLE,
                                               .at = { 9016, 4008 },
                                               .radius = 800 };
    auto_scene scene = scene_of(&bubble, .4f);

    CHECK_NEAR(od_at(&scene, 9016, 4008, 1), .3, 1e-5);
    CHECK_NEAR(od_at(&scene, 9816 + 48, 4008, 1), .4 + .35 * exp(-.5), 1e-5);
    CHECK_NEAR(od_at(&scene, 9816 + 160, 4008, 1), .4 + .35 * exp(-100 / 18.), 1e-5);
}

/* Defocus spreads light and loses none: a step between two densities keeps its sum along a line
 * across it, and at the step itself lies their mean (of the light). */
TEST(defocus_keeps_the_light)
{
    const struct gsn_phantom_defect defocus = {
        .kind = GSN_PHANTOM_DEFOCUS, .at = { 9600, 4008 }, .radius = 1200, .sigma_px = 2
    };
    auto_scene scene = scene_of(NULL, 0);
    struct gsn_error err = { 0 };
    double before = 0, after = 0;

    for (uint32_t y = 0; y < HIGH; y++)
        for (uint32_t x = 600; x < WIDE; x++)
            scene.glass.od[3 * ((size_t)y * WIDE + x)] = 1;
    for (double x = 9000; x < 10200; x += 16)
        before += pow(10, -od_at(&scene, x, 4008, 0));
    scene.plan.defects = 1;
    scene.plan.defect[0] = defocus;
    CHECK_OK(gsn_phantom_overlay_draw(&scene.plan, 1, &scene.glass, &err), err);
    for (double x = 9000; x < 10200; x += 16)
        after += pow(10, -od_at(&scene, x, 4008, 0));
    CHECK_NEAR(after, before, 1e-4);
    CHECK_NEAR(pow(10, -od_at(&scene, 9599, 4008, 0)) + pow(10, -od_at(&scene, 9601, 4008, 0)), 1.1,
               1e-5);
    CHECK_NEAR(od_at(&scene, 9000, 4008, 0), 0, 1e-6);
}

/* An edge is a dark line over all four slots of a row, recorded for each and drawn once. */
TEST(the_edge_of_a_coverslip_is_drawn_once)
{
    const struct gsn_phantom_defect edge = { .kind = GSN_PHANTOM_COVERSLIP_EDGE,
                                             .at = { 8200, 3000 },
                                             .width = 40 };
    auto_scene scene = scene_of(&edge, 0);
    auto_scene twice = scene_of(NULL, 0);
    struct gsn_error err = { 0 };
    double across = 0;

    for (double y = 2900; y < 3100; y += 16)
        across += od_at(&scene, 20000, y, 0) * 16;
    CHECK_NEAR(across, .6 * 40, 1e-3);
    CHECK_NEAR(od_at(&scene, 36000, 3000, 0), .6, 1e-6);
    CHECK_NEAR(od_at(&scene, 4100, 3000, 0), 0, 0);
    twice.plan.defects = 4;
    for (int k = 0; k < 4; k++) {
        twice.plan.defect[k] = edge;
        twice.plan.defect[k].k = k;
    }
    CHECK_OK(gsn_phantom_overlay_draw(&twice.plan, 1, &twice.glass, &err), err);
    CHECK(memcmp(twice.glass.od, scene.glass.od, 3 * sizeof(float) * WIDE * HIGH) == 0);
}

TEST(decoys_are_dark_and_have_no_pale_ring)
{
    for (int kind = 0; kind < GSN_PHANTOM_DECOY_KINDS; kind++) {
        auto_scene scene = scene_of(NULL, .3f);
        struct gsn_error err = { 0 };
        double most = 0, least = 9;

        scene.plan.section[2].decoys = 1;
        scene.plan.section[2].decoy[0] = (struct gsn_phantom_decoy){
            .kind = (enum gsn_phantom_decoy_kind)kind, .at_um = { 9008, 4008 }, .radius_um = 80
        };
        CHECK_OK(gsn_phantom_overlay_draw(&scene.plan, 1, &scene.glass, &err), err);
        for (double y = 3600; y < 4400; y += 16)
            for (double x = 8600; x < 9400; x += 16) {
                most = fmax(most, od_at(&scene, x, y, 1));
                if (hypot(x - 9008, y - 4008) > 90)
                    least = fmin(least, od_at(&scene, x, y, 1));
            }
        CHECK(most > .45);
        CHECK_NEAR(least, .3, 1e-6);
    }
}

static int spoil_once(const struct scene *scene, struct gsn_error *err)
{
    return gsn_phantom_overlay_draw(&scene->plan, 1, &scene->glass, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct gsn_phantom_defect bubble = { .kind = GSN_PHANTOM_BUBBLE,
                                               .at = { 9008, 4008 },
                                               .radius = 200 };
    auto_scene scene = scene_of(&bubble, .1f);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(spoil_once(&scene, &err), err);
}
