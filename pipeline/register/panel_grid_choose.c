/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel_grid_parts.h"

#include "pipeline/core/mem.h"

#include <math.h>
#include <string.h>

/* Odds of 100 to 1: less is doubt. */
static const double CLEAR = 4.6;

static size_t differ(const struct gsn_grid_answer *a, const struct gsn_grid_answer *b, size_t count)
{
    size_t n = 0;

    for (size_t i = 0; i < count; i++)
        n += a->place[i] != b->place[i];
    return n;
}

/* Notes where a grid that is nearly as good has the centres: few that differ are doubtful. */
static void note_rival(const struct gsn_grid_answer *rival, const struct gsn_grid_answer *best,
                       size_t count, struct gsn_panel_seat *seat)
{
    for (size_t i = 0; i < count; i++)
        if (rival->place[i] != best->place[i] && rival->place[i] != GSN_NO_PLACE)
            seat[i].other = rival->place[i];
}

/* What another centre would pay to make room, by moving to where it costs it least. */
static double room_cost(const struct gsn_grid_problem *p, const struct gsn_grid_answer *a,
                        int place, int freed, size_t mover)
{
    const int places = (int)(p->ground->rows * p->ground->columns);

    for (size_t j = 0; j < p->count; j++) {
        double least = gsn_grid_stranger_cost(p, j);

        if (j == mover || a->place[j] != place)
            continue;
        for (int k = 0; k < places; k++) {
            int is_free = k == freed || k != place;

            for (size_t l = 0; is_free && k != freed && l < p->count; l++)
                is_free = a->place[l] != k;
            if (is_free)
                least = fmin(least, gsn_grid_seat_cost(p, &a->grid, j, k));
        }
        return least - gsn_grid_seat_cost(p, &a->grid, j, place);
    }
    return 0;
}

/* A section between two slots is doubtful where the second costs little more, all paid. */
static void doubt_seats(const struct gsn_grid_problem *p, const struct gsn_grid_answer *a,
                        struct gsn_panel_seat *seat)
{
    const int places = (int)(p->ground->rows * p->ground->columns);

    for (size_t i = 0; i < p->count; i++) {
        double least = CLEAR;
        double own;

        if (a->place[i] == GSN_NO_PLACE)
            continue;
        own = gsn_grid_seat_cost(p, &a->grid, i, a->place[i]);
        for (int k = 0; k < places; k++) {
            const double more = gsn_grid_seat_cost(p, &a->grid, i, k) - own;

            if (k == a->place[i] || more >= least ||
                more + room_cost(p, a, k, a->place[i], i) >= least)
                continue;
            least = more;
            seat[i].other = k;
        }
    }
}

/* The section that both grids have and that comes first on the panel. */
static size_t first_of(const struct gsn_grid_answer *a, const struct gsn_grid_answer *b,
                       size_t count)
{
    size_t first = count;

    for (size_t i = 0; i < count; i++)
        if (a->place[i] != GSN_NO_PLACE && b->place[i] != GSN_NO_PLACE &&
            (first == count || a->place[i] < a->place[first]))
            first = i;
    return first;
}

static int undecided(const struct gsn_grid_problem *p, const struct gsn_grid_answer *best,
                     const struct gsn_grid_answer *rival, struct gsn_error *err)
{
    const size_t i = first_of(best, rival, p->count);
    unsigned a, b;

    if (i == p->count)
        return gsn_fail(err, GSN_E_WITHHELD,
                        "which %u x %u slots the %zu pieces on it lie in cannot be told: look at "
                        "the glass, and mount it again",
                        p->ground->rows, p->ground->columns, p->count);
    a = p->ground->slot[best->place[i]] + 1;
    b = p->ground->slot[rival->place[i]] + 1;
    return gsn_fail(err, GSN_E_WITHHELD,
                    "the sections found (%zu) fit %u x %u slots in two ways, and which cannot be "
                    "told: the first of them lies in slot %u or in slot %u; look at the glass and "
                    "say in which",
                    p->count, p->ground->rows, p->ground->columns, a < b ? a : b, a < b ? b : a);
}

static size_t count_strangers(const struct gsn_grid_problem *p, const struct gsn_grid_answer *a)
{
    size_t count = 0;

    for (size_t i = 0; i < p->count; i++)
        count += a->place[i] == GSN_NO_PLACE && !(p->ground->loose && p->ground->loose[i]);
    return count;
}

static int no_room(const struct gsn_grid_problem *p, const struct gsn_grid_answer *best,
                   struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT,
                    "%zu of %zu sections found fit no slot of a layout of %u x %u: correct "
                    "\"layout\" in job.json and import it again, or mount the panel again",
                    count_strangers(p, best), p->count, p->ground->rows, p->ground->columns);
}

/* A label, or a scrap as large as a section, is a stranger among many. */
static int has_room(const struct gsn_grid_problem *p, const struct gsn_grid_answer *best)
{
    const size_t strangers = count_strangers(p, best);

    return isfinite(best->cost) && (strangers <= 1 || 4 * strangers <= p->count);
}

int gsn_grid_choose(const struct gsn_grid_problem *p, const struct gsn_grid_answer *answers,
                    size_t number, struct gsn_panel_grid *ret_grid, struct gsn_panel_seat *ret_seat,
                    struct gsn_error *err)
{
    const struct gsn_grid_answer *best = &answers[0], *rival = NULL;
    gsn_auto_mem(struct gsn_panel_seat) seat = gsn_alloc_array(p->count, sizeof *seat);

    if (!seat)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the slots of a panel");
    for (size_t k = 1; k < number; k++)
        if (answers[k].cost < best->cost)
            best = &answers[k];
    if (!has_room(p, best))
        return no_room(p, best, err);
    for (size_t i = 0; i < p->count; i++)
        seat[i] = (struct gsn_panel_seat){ best->place[i], GSN_NO_PLACE };
    doubt_seats(p, best, seat);
    for (size_t k = 0; k < number; k++) {
        const struct gsn_grid_answer *other = &answers[k];

        if (!(other->cost - best->cost < CLEAR))
            continue;
        if (2 * differ(other, best, p->count) >= p->count && (!rival || other->cost < rival->cost))
            rival = other;
        note_rival(other, best, p->count, seat);
    }
    if (rival)
        return undecided(p, best, rival, err);
    *ret_grid = best->grid;
    memcpy(ret_seat, seat, p->count * sizeof *seat);
    return GSN_OK;
}
