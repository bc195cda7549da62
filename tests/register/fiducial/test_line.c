/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/fiducial/line.h"

#include "tests/check.h"
#include "tests/register/draw.h"

#include "pipeline/register/fiducial/detect.h"

#include <math.h>
#include <string.h>

enum { WIDTH = 330, HEIGHT = 260 };
static const double PX = 16;

static float value[WIDTH * HEIGHT], clear[WIDTH * HEIGHT];
static struct gsn_plane panel = { WIDTH, HEIGHT, value };

/* A field of one cell a pixel, as at 16 um. */
static struct gsn_blob_field whole(void)
{
    return (struct gsn_blob_field){
        .width = WIDTH, .height = HEIGHT, .cell_px = 1, .origin_px = { 40, 70 }, .od = value
    };
}

static void draw_tissue(uint64_t seed)
{
    struct draw_chance chance = { seed };
    const struct draw_mark burn = draw_phantom_mark((struct gsn_point){ 90.3, 120.4 }, PX);

    draw_fill(&panel, 0.01);
    draw_ellipse(&panel, (struct gsn_point){ 160, 130 }, 130, 105, 0.2, 0.25);
    draw_noise(&panel, &chance, 0.03);
    draw_burn(&panel, &burn);
    memcpy(clear, value, sizeof value);
}

/* Shadow of half a width, with edges a pixel wide, from share `from` of the way on. */
static void draw_line(int steep, double start, double slope, double half, double from, double bend)
{
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            const double u = (steep ? y : x) + 0.5, v = (steep ? x : y) + 0.5;
            const double share = u / (steep ? HEIGHT : WIDTH);
            const double off = fabs(v - start - slope * u - bend * share * (1 - share));
            const double cover = fmin(fmax(half + 0.5 - off, 0), 1);

            if (share >= from)
                value[y * WIDTH + x] += (float)(0.7 * cover);
        }
}

static double worst_change(void)
{
    double worst = 0;

    for (size_t i = 0; i < sizeof value / sizeof *value; i++)
        worst = fmax(worst, fabs((double)value[i] - (double)clear[i]));
    return worst;
}

/* Where the line is in the panel: the field begins at (40, 70). */
static void check_line(const struct gsn_coverslip_line *line, int steep, double start, double slope,
                       double half)
{
    const double along = steep ? 70 : 40, other = steep ? 40 : 70;
    const double middle = along + (steep ? HEIGHT : WIDTH) / 2.0;

    CHECK(line->steep == steep);
    CHECK_NEAR(line->slope, slope, 0.003);
    CHECK_NEAR(line->start + line->slope * middle, other + start + slope * (middle - along), 0.3);
    CHECK(line->half_px >= half && line->half_px <= half + 1.5);
}

TEST(an_edge_of_glass_is_found_and_bridged)
{
    static const double slopes[] = { 0, -0.013, 0.11, 0.4 };

    for (size_t i = 0; i < sizeof slopes / sizeof *slopes; i++)
        for (int steep = 0; steep < 2; steep++) {
            const double start = 125 - 150 * slopes[i];
            struct gsn_blob_field field = whole();
            struct gsn_coverslip_line line[GSN_COVERSLIP_LINES];

            draw_tissue(i);
            draw_line(steep, start, slopes[i], 1.25, 0, 0);
            CHECK(worst_change() > 0.6);
            CHECK(gsn_coverslip_lines_bridge(&field, PX, line) == 1);
            check_line(&line[0], steep, start, slopes[i], 1.25);
            /* What noise, and the rim of a burn and of the tissue, leave. */
            CHECK(worst_change() < 0.45);
        }
}

TEST(two_edges_that_cross_are_both_found)
{
    struct gsn_blob_field field = whole();
    struct gsn_coverslip_line line[GSN_COVERSLIP_LINES];

    draw_tissue(5);
    draw_line(0, 60, 0.02, 1.25, 0, 0);
    draw_line(1, 250, -0.02, 1.25, 0, 0);
    CHECK(gsn_coverslip_lines_bridge(&field, PX, line) == 2);
    check_line(&line[0], 0, 60, 0.02, 1.25);
    check_line(&line[1], 1, 250, -0.02, 1.25);
}

/* Burns, tissue, a hair that bends, a scratch over half of the section, a band of ink. */
TEST(what_is_no_edge_of_glass_stays_as_it_is)
{
    for (int what = 0; what < 4; what++) {
        struct gsn_blob_field field = whole();
        struct gsn_coverslip_line line[GSN_COVERSLIP_LINES];

        draw_tissue((uint64_t)what);
        if (what == 1)
            draw_line(0, 120, 0, 1.25, 0, 60);
        if (what == 2)
            draw_line(0, 120, 0.1, 1.25, 0.5, 0);
        if (what == 3)
            draw_line(0, 120, 0.1, 25, 0, 0);
        memcpy(clear, value, sizeof value);
        CHECK(gsn_coverslip_lines_bridge(&field, PX, line) == 0);
        CHECK(worst_change() == 0);
    }
}

TEST(a_field_too_small_for_a_line_has_none)
{
    struct gsn_coverslip_line line[GSN_COVERSLIP_LINES];
    struct gsn_blob_field field = whole();

    draw_tissue(1);
    for (field.width = 0; field.width < 8; field.width++)
        for (field.height = 0; field.height < 8; field.height++)
            CHECK(gsn_coverslip_lines_bridge(&field, PX, line) == 0);
    CHECK(worst_change() == 0);
}

TEST(what_a_line_covers_is_masked_and_nothing_else)
{
    const struct gsn_density_source density = draw_density(&panel);
    const struct gsn_lined_density lined = { &density, 1, { { 1, 100, 0.1, 2 } } };
    const struct gsn_density_source open = gsn_density_without_lines(&lined);
    float row[100];

    draw_tissue(2);
    CHECK(open.width == WIDTH && open.height == HEIGHT);
    for (uint32_t y = 0; y < HEIGHT; y++) {
        open.row(open.context, 7, y, 3, 100, row);
        for (uint32_t i = 0; i < 100; i++) {
            const double off = fabs(7.5 + 3 * i - 100 - 0.1 * (y + 0.5));
            const float whole = value[y * (uint32_t)WIDTH + 7 + 3 * i];
            const int masked = isnan(row[i]),
                      right = masked ? off <= 2 : row[i] == whole && off > 2;

            CHECK(right);
        }
    }
}
