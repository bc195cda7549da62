/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/quality_control.h"

#include "tests/check.h"

/* Of a panel of 90 x 60 pixels, every third in both directions. */
enum { APART = 3, WIDTH = 30, HEIGHT = 20 };

static struct gsn_plane od = { WIDTH, HEIGHT, NULL };
static const struct gsn_scan scan = { .od = { &od }, .apart = APART };

/* Two on this panel, one with a mark and a place where none was found; one on the next panel, and a
 * slot where nothing is. */
static struct gsn_section section[] = {
    { .panel = 2,
      .seen = { .x = 6,
                .y = 9,
                .width = 42,
                .height = 36,
                .mark = { { .found = 1, .px = { 25.5, 24.5 }, .radius_px = 3 },
                          { .px = { 12, 12 }, .radius_px = 3 } } } },
    { .panel = 2, .seen = { .x = 60, .y = 0, .width = 30, .height = 60 } },
    { .panel = 1, .seen = { .width = 90, .height = 6 } },
    { .panel = 2 },
};
static const struct gsn_poses poses = { .section_count = 4, .section = section };

static int find_tissue_of(unsigned panel, struct gsn_image **ret_tissue, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_section_marks) marks = NULL;
    const int r = gsn_poses_marks(&poses, &marks, err);

    return r < 0 ? r : gsn_masking_tissue(&scan, panel, &poses, marks, ret_tissue, err);
}

static int in_box(const struct gsn_panel_section *s, double x, double y)
{
    return x >= s->x && x < s->x + s->width && y >= s->y && y < s->y + s->height;
}

TEST(tissue_is_what_the_panels_sections_show_beyond_three_radii_of_their_marks)
{
    gsn_auto(gsn_image) tissue = NULL;
    struct gsn_error err = { 0 };
    size_t wrong = 0, inside = 0, burnt = 0;

    CHECK_OK(find_tissue_of(2, &tissue, &err), err);
    CHECK(tissue->width == WIDTH && tissue->height == HEIGHT && tissue->channels == 1 &&
          tissue->bits == 8);
    for (int i = 0; i < WIDTH * HEIGHT; i++) {
        const double x = i % WIDTH * APART + 0.5, y = i / WIDTH * APART + 0.5;
        const int boxed = in_box(&section[0].seen, x, y) || in_box(&section[1].seen, x, y);
        const int near = (x - 25.5) * (x - 25.5) + (y - 24.5) * (y - 24.5) <= 81;

        inside += (size_t)boxed;
        burnt += boxed && near;
        wrong += (((const uint8_t *)tissue->samples)[i] != 0) != (boxed && !near);
    }
    CHECK(wrong == 0);
    CHECK(inside == (42 * 36 + 30 * 60) / (APART * APART));
    CHECK_NEAR((double)burnt, M_PI * 81 / (APART * APART), 6);
}

TEST(a_panel_without_sections_shows_none)
{
    gsn_auto(gsn_image) tissue = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(find_tissue_of(3, &tissue, &err), err);
    for (int i = 0; i < WIDTH * HEIGHT; i++)
        CHECK(((const uint8_t *)tissue->samples)[i] == 0);
}

static int find_tissue(struct gsn_error *err)
{
    gsn_auto(gsn_image) tissue = NULL;

    return find_tissue_of(2, &tissue, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(find_tissue(&err), err);
}
