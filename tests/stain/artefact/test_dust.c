/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/artefact/dust.h"

#include "pipeline/core/geom.h"
#include "tests/check.h"
#include "tests/stain/paint.h"

enum { WIDTH = 300, HEIGHT = 220 };

static const struct gsn_pixel_box ALL = { 0, 0, WIDTH, HEIGHT };
static const struct gsn_dust_turn UPRIGHT;

struct panel {
    struct gsn_plane *od[3];
};

static void panel_done(struct panel *p)
{
    for (int c = 0; c < 3; c++)
        gsn_plane_free(p->od[c]);
}
#define panel_auto __attribute__((cleanup(panel_done))) struct panel

/* Grainy tissue with an edge, each time another; grains that are dark in a crowd. */
static int draw(uint64_t seed, struct panel *p, struct gsn_error *err)
{
    struct dice dice = { seed };
    const double edge = 60 + 100 * dice_even(&dice);

    for (int c = 0; c < 3; c++) {
        const int r = gsn_plane_new(WIDTH, HEIGHT, &p->od[c], err);

        if (r < 0)
            return r;
    }
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            const double tissue = x > edge ? 0.25 : 0;
            const double grain = tissue > 0 ? 0.04 * dice_normal(&dice) : 0;
            const double dark = tissue > 0 && dice_even(&dice) < 0.01 ? 0.4 : 0;

            for (int c = 0; c < 3; c++)
                p->od[c]->value[y * WIDTH + x] = (float)(tissue * (1 + c) + grain + dark);
        }
    return GSN_OK;
}

static void stain(struct panel *p, double x0, double y0, double radius, double od)
{
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            for (int c = 0; c < 3 && hypot(x + 0.5 - x0, y + 0.5 - y0) <= radius; c++)
                p->od[c]->value[y * WIDTH + x] += (float)od;
}

static void turn_plane(struct gsn_plane **plane, int mirrored)
{
    struct gsn_plane *was = *plane, *now = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_plane_new(mirrored ? was->width : was->height, mirrored ? was->height : was->width,
                           &now, &err),
             err);
    for (uint32_t y = 0; y < was->height; y++)
        for (uint32_t x = 0; x < was->width; x++) {
            const size_t to = mirrored ? (size_t)y * was->width + was->width - 1 - x
                                       : (size_t)x * was->height + was->height - 1 - y;

            now->value[to] = was->value[(size_t)y * was->width + x];
        }
    gsn_plane_free(was);
    *plane = now;
}

/* As the scanner gave it, set upright. */
static void set_upright(struct panel *p, struct gsn_dust_turn way)
{
    for (int c = 0; c < 3; c++) {
        if (way.mirrored)
            turn_plane(&p->od[c], 1);
        for (unsigned i = 0; i < way.quarters; i++)
            turn_plane(&p->od[c], 0);
    }
}

/* Four panels, the last of which was turned by turn; a speck over tissue, one over glass, and one
 * that only dirty panels have. */
static int searched(struct gsn_dust_turn turn, unsigned panels, unsigned dirty,
                    struct gsn_dust **ret_dust, struct gsn_artefact_disc **ret_spot,
                    size_t *ret_count, unsigned *ret_panels, struct gsn_error *err)
{
    gsn_auto(gsn_dust) dust = NULL;
    int r = gsn_dust_new(&dust, err);

    for (unsigned i = 0; r >= 0 && i < panels; i++) {
        const struct gsn_dust_turn way = i + 1 == panels ? turn : UPRIGHT;
        const struct gsn_pixel_box all = { 0, 0, way.quarters % 2 ? HEIGHT : WIDTH,
                                           way.quarters % 2 ? WIDTH : HEIGHT };
        panel_auto p = { { NULL, NULL, NULL } };

        r = draw(i + 1, &p, err);
        if (r < 0)
            return r;
        stain(&p, 220.5, 100.5, 2, 0.4);
        stain(&p, 30, 180, 5, 0.3);
        if (i < dirty)
            stain(&p, 150, 40, 3, 0.5);
        set_upright(&p, way);
        r = gsn_dust_add(dust, p.od, 20, way, &all, NULL, 0, err);
    }
    if (r >= 0)
        r = gsn_dust_find(dust, ret_spot, ret_count, ret_panels, err);
    if (r >= 0 && ret_dust)
        *ret_dust = gsn_steal(&dust);
    return r;
}

/* Case 10. */
TEST(what_is_dark_at_one_place_of_all_panels_is_found_and_nothing_else)
{
    gsn_auto_mem(struct gsn_artefact_disc) spot = NULL;
    struct gsn_error err = { 0 };
    unsigned panels = 0;
    size_t count = 0;

    CHECK_OK(searched(UPRIGHT, 4, 3, NULL, &spot, &count, &panels, &err), err);
    CHECK(panels == 4 && count == 2);
    CHECK_NEAR(spot[0].px.x, 220.5, 1);
    CHECK_NEAR(spot[0].px.y, 100.5, 1);
    CHECK(spot[0].radius_px >= 2 && spot[0].radius_px < 6);
    CHECK_NEAR(spot[1].px.x, 30, 1);
    CHECK_NEAR(spot[1].px.y, 180, 1);
    CHECK(spot[1].radius_px >= 5 && spot[1].radius_px < 9);
}

TEST(a_panel_that_was_turned_upright_is_compared_as_it_was_scanned)
{
    static const struct gsn_point upright[4] = {
        { 30, 180 }, { HEIGHT - 180, 30 }, { WIDTH - 30, HEIGHT - 180 }, { 180, WIDTH - 30 }
    };
    static const struct gsn_point mirrored[4] = {
        { WIDTH - 30, 180 }, { HEIGHT - 180, WIDTH - 30 }, { 30, HEIGHT - 180 }, { 180, 30 }
    };

    for (unsigned way = 1; way < 8; way++) {
        const struct gsn_dust_turn turn = { way & 1, way >> 1 };
        const struct gsn_point truth = (way & 1 ? mirrored : upright)[way >> 1];
        gsn_auto(gsn_dust) dust = NULL;
        gsn_auto_mem(struct gsn_artefact_disc) spot = NULL;
        struct gsn_error err = { 0 };
        struct gsn_artefact_disc there;
        unsigned panels = 0;
        size_t count = 0;

        CHECK_OK(searched(turn, 4, 0, &dust, &spot, &count, &panels, &err), err);
        CHECK(count == 2);
        CHECK_NEAR(spot[1].px.x, 30, 1);
        there = gsn_dust_upright(dust, &spot[1], turn);
        CHECK_NEAR(there.px.x, truth.x, 1);
        CHECK_NEAR(there.px.y, truth.y, 1);
    }
}

TEST(two_panels_may_agree_by_chance_and_marks_are_no_dust)
{
    gsn_auto(gsn_dust) dust = NULL;
    gsn_auto_mem(struct gsn_artefact_disc) none = NULL;
    gsn_auto_mem(struct gsn_artefact_disc) spot = NULL;
    const struct gsn_artefact_disc mark = { { 30, 180 }, 5 };
    struct gsn_error err = { 0 };
    unsigned panels = 0;
    size_t count = 7;

    CHECK_OK(searched(UPRIGHT, 2, 2, NULL, &none, &count, &panels, &err), err);
    CHECK(count == 0 && panels == 2);
    CHECK_OK(gsn_dust_new(&dust, &err), err);
    for (unsigned i = 0; i < 3; i++) {
        panel_auto p = { { NULL, NULL, NULL } };

        CHECK_OK(draw(i + 1, &p, &err), err);
        stain(&p, 30, 180, 5, 0.8);
        CHECK_OK(gsn_dust_add(dust, p.od, 20, UPRIGHT, &ALL, &mark, i == 0, &err), err);
        CHECK_OK(gsn_dust_add(dust, p.od, 21, UPRIGHT, &ALL, NULL, 0, &err), err); /* other scan */
    }
    CHECK_OK(gsn_dust_find(dust, &spot, &count, &panels, &err), err);
    CHECK(count == 0 && panels == 3);
}

static int whole(struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_artefact_disc) spot = NULL;
    unsigned panels;
    size_t count;

    return searched(UPRIGHT, 3, 0, NULL, &spot, &count, &panels, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(whole(&err), err);
}
