/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/fiducial/detect.h"

#include "pipeline/register/fiducial/localise.h"
#include "pipeline/register/panel/slots.h"

#include "tests/check.h"
#include "tests/register/draw.h"

enum { WIDTH = 120, HEIGHT = 90, CELLS = 40 * 40 };

static float value[WIDTH * HEIGHT], cells[CELLS];
static struct gsn_plane plane = { WIDTH, HEIGHT, value };

static struct gsn_slot slot_at(int x, int y, int width, int height)
{
    return (struct gsn_slot){ .found = 1, .x = x, .y = y, .width = width, .height = height };
}

static struct gsn_blob_field reduced(const struct gsn_slot *slot, size_t step)
{
    const struct gsn_density_source density = draw_density(&plane);
    struct gsn_blob_field field = { .width = (size_t)slot->width / step,
                                    .height = (size_t)slot->height / step,
                                    .cell_px = (double)step,
                                    .od = cells };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_density_reduce(&density, slot, step, &field, &err), err);
    return field;
}

/* Of a slope the pixels spread over a cell have the mean that all of it has: that at its middle. */
TEST(a_cell_is_the_density_at_its_middle)
{
    for (size_t i = 0; i < WIDTH * HEIGHT; i++)
        value[i] = 0.01f * (float)(i % WIDTH) + 0.02f * (float)(i / WIDTH);
    for (size_t step = 1; step <= 8; step++) {
        const struct gsn_slot slot = slot_at(7, 5, 40, 33);
        const struct gsn_blob_field field = reduced(&slot, step);
        const double middle = 0.5 * (double)step - 0.5;

        for (size_t i = 0; i < field.width * field.height; i++) {
            const double x = 7 + (double)(i % field.width * step) + middle;
            const double y = 5 + (double)(i / field.width * step) + middle;

            CHECK_NEAR(cells[i], 0.01 * x + 0.02 * y, 1e-5);
        }
    }
}

TEST(masked_cells_take_the_mean_of_the_others)
{
    const struct gsn_slot slot = slot_at(0, 0, 40, 40);

    draw_fill(&plane, 0.3);
    draw_box(&plane, 8, 8, 4, 4, NAN);
    draw_box(&plane, 20, 20, 1, 4, NAN);
    for (size_t i = 0; i < 100; i++)
        CHECK_NEAR((reduced(&slot, 4), cells[i]), 0.3, 1e-6);
    draw_fill(&plane, NAN);
    (void)reduced(&slot, 4);
    CHECK(cells[0] == 0 && cells[99] == 0);
}

/* The window that is read around a spot holds all that the fit looks at. */
TEST(a_mark_is_where_the_whole_plane_shows_it)
{
    const struct gsn_density_source density = draw_density(&plane);
    const struct gsn_slot slot = slot_at(0, 0, WIDTH, HEIGHT);
    struct draw_chance chance = { 4 };
    struct gsn_error err = { 0 };

    for (int n = 0; n < 8; n++) {
        const struct gsn_point at = { draw_uniform(&chance, 30, 90),
                                      draw_uniform(&chance, 30, 60) };
        const double px_um = n % 2 ? 6 : 16, radius = 75 / px_um;
        const struct draw_mark burn = draw_phantom_mark(at, px_um);
        struct gsn_fiducial own, all;

        draw_fill(&plane, 0.1);
        draw_burn(&plane, &burn);
        draw_noise(&plane, &chance, 0.02);
        CHECK_OK(gsn_density_localise(&density, &slot, at, radius, 0, &own, &err), err);
        CHECK_OK(gsn_fiducial_localise(&plane, at, radius, &all, &err), err);
        CHECK(own.found && all.found);
        CHECK_NEAR(own.px.x, all.px.x, 1e-4);
        CHECK_NEAR(own.px.y, all.px.y, 1e-4);
        CHECK_NEAR(own.cov_xx, all.cov_xx, 1e-4 * all.cov_xx);
    }
}

/* Begun at the rim of a blot with half of its radius, a fit may end on all of the blot, of whose
 * surroundings it has seen next to nothing. It is then as good as one that began there. */
TEST(what_a_mark_stands_out_by_is_told_by_the_tissue_around_it)
{
    const struct gsn_density_source density = draw_density(&plane);
    const struct gsn_slot slot = slot_at(0, 0, WIDTH, HEIGHT);
    const double radius = 5.4, begun = 0.5 * radius;
    struct draw_chance chance = { 9 };
    struct gsn_error err = { 0 };
    int wide = 0;

    for (int n = 0; n < 200; n++) {
        const struct gsn_point c = { draw_uniform(&chance, 55, 65), draw_uniform(&chance, 40, 50) };
        const double angle = draw_uniform(&chance, 0, 2 * M_PI);
        const struct gsn_point rim = { c.x + begun * cos(angle), c.y + begun * sin(angle) };
        struct gsn_fiducial mark;

        draw_fill(&plane, 0.1);
        draw_ellipse(&plane, c, radius, radius, 0, 0.15);
        draw_noise(&plane, &chance, 0.05);
        CHECK_OK(gsn_density_localise(&density, &slot, rim, begun, 0, &mark, &err), err);
        if (!mark.found || mark.radius_px < GSN_LOCALISE_FACTOR * begun)
            continue;
        wide++;
        CHECK_NEAR(mark.contrast, 0.15, 0.03);
    }
    CHECK(wide > 50);
}

static int read_once(struct gsn_error *err)
{
    const struct gsn_density_source density = draw_density(&plane);
    const struct gsn_slot slot = slot_at(0, 0, WIDTH, HEIGHT);
    struct gsn_blob_field field = { .width = 20, .height = 20, .cell_px = 4, .od = cells };
    struct gsn_fiducial mark = { .score = 77 };
    int r = gsn_density_reduce(&density, &slot, 4, &field, err);

    if (r >= 0)
        r = gsn_density_reduce_filled(&density, &slot, 4, &field, err);
    if (r >= 0)
        r = gsn_density_localise(&density, &slot, (struct gsn_point){ 60, 45 }, 12, 1, &mark, err);
    CHECK(r >= 0 || mark.score == 77);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    draw_fill(&plane, 0.1);
    CHECK_EVERY_OOM(read_once(&err), err);
}
