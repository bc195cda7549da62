/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Refines the sections' poses by their tissue: every section against the straight line through its
 * neighbours, all moves solved together.
 *
 * Steps, in ROUNDS of Gauss-Newton: (1) every section is resampled where its move so far puts it
 * and brought to mean 0 and variance 1 under a taper. (2) The line through up to four sections on
 * either side, itself left out, is what it is compared with: a slant passes it unchanged. Cells
 * that fit no neighbour lose their weight (debris, ink, folds, bubbles) and are filled from the
 * line. (3) Weights from place to place and by spatial frequency (refine_weights.c). (4) The line's
 * slopes times the six parts of a move, in the frequency domain, against what the section differs
 * by: normal equations of each section, scaled by how far sections answer to a move in this stack,
 * and made less certain by how sections are bent. (5) All sections' equations with the marks'
 * covariance as prior: one banded normal matrix, solved by Cholesky; the two factors of variance
 * are estimated from what priors and comparisons are left with, each over its own degrees of
 * freedom (MacKay 1992).
 *
 * Fails when a prior is no covariance, serial numbers do not rise or memory runs out; a stack whose
 * sections share nothing moves none. Cost: per section and round some ten transforms of a square of
 * side cells. The result does not depend on the number of threads. */
#include "pipeline/register/tissue/refine.h"

#include "pipeline/core/linalg.h"
#include "pipeline/core/parallel.h"
#include "pipeline/core/robust.h"
#include "pipeline/imaging/smooth.h"
#include "pipeline/register/tissue/refine_weights.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* The parts of a move at a cell. */
static void basis_at(const struct gsn_refine_stack *stack, double x, double y, double ret_x[PARTS],
                     double ret_y[PARTS])
{
    const double scale = stack->cell_um / stack->unit_um, half = 0.5 * (double)stack->side - 0.5;
    const double u = scale * (x - half), v = scale * (y - half);
    const double of_x[PARTS] = { 1, 0, -v, u, u, v }, of_y[PARTS] = { 0, 1, u, v, -v, u };

    for (size_t p = 0; p < PARTS; p++) {
        ret_x[p] = of_x[p];
        ret_y[p] = of_y[p];
    }
}

/* Between the four cells around it; NaN where one of them is not known or not there. */
static float value_at(const float *plane, size_t side, double x, double y)
{
    const double last = (double)side - 1;
    size_t i, j;
    float s, t;

    if (!(x >= 0 && y >= 0 && x <= last && y <= last))
        return NAN;
    i = x < last ? (size_t)x : side - 2;
    j = y < last ? (size_t)y : side - 2;
    s = (float)(x - (double)i);
    t = (float)(y - (double)j);

    const float *at = plane + j * side + i;

    return (at[0] * (1 - s) + at[1] * s) * (1 - t) + (at[side] * (1 - s) + at[side + 1] * s) * t;
}

static void resample_moved(const struct gsn_refine_stack *stack, const float *density,
                           const double move[PARTS], float *ret_laid)
{
    for (size_t y = 0; y < stack->side; y++)
        for (size_t x = 0; x < stack->side; x++) {
            double bx[PARTS], by[PARTS], dx = 0, dy = 0;

            basis_at(stack, (double)x, (double)y, bx, by);
            for (size_t p = 0; p < PARTS; p++) {
                dx += bx[p] * move[p] / stack->cell_um;
                dy += by[p] * move[p] / stack->cell_um;
            }
            ret_laid[y * stack->side + x] =
                value_at(density, stack->side, (double)x + dx, (double)y + dy);
        }
}

struct gsn_affine gsn_refine_map(const struct gsn_refine_stack *stack, const double move[PARTS])
{
    const double *m = move, unit = stack->unit_um;
    const double xx = (m[3] + m[4]) / unit, xy = (m[5] - m[2]) / unit;
    const double yx = (m[5] + m[2]) / unit, yy = (m[3] - m[4]) / unit;
    const struct gsn_point c = stack->centre;
    const struct gsn_affine shown = { 1 + xx, xy,     m[0] - xx * c.x - xy * c.y,
                                      yx,     1 + yy, m[1] - yx * c.x - yy * c.y };

    return gsn_affine_inverse(&shown);
}

/* Weights of the sections around the i-th that are there, from i - AROUND on: the value at i of the
 * straight line through them; all 0 where none is. weight[AROUND], its own, is 0. */
static void line_weights(const struct gsn_refine_stack *stack, const int *there, size_t i,
                         double ret_weight[2 * AROUND + 1])
{
    double sum = 0, first = 0, second = 0, before = 0, after = 0, far[2 * AROUND + 1] = { 0 };

    for (size_t k = 0; k <= 2 * AROUND; k++) {
        const size_t j = i + k - AROUND;
        double d;

        ret_weight[k] = 0;
        if (k == AROUND || i + k < AROUND || j >= stack->count || !there[j])
            continue;
        d = (double)stack->section[j].serial - (double)stack->section[i].serial;
        if (fabs(d) > AROUND)
            continue;
        far[k] = d;
        ret_weight[k] = 1 - fabs(d) / (AROUND + 1);
        sum += ret_weight[k];
        first += ret_weight[k] * d;
        second += ret_weight[k] * d * d;
        before += d < 0;
        after += d > 0;
    }
    for (size_t k = 0; k <= 2 * AROUND; k++)
        ret_weight[k] *= before > 0 && after > 0
                             ? (second - first * far[k]) / (sum * second - first * first)
                             : 0;
}

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

static int allocate_planes(struct gsn_refine_comparison *c)
{
    const size_t count = c->stack->count, most = c->stack->side / LEAST_WAVE;

    c->dft = (struct gsn_refine_dft){ c->stack->side, most };
    c->pairs = gsn_refine_dft_count(&c->dft);
    c->rings = most + 1;
    c->taper = gsn_alloc_array(c->cells, sizeof *c->taper);
    c->placed = gsn_alloc_array(count * c->cells, sizeof *c->placed);
    c->weight = gsn_alloc_array(count * c->cells, sizeof *c->weight);
    c->filled = gsn_alloc_array(count * c->cells, sizeof *c->filled);
    c->line = gsn_alloc_array(count * c->cells, sizeof *c->line);
    c->off = gsn_alloc_array(count * c->cells, sizeof *c->off);
    c->local = gsn_alloc_array(count * c->cells, sizeof *c->local);
    c->wave = gsn_alloc_array(count * c->pairs, 2 * sizeof *c->wave);
    c->room = gsn_alloc_array(count * (c->cells + c->pairs), sizeof *c->room);
    c->common = gsn_alloc_array(count * c->rings, sizeof *c->common);
    c->response = gsn_alloc_array(count + 1, sizeof *c->response);
    c->coherence = gsn_alloc_array(c->rings, sizeof *c->coherence);
    c->noise = gsn_alloc_array(c->rings, sizeof *c->noise);
    c->there = gsn_alloc_array(count + 1, sizeof *c->there);
    c->flanked = gsn_alloc_array(count + 1, sizeof *c->flanked);
    return c->taper && c->placed && c->weight && c->filled && c->line && c->off && c->local &&
                   c->wave && c->room && c->common && c->response && c->coherence && c->noise &&
                   c->there && c->flanked
               ? GSN_OK
               : GSN_E_NOMEM;
}

static void gsn_refine_comparison_free(struct gsn_refine_comparison *c)
{
    if (!c)
        return;
    gsn_free(c->taper);
    gsn_free(c->placed);
    gsn_free(c->weight);
    gsn_free(c->filled);
    gsn_free(c->line);
    gsn_free(c->off);
    gsn_free(c->local);
    gsn_free(c->wave);
    gsn_free(c->room);
    gsn_free(c->common);
    gsn_free(c->response);
    gsn_free(c->coherence);
    gsn_free(c->noise);
    gsn_free(c->there);
    gsn_free(c->flanked);
    gsn_free(c);
}

GSN_DEFINE_AUTO(gsn_refine_comparison);

/* gives; borrows stack. */
static int new_comparison(const struct gsn_refine_stack *stack,
                          struct gsn_refine_comparison **ret_compare, struct gsn_error *err)
{
    gsn_auto(gsn_refine_comparison) c = gsn_alloc_array(1, sizeof *c);
    const double half = 0.5 * (double)stack->side;

    if (c) {
        c->stack = stack;
        c->cells = stack->side * stack->side;
    }
    if (!c || allocate_planes(c) < 0)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to compare the sections' tissue");
    for (size_t i = 0; i < c->cells; i++) {
        const double x = (double)(i % stack->side) + 0.5 - half;
        const double y = (double)(i / stack->side) + 0.5 - half;

        c->taper[i] = (float)fmin(fmax((1 - hypot(x, y) / half) / (1 - FULL), 0), 1);
    }
    *ret_compare = gsn_steal(&c);
    return GSN_OK;
}

/* ---- Laid, and brought to mean 0 and variance 1 ------------------------------------------- */

static int standardise(const struct gsn_refine_comparison *c, float *laid)
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

static int resample_section(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_comparison *c = context;
    float *laid = c->placed + k * c->cells;

    (void)err;
    c->there[k] = 0;
    if (!c->stack->section[k].density)
        return GSN_OK;
    resample_moved(c->stack, c->stack->section[k].density, c->move[k], laid);
    c->there[k] = standardise(c, laid);
    for (size_t i = 0; i < c->cells; i++) {
        c->weight[k * c->cells + i] = isnan(laid[i]) ? 0.0F : 1.0F;
        c->filled[k * c->cells + i] = isnan(laid[i]) ? 0 : laid[i];
    }
    return GSN_OK;
}

/* ---- The line through the neighbours, and what fits it ------------------------------------ */

static int draw_line(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_comparison *c = context;
    float *line = c->line + k * c->cells;
    double weight[2 * AROUND + 1];

    (void)err;
    memset(line, 0, c->cells * sizeof *line);
    c->flanked[k] = 0;
    if (!c->there[k])
        return GSN_OK;
    line_weights(c->stack, c->there, k, weight);
    for (size_t j = 0; j <= 2 * AROUND; j++) {
        const float w = (float)weight[j];

        if (w == 0)
            continue;
        c->flanked[k] = 1;
        for (size_t i = 0; i < c->cells; i++)
            line[i] += w * c->filled[(k + j - AROUND) * c->cells + i];
    }
    return GSN_OK;
}

/* How far off the line each cell, or the patch around it, is. The line is scratch for the blur. */
static int blur_difference(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_comparison *c = context;
    float *off = c->off + k * c->cells;
    gsn_auto_mem(float) scratch = NULL;

    if (!c->flanked[k])
        return GSN_OK;
    scratch = gsn_alloc_array(c->cells, sizeof *scratch);
    if (!scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to compare the sections' tissue");
    for (size_t i = 0; i < c->cells; i++) {
        const float laid = c->placed[k * c->cells + i];

        off[i] = isnan(laid) ? 0 : laid - c->line[k * c->cells + i];
    }
    gsn_smooth_gaussian(off, c->stack->side, c->stack->side, SCALE_CELLS[c->vote], scratch);
    return GSN_OK;
}

static double usual_difference(struct gsn_refine_comparison *c)
{
    size_t n = 0;

    for (size_t k = 0; k < c->stack->count; k++)
        for (size_t i = 0; c->flanked[k] && i < c->cells; i += THIN)
            if (c->taper[i] > 0 && !isnan(c->placed[k * c->cells + i]))
                c->room[n++] = fabs((double)c->off[k * c->cells + i]);
    return n > 0 ? 1.4826 * gsn_median(c->room, n) : 0;
}

static int vote_cells(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_comparison *c = context;

    (void)err;
    for (size_t i = 0; c->flanked[k] && i < c->cells; i++) {
        const double off = c->off[k * c->cells + i] / (MOST_OFF * c->scale);
        float *weight = &c->weight[k * c->cells + i];

        if (c->vote == 0)
            *weight = isnan(c->placed[k * c->cells + i]) ? 0.0F : 1.0F;
        *weight *= (float)(1 / (1 + off * off * off * off));
    }
    return GSN_OK;
}

/* What fits no neighbour is replaced by what they show. */
static int fill_cells(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_comparison *c = context;

    (void)err;
    for (size_t i = k * c->cells; c->flanked[k] && i < (k + 1) * c->cells; i++) {
        const float laid = isnan(c->placed[i]) ? 0 : c->placed[i];

        c->filled[i] = c->weight[i] * laid + (1 - c->weight[i]) * c->line[i];
    }
    return GSN_OK;
}

static int vote_all(struct gsn_refine_comparison *c, unsigned threads, struct gsn_error *err)
{
    const size_t count = c->stack->count;
    int r = gsn_parallel_for(count, threads, draw_line, c, err);

    for (int round = 0; r >= 0 && round < VOTES; round++) {
        for (c->vote = 0; r >= 0 && c->vote < SCALES; c->vote++) {
            r = gsn_parallel_for(count, threads, blur_difference, c, err);
            c->scale = r >= 0 ? usual_difference(c) : 0;
            if (c->scale > 0)
                r = gsn_parallel_for(count, threads, vote_cells, c, err);
        }
        if (r >= 0)
            r = gsn_parallel_for(count, threads, fill_cells, c, err);
        if (r >= 0)
            r = gsn_parallel_for(count, threads, draw_line, c, err);
    }
    return r;
}

/* Sections that answer to a move by less than this share say no more than as if by it. */
static const double LEAST_RESPONSE = 0.2;

/* The tapered square has so many times fewer independent frequencies than an even one. */
static double taper_freedom(const struct gsn_refine_comparison *c)
{
    double second = 0, fourth = 0;

    for (size_t i = 0; i < c->cells; i++) {
        const double square = (double)c->taper[i] * c->taper[i];

        second += square;
        fourth += square * square;
    }
    return second * second / fourth / (double)c->cells;
}

/* What of the line is tissue, in room->plane. */
static int smooth_line(const struct gsn_refine_comparison *c, size_t k,
                       struct gsn_refine_buffers *room, struct gsn_error *err)
{
    const float *line = c->line + k * c->cells;
    const int r = gsn_refine_dft_forward(&c->dft, line, room->scratch, room->pairs, err);

    for (size_t i = 0; r >= 0 && i < c->pairs; i++) {
        const size_t ring = gsn_refine_dft_ring(&c->dft, i);
        const float told = ring < c->rings ? (float)c->coherence[ring] : 0;

        room->pairs[2 * i] *= told;
        room->pairs[2 * i + 1] *= told;
    }
    return r < 0 ? r
                 : gsn_refine_dft_inverse(&c->dft, room->pairs, room->scratch, room->plane, err);
}

/* Weighed slopes of the plane, per um. */
static void compute_slopes(const struct gsn_refine_comparison *c, size_t k,
                           struct gsn_refine_buffers *room)
{
    const size_t side = c->stack->side;

    for (size_t i = 0; i < c->cells; i++) {
        const size_t x = i % side, y = i / side;
        const float weight = c->taper[i] * c->weight[k * c->cells + i] *
                             c->local[k * c->cells + i] / (2 * (float)c->stack->cell_um);

        if (x == 0 || y == 0 || x + 1 == side || y + 1 == side) {
            room->gradient[0][i] = room->gradient[1][i] = 0;
            continue;
        }
        room->gradient[0][i] = weight * (room->plane[i + 1] - room->plane[i - 1]);
        room->gradient[1][i] = weight * (room->plane[i + side] - room->plane[i - side]);
    }
}

/* What a part of a move makes of the weighed slopes. */
static int transform_part(const struct gsn_refine_comparison *c, size_t p,
                          struct gsn_refine_buffers *room, float *ret_pairs, struct gsn_error *err)
{
    const size_t side = c->stack->side;

    for (size_t i = 0; i < c->cells; i++) {
        double bx[PARTS], by[PARTS];

        basis_at(c->stack, (double)(i % side), (double)(i / side), bx, by);
        room->plane[i] = (float)(bx[p] * room->gradient[0][i] + by[p] * room->gradient[1][i]);
    }
    return gsn_refine_dft_forward(&c->dft, room->plane, room->scratch, ret_pairs, err);
}

static double frequency_weight(const struct gsn_refine_comparison *c, size_t i, double even)
{
    const size_t ring = gsn_refine_dft_ring(&c->dft, i);

    if (ring >= c->rings || !(c->coherence[ring] > 0) || !(c->noise[ring] > 0))
        return 0;
    return even * gsn_refine_dft_times(&c->dft, i) / c->noise[ring];
}

static void sum_equation(const struct gsn_refine_comparison *c,
                         const struct gsn_refine_buffers *room, double even,
                         struct gsn_refine_equation *to)
{
    for (size_t i = 0; i < c->pairs; i++) {
        const double worth = frequency_weight(c, i, even);

        for (size_t p = 0; worth > 0 && p < PARTS; p++) {
            const float *column = room->column[p] + 2 * i;

            to->right[p] += worth * gsn_refine_product(column, room->pairs + 2 * i);
            for (size_t q = 0; q < PARTS; q++)
                to->information[p][q] +=
                    worth * gsn_refine_product(column, room->column[q] + 2 * i);
        }
    }
}

/* The section's own slopes against those that its line predicts: its texture has no part in the
 * line, so what they share is how it answers to a move. */
static int add_response(const struct gsn_refine_comparison *c, size_t k,
                        struct gsn_refine_buffers *room, double even, struct gsn_error *err)
{
    int r = GSN_OK;

    memcpy(room->plane, c->filled + k * c->cells, c->cells * sizeof *room->plane);
    compute_slopes(c, k, room);
    for (size_t p = 0; r >= 0 && p < PARTS; p++) {
        r = transform_part(c, p, room, room->pairs, err);
        for (size_t i = 0; r >= 0 && i < c->pairs; i++)
            c->response[k][p] += frequency_weight(c, i, even) *
                                 gsn_refine_product(room->column[p] + 2 * i, room->pairs + 2 * i);
    }
    return r;
}

static int compare_section(const struct gsn_refine_comparison *c, size_t k,
                           struct gsn_refine_buffers *room, float *left, struct gsn_error *err)
{
    const double even = taper_freedom(c);
    int r = smooth_line(c, k, room, err);

    if (r < 0)
        return r;
    compute_slopes(c, k, room);
    for (size_t i = 0, at = k * c->cells; i < c->cells; i++, at++)
        left[i] = isnan(c->placed[at]) ? 0
                                       : (room->plane[i] - c->placed[at]) * c->taper[i] *
                                             c->weight[at] * c->local[at];
    for (size_t p = 0; r >= 0 && p < PARTS; p++)
        r = transform_part(c, p, room, room->column[p], err);
    if (r >= 0)
        r = gsn_refine_dft_forward(&c->dft, left, room->scratch, room->pairs, err);
    if (r < 0)
        return r;
    sum_equation(c, room, even, &c->equation[k]);
    return add_response(c, k, room, even, err);
}

static int make_equation(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_comparison *c = context;
    struct gsn_refine_buffers room = { 0 };
    gsn_auto_mem(float) left = NULL;
    int r;

    c->equation[k] = (struct gsn_refine_equation){ 0 };
    memset(c->response[k], 0, sizeof c->response[k]);
    if (!c->flanked[k] || !(c->coherence[1] > 0))
        return GSN_OK;
    left = gsn_alloc_array(c->cells, sizeof *left);
    if (!left)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to compare the sections' tissue");
    r = gsn_refine_buffers_init(c, &room, err);
    if (r >= 0)
        r = compare_section(c, k, &room, left, err);
    gsn_refine_buffers_done(&room);
    return r;
}

/* ---- What the equations are worth --------------------------------------------------------- */

/* Of the change that the lines predict of a part, what all sections together show: structures that
 * are others in the next section, and those that are weighed down, do not move with it. */
static double estimate_response(const struct gsn_refine_comparison *c, size_t p)
{
    double shown = 0, predicted = 0;

    for (size_t k = 0; k < c->stack->count; k++) {
        shown += c->response[k][p];
        predicted += c->equation[k].information[p][p];
    }
    return predicted > 0 ? fmin(fmax(shown / predicted, LEAST_RESPONSE), 1) : 1;
}

static void apply_response(struct gsn_refine_comparison *c)
{
    double response[PARTS];

    for (size_t p = 0; p < PARTS; p++)
        response[p] = estimate_response(c, p);
    for (size_t k = 0; k < c->stack->count; k++)
        for (size_t p = 0; p < PARTS; p++) {
            c->equation[k].right[p] *= response[p];
            for (size_t q = 0; q < PARTS; q++)
                c->equation[k].information[p][q] *= response[p] * response[q];
        }
}

/* A section that is bent looks moved where its tissue tells most: that comes on top of the noise.
 */
static void add_bending(const struct gsn_refine_comparison *c, struct gsn_refine_equation *e)
{
    double spread[PARTS][PARTS], move[PARTS] = { 0 };

    memcpy(spread, e->information, sizeof spread);
    if (!(e->information[0][0] > 0) || gsn_invert_spd(&spread[0][0], PARTS, PARTS) < 0)
        return;
    for (size_t p = 0; p < PARTS; p++)
        for (size_t q = 0; q < PARTS; q++)
            move[p] += spread[p][q] * e->right[q];
    for (size_t p = 0; p < PARTS; p++)
        spread[p][p] += c->stack->bent_um2;
    if (gsn_invert_spd(&spread[0][0], PARTS, PARTS) < 0)
        return;
    memcpy(e->information, spread, sizeof spread);
    for (size_t p = 0; p < PARTS; p++) {
        e->right[p] = 0;
        for (size_t q = 0; q < PARTS; q++)
            e->right[p] += spread[p][q] * move[q];
    }
}

/* The equations of the sections as they are resampled and weighed. */
static int make_equations(struct gsn_refine_comparison *c, unsigned threads,
                          struct gsn_refine_equation *ret_equation, double *ret_finest_um,
                          struct gsn_error *err)
{
    size_t finest = 0;
    int r;

    c->equation = ret_equation;
    r = gsn_parallel_for(c->stack->count, threads, make_equation, c, err);
    if (r < 0)
        return r;
    apply_response(c);
    for (size_t k = 0; k < c->stack->count; k++)
        add_bending(c, &c->equation[k]);
    while (finest + 1 < c->rings && c->coherence[finest + 1] > 0)
        finest++;
    *ret_finest_um = finest > 0 ? (double)c->stack->side * c->stack->cell_um / (double)finest : 0;
    return GSN_OK;
}

/* Resamples all sections as the moves so far say and compares them. ret_there[i]: whether there is
 * enough of section i. */
static int compare_all(struct gsn_refine_comparison *c, const double (*move)[PARTS],
                       unsigned threads, int *ret_there, struct gsn_refine_equation *ret_equation,
                       double *ret_finest_um, struct gsn_error *err)
{
    int r;

    c->move = move;
    r = gsn_parallel_for(c->stack->count, threads, resample_section, c, err);
    if (r >= 0)
        r = vote_all(c, threads, err);
    if (r >= 0)
        r = gsn_refine_normalise_locally(c, threads, err);
    if (r >= 0)
        r = gsn_refine_learn_coherence(c, threads, err);
    if (r >= 0)
        r = make_equations(c, threads, ret_equation, ret_finest_um, err);
    if (r >= 0)
        memcpy(ret_there, c->there, c->stack->count * sizeof *ret_there);
    return r;
}

/* Two sections are in one equation when a third lies within AROUND of both. */
enum { BAND = PARTS * (2 * AROUND + 1), JOINT_ROUNDS = 4 };

/* A section whose comparison is off by more than so many times its error is worth less. */
static const double MOST_OFF2 = 4;

/* What stacks can show of their own errors. */
static const double MOST_PRIOR = 9, MOST_COMPARISON = 9;

typedef double matrix[PARTS][PARTS];

struct joint {
    const struct gsn_refine_stack *stack;
    const int *there;
    const struct gsn_refine_equation *equation;
    double (*move)[PARTS];
    double (*line)[2 * AROUND + 1];
    matrix *prior, *spread; /* inverses of the priors and of the information */
    double *worth;          /* of a section's comparison */
    size_t wide;            /* of the band: BAND, or size where that is less */
    double *band;           /* column i: a[i .. i + wide - 1][i], then its Cholesky factor */
    double *step, *column;  /* unknowns */
    double (*covariance)[PARTS][PARTS];
    double prior_factor, comparison_factor;
    size_t size;
};

static void free_joint(struct joint *j)
{
    gsn_free(j->line);
    gsn_free(j->prior);
    gsn_free(j->spread);
    gsn_free(j->worth);
    gsn_free(j->band);
    gsn_free(j->step);
    gsn_free(j->column);
}

static int is_compared(const struct gsn_refine_equation *e)
{
    return e->information[0][0] > 0;
}

static int init_joint(struct joint *j, struct gsn_error *err)
{
    const size_t count = j->stack->count;

    j->size = count * PARTS;
    j->wide = BAND < j->size ? BAND : j->size;
    j->line = gsn_alloc_array(count, sizeof *j->line);
    j->prior = gsn_alloc_array(count, sizeof *j->prior);
    j->spread = gsn_alloc_array(count, sizeof *j->spread);
    j->worth = gsn_alloc_array(count, sizeof *j->worth);
    j->band = gsn_alloc_array(j->size, j->wide * sizeof *j->band);
    j->step = gsn_alloc_array(j->size, sizeof *j->step);
    j->column = gsn_alloc_array(j->size, sizeof *j->column);
    if (!j->line || !j->prior || !j->spread || !j->worth || !j->band || !j->step || !j->column)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to lay sections by their tissue");
    for (size_t k = 0; k < count; k++) {
        memcpy(j->prior[k], j->stack->section[k].prior, sizeof j->prior[k]);
        if (gsn_invert_spd(&j->prior[k][0][0], PARTS, PARTS) < 0)
            return gsn_fail(err, GSN_E_INPUT,
                            "what is known of section %u beforehand is no "
                            "covariance",
                            j->stack->section[k].serial + 1);
        memcpy(j->spread[k], j->equation[k].information, sizeof j->spread[k]);
        if (is_compared(&j->equation[k]) &&
            gsn_invert_spd(&j->spread[k][0][0], PARTS, PARTS) >= 0) {
            line_weights(j->stack, j->there, k, j->line[k]);
            j->worth[k] = 1;
        }
    }
    return GSN_OK;
}

/* How section `other` enters the k-th comparison: the move itself, minus the line's. */
static double part_of_section(const struct joint *j, size_t k, size_t offset)
{
    return (offset == AROUND ? 1 : 0) - j->line[k][offset];
}

static double *band_at(struct joint *j, size_t row, size_t column)
{
    return &j->band[column * j->wide + (row - column)];
}

static void add_block(struct joint *j, size_t k, size_t l, double times, const matrix block)
{
    for (size_t p = 0; p < PARTS; p++)
        for (size_t q = 0; q < PARTS; q++)
            if (k * PARTS + p >= l * PARTS + q)
                *band_at(j, k * PARTS + p, l * PARTS + q) += times * block[p][q];
}

static void add_comparison(struct joint *j, size_t k)
{
    const struct gsn_refine_equation *e = &j->equation[k];
    const double worth = j->worth[k] / j->comparison_factor;

    for (size_t a = 0; a <= 2 * AROUND; a++) {
        const double pa = part_of_section(j, k, a);

        if (pa == 0)
            continue;
        for (size_t p = 0; p < PARTS; p++)
            j->step[(k + a - AROUND) * PARTS + p] += worth * pa * e->right[p];
        for (size_t b = 0; b <= a; b++)
            if (part_of_section(j, k, b) != 0)
                add_block(j, k + a - AROUND, k + b - AROUND, worth * pa * part_of_section(j, k, b),
                          e->information);
    }
}

/* Normal equations: the right side goes to step. */
static void set_up_normal(struct joint *j)
{
    memset(j->band, 0, j->size * j->wide * sizeof *j->band);
    memset(j->step, 0, j->size * sizeof *j->step);
    for (size_t k = 0; k < j->stack->count; k++) {
        add_block(j, k, k, 1 / j->prior_factor, j->prior[k]);
        for (size_t p = 0; p < PARTS; p++)
            for (size_t q = 0; q < PARTS; q++)
                j->step[k * PARTS + p] -= j->prior[k][p][q] * j->move[k][q] / j->prior_factor;
        if (j->worth[k] > 0)
            add_comparison(j, k);
    }
}

static void fill_covariances(struct joint *j)
{
    for (size_t k = 0; k < j->stack->count; k++)
        for (size_t p = 0; p < PARTS; p++) {
            memset(j->column, 0, j->size * sizeof *j->column);
            j->column[k * PARTS + p] = 1;
            gsn_band_solve(j->band, j->size, j->wide, j->column);
            memcpy(j->covariance[k][p], j->column + k * PARTS, sizeof j->covariance[k][p]);
        }
}

/* What a comparison still differs by, over its variance. */
static double residual_of(const struct joint *j, size_t k)
{
    double left[PARTS];

    for (size_t p = 0; p < PARTS; p++) {
        left[p] = 0;
        for (size_t q = 0; q < PARTS; q++)
            left[p] += j->spread[k][p][q] * j->equation[k].right[q];
        for (size_t a = 0; a <= 2 * AROUND; a++)
            if (part_of_section(j, k, a) != 0)
                left[p] -= part_of_section(j, k, a) * j->step[(k + a - AROUND) * PARTS + p];
    }
    return gsn_quadratic_form(&j->equation[k].information[0][0], PARTS, left);
}

/* Variances from what priors and comparisons are left with, over the degrees of freedom that each
 * has of its own (MacKay 1992). */
static void estimate_factors(struct joint *j)
{
    double of_priors = 0, of_comparisons = 0, free = 0, told = 0;

    for (size_t k = 0; k < j->stack->count; k++) {
        double moved[PARTS], left;

        for (size_t p = 0; p < PARTS; p++) {
            moved[p] = j->move[k][p] + j->step[k * PARTS + p];
            told += 1;
            for (size_t q = 0; q < PARTS; q++)
                told -= j->prior[k][p][q] * j->covariance[k][q][p] / j->prior_factor;
        }
        of_priors += gsn_quadratic_form(&j->prior[k][0][0], PARTS, moved);
        if (!(j->worth[k] > 0))
            continue;
        left = residual_of(j, k);
        of_comparisons += j->worth[k] * left;
        free += PARTS;
        j->worth[k] = fmin(1, MOST_OFF2 * PARTS * j->comparison_factor / left);
    }
    if (!(told > 1) || !(free - told > 1))
        return;
    j->prior_factor = fmin(fmax(of_priors / told, 1), MOST_PRIOR);
    j->comparison_factor = fmin(fmax(of_comparisons / (free - told), 1), MOST_COMPARISON);
}

static int iterate_joint(struct joint *j, struct gsn_error *err)
{
    for (int round = 0;; round++) {
        set_up_normal(j);
        if (gsn_band_cholesky(j->band, j->size, j->wide) < 0)
            return gsn_fail(err, GSN_E_FIT, "the sections' moves cannot be solved");
        gsn_band_solve(j->band, j->size, j->wide, j->step);
        fill_covariances(j);
        if (round == JOINT_ROUNDS)
            return GSN_OK;
        estimate_factors(j);
    }
}

/* Adds to the moves what all equations and priors together say, estimates the two factors, and
 * fills the covariances. */
static int solve_joint(const struct gsn_refine_stack *stack, const int *there,
                       const struct gsn_refine_equation *equation, double (*move)[PARTS],
                       double (*covariance)[PARTS][PARTS], struct gsn_refine_summary *summary,
                       struct gsn_error *err)
{
    struct joint j = { .stack = stack,
                       .there = there,
                       .equation = equation,
                       .move = move,
                       .covariance = covariance,
                       .prior_factor = 1,
                       .comparison_factor = 1 };
    int r = init_joint(&j, err);

    if (r >= 0)
        r = iterate_joint(&j, err);
    for (size_t k = 0; r >= 0 && k < stack->count; k++)
        for (size_t p = 0; p < PARTS; p++)
            move[k][p] += j.step[k * PARTS + p];
    if (r >= 0) {
        summary->prior_factor = j.prior_factor;
        summary->comparison_factor = j.comparison_factor;
    }
    free_joint(&j);
    return r;
}

/* The moves are tens of um at most and the structures compared at least a hundred, so Gauss and
 * Newton are there in three. */
enum { ROUNDS = 3, LEAST_SIDE = 16 };

static int check_stack(const struct gsn_refine_stack *stack, struct gsn_error *err)
{
    if (stack->side < LEAST_SIDE)
        return gsn_fail(err, GSN_E_INPUT, "%zu cells a side are too few to compare tissue in",
                        stack->side);
    if (!(stack->cell_um > 0) || !(stack->unit_um > 0) || !isfinite(stack->cell_um) ||
        !isfinite(stack->unit_um))
        return gsn_fail(err, GSN_E_INPUT, "cells of %g um about %g um are no square",
                        stack->cell_um, stack->unit_um);
    if (!(stack->bent_um2 >= 0) || !isfinite(stack->bent_um2))
        return gsn_fail(err, GSN_E_INPUT, "sections bent by %g um2 are none", stack->bent_um2);
    for (size_t k = 1; k < stack->count; k++)
        if (stack->section[k].serial <= stack->section[k - 1].serial)
            return gsn_fail(err, GSN_E_INPUT, "section %u comes after section %u",
                            stack->section[k].serial + 1, stack->section[k - 1].serial + 1);
    return GSN_OK;
}

int gsn_refine_solve(const struct gsn_refine_stack *stack, unsigned threads,
                     struct gsn_refined *ret_refined, struct gsn_refine_summary *ret_summary,
                     struct gsn_error *err)
{
    gsn_auto(gsn_refine_comparison) compare = NULL;
    gsn_auto_mem(struct gsn_refine_equation) equation = NULL;
    gsn_auto_mem(int) there = NULL;
    double(*move)[PARTS] __attribute__((cleanup(gsn_auto_release))) = NULL;
    double(*covariance)[PARTS][PARTS] __attribute__((cleanup(gsn_auto_release))) = NULL;
    struct gsn_refine_summary summary = { 0 };
    int r;

    assert(stack && ret_refined && ret_summary && (stack->section || stack->count == 0));

    r = check_stack(stack, err);
    if (r >= 0)
        r = new_comparison(stack, &compare, err);
    if (r < 0)
        return r;
    equation = gsn_alloc_array(stack->count + 1, sizeof *equation);
    there = gsn_alloc_array(stack->count + 1, sizeof *there);
    move = gsn_alloc_array(stack->count + 1, sizeof *move);
    covariance = gsn_alloc_array(stack->count + 1, sizeof *covariance);
    if (!equation || !there || !move || !covariance)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to lay sections by their tissue");
    for (int round = 0; r >= 0 && round < ROUNDS; round++) {
        r = compare_all(compare, (const double(*)[PARTS])move, threads, there, equation,
                        &summary.finest_um, err);
        if (r >= 0)
            r = solve_joint(stack, there, equation, move, covariance, &summary, err);
    }
    if (r < 0)
        return r;
    for (size_t k = 0; k < stack->count; k++) {
        ret_refined[k].compared = equation[k].information[0][0] > 0;
        memcpy(ret_refined[k].move, move[k], sizeof move[k]);
        memcpy(ret_refined[k].covariance, covariance[k], sizeof covariance[k]);
        summary.compared += (size_t)ret_refined[k].compared;
    }
    *ret_summary = summary;
    return GSN_OK;
}
