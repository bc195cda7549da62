/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/bins.h"

#include "tests/check.h"
#include "tests/model/kuhn.h"

#include <string.h>

enum { BOXES = 300 };

static void draw_boxes(uint64_t *seed, struct gsn_box *box, int count)
{
    for (int i = 0; i < count; i++) {
        for (int c = 0; c < 3; c++) {
            box[i].low[c] = 10 * draw(seed) * (c == 2 ? 0.1 : 1);
            box[i].high[c] = box[i].low[c] + draw(seed) * (i % 50 == 0 ? 8 : 0.5);
        }
    }
}

static int overlap(const struct gsn_box *a, const struct gsn_box *b)
{
    for (int c = 0; c < 3; c++) {
        if (a->low[c] > b->high[c] || b->low[c] > a->high[c])
            return 0;
    }
    return 1;
}

static int count_visit(void *context, uint32_t box)
{
    ((int *)context)[box]++;
    return 0;
}

static int stop_visit(void *context, uint32_t box)
{
    ++*(int *)context;
    return (int)box + 1;
}

TEST(every_box_that_meets_another_is_visited_once)
{
    static struct gsn_box box[BOXES], asked[100];
    gsn_auto(gsn_bins) bins = NULL;
    struct gsn_error err = { 0 };
    uint64_t seed = 4;

    draw_boxes(&seed, box, BOXES);
    draw_boxes(&seed, asked, 100);
    CHECK_OK(gsn_bins_new(box, BOXES, &bins, &err), err);
    for (int i = 0; i < 100; i++) {
        int seen[BOXES] = { 0 };

        CHECK(gsn_bins_meeting(bins, &asked[i], count_visit, seen) == 0);
        for (int b = 0; b < BOXES; b++)
            CHECK(seen[b] == overlap(&asked[i], &box[b]));
    }
}

TEST(a_point_finds_every_box_that_holds_it)
{
    static struct gsn_box box[BOXES];
    gsn_auto(gsn_bins) bins = NULL;
    struct gsn_error err = { 0 };
    uint64_t seed = 6;

    draw_boxes(&seed, box, BOXES);
    CHECK_OK(gsn_bins_new(box, BOXES, &bins, &err), err);
    for (int i = 0; i < 3 * BOXES; i++) {
        const double *u = i < BOXES ? box[i].low : i < 2 * BOXES ? box[i - BOXES].high : NULL;
        const double any[3] = { 12 * draw(&seed), 12 * draw(&seed), 2 * draw(&seed) };
        struct gsn_box point;
        const uint32_t *list = NULL;
        size_t count, place = 0;

        memcpy(point.low, u ? u : any, sizeof point.low);
        memcpy(point.high, point.low, sizeof point.high);
        count = gsn_bins_at(bins, point.low, &list);
        for (uint32_t b = 0; b < BOXES; b++) {
            if (!overlap(&point, &box[b]))
                continue;
            while (place < count && list[place] < b)
                place++;
            CHECK(place < count && list[place] == b);
        }
    }
}

TEST(a_visit_can_end_the_search_and_flat_boxes_are_fine)
{
    const struct gsn_box flat[2] = { { { 0, 0, 0 }, { 1, 1, 0 } }, { { 2, 0, 0 }, { 3, 1, 0 } } };
    gsn_auto(gsn_bins) bins = NULL;
    struct gsn_error err = { 0 };
    int calls = 0;

    CHECK_OK(gsn_bins_new(flat, 2, &bins, &err), err);
    CHECK(gsn_bins_meeting(bins, gsn_bins_bounds(bins), stop_visit, &calls) > 0);
    CHECK(calls == 1);
    CHECK(memcmp(gsn_bins_box(bins, 1), &flat[1], sizeof flat[1]) == 0);
}
