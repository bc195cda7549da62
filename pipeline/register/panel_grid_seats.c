/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel_grid_parts.h"

#include "pipeline/core/mem.h"
#include "pipeline/register/assign.h"

#include <limits.h>
#include <math.h>
#include <string.h>

/* Something of a section's size that is no section: a label, a thirteenth scrap. One in a thousand,
 * and it may lie anywhere on a panel of a hundred times the square of what a hand is off. */
static const double STRANGER = 12;
/* The same for a part of something larger than a section. */
static const double LOOSE_STRANGER = 4;
/* A row or column left empty between others; outer ones are left empty for want of sections. */
static const double EMPTY_BETWEEN = 1.5;
/* In pitches: a slot's centre lies half a pitch from the border of the panel, or a little less
 * where the picture is cut close. Nothing is too near: a pitch told by few sections puts an outer
 * line nearer to the border than it is. */
static const double MARGIN = 0.5, MARGIN_SD = 0.1;
/* Panels are made full: logarithm of the pitch there is room for, over the pitch. Pitches along and
 * across are alike: logarithm of their ratio. */
static const double FULL_SD = 0.25, ALIKE_SD = 0.3;
/* A panel lies against the edge of its holder: 3 degrees. */
static const double TURN_SD = 0.052;

enum { ROUNDS = 4 };

static double square(double x)
{
    return x * x;
}

double gsn_grid_stranger_cost(const struct gsn_grid_problem *p, size_t i)
{
    return p->ground->loose && p->ground->loose[i] ? LOOSE_STRANGER : STRANGER;
}

double gsn_grid_seat_cost(const struct gsn_grid_problem *p, const struct gsn_panel_grid *grid,
                          size_t i, int place)
{
    const struct gsn_point at = gsn_panel_grid_centre(grid, place);

    return (square(p->centre[i].x - at.x) + square(p->centre[i].y - at.y)) / 2 / square(p->hand);
}

/* How near an empty line of slots comes to the border of the panel; where sections lie in it, the
 * picture may well end in the middle of them. */
static double margin_cost(double margin, double pitch)
{
    const double lack = MARGIN - margin / pitch;

    return lack > 0 ? square(lack / MARGIN_SD) / 2 : 0;
}

static int is_used(const struct gsn_grid_answer *a, size_t count, int along_x, unsigned line)
{
    for (size_t i = 0; i < count; i++) {
        const unsigned columns = a->grid.columns, place = (unsigned)a->place[i];

        if (a->place[i] != GSN_NO_PLACE && (along_x ? place % columns : place / columns) == line)
            return 1;
    }
    return 0;
}

static double empty_between(const struct gsn_grid_answer *a, size_t count, int along_x,
                            unsigned lines)
{
    unsigned least = lines, most = 0, used = 0;

    for (unsigned line = 0; line < lines; line++) {
        if (!is_used(a, count, along_x, line))
            continue;
        least = least < line ? least : line;
        most = line;
        used++;
    }
    return used > 0 ? EMPTY_BETWEEN * (most - least + 1 - used) : 0;
}

struct span {
    double low, high;
};

static struct span line_span(const struct gsn_grid_answer *a, int along_x, unsigned line)
{
    const struct gsn_panel_grid *g = &a->grid;
    const unsigned from = along_x ? line : line * g->columns;
    const unsigned to = from + (along_x ? (g->rows - 1) * g->columns : g->columns - 1);
    const struct gsn_point p = gsn_panel_grid_centre(g, (int)from),
                           q = gsn_panel_grid_centre(g, (int)to);

    return along_x ? (struct span){ fmin(p.x, q.x), fmax(p.x, q.x) }
                   : (struct span){ fmin(p.y, q.y), fmax(p.y, q.y) };
}

/* What is known of panels along one axis before one looks at the sections. */
static double axis_prior(const struct gsn_grid_problem *p, const struct gsn_grid_answer *a,
                         int along_x)
{
    const unsigned lines = along_x ? p->ground->columns : p->ground->rows;
    const double length = along_x ? p->ground->width : p->ground->height;
    const double pitch = along_x ? a->grid.pitch_x : a->grid.pitch_y;
    double cost;

    if (lines == 1)
        return 0;
    cost = square(log(length / lines / pitch) / FULL_SD) / 2 +
           empty_between(a, p->count, along_x, lines);
    if (!is_used(a, p->count, along_x, 0))
        cost += margin_cost(line_span(a, along_x, 0).low, pitch);
    if (!is_used(a, p->count, along_x, lines - 1))
        cost += margin_cost(length - line_span(a, along_x, lines - 1).high, pitch);
    return cost;
}

static double prior_cost(const struct gsn_grid_problem *p, const struct gsn_grid_answer *a)
{
    double cost = square(a->grid.turn / TURN_SD) / 2 + axis_prior(p, a, 1) + axis_prior(p, a, 0);

    if (p->ground->rows > 1 && p->ground->columns > 1)
        cost += square(log(a->grid.pitch_x / a->grid.pitch_y) / ALIKE_SD) / 2;
    return cost;
}

/* Each centre to the slot that costs it least, when no two want the same one: then that is the best
 * there is. */
static int seat_nearest(const struct gsn_grid_problem *p, struct gsn_grid_answer *a, char *taken)
{
    const int places = (int)(p->ground->rows * p->ground->columns);

    memset(taken, 0, (size_t)places);
    for (size_t i = 0; i < p->count; i++) {
        double least = gsn_grid_stranger_cost(p, i);

        a->place[i] = GSN_NO_PLACE;
        for (int k = 0; k < places; k++) {
            const double cost = gsn_grid_seat_cost(p, &a->grid, i, k);

            if (cost < least) {
                least = cost;
                a->place[i] = k;
            }
        }
        if (a->place[i] == GSN_NO_PLACE)
            continue;
        if (taken[a->place[i]])
            return 0;
        taken[a->place[i]] = 1;
    }
    return 1;
}

static int seat_all(const struct gsn_grid_problem *p, struct gsn_grid_answer *a,
                    struct gsn_error *err)
{
    const size_t places = (size_t)p->ground->rows * p->ground->columns;
    gsn_auto_mem(char) taken = gsn_alloc_array(places, 1);
    gsn_auto_mem(double) cost = NULL;
    size_t wide = places + p->count;
    int r;

    if (!taken)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the slots of a panel");
    if (seat_nearest(p, a, taken))
        return GSN_OK;
    cost = gsn_alloc_array(p->count * wide, sizeof *cost);
    if (!cost)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the slots of a panel");
    for (size_t i = 0; i < p->count; i++)
        for (size_t k = 0; k < wide; k++)
            cost[i * wide + k] = k < places ? gsn_grid_seat_cost(p, &a->grid, i, (int)k)
                                            : gsn_grid_stranger_cost(p, i);
    r = gsn_assign(cost, p->count, wide, a->place, err);
    for (size_t i = 0; r >= 0 && i < p->count; i++)
        if (a->place[i] >= (int)places ||
            gsn_grid_seat_cost(p, &a->grid, i, a->place[i]) > gsn_grid_stranger_cost(p, i))
            a->place[i] = GSN_NO_PLACE;
    return r;
}

struct sums {
    double n, u, v, x, y;
};

static struct sums mean_seat(const struct gsn_grid_problem *p, const struct gsn_grid_answer *a)
{
    struct sums s = { 0 };

    for (size_t i = 0; i < p->count; i++) {
        if (a->place[i] == GSN_NO_PLACE)
            continue;
        s.n++;
        s.u += (double)((unsigned)a->place[i] % a->grid.columns);
        s.v += (double)((unsigned)a->place[i] / a->grid.columns);
        s.x += p->centre[i].x;
        s.y += p->centre[i].y;
    }
    if (s.n > 0)
        s = (struct sums){ s.n, s.u / s.n, s.v / s.n, s.x / s.n, s.y / s.n };
    return s;
}

/* Pitches for this turn, then the turn for these pitches, least squares both; the turn is drawn to
 * 0 by what is known of holders. Sections in one line alone borrow the other pitch. */
static void lay_pitches(const struct gsn_grid_problem *p, struct gsn_grid_answer *a,
                        const struct sums *mean)
{
    const double c = cos(a->grid.turn), s = sin(a->grid.turn);
    double uu = 0, vv = 0, ux = 0, vy = 0, cross = 0;
    double dot = square(p->hand / TURN_SD);

    for (size_t i = 0; i < p->count; i++) {
        const double dx = p->centre[i].x - mean->x, dy = p->centre[i].y - mean->y;
        double u, v;

        if (a->place[i] == GSN_NO_PLACE)
            continue;
        u = (double)((unsigned)a->place[i] % a->grid.columns) - mean->u;
        v = (double)((unsigned)a->place[i] / a->grid.columns) - mean->v;
        uu += u * u;
        vv += v * v;
        ux += u * (c * dx + s * dy);
        vy += v * (c * dy - s * dx);
        cross += u * a->grid.pitch_x * dy - v * a->grid.pitch_y * dx;
        dot += u * a->grid.pitch_x * dx + v * a->grid.pitch_y * dy;
    }
    if (uu > 0)
        a->grid.pitch_x = ux / uu;
    if (vv > 0)
        a->grid.pitch_y = vy / vv;
    if (!(uu > 0) && vv > 0)
        a->grid.pitch_x = a->grid.pitch_y;
    if (!(vv > 0) && uu > 0)
        a->grid.pitch_y = a->grid.pitch_x;
    a->grid.turn = atan2(cross, dot);
}

static void lay_grid(const struct gsn_grid_problem *p, struct gsn_grid_answer *a)
{
    const struct sums mean = mean_seat(p, a);
    struct gsn_point shift;

    if (!(mean.n > 0))
        return;
    lay_pitches(p, a, &mean);
    a->grid.first = (struct gsn_point){ 0, 0 };
    shift = (struct gsn_point){ mean.u * a->grid.pitch_x, mean.v * a->grid.pitch_y };
    a->grid.first.x = mean.x - cos(a->grid.turn) * shift.x + sin(a->grid.turn) * shift.y;
    a->grid.first.y = mean.y - sin(a->grid.turn) * shift.x - cos(a->grid.turn) * shift.y;
}

static double cost_of(const struct gsn_grid_problem *p, const struct gsn_grid_answer *a)
{
    double cost = 0;
    int first = INT_MAX;

    for (size_t i = 0; i < p->count; i++) {
        cost += a->place[i] == GSN_NO_PLACE ? gsn_grid_stranger_cost(p, i)
                                            : gsn_grid_seat_cost(p, &a->grid, i, a->place[i]);
        if (a->place[i] != GSN_NO_PLACE && a->place[i] < first)
            first = a->place[i];
    }
    if (!(a->grid.pitch_x >= GSN_GRID_PITCH_LEAST * p->ground->size * 0.95) ||
        !(a->grid.pitch_y >= GSN_GRID_PITCH_LEAST * p->ground->size * 0.95))
        return INFINITY;
    if (p->ground->first != GSN_NO_PLACE && first != p->ground->first)
        return INFINITY;
    return cost + prior_cost(p, a);
}

/* From a first guess to the grid and the assignment that suit each other. */
int gsn_grid_settle(const struct gsn_grid_problem *p, struct gsn_grid_answer *a,
                    struct gsn_error *err)
{
    for (int round = 0; round < ROUNDS; round++) {
        const int r = seat_all(p, a, err);

        if (r < 0)
            return r;
        lay_grid(p, a);
        if (!(a->grid.pitch_x > 0) || !(a->grid.pitch_y > 0))
            break;
    }
    a->cost = cost_of(p, a);
    return GSN_OK;
}
