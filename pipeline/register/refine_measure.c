/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/parallel.h"
#include "pipeline/register/median.h"
#include "pipeline/register/refine_parts.h"
#include "pipeline/register/small.h"

#include <math.h>
#include <string.h>

/* A frequency that the line through the neighbours tells worse than this says nothing. */
static const double LEAST_TOLD = 0.15;
/* Power that neighbours share by chance stays below so many of its deviations. */
static const double CHANCE = 4;
/* Median of an exponential distribution with mean 1: the power in one frequency. */
static const double MEDIAN_POWER = 0.6931;

/* Room of one section's thread. */
struct room {
    float *plane, *gradient[2], *scratch, *pairs, *column[PARTS];
};

static void room_done(struct room *room)
{
    gsn_free(room->plane);
    gsn_free(room->gradient[0]);
    gsn_free(room->gradient[1]);
    gsn_free(room->scratch);
    gsn_free(room->pairs);
    for (size_t p = 0; p < PARTS; p++)
        gsn_free(room->column[p]);
}

static int room_init(const struct gsn_refine_compare *c, struct room *room, struct gsn_error *err)
{
    const size_t pairs = 2 * c->pairs;
    int full;

    room->plane = gsn_alloc_array(c->cells, sizeof *room->plane);
    room->gradient[0] = gsn_alloc_array(c->cells, sizeof *room->plane);
    room->gradient[1] = gsn_alloc_array(c->cells, sizeof *room->plane);
    room->scratch = gsn_alloc_array(2 * c->stack->side * c->rings, sizeof *room->scratch);
    room->pairs = gsn_alloc_array(pairs, sizeof *room->pairs);
    full = room->plane && room->gradient[0] && room->gradient[1] && room->scratch && room->pairs;
    for (size_t p = 0; p < PARTS; p++) {
        room->column[p] = gsn_alloc_array(pairs, sizeof *room->column[p]);
        full = full && room->column[p];
    }
    return full ? GSN_OK
                : gsn_fail(err, GSN_E_NOMEM, "out of memory to compare the sections' tissue");
}

/* The transform of one section, or of what it differs by from the line. */
static int transform(struct gsn_refine_compare *c, size_t k, int difference, struct gsn_error *err)
{
    struct room room = { 0 };
    int r = room_init(c, &room, err);

    for (size_t i = 0, at = k * c->cells; r >= 0 && i < c->cells; i++, at++) {
        const float laid = c->laid[at];
        const float value = !difference ? c->filled[at] : isnan(laid) ? 0 : laid - c->line[at];

        room.plane[i] = value * c->taper[i];
    }
    if (r >= 0)
        gsn_waves_of(&c->waves, room.plane, room.scratch, c->wave + 2 * k * c->pairs);
    room_done(&room);
    return r;
}

static int transform_section(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_compare *c = context;

    return c->there[k] ? transform(c, k, 0, err) : GSN_OK;
}

static int transform_difference(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_compare *c = context;

    return c->faced[k] ? transform(c, k, 1, err) : GSN_OK;
}

static double product(const float *a, const float *b)
{
    return (double)a[0] * b[0] + (double)a[1] * b[1];
}

/* What a ring holds of all sections and of neighbours together, and how many frequencies of it
 * there are. */
struct shared {
    double power, common, pairs, powers;
};

static struct shared share(const struct gsn_refine_compare *c, size_t ring)
{
    struct shared s = { 0 };
    size_t last = c->stack->count;

    for (size_t k = 0; k < c->stack->count; k++) {
        const float *wave = c->wave + 2 * k * c->pairs;

        if (!c->there[k])
            continue;
        for (size_t i = 0; i < c->pairs; i++) {
            if (gsn_waves_ring(&c->waves, i) != ring)
                continue;
            s.power += product(wave + 2 * i, wave + 2 * i);
            s.powers++;
            if (last == c->stack->count)
                continue;
            s.common += product(wave + 2 * i, c->wave + 2 * (last * c->pairs + i));
            s.pairs++;
        }
        last = k;
    }
    return s;
}

/* Sections that a line counts for. */
static double worth_of_line(const struct gsn_refine_compare *c)
{
    double square = 0, n = 0;

    for (size_t k = 0; k < c->stack->count; k++) {
        double weight[2 * AROUND + 1];

        if (!c->faced[k])
            continue;
        gsn_refine_line(c->stack, c->there, k, weight);
        for (size_t j = 0; j <= 2 * AROUND; j++)
            square += weight[j] * weight[j];
        n++;
    }
    return n > 0 ? n / square : 1;
}

/* Wiener's share: how much of a line's value at this wavelength is the tissue's. What neighbours
 * share falls with the wavelength; where it once says nothing, finer ones do not either. */
static void believe(struct gsn_refine_compare *c)
{
    const double worth = worth_of_line(c);
    double most = 1;

    for (size_t ring = 1; ring < c->rings; ring++) {
        const struct shared s = share(c, ring);
        const double power = s.powers > 0 ? s.power / s.powers : 0;
        const double common = s.pairs > 0 ? fmax(s.common / s.pairs, 0) : 0;
        const double alone = fmax(power - common, 0.02 * power);
        double told = power > 0 ? common / (common + alone / worth) : 0;

        if (common < CHANCE * power / sqrt(s.pairs + 1) || told < LEAST_TOLD)
            told = 0;
        most = fmin(most, told);
        c->told[ring] = most;
    }
    c->told[0] = c->told[1];
}

static void learn_noise(struct gsn_refine_compare *c)
{
    for (size_t ring = 1; ring < c->rings; ring++) {
        size_t n = 0;

        for (size_t k = 0; k < c->stack->count; k++)
            for (size_t i = 0; c->faced[k] && i < c->pairs; i++)
                if (gsn_waves_ring(&c->waves, i) == ring) {
                    const float *at = c->wave + 2 * (k * c->pairs + i);

                    c->room[n++] = product(at, at);
                }
        c->noise[ring] = n > 0 ? gsn_median(c->room, n) / MEDIAN_POWER : 0;
    }
    /* The sections' means were taken off, so the lowest frequencies look better known than they
     * are. */
    c->noise[1] = fmax(c->noise[1], c->noise[2]);
    c->noise[0] = c->noise[1];
}

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
static void smooth_line(const struct gsn_refine_compare *c, size_t k, struct room *room)
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
static void slopes(const struct gsn_refine_compare *c, size_t k, struct room *room)
{
    const size_t side = c->stack->side;

    for (size_t i = 0; i < c->cells; i++) {
        const size_t x = i % side, y = i / side;
        const float weight =
            c->taper[i] * c->weight[k * c->cells + i] / (2 * (float)c->stack->cell_um);

        if (x == 0 || y == 0 || x + 1 == side || y + 1 == side) {
            room->gradient[0][i] = room->gradient[1][i] = 0;
            continue;
        }
        room->gradient[0][i] = weight * (room->plane[i + 1] - room->plane[i - 1]);
        room->gradient[1][i] = weight * (room->plane[i + side] - room->plane[i - side]);
    }
}

static void transform_columns(const struct gsn_refine_compare *c, struct room *room)
{
    const size_t side = c->stack->side;

    for (size_t p = 0; p < PARTS; p++) {
        for (size_t i = 0; i < c->cells; i++) {
            double bx[PARTS], by[PARTS];

            gsn_refine_basis(c->stack, (double)(i % side), (double)(i / side), bx, by);
            room->plane[i] = (float)(bx[p] * room->gradient[0][i] + by[p] * room->gradient[1][i]);
        }
        gsn_waves_of(&c->waves, room->plane, room->scratch, room->column[p]);
    }
}

static void sum_up(const struct gsn_refine_compare *c, const struct room *room, double even,
                   struct gsn_refine_equation *to)
{
    for (size_t i = 0; i < c->pairs; i++) {
        const size_t ring = gsn_waves_ring(&c->waves, i);
        double worth;

        if (ring >= c->rings || !(c->told[ring] > 0) || !(c->noise[ring] > 0))
            continue;
        worth = even * gsn_waves_times(&c->waves, i) / c->noise[ring];
        for (size_t p = 0; p < PARTS; p++) {
            const float *column = room->column[p] + 2 * i;

            to->right[p] += worth * product(column, room->pairs + 2 * i);
            for (size_t q = 0; q < PARTS; q++)
                to->information[p][q] += worth * product(column, room->column[q] + 2 * i);
        }
    }
}

static int measure(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_compare *c = context;
    struct room room = { 0 };
    int r = GSN_OK;

    c->equation[k] = (struct gsn_refine_equation){ 0 };
    if (!c->faced[k] || !(c->told[1] > 0))
        return GSN_OK;
    r = room_init(c, &room, err);
    if (r >= 0) {
        gsn_auto_mem(float) left = gsn_alloc_array(c->cells, sizeof *left);

        if (!left) {
            room_done(&room);
            return gsn_fail(err, GSN_E_NOMEM, "out of memory to compare the sections' tissue");
        }
        smooth_line(c, k, &room);
        slopes(c, k, &room);
        for (size_t i = 0, at = k * c->cells; i < c->cells; i++, at++)
            left[i] = isnan(c->laid[at])
                          ? 0
                          : (room.plane[i] - c->laid[at]) * c->taper[i] * c->weight[at];
        transform_columns(c, &room);
        gsn_waves_of(&c->waves, left, room.scratch, room.pairs);
        sum_up(c, &room, evenness(c), &c->equation[k]);
    }
    room_done(&room);
    return r;
}

int gsn_refine_measure(struct gsn_refine_compare *c, unsigned threads,
                       struct gsn_refine_equation *ret_equation, double *ret_finest_um,
                       struct gsn_error *err)
{
    const size_t count = c->stack->count;
    size_t finest = 0;
    int r = gsn_parallel_for(count, threads, transform_section, c, err);

    if (r < 0)
        return r;
    believe(c);
    r = gsn_parallel_for(count, threads, transform_difference, c, err);
    if (r < 0)
        return r;
    learn_noise(c);
    c->equation = ret_equation;
    r = gsn_parallel_for(count, threads, measure, c, err);
    while (finest + 1 < c->rings && c->told[finest + 1] > 0)
        finest++;
    *ret_finest_um = finest > 0 ? (double)c->stack->side * c->stack->cell_um / (double)finest : 0;
    return r;
}
