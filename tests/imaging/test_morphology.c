/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/imaging/morphology.h"

#include "pipeline/core/distance.h"
#include "tests/check.h"

#include <string.h>

enum { CASES = 200, WIDTH = 61, HEIGHT = 47, PIXELS = WIDTH * HEIGHT };

static void draw(uint8_t *set, unsigned per_mille, uint32_t *seed)
{
    for (int i = 0; i < PIXELS; i++) {
        *seed = *seed * 1664525u + 1013904223u;
        set[i] = (*seed >> 8) % 1000 < per_mille;
    }
}

/* By our exact distance transform, which is another method and another hand's. Radii from none to
 * beyond the picture, whole ones among them, and both sides of where the method changes. */
TEST(sets_grow_and_shrink_by_exactly_the_radius)
{
    const struct gsn_distance_box box = { WIDTH, HEIGHT, 1, 1, 1, 1 };
    uint32_t seed = 3;

    for (unsigned k = 0; k < CASES; k++) {
        const double radius = k % 7 == 0 ? k % 20 : 0.11 * k;
        uint8_t set[PIXELS], grown[PIXELS], worn[PIXELS], other[PIXELS];
        float to_set[PIXELS], to_rest[PIXELS];
        struct gsn_error err = { 0 };

        draw(set, k % 2 ? 1000 - k % 3 : k % 3, &seed);
        for (int i = 0; i < PIXELS; i++)
            other[i] = !set[i];
        memcpy(grown, set, sizeof set);
        memcpy(worn, set, sizeof set);
        CHECK_OK(gsn_distance_squared(set, &box, 1, to_set, &err), err);
        CHECK_OK(gsn_distance_squared(other, &box, 1, to_rest, &err), err);
        CHECK_OK(gsn_dilate(grown, WIDTH, HEIGHT, radius, &err), err);
        CHECK_OK(gsn_erode(worn, WIDTH, HEIGHT, radius, &err), err);
        for (int i = 0; i < PIXELS; i++) {
            CHECK(grown[i] == (to_set[i] <= (float)(radius * radius)));
            CHECK(worn[i] == (to_rest[i] > (float)(radius * radius)));
        }
    }
}

TEST(an_endless_radius_takes_all_or_nothing)
{
    uint8_t set[PIXELS] = { [17] = 1 }, empty[PIXELS] = { 0 };
    struct gsn_error err = { 0 };
    size_t count = 0;

    CHECK_OK(gsn_dilate(set, WIDTH, HEIGHT, INFINITY, &err), err);
    CHECK_OK(gsn_dilate(empty, WIDTH, HEIGHT, INFINITY, &err), err);
    for (int i = 0; i < PIXELS; i++)
        count += set[i] && !empty[i];
    CHECK(count == PIXELS);
    set[0] = 0;
    CHECK_OK(gsn_erode(set, WIDTH, HEIGHT, INFINITY, &err), err);
    CHECK(memcmp(set, empty, PIXELS) == 0);
}

/* A ring is filled; a ring with a gap, even one across a corner, is not. */
TEST(holes_are_what_no_way_from_outside_reaches)
{
    for (int gap = 0; gap < 2; gap++) {
        uint8_t set[PIXELS] = { 0 };
        struct gsn_error err = { 0 };
        size_t count = 0;

        for (int y = 10; y < 20; y++)
            for (int x = 10; x < 30; x++)
                set[y * WIDTH + x] = x == 10 || x == 29 || y == 10 || y == 19;
        if (gap)
            set[10 * WIDTH + 10] = 0;
        CHECK_OK(gsn_fill_holes(set, WIDTH, HEIGHT, 8, &err), err);
        for (int i = 0; i < PIXELS; i++)
            count += set[i];
        CHECK(count == (gap ? 55u : 200u));
    }
}

/* Grown from the border cell by cell until nothing changes. */
static void fill_slowly(uint8_t *set, int width, int height, int neighbours)
{
    static uint8_t outside[PIXELS];
    int more = 1;

    memset(outside, 0, sizeof outside);
    while (more) {
        more = 0;
        for (int i = 0; i < width * height; i++) {
            const int x = i % width, y = i / width;
            int reached = x == 0 || y == 0 || x == width - 1 || y == height - 1;

            if (set[i] || outside[i])
                continue;
            for (int v = y - 1; v <= y + 1 && !reached; v++)
                for (int u = x - 1; u <= x + 1 && !reached; u++)
                    reached = outside[v * width + u] && (neighbours == 8 || u == x || v == y);
            more |= outside[i] = (uint8_t)reached;
        }
    }
    for (int i = 0; i < width * height; i++)
        set[i] = !outside[i];
}

TEST(holes_are_those_of_a_slow_search)
{
    uint32_t seed = 5;

    for (unsigned k = 0; k < CASES; k++) {
        const int width = 1 + (int)(k % 23), height = 1 + (int)(k % 19);
        uint8_t set[PIXELS], slow[PIXELS];
        struct gsn_error err = { 0 };

        draw(set, 300 + k, &seed);
        memcpy(slow, set, sizeof set);
        CHECK_OK(gsn_fill_holes(set, (uint32_t)width, (uint32_t)height, k % 2 ? 8 : 4, &err), err);
        fill_slowly(slow, width, height, k % 2 ? 8 : 4);
        CHECK(memcmp(set, slow, (size_t)(width * height)) == 0);
    }
}

TEST(a_signed_distance_is_measured_from_half_a_pixel_beyond_the_set)
{
    enum { WIDE = 20, HIGH = 11, EDGE = 7 };
    uint8_t set[WIDE * HIGH];
    float distance[WIDE * HIGH];
    struct gsn_error err = { 0 };

    for (int i = 0; i < WIDE * HIGH; i++)
        set[i] = i % WIDE < EDGE;
    CHECK_OK(gsn_signed_distance(set, WIDE, HIGH, distance, &err), err);
    for (int y = 0; y < HIGH; y++)
        for (int x = 0; x < WIDE; x++) {
            const double across = EDGE - (x + 0.5);
            const double border = fmin(x + 0.5, fmin(y + 0.5, HIGH - y - 0.5));

            CHECK_NEAR(distance[y * WIDE + x], across > 0 ? fmin(across, border) : across, 1e-6);
        }
}
