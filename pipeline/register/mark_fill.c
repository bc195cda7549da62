/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_fill.h"

#include "pipeline/core/mem.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* The level that a way over a neighbour needs: no less than the cell's own. */
static inline float over(float own, float level, float neighbour)
{
    const float way = neighbour > own ? neighbour : own;

    return way < level ? way : level;
}

/* From a row's neighbour on one side, then along the row, both ways. */
static int sweep_row(const float *own, const float *beside, size_t width, float *level)
{
    int changed = 0;

    for (size_t x = 0; x < width; x++) {
        float now = over(own[x], level[x], beside[x]);

        now = x > 0 ? over(own[x], now, level[x - 1]) : now;
        changed |= now < level[x];
        level[x] = now;
    }
    for (size_t x = width - 1; x-- > 0;) {
        const float now = over(own[x], level[x], level[x + 1]);

        changed |= now < level[x];
        level[x] = now;
    }
    return changed;
}

/* The largest of a cell and the two beside it along a line; sign -1: the smallest. */
static void widen_line(float *value, size_t count, size_t apart, float sign)
{
    float before = -INFINITY;

    for (size_t i = 0; i < count; i++) {
        float *at = value + i * apart;
        const float own = sign * *at, after = i + 1 < count ? sign * at[apart] : -INFINITY;

        *at = sign * fmaxf(fmaxf(before, own), after);
        before = own;
    }
}

/* The same of a square of 3 x 3 cells. */
static void widen(float *value, size_t width, size_t height, float sign)
{
    for (size_t y = 0; y < height; y++)
        widen_line(value + y * width, width, 1, sign);
    for (size_t x = 0; x < width; x++)
        widen_line(value + x, height, width, sign);
}

/* Raises level, which is infinite inside, until every cell has its way out. */
static void flood(const float *own, size_t width, size_t height, float *level)
{
    int changed = 1;

    while (changed) {
        changed = 0;
        for (size_t y = 1; y < height; y++)
            changed |=
                sweep_row(own + y * width, level + (y - 1) * width, width, level + y * width);
        for (size_t y = height - 1; y-- > 0;)
            changed |=
                sweep_row(own + y * width, level + (y + 1) * width, width, level + y * width);
    }
}

int gsn_mark_fill(float *value, size_t width, size_t height, struct gsn_error *err)
{
    gsn_auto_mem(float) room = NULL;
    float *own, *level;

    assert(value);

    if (width < 3 || height < 3)
        return GSN_OK;
    room = gsn_alloc(2 * width * height * sizeof *room);
    if (!room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for holes with a dark rim");
    own = room;
    level = room + width * height;
    for (size_t i = 0; i < width * height; i++)
        own[i] = isnan(value[i]) ? -INFINITY : value[i];
    widen(own, width, height, 1);
    for (size_t i = 0; i < width * height; i++) {
        const size_t x = i % width, y = i / width;
        const int edge = x == 0 || y == 0 || x + 1 == width || y + 1 == height;

        level[i] = edge ? own[i] : INFINITY;
    }
    flood(own, width, height, level);
    widen(level, width, height, -1);
    for (size_t i = 0; i < width * height; i++)
        if (!isnan(value[i]))
            value[i] = level[i];
    return GSN_OK;
}
