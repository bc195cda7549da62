/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/linalg.h"
#include "pipeline/core/parallel.h"
#include "pipeline/register/refine_parts.h"

#include <math.h>
#include <string.h>

/* Sections that answer to a move by less than this share say no more than as if by it. */
static const double LEAST_RESPONSE = 0.2;

/* The tapered square has so many times fewer independent frequencies than an even one. */
static double evenness(const struct gsn_refine_compare *c)
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
static void smooth_line(const struct gsn_refine_compare *c, size_t k, struct gsn_refine_room *room)
{
    gsn_waves_of(&c->waves, c->line + k * c->cells, room->scratch, room->pairs);
    for (size_t i = 0; i < c->pairs; i++) {
        const size_t ring = gsn_waves_ring(&c->waves, i);
        const float told = ring < c->rings ? (float)c->told[ring] : 0;

        room->pairs[2 * i] *= told;
        room->pairs[2 * i + 1] *= told;
    }
    gsn_waves_back(&c->waves, room->pairs, room->scratch, room->plane);
}

/* Weighed slopes of the plane, per um. */
static void slopes(const struct gsn_refine_compare *c, size_t k, struct gsn_refine_room *room)
{
    const size_t side = c->stack->side;

    for (size_t i = 0; i < c->cells; i++) {
        const size_t x = i % side, y = i / side;
        const float weight = c->taper[i] * c->weight[k * c->cells + i] * c->even[k * c->cells + i] /
                             (2 * (float)c->stack->cell_um);

        if (x == 0 || y == 0 || x + 1 == side || y + 1 == side) {
            room->gradient[0][i] = room->gradient[1][i] = 0;
            continue;
        }
        room->gradient[0][i] = weight * (room->plane[i + 1] - room->plane[i - 1]);
        room->gradient[1][i] = weight * (room->plane[i + side] - room->plane[i - side]);
    }
}

/* What a part of a move makes of the weighed slopes. */
static void transform_part(const struct gsn_refine_compare *c, size_t p,
                           struct gsn_refine_room *room, float *ret_pairs)
{
    const size_t side = c->stack->side;

    for (size_t i = 0; i < c->cells; i++) {
        double bx[PARTS], by[PARTS];

        gsn_refine_basis(c->stack, (double)(i % side), (double)(i / side), bx, by);
        room->plane[i] = (float)(bx[p] * room->gradient[0][i] + by[p] * room->gradient[1][i]);
    }
    gsn_waves_of(&c->waves, room->plane, room->scratch, ret_pairs);
}

static double worth_of(const struct gsn_refine_compare *c, size_t i, double even)
{
    const size_t ring = gsn_waves_ring(&c->waves, i);

    if (ring >= c->rings || !(c->told[ring] > 0) || !(c->noise[ring] > 0))
        return 0;
    return even * gsn_waves_times(&c->waves, i) / c->noise[ring];
}

static void sum_up(const struct gsn_refine_compare *c, const struct gsn_refine_room *room,
                   double even, struct gsn_refine_equation *to)
{
    for (size_t i = 0; i < c->pairs; i++) {
        const double worth = worth_of(c, i, even);

        for (size_t p = 0; worth > 0 && p < PARTS; p++) {
            const float *column = room->column[p] + 2 * i;

            to->right[p] += worth * gsn_refine_product(column, room->pairs + 2 * i);
            for (size_t q = 0; q < PARTS; q++)
                to->information[p][q] +=
                    worth * gsn_refine_product(column, room->column[q] + 2 * i);
        }
    }
}

/* The section's own slopes against those that its line foretells: its texture has no part in the
 * line, so what they share is how it answers to a move. */
static void look_at_response(const struct gsn_refine_compare *c, size_t k,
                             struct gsn_refine_room *room, double even)
{
    memcpy(room->plane, c->filled + k * c->cells, c->cells * sizeof *room->plane);
    slopes(c, k, room);
    for (size_t p = 0; p < PARTS; p++) {
        transform_part(c, p, room, room->pairs);
        for (size_t i = 0; i < c->pairs; i++)
            c->response[k][p] += worth_of(c, i, even) *
                                 gsn_refine_product(room->column[p] + 2 * i, room->pairs + 2 * i);
    }
}

static void compare(const struct gsn_refine_compare *c, size_t k, struct gsn_refine_room *room,
                    float *left)
{
    const double even = evenness(c);

    smooth_line(c, k, room);
    slopes(c, k, room);
    for (size_t i = 0, at = k * c->cells; i < c->cells; i++, at++)
        left[i] = isnan(c->laid[at])
                      ? 0
                      : (room->plane[i] - c->laid[at]) * c->taper[i] * c->weight[at] * c->even[at];
    for (size_t p = 0; p < PARTS; p++)
        transform_part(c, p, room, room->column[p]);
    gsn_waves_of(&c->waves, left, room->scratch, room->pairs);
    sum_up(c, room, even, &c->equation[k]);
    look_at_response(c, k, room, even);
}

static int measure(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_compare *c = context;
    struct gsn_refine_room room = { 0 };
    gsn_auto_mem(float) left = NULL;
    int r;

    c->equation[k] = (struct gsn_refine_equation){ 0 };
    memset(c->response[k], 0, sizeof c->response[k]);
    if (!c->faced[k] || !(c->told[1] > 0))
        return GSN_OK;
    left = gsn_alloc_array(c->cells, sizeof *left);
    if (!left)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to compare the sections' tissue");
    r = gsn_refine_room_init(c, &room, err);
    if (r >= 0)
        compare(c, k, &room, left);
    gsn_refine_room_done(&room);
    return r;
}

/* ---- What the equations are worth ---------------------------------------------------------------
 */

/* Of the change that the lines foretell of a part, what all sections together show: structures that
 * are others in the next section, and those that are weighed down, do not move with it. */
static double response_of(const struct gsn_refine_compare *c, size_t p)
{
    double shown = 0, foretold = 0;

    for (size_t k = 0; k < c->stack->count; k++) {
        shown += c->response[k][p];
        foretold += c->equation[k].information[p][p];
    }
    return foretold > 0 ? fmin(fmax(shown / foretold, LEAST_RESPONSE), 1) : 1;
}

static void respond(struct gsn_refine_compare *c)
{
    double response[PARTS];

    for (size_t p = 0; p < PARTS; p++)
        response[p] = response_of(c, p);
    for (size_t k = 0; k < c->stack->count; k++)
        for (size_t p = 0; p < PARTS; p++) {
            c->equation[k].right[p] *= response[p];
            for (size_t q = 0; q < PARTS; q++)
                c->equation[k].information[p][q] *= response[p] * response[q];
        }
}

/* A section that is bent looks moved where its tissue tells most: that comes on top of the noise.
 */
static void bend(const struct gsn_refine_compare *c, struct gsn_refine_equation *e)
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

int gsn_refine_measure(struct gsn_refine_compare *c, unsigned threads,
                       struct gsn_refine_equation *ret_equation, double *ret_finest_um,
                       struct gsn_error *err)
{
    size_t finest = 0;
    int r;

    c->equation = ret_equation;
    r = gsn_parallel_for(c->stack->count, threads, measure, c, err);
    if (r < 0)
        return r;
    respond(c);
    for (size_t k = 0; k < c->stack->count; k++)
        bend(c, &c->equation[k]);
    while (finest + 1 < c->rings && c->told[finest + 1] > 0)
        finest++;
    *ret_finest_um = finest > 0 ? (double)c->stack->side * c->stack->cell_um / (double)finest : 0;
    return GSN_OK;
}
