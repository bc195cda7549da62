/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/parallel.h"
#include "pipeline/register/refine_parts.h"

#include <math.h>
#include <string.h>

/* Tissues differ in how coarse they are: from so many sections on either side, in patches of so
 * many cells, and no place counts more than what is left at this share of the mean. */
enum { NEAR = 8 };
static const double PATCH_CELLS = 1.5, LEAST_ROUGH = 0.3;
/* Of the sections near, as many have to show a place. */
static const float LEAST_SHOWN = 1;

/* Adds squares of what sections near the k-th are off their lines by, and how many show them. */
static void add_up(const struct gsn_refine_compare *c, size_t k, float *square, float *shown)
{
    const size_t first = k > NEAR ? k - NEAR : 0;

    for (size_t j = first; j < c->stack->count && j <= k + NEAR; j++) {
        const size_t from = j * c->cells;

        for (size_t i = 0; c->faced[j] && i < c->cells; i++) {
            const float off = c->laid[from + i] - c->line[from + i];

            if (isnan(off))
                continue;
            square[i] += c->weight[from + i] * off * off;
            shown[i] += c->weight[from + i];
        }
    }
}

static double mean_square(const struct gsn_refine_compare *c, const float *square,
                          const float *shown)
{
    double sum = 0, n = 0;

    for (size_t i = 0; i < c->cells; i++)
        if (shown[i] > LEAST_SHOWN) {
            sum += (double)(c->taper[i] * square[i] / shown[i]);
            n += (double)c->taper[i];
        }
    return n > 0 ? sum / n : 0;
}

static int learn(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_compare *c = context;
    float *even = c->even + k * c->cells;
    gsn_auto_mem(float) scratch = NULL;
    gsn_auto_mem(float) shown = NULL;
    double mean;

    if (!c->faced[k])
        return GSN_OK;
    scratch = gsn_alloc_array(c->cells, sizeof *scratch);
    shown = gsn_alloc_array(c->cells, sizeof *shown);
    if (!scratch || !shown)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to compare the sections' tissue");
    memset(even, 0, c->cells * sizeof *even);
    memset(shown, 0, c->cells * sizeof *shown);
    add_up(c, k, even, shown);
    gsn_refine_blur(c->stack->side, PATCH_CELLS, scratch, even);
    gsn_refine_blur(c->stack->side, PATCH_CELLS, scratch, shown);
    mean = mean_square(c, even, shown);
    for (size_t i = 0; i < c->cells; i++) {
        const double here = shown[i] > LEAST_SHOWN ? (double)(even[i] / shown[i]) : mean;

        even[i] =
            mean > 0 ? (float)sqrt((1 + LEAST_ROUGH) * mean / (here + LEAST_ROUGH * mean)) : 1;
    }
    return GSN_OK;
}

int gsn_refine_even(struct gsn_refine_compare *c, unsigned threads, struct gsn_error *err)
{
    return gsn_parallel_for(c->stack->count, threads, learn, c, err);
}
