/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/parallel.h"
#include "pipeline/core/robust.h"
#include "pipeline/register/refine_parts.h"

#include <math.h>
#include <string.h>

/* A frequency that the line through the neighbours tells worse than this says nothing. */
static const double LEAST_TOLD = 0.15;
/* What sections and their lines share by chance stays below so many of its deviations. Two
 * neighbours meet twice, each in the other's line. */
static const double CHANCE = 4 * M_SQRT2;
/* Median of an exponential distribution with mean 1: the power in one frequency. */
static const double MEDIAN_POWER = 0.6931;

void gsn_refine_room_done(struct gsn_refine_room *room)
{
    gsn_free(room->plane);
    gsn_free(room->gradient[0]);
    gsn_free(room->gradient[1]);
    gsn_free(room->scratch);
    gsn_free(room->pairs);
    for (size_t p = 0; p < PARTS; p++)
        gsn_free(room->column[p]);
}

int gsn_refine_room_init(const struct gsn_refine_compare *c, struct gsn_refine_room *room,
                         struct gsn_error *err)
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

double gsn_refine_product(const float *a, const float *b)
{
    return (double)a[0] * b[0] + (double)a[1] * b[1];
}

/* The transform of the section as it is filled; of its line; of what it is off the line by, weighed
 * as that is from place to place. */
enum what { SECTION, LINE, OFF };

static void transform(const struct gsn_refine_compare *c, size_t k, enum what what,
                      struct gsn_refine_room *room, float *ret_pairs)
{
    for (size_t i = 0, at = k * c->cells; i < c->cells; i++, at++) {
        const float off = isnan(c->laid[at]) ? 0 : (c->laid[at] - c->line[at]) * c->even[at];
        const float value = what == SECTION ? c->filled[at] : what == LINE ? c->line[at] : off;

        room->plane[i] = value * c->taper[i];
    }
    gsn_waves_of(&c->waves, room->plane, room->scratch, ret_pairs);
}

static void add_common(const struct gsn_refine_compare *c, const float *section, const float *line,
                       struct gsn_refine_common *common)
{
    for (size_t i = 0; i < c->pairs; i++) {
        const size_t ring = gsn_waves_ring(&c->waves, i);
        const float *a = section + 2 * i, *b = line + 2 * i;

        if (ring >= c->rings)
            continue;
        common[ring].both += gsn_refine_product(a, b);
        common[ring].line += gsn_refine_product(b, b);
        common[ring].section += gsn_refine_product(a, a);
        common[ring].frequencies++;
    }
}

static int look(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_compare *c = context;
    struct gsn_refine_common *common = c->common + k * c->rings;
    struct gsn_refine_room room = { 0 };
    int r;

    memset(common, 0, c->rings * sizeof *common);
    if (!c->faced[k])
        return GSN_OK;
    r = gsn_refine_room_init(c, &room, err);
    if (r >= 0) {
        transform(c, k, SECTION, &room, room.column[0]);
        transform(c, k, LINE, &room, room.column[1]);
        transform(c, k, OFF, &room, c->wave + 2 * k * c->pairs);
        add_common(c, room.column[0], room.column[1], common);
    }
    gsn_refine_room_done(&room);
    return r;
}

/* How much of a line's value at this wavelength the sections show themselves: their regression on
 * their lines, in which no section takes part in its own line. What neighbours share falls with the
 * wavelength; where it once says nothing, finer ones do not either. */
static void believe(struct gsn_refine_compare *c)
{
    double most = 1;

    for (size_t ring = 1; ring < c->rings; ring++) {
        struct gsn_refine_common s = { 0 };
        double told;

        for (size_t k = 0; k < c->stack->count; k++) {
            const struct gsn_refine_common *of = &c->common[k * c->rings + ring];

            s.both += of->both;
            s.line += of->line;
            s.section += of->section;
            s.frequencies += of->frequencies;
        }
        told = s.line > 0 ? s.both / s.line : 0;
        if (s.both < CHANCE * sqrt(s.line * s.section / (s.frequencies + 1)) || told < LEAST_TOLD)
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

                    c->room[n++] = gsn_refine_product(at, at);
                }
        c->noise[ring] = n > 0 ? gsn_median(c->room, n) / MEDIAN_POWER : 0;
    }
    /* The sections' means were taken off, so the lowest frequencies look better known than they
     * are. */
    c->noise[1] = fmax(c->noise[1], c->noise[2]);
    c->noise[0] = c->noise[1];
}

int gsn_refine_believe(struct gsn_refine_compare *c, unsigned threads, struct gsn_error *err)
{
    const int r = gsn_parallel_for(c->stack->count, threads, look, c, err);

    if (r < 0)
        return r;
    believe(c);
    learn_noise(c);
    return GSN_OK;
}
