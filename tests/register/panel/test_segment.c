/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel/segment.h"

#include "tests/check.h"
#include "tests/register/draw.h"

#include <string.h>

enum { WIDTH = 41, HEIGHT = 29, CELLS = WIDTH * HEIGHT };

static int at(const uint8_t *mask, int x, int y)
{
    return x >= 0 && y >= 0 && x < WIDTH && y < HEIGHT && mask[y * WIDTH + x];
}

/* Closing by its definition: a cell belongs to it when every cross that covers the cell meets the
 * mask. */
static int closed(const uint8_t *mask, int x, int y)
{
    static const int step[5][2] = { { 0, 0 }, { 1, 0 }, { -1, 0 }, { 0, 1 }, { 0, -1 } };

    for (int i = 0; i < 5; i++) {
        int meets = 0;

        for (int k = 0; k < 5; k++)
            meets |= at(mask, x + step[i][0] + step[k][0], y + step[i][1] + step[k][1]);
        if (!meets)
            return 0;
    }
    return 1;
}

static void flood(const uint8_t *mask, int x, int y, int number, int *label)
{
    if (!at(mask, x, y) || label[y * WIDTH + x])
        return;
    label[y * WIDTH + x] = number;
    for (int k = 0; k < 9; k++)
        flood(mask, x + k % 3 - 1, y + k / 3 - 1, number, label);
}

/* Against a flood fill of the closing, over masks from sparse to full. */
TEST(pieces_are_those_of_a_flood_fill)
{
    struct draw_chance chance = { 7 };

    for (int density = 1; density < 40; density++) {
        uint8_t mask[CELLS], shut[CELLS];
        int label[CELLS] = { 0 }, seen[CELLS] = { 0 }, count = 0;
        gsn_auto(gsn_components) pieces = NULL;
        struct gsn_error err = { 0 };
        size_t cells = 0;

        for (int i = 0; i < CELLS; i++)
            mask[i] = draw_uniform(&chance, 0, 1) < density / 40.0;
        for (int i = 0; i < CELLS; i++)
            shut[i] = (uint8_t)closed(mask, i % WIDTH, i / WIDTH);
        for (int i = 0; i < CELLS; i++)
            if (shut[i] && !label[i])
                flood(shut, i % WIDTH, i / WIDTH, ++count, label);
        CHECK_OK(gsn_segment_mask(mask, WIDTH, HEIGHT, 0, &pieces, NULL, &err), err);
        CHECK(pieces->count == (size_t)count);
        for (size_t i = 0; i < pieces->count; i++)
            for (size_t k = 0; k < pieces->component[i].area; k++)
                seen[pieces->pixel[pieces->component[i].first + k]] = (int)i + 1;
        assert_memory_equal(seen, label, sizeof label);
        for (size_t i = 0; i < pieces->count; i++)
            cells += pieces->component[i].area;
        for (int i = 0; i < CELLS; i++)
            cells -= (size_t)shut[i];
        CHECK(cells == 0);
    }
}

TEST(box_and_centre_are_those_of_the_piece)
{
    uint8_t mask[CELLS] = { 0 };
    gsn_auto(gsn_components) pieces = NULL;
    struct gsn_error err = { 0 };

    /* 6 by 4 cells, and one cell in the last corner. */
    for (int i = 0; i < 24; i++)
        mask[(10 + i / 6) * WIDTH + 20 + i % 6] = 1;
    mask[CELLS - 1] = 1;
    CHECK_OK(gsn_segment_mask(mask, WIDTH, HEIGHT, 0, &pieces, NULL, &err), err);
    CHECK(pieces->count == 2 && pieces->component[0].area == 24 && pieces->component[1].area == 1);
    CHECK(pieces->component[0].x == 20 && pieces->component[0].y == 10);
    CHECK(pieces->component[0].width == 6 && pieces->component[0].height == 4);
    CHECK_NEAR(pieces->component[0].cx, 23, 1e-12);
    CHECK_NEAR(pieces->component[0].cy, 12, 1e-12);
    CHECK_NEAR(pieces->component[1].cx, WIDTH - 0.5, 1e-12);
}

TEST(nothing_and_everything_are_no_and_one_piece)
{
    uint8_t mask[CELLS] = { 0 };
    gsn_auto(gsn_components) none = NULL;
    gsn_auto(gsn_components) all = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_segment_mask(mask, WIDTH, HEIGHT, 0, &none, NULL, &err), err);
    CHECK(none->count == 0);
    memset(mask, 1, sizeof mask);
    CHECK_OK(gsn_segment_mask(mask, WIDTH, HEIGHT, 0, &all, NULL, &err), err);
    CHECK(all->count == 1 && all->component[0].area == CELLS);
}

/* Two squares of 8 cells, a line of two between them, and a line by itself. */
TEST(a_thread_joins_nothing_and_a_thing_that_thin_is_marked)
{
    uint8_t mask[CELLS] = { 0 };
    gsn_auto(gsn_components) pieces = NULL;
    gsn_auto(gsn_components) whole = NULL;
    gsn_auto_mem(uint8_t) thin = NULL;
    struct gsn_error err = { 0 };

    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            mask[y * WIDTH + x] = (y >= 4 && y < 12 && (x / 8 == 1 || x / 8 == 3)) ||
                                  (y >= 7 && y < 9 && x >= 8 && x < 40) || y == 20;
    CHECK_OK(gsn_segment_mask(mask, WIDTH, HEIGHT, 0, &whole, NULL, &err), err);
    CHECK(whole->count == 2);
    CHECK_OK(gsn_segment_mask(mask, WIDTH, HEIGHT, 4, &pieces, &thin, &err), err);
    CHECK(pieces->count == 3);
    /* An end of the thread stays where it meets a square. */
    CHECK(!thin[0] && pieces->component[0].x == 8 && pieces->component[0].width <= 11);
    CHECK(!thin[1] && pieces->component[1].x >= 21 && pieces->component[1].width <= 14);
    CHECK(pieces->component[0].area >= 60 && pieces->component[1].area >= 60);
    CHECK(thin[2] && pieces->component[2].width == WIDTH && pieces->component[2].height == 1);
}

static int split_once(const uint8_t *mask, struct gsn_error *err)
{
    gsn_auto(gsn_components) pieces = NULL;

    return gsn_segment_mask(mask, WIDTH, HEIGHT, 0, &pieces, NULL, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    uint8_t mask[CELLS] = { [3] = 1, [200] = 1 };
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(split_once(mask, &err), err);
}
