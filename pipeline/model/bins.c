/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/bins.h"

#include <assert.h>
#include <math.h>
#include <string.h>

enum { MOST_PER_AXIS = 512 };

struct gsn_bins {
    struct gsn_box bounds;
    size_t count, size[3]; /* boxes; bins along each axis */
    double per_unit[3];    /* bins per unit of length */
    struct gsn_box *box;
    size_t *start; /* bin b lists item[start[b]] .. item[start[b + 1] - 1] */
    uint32_t *item;
};

/* The bins a box touches, both ends included. */
struct span {
    size_t low[3], high[3];
};

static size_t bin_of(const struct gsn_bins *bins, double x, int axis)
{
    const double place = (x - bins->bounds.low[axis]) * bins->per_unit[axis];

    if (!(place > 0))
        return 0;
    return place < (double)bins->size[axis] ? (size_t)place : bins->size[axis] - 1;
}

static struct span span_of(const struct gsn_bins *bins, const struct gsn_box *box)
{
    struct span span;

    for (int c = 0; c < 3; c++) {
        span.low[c] = bin_of(bins, box->low[c], c);
        span.high[c] = bin_of(bins, box->high[c], c);
    }
    return span;
}

static size_t bin_number(const struct gsn_bins *bins, size_t x, size_t y, size_t z)
{
    return (z * bins->size[1] + y) * bins->size[0] + x;
}

static void bound(struct gsn_bins *bins)
{
    bins->bounds = bins->box[0];
    for (size_t i = 1; i < bins->count; i++) {
        for (int c = 0; c < 3; c++) {
            bins->bounds.low[c] = fmin(bins->bounds.low[c], bins->box[i].low[c]);
            bins->bounds.high[c] = fmax(bins->bounds.high[c], bins->box[i].high[c]);
        }
    }
}

/* Cubic bins, as many as boxes. */
static void choose_size(struct gsn_bins *bins)
{
    double edge[3], volume = 1, step;

    for (int c = 0; c < 3; c++) {
        edge[c] = bins->bounds.high[c] - bins->bounds.low[c];
        volume *= edge[c];
    }
    step = cbrt(volume / (double)bins->count);
    for (int c = 0; c < 3; c++) {
        const double wanted = step > 0 ? ceil(edge[c] / step) : 1;

        bins->size[c] = wanted < MOST_PER_AXIS ? (size_t)fmax(wanted, 1) : MOST_PER_AXIS;
        bins->per_unit[c] = edge[c] > 0 ? (double)bins->size[c] / edge[c] : 0;
    }
}

/* Counts (item NULL) or enters every box into its bins; start[b + 1] runs ahead meanwhile. */
static void enter_all(struct gsn_bins *bins)
{
    for (size_t i = 0; i < bins->count; i++) {
        const struct span span = span_of(bins, &bins->box[i]);

        for (size_t z = span.low[2]; z <= span.high[2]; z++) {
            for (size_t y = span.low[1]; y <= span.high[1]; y++) {
                for (size_t x = span.low[0]; x <= span.high[0]; x++) {
                    size_t *next = &bins->start[bin_number(bins, x, y, z) + 1];

                    if (bins->item)
                        bins->item[*next] = (uint32_t)i;
                    ++*next;
                }
            }
        }
    }
}

/* From counts at [b + 1] to where bin b begins at [b + 1], so that entering ends with the starts
 * in place. */
static size_t counts_to_starts(size_t *start, size_t bins)
{
    size_t sum = 0;

    for (size_t b = 1; b <= bins; b++) {
        const size_t count = start[b];

        start[b] = sum;
        sum += count;
    }
    return sum;
}

int gsn_bins_new(const struct gsn_box *box, size_t count, struct gsn_bins **ret_bins,
                 struct gsn_error *err)
{
    gsn_auto(gsn_bins) bins = gsn_alloc_array(1, sizeof *bins);
    size_t all;

    assert(box && count > 0 && ret_bins);

    if (!bins)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for bins");
    bins->count = count;
    bins->box = gsn_memdup(box, count * sizeof *box);
    if (!bins->box)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu boxes", count);
    bound(bins);
    choose_size(bins);
    all = bins->size[0] * bins->size[1] * bins->size[2];
    bins->start = gsn_alloc_array(all + 1, sizeof *bins->start);
    if (!bins->start)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu bins", all);
    enter_all(bins);
    bins->item = gsn_alloc_array(counts_to_starts(bins->start, all), sizeof *bins->item);
    if (!bins->item)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu bins", all);
    enter_all(bins);
    *ret_bins = gsn_steal(&bins);
    return GSN_OK;
}

void gsn_bins_free(struct gsn_bins *bins)
{
    if (!bins)
        return;
    gsn_free(bins->box);
    gsn_free(bins->start);
    gsn_free(bins->item);
    gsn_free(bins);
}

const struct gsn_box *gsn_bins_bounds(const struct gsn_bins *bins)
{
    return &bins->bounds;
}

const struct gsn_box *gsn_bins_box(const struct gsn_bins *bins, size_t box)
{
    return &bins->box[box];
}

size_t gsn_bins_at(const struct gsn_bins *bins, const double u[3], const uint32_t **ret_list)
{
    size_t at[3], b;

    for (int c = 0; c < 3; c++) {
        if (!(u[c] >= bins->bounds.low[c] && u[c] <= bins->bounds.high[c]))
            return 0;
        at[c] = bin_of(bins, u[c], c);
    }
    b = bin_number(bins, at[0], at[1], at[2]);
    *ret_list = &bins->item[bins->start[b]];
    return bins->start[b + 1] - bins->start[b];
}

static int meet(const struct gsn_box *a, const struct gsn_box *b)
{
    for (int c = 0; c < 3; c++) {
        if (a->low[c] > b->high[c] || a->high[c] < b->low[c])
            return 0;
    }
    return 1;
}

/* A pair that shares several bins is met in the first of them alone. */
static int is_first(const struct gsn_bins *bins, const struct span *span, uint32_t box, size_t x,
                    size_t y, size_t z)
{
    const struct span own = span_of(bins, &bins->box[box]);
    const size_t at[3] = { x, y, z };

    for (int c = 0; c < 3; c++) {
        if (at[c] != (own.low[c] > span->low[c] ? own.low[c] : span->low[c]))
            return 0;
    }
    return 1;
}

int gsn_bins_meeting(const struct gsn_bins *bins, const struct gsn_box *box,
                     int (*visit)(void *context, uint32_t box), void *context)
{
    const struct span span = span_of(bins, box);

    for (size_t z = span.low[2]; z <= span.high[2]; z++) {
        for (size_t y = span.low[1]; y <= span.high[1]; y++) {
            for (size_t x = span.low[0]; x <= span.high[0]; x++) {
                const size_t b = bin_number(bins, x, y, z);

                for (size_t i = bins->start[b]; i < bins->start[b + 1]; i++) {
                    int r = 0;

                    if (meet(&bins->box[bins->item[i]], box) &&
                        is_first(bins, &span, bins->item[i], x, y, z))
                        r = visit(context, bins->item[i]);
                    if (r != 0)
                        return r;
                }
            }
        }
    }
    return 0;
}
