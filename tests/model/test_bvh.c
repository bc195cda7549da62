/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/bvh.h"

#include "pipeline/model/sorted_batch.h"

#include "tests/check.h"
#include "tests/model/kuhn.h"

#include <string.h>

enum { BOXES = 3000 };

/* Flat in z, some boxes long; moved and scaled as a whole. */
static void draw_boxes(uint64_t *seed, double origin, double scale, struct gsn_bvh_box *box,
                       int count)
{
    for (int i = 0; i < count; i++) {
        for (int c = 0; c < 3; c++) {
            const double low = 10 * draw(seed) * (c == 2 ? 0.1 : 1);
            const double edge = draw(seed) * (i % 50 == 0 ? 8 : 0.5);

            box[i].low[c] = origin + scale * low;
            box[i].high[c] = origin + scale * (low + edge);
        }
    }
}

static int overlap(const struct gsn_bvh_box *a, const struct gsn_bvh_box *b)
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

/* Each box that must be found is found once, none twice, and not many that need not be. */
static void check_found(const struct gsn_bvh_box *box, int count, const struct gsn_bvh_box *asked,
                        const int *found, size_t *needed, size_t *idle)
{
    for (int b = 0; b < count; b++) {
        const int must = overlap(asked, &box[b]);

        CHECK(found[b] <= 1 && found[b] >= must);
        *needed += (size_t)must;
        *idle += (size_t)(found[b] - must);
    }
}

static void check_meeting(int count, double origin, double scale)
{
    static struct gsn_bvh_box box[BOXES], asked[100];
    gsn_auto(gsn_bvh) tree = NULL;
    struct gsn_error err = { 0 };
    uint64_t seed = 4;
    size_t needed = 0, idle = 0;

    draw_boxes(&seed, origin, scale, box, count);
    draw_boxes(&seed, origin, scale, asked, 100);
    CHECK_OK(gsn_bvh_new(box, (size_t)count, &tree, &err), err);
    for (int i = 0; i < 100; i++) {
        int found[BOXES] = { 0 };

        CHECK(gsn_bvh_meeting(tree, &asked[i], count_visit, found) == 0);
        check_found(box, count, &asked[i], found, &needed, &idle);
    }
    CHECK(count < 100 || idle < 8 * needed);
}

TEST(every_box_that_meets_another_is_found_once)
{
    for (int count = 1; count < 40; count++)
        check_meeting(count, 0, 1);
    check_meeting(BOXES, 0, 1);
    check_meeting(BOXES, 1e6, 1);
    check_meeting(BOXES, -3e9, 1e-3);
    check_meeting(BOXES, 0, 1e-60);
    check_meeting(BOXES, 0, 1e300);
}

static void check_points(double origin, double scale)
{
    static struct gsn_bvh_box box[BOXES];
    gsn_auto(gsn_bvh) tree = NULL;
    struct gsn_error err = { 0 };
    uint64_t seed = 6;
    size_t needed = 0, idle = 0;

    draw_boxes(&seed, origin, scale, box, BOXES);
    CHECK_OK(gsn_bvh_new(box, BOXES, &tree, &err), err);
    for (int i = 0; i < BOXES; i++) {
        const double any[3] = { origin + 12 * scale * draw(&seed),
                                origin + 12 * scale * draw(&seed),
                                origin + 2 * scale * draw(&seed) };
        const double *at[3] = { box[i].low, box[i].high, any };

        for (int j = 0; j < 3 && i % 3 == 0; j++) {
            int found[BOXES] = { 0 };
            struct gsn_bvh_box point;

            memcpy(point.low, at[j], sizeof point.low);
            memcpy(point.high, at[j], sizeof point.high);
            CHECK(gsn_bvh_at(tree, at[j], count_visit, found) == 0);
            check_found(box, BOXES, &point, found, &needed, &idle);
        }
    }
    CHECK(idle < 20 * needed);
}

TEST(a_point_finds_every_box_that_holds_it)
{
    check_points(0, 1);
    check_points(1e6, 1e-3);
    check_points(-7, 1e12);
}

TEST(no_box_holds_a_point_that_is_far_away_or_not_finite)
{
    static struct gsn_bvh_box box[BOXES];
    const double odd[] = { NAN, INFINITY, -INFINITY, 1e9, -1e9, 1e300, -1e300 };
    gsn_auto(gsn_bvh) tree = NULL;
    struct gsn_error err = { 0 };
    uint64_t seed = 8;

    draw_boxes(&seed, 0, 1, box, BOXES);
    CHECK_OK(gsn_bvh_new(box, BOXES, &tree, &err), err);
    for (size_t i = 0; i < 3 * sizeof odd / sizeof *odd; i++) {
        double u[3] = { 5, 5, 0.5 };
        int calls = 0;

        u[i % 3] = odd[i / 3];
        CHECK(gsn_bvh_at(tree, u, stop_visit, &calls) == 0 && calls == 0);
    }
}

/* Points of boxes joined by lines, which therefore meet both boxes. */
static void check_lines(double origin, double scale)
{
    static struct gsn_bvh_box box[BOXES];
    gsn_auto(gsn_bvh) tree = NULL;
    struct gsn_error err = { 0 };
    uint64_t seed = 9;
    size_t all = 0;

    draw_boxes(&seed, origin, scale, box, BOXES);
    CHECK_OK(gsn_bvh_new(box, BOXES, &tree, &err), err);
    for (int i = 0; i + 1 < BOXES; i += 7) {
        double p[3], d[3], size = 0;
        int found[BOXES] = { 0 };

        for (int c = 0; c < 3; c++) {
            p[c] = i % 2 ? box[i].low[c] : box[i].high[c];
            d[c] = box[i + 1].low[c] / 2 + box[i + 1].high[c] / 2 - p[c];
            size += d[c] / scale * (d[c] / scale);
        }
        for (int c = 0; c < 3; c++) {
            d[c] = i % 3 ? d[c] / scale / sqrt(size) : c == i % 3;
            p[c] += (i % 5 - 2) * 50 * scale * d[c];
        }
        CHECK(gsn_bvh_along(tree, p, d, count_visit, found) == 0);
        CHECK(found[i] == 1 && (i % 3 == 0 || found[i + 1] == 1));
        for (int b = 0; b < BOXES; b++)
            all += (size_t)found[b];
    }
    CHECK(all / (BOXES / 7) < BOXES / 6);
}

TEST(a_line_finds_every_box_it_meets)
{
    check_lines(0, 1);
    check_lines(1e6, 1);
    check_lines(0, 1e-30);
}

TEST(a_line_along_the_gap_between_boxes_finds_none)
{
    const struct gsn_bvh_box two[2] = { { { 0, 0, 0 }, { 1, 1, 1 } },
                                        { { 2, 0, 0 }, { 3, 1, 1 } } };
    const double beside[3] = { 0, 5, 5 }, nowhere[3] = { NAN, NAN, NAN };
    gsn_auto(gsn_bvh) tree = NULL;
    struct gsn_error err = { 0 };
    int calls = 0;

    CHECK_OK(gsn_bvh_new(two, 2, &tree, &err), err);
    CHECK(gsn_bvh_along(tree, beside, (const double[3]){ 1, 0, 0 }, stop_visit, &calls) == 0);
    CHECK(gsn_bvh_along(tree, beside, nowhere, stop_visit, &calls) == 0);
    CHECK(gsn_bvh_along(tree, nowhere, beside, stop_visit, &calls) == 0);
    CHECK(calls == 0);
}

TEST(a_visit_can_end_the_search_and_flat_boxes_are_fine)
{
    const struct gsn_bvh_box flat[2] = { { { 0, 0, 0 }, { 1, 1, 0 } },
                                         { { 2, 0, 0 }, { 3, 1, 0 } } };
    const struct gsn_bvh_box same[2] = { { { 1, 1, 1 }, { 1, 1, 1 } },
                                         { { 1, 1, 1 }, { 1, 1, 1 } } };
    gsn_auto(gsn_bvh) tree = NULL;
    gsn_auto(gsn_bvh) point = NULL;
    struct gsn_error err = { 0 };
    int calls = 0;

    CHECK_OK(gsn_bvh_new(flat, 2, &tree, &err), err);
    CHECK(gsn_bvh_bounds(tree)->high[0] == 3 && gsn_bvh_bounds(tree)->low[1] == 0);
    CHECK(gsn_bvh_meeting(tree, gsn_bvh_bounds(tree), stop_visit, &calls) > 0);
    CHECK(calls == 1);
    CHECK_OK(gsn_bvh_new(same, 2, &point, &err), err);
    CHECK(gsn_bvh_at(point, same[1].low, stop_visit, &calls) > 0);
}

TEST(it_takes_twelve_bytes_an_item)
{
    static struct gsn_bvh_box box[BOXES];
    gsn_auto(gsn_bvh) tree = NULL;
    struct gsn_error err = { 0 };
    uint64_t seed = 10;

    draw_boxes(&seed, 0, 1, box, BOXES);
    CHECK_OK(gsn_bvh_new(box, BOXES, &tree, &err), err);
    CHECK(gsn_bvh_bytes(tree) < 12 * BOXES + 256);
}

/* Numbers 3 i for i < count, in a random order. */
static void add_all(struct gsn_sorted_batch *ascent, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++)
        (void)gsn_sorted_batch_add(ascent, i * 1237 % count * 3);
}

TEST(an_ascent_gives_every_item_once_in_order)
{
    const uint32_t counts[] = {
        0, 1, 2, 500, GSN_SORTED_BATCH_ROOM, GSN_SORTED_BATCH_ROOM + 1, 3000
    };

    for (size_t i = 0; i < sizeof counts / sizeof *counts; i++) {
        struct gsn_sorted_batch ascent;
        uint32_t next = 0;

        gsn_sorted_batch_begin(&ascent);
        do {
            add_all(&ascent, counts[i]);
            for (size_t k = 0; k < ascent.count; k++) {
                CHECK(ascent.item[k] == next);
                next += 3;
            }
        } while (gsn_sorted_batch_next(&ascent));
        CHECK(next == 3 * counts[i]);
    }
}

static int make_once(struct gsn_error *err)
{
    const struct gsn_bvh_box box = { { 0, 0, 0 }, { 1, 1, 1 } };
    gsn_auto(gsn_bvh) tree = NULL;

    return gsn_bvh_new(&box, 1, &tree, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(make_once(&err), err);
}
