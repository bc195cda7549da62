/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/parallel.h"
#include "pipeline/core/robust.h"
#include "pipeline/register/refine_parts.h"

#include <math.h>
#include <string.h>

/* The square counts fully within this share of its half side, and not at all at its edge. */
static const double FULL = 0.82;
/* Wavelengths of fewer cells are not looked at. */
enum { LEAST_WAVE = 4, SCALES = 2, VOTES = 2, THIN = 3 };
/* Cells off the neighbours by so many deviations, one by one or a patch of them, are debris, ink,
 * folds and bubbles. A lower limit votes down the rims of a section that lies off, which is what is
 * to be seen. */
static const double MOST_OFF = 8, SCALE_CELLS[SCALES] = { 1, 3 };
/* Of the square's weight that has to be known. */
static const double LEAST_KNOWN = 0.25;

static int make_room(struct gsn_refine_compare *c)
{
    const size_t count = c->stack->count, most = c->stack->side / LEAST_WAVE;

    if (gsn_waves_init(&c->waves, c->stack->side, most) < 0)
        return GSN_E_NOMEM;
    c->pairs = gsn_waves_count(&c->waves);
    c->rings = most + 1;
    c->taper = gsn_alloc_array(c->cells, sizeof *c->taper);
    c->laid = gsn_alloc_array(count * c->cells, sizeof *c->laid);
    c->weight = gsn_alloc_array(count * c->cells, sizeof *c->weight);
    c->filled = gsn_alloc_array(count * c->cells, sizeof *c->filled);
    c->line = gsn_alloc_array(count * c->cells, sizeof *c->line);
    c->off = gsn_alloc_array(count * c->cells, sizeof *c->off);
    c->even = gsn_alloc_array(count * c->cells, sizeof *c->even);
    c->wave = gsn_alloc_array(count * c->pairs, 2 * sizeof *c->wave);
    c->room = gsn_alloc_array(count * (c->cells + c->pairs), sizeof *c->room);
    c->common = gsn_alloc_array(count * c->rings, sizeof *c->common);
    c->response = gsn_alloc_array(count + 1, sizeof *c->response);
    c->told = gsn_alloc_array(c->rings, sizeof *c->told);
    c->noise = gsn_alloc_array(c->rings, sizeof *c->noise);
    c->there = gsn_alloc_array(count + 1, sizeof *c->there);
    c->faced = gsn_alloc_array(count + 1, sizeof *c->faced);
    return c->taper && c->laid && c->weight && c->filled && c->line && c->off && c->even &&
                   c->wave && c->room && c->common && c->response && c->told && c->noise &&
                   c->there && c->faced
               ? GSN_OK
               : GSN_E_NOMEM;
}

int gsn_refine_compare_new(const struct gsn_refine_stack *stack,
                           struct gsn_refine_compare **ret_compare, struct gsn_error *err)
{
    gsn_auto(gsn_refine_compare) c = gsn_alloc_array(1, sizeof *c);
    const double half = 0.5 * (double)stack->side;

    if (c) {
        c->stack = stack;
        c->cells = stack->side * stack->side;
    }
    if (!c || make_room(c) < 0)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to compare the sections' tissue");
    for (size_t i = 0; i < c->cells; i++) {
        const double x = (double)(i % stack->side) + 0.5 - half;
        const double y = (double)(i / stack->side) + 0.5 - half;

        c->taper[i] = (float)fmin(fmax((1 - hypot(x, y) / half) / (1 - FULL), 0), 1);
    }
    *ret_compare = gsn_steal(&c);
    return GSN_OK;
}

void gsn_refine_compare_free(struct gsn_refine_compare *c)
{
    if (!c)
        return;
    gsn_waves_done(&c->waves);
    gsn_free(c->taper);
    gsn_free(c->laid);
    gsn_free(c->weight);
    gsn_free(c->filled);
    gsn_free(c->line);
    gsn_free(c->off);
    gsn_free(c->even);
    gsn_free(c->wave);
    gsn_free(c->room);
    gsn_free(c->common);
    gsn_free(c->response);
    gsn_free(c->told);
    gsn_free(c->noise);
    gsn_free(c->there);
    gsn_free(c->faced);
    gsn_free(c);
}

/* ---- Laid, and brought to mean 0 and variance 1 ------------------------------------------------
 */

static int standardise(const struct gsn_refine_compare *c, float *laid)
{
    double all = 0, known = 0, sum = 0, square = 0, mean, sd;

    for (size_t i = 0; i < c->cells; i++) {
        all += c->taper[i];
        if (isnan(laid[i]))
            continue;
        known += c->taper[i];
        sum += (double)c->taper[i] * laid[i];
        square += (double)c->taper[i] * laid[i] * laid[i];
    }
    if (!(known > LEAST_KNOWN * all))
        return 0;
    mean = sum / known;
    sd = sqrt(fmax(square / known - mean * mean, 0));
    if (!(sd > 0))
        return 0;
    for (size_t i = 0; i < c->cells; i++)
        laid[i] = (float)((laid[i] - mean) / sd);
    return 1;
}

static int lay(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_compare *c = context;
    float *laid = c->laid + k * c->cells;

    (void)err;
    c->there[k] = 0;
    if (!c->stack->section[k].density)
        return GSN_OK;
    gsn_refine_lay(c->stack, c->stack->section[k].density, c->move[k], laid);
    c->there[k] = standardise(c, laid);
    for (size_t i = 0; i < c->cells; i++) {
        c->weight[k * c->cells + i] = isnan(laid[i]) ? 0.0F : 1.0F;
        c->filled[k * c->cells + i] = isnan(laid[i]) ? 0 : laid[i];
    }
    return GSN_OK;
}

/* ---- The line through the neighbours, and what fits it -----------------------------------------
 */

static int draw_line(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_compare *c = context;
    float *line = c->line + k * c->cells;
    double weight[2 * AROUND + 1];

    (void)err;
    memset(line, 0, c->cells * sizeof *line);
    c->faced[k] = 0;
    if (!c->there[k])
        return GSN_OK;
    gsn_refine_line(c->stack, c->there, k, weight);
    for (size_t j = 0; j <= 2 * AROUND; j++) {
        const float w = (float)weight[j];

        if (w == 0)
            continue;
        c->faced[k] = 1;
        for (size_t i = 0; i < c->cells; i++)
            line[i] += w * c->filled[(k + j - AROUND) * c->cells + i];
    }
    return GSN_OK;
}

/* How far off the line each cell, or the patch around it, is. The line is scratch for the blur. */
static int look_off(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_compare *c = context;
    float *off = c->off + k * c->cells;
    gsn_auto_mem(float) scratch = NULL;

    if (!c->faced[k])
        return GSN_OK;
    scratch = gsn_alloc_array(c->cells, sizeof *scratch);
    if (!scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to compare the sections' tissue");
    for (size_t i = 0; i < c->cells; i++) {
        const float laid = c->laid[k * c->cells + i];

        off[i] = isnan(laid) ? 0 : laid - c->line[k * c->cells + i];
    }
    gsn_refine_blur(c->stack->side, SCALE_CELLS[c->vote], scratch, off);
    return GSN_OK;
}

static double usual_off(struct gsn_refine_compare *c)
{
    size_t n = 0;

    for (size_t k = 0; k < c->stack->count; k++)
        for (size_t i = 0; c->faced[k] && i < c->cells; i += THIN)
            if (c->taper[i] > 0 && !isnan(c->laid[k * c->cells + i]))
                c->room[n++] = fabs((double)c->off[k * c->cells + i]);
    return n > 0 ? 1.4826 * gsn_median(c->room, n) : 0;
}

static int vote(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_compare *c = context;

    (void)err;
    for (size_t i = 0; c->faced[k] && i < c->cells; i++) {
        const double off = c->off[k * c->cells + i] / (MOST_OFF * c->scale);
        float *weight = &c->weight[k * c->cells + i];

        if (c->vote == 0)
            *weight = isnan(c->laid[k * c->cells + i]) ? 0.0F : 1.0F;
        *weight *= (float)(1 / (1 + off * off * off * off));
    }
    return GSN_OK;
}

/* What fits no neighbour is replaced by what they show. */
static int fill(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_compare *c = context;

    (void)err;
    for (size_t i = k * c->cells; c->faced[k] && i < (k + 1) * c->cells; i++) {
        const float laid = isnan(c->laid[i]) ? 0 : c->laid[i];

        c->filled[i] = c->weight[i] * laid + (1 - c->weight[i]) * c->line[i];
    }
    return GSN_OK;
}

static int vote_all(struct gsn_refine_compare *c, unsigned threads, struct gsn_error *err)
{
    const size_t count = c->stack->count;
    int r = gsn_parallel_for(count, threads, draw_line, c, err);

    for (int round = 0; r >= 0 && round < VOTES; round++) {
        for (c->vote = 0; r >= 0 && c->vote < SCALES; c->vote++) {
            r = gsn_parallel_for(count, threads, look_off, c, err);
            c->scale = r >= 0 ? usual_off(c) : 0;
            if (c->scale > 0)
                r = gsn_parallel_for(count, threads, vote, c, err);
        }
        if (r >= 0)
            r = gsn_parallel_for(count, threads, fill, c, err);
        if (r >= 0)
            r = gsn_parallel_for(count, threads, draw_line, c, err);
    }
    return r;
}

int gsn_refine_compare_all(struct gsn_refine_compare *c, const double (*move)[PARTS],
                           unsigned threads, int *ret_there,
                           struct gsn_refine_equation *ret_equation, double *ret_finest_um,
                           struct gsn_error *err)
{
    int r;

    c->move = move;
    r = gsn_parallel_for(c->stack->count, threads, lay, c, err);
    if (r >= 0)
        r = vote_all(c, threads, err);
    if (r >= 0)
        r = gsn_refine_even(c, threads, err);
    if (r >= 0)
        r = gsn_refine_believe(c, threads, err);
    if (r >= 0)
        r = gsn_refine_measure(c, threads, ret_equation, ret_finest_um, err);
    if (r >= 0)
        memcpy(ret_there, c->there, c->stack->count * sizeof *ret_there);
    return r;
}
