/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/imaging/components.h"

#include "tests/check.h"

#include <string.h>

enum { CASES = 200, WIDTH = 41, HEIGHT = 29, PIXELS = WIDTH * HEIGHT };

static void draw(uint8_t *set, unsigned percent, uint32_t *seed)
{
    for (int i = 0; i < PIXELS; i++) {
        *seed = *seed * 1664525u + 1013904223u;
        set[i] = (*seed >> 8) % 100 < percent;
    }
}

static void flood(const uint8_t *set, int x, int y, int number, int *label)
{
    if (x < 0 || y < 0 || x >= WIDTH || y >= HEIGHT || !set[y * WIDTH + x] || label[y * WIDTH + x])
        return;
    label[y * WIDTH + x] = number;
    for (int k = 0; k < 9; k++)
        flood(set, x + k % 3 - 1, y + k / 3 - 1, number, label);
}

/* From nearly empty to nearly full. */
TEST(components_are_those_of_a_flood_fill)
{
    uint32_t seed = 5;

    for (unsigned k = 0; k < CASES; k++) {
        gsn_auto(gsn_components) all = NULL;
        struct gsn_error err = { 0 };
        int label[PIXELS] = { 0 }, seen[PIXELS] = { 0 }, count = 0;
        uint8_t set[PIXELS];

        draw(set, k / 2, &seed);
        for (int i = 0; i < PIXELS; i++)
            if (set[i] && !label[i])
                flood(set, i % WIDTH, i / WIDTH, ++count, label);
        CHECK_OK(gsn_components_find(set, WIDTH, HEIGHT, &all, &err), err);
        CHECK(all->count == (size_t)count && all->width == WIDTH);
        for (size_t c = 0; c < all->count; c++)
            for (size_t i = 0; i < all->component[c].area; i++)
                seen[all->pixel[all->component[c].first + i]] = (int)c + 1;
        assert_memory_equal(seen, label, sizeof label);
    }
}

/* A bar of 12 by 3 pixels, lying and standing: box, centre, and the axes of a rectangle. */
TEST(a_bar_has_the_box_centre_and_axes_of_a_bar)
{
    for (int standing = 0; standing < 2; standing++) {
        gsn_auto(gsn_components) all = NULL;
        struct gsn_error err = { 0 };
        uint8_t set[PIXELS] = { 0 };
        const int w = standing ? 3 : 12, h = standing ? 12 : 3;

        for (int i = 0; i < w * h; i++)
            set[(7 + i / w) * WIDTH + 10 + i % w] = 1;
        CHECK_OK(gsn_components_find(set, WIDTH, HEIGHT, &all, &err), err);
        CHECK(all->count == 1);
        const struct gsn_component *c = &all->component[0];

        CHECK(c->x == 10 && c->y == 7 && c->width == w && c->height == h && c->area == 36);
        CHECK_NEAR(c->cx, 10 + w / 2.0, 1e-12);
        CHECK_NEAR(c->cy, 7 + h / 2.0, 1e-12);
        CHECK_NEAR(c->length, 4 * 12 / sqrt(12), 1e-12);
        CHECK_NEAR(c->breadth, 4 * 3 / sqrt(12), 1e-12);
        CHECK_NEAR(fabs(standing ? c->along_y : c->along_x), 1, 1e-12);
    }
}

static int find_once(const uint8_t *set, struct gsn_error *err)
{
    gsn_auto(gsn_components) all = NULL;

    return gsn_components_find(set, WIDTH, HEIGHT, &all, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    uint8_t set[PIXELS] = { [3] = 1, [200] = 1 };
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(find_once(set, &err), err);
}
