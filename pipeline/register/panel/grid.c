/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: maximum a posteriori fit of a regular grid, with the assignment of sections to slots in
 * it (Kuhn's Hungarian method, core/assignment.h).
 *
 * Steps. 1. find_axes(): along x and along y each, every pitch in steps of a twentieth and every
 * place in steps of a tenth of it is scored; of those that put the centres into the same lines the
 * best is kept, a dozen in all. 2. fit_answer(): for each pair of axes, centres are assigned to
 * slots and the grid is fitted to the assignment by least squares, in turn. 3. gsn_panel_grid_fit()
 * takes the answer of the least cost, notes for each section the slot that it could lie in nearly
 * as well, and refuses where a grid that most sections would lie differently in costs less than 4.6
 * nats more (odds of 100 to 1).
 *
 * Fails when two grids explain the centres nearly as well (GSN_E_WITHHELD), when the layout has no
 * room for them (GSN_E_INPUT), and when memory runs out. Cost: at most 144 small fits. */
#include "pipeline/register/panel/grid.h"

#include "pipeline/core/assignment.h"
#include "pipeline/core/mem.h"

#include <assert.h>
#include <limits.h>
#include <math.h>
#include <string.h>

/* Sections would overlap below this pitch, in sizes of a section. */
#define PITCH_MIN 0.9

/* Axes that are kept of each direction. */
enum { AXES = 12 };

struct problem {
    const struct gsn_point *centre;
    size_t count;
    const struct gsn_grid_prior *prior;
    double hand; /* what a section is off its slot's centre, along each axis */
};

/* Evenly spaced lines in one direction. */
struct axis {
    double first, pitch, cost;
};

struct answer {
    struct gsn_panel_grid grid;
    double cost;
    int *place; /* one for each centre */
};

/* What a hand is off, in sizes of a section and along each axis: most sections lie within a quarter
 * of their own size, and half a pitch is three times that. */
static const double HAND = 0.25;
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

static double square_of(double x)
{
    return x * x;
}

static struct gsn_point slot_centre(const struct gsn_panel_grid *grid, int place)
{
    const double x = (double)((unsigned)place % grid->columns) * grid->pitch_x;
    const double y = (double)((unsigned)place / grid->columns) * grid->pitch_y;
    const double c = cos(grid->turn), s = sin(grid->turn);

    return (struct gsn_point){ grid->first.x + c * x - s * y, grid->first.y + s * x + c * y };
}

int gsn_panel_grid_place(const struct gsn_panel_grid *grid, struct gsn_point at)
{
    const double dx = at.x - grid->first.x, dy = at.y - grid->first.y;
    const double c = cos(grid->turn), s = sin(grid->turn);
    const double column = round((c * dx + s * dy) / grid->pitch_x);
    const double row = round((c * dy - s * dx) / grid->pitch_y);

    if (!(column >= 0 && column < grid->columns && row >= 0 && row < grid->rows))
        return GSN_NO_PLACE;
    return (int)row * (int)grid->columns + (int)column;
}

/* ---- what an answer costs ----------------------------------------------------------------------
 */

/* What it costs that a centre is no section's. */
static double stranger_cost(const struct problem *p, size_t i)
{
    return p->prior->loose && p->prior->loose[i] ? LOOSE_STRANGER : STRANGER;
}

/* What it costs that centre i lies in a place. */
static double slot_cost(const struct problem *p, const struct gsn_panel_grid *grid, size_t i,
                        int place)
{
    const struct gsn_point at = slot_centre(grid, place);

    return (square_of(p->centre[i].x - at.x) + square_of(p->centre[i].y - at.y)) / 2 /
           square_of(p->hand);
}

/* How near an empty line of slots comes to the border of the panel; where sections lie in it, the
 * picture may well end in the middle of them. */
static double margin_cost(double margin, double pitch)
{
    const double lack = MARGIN - margin / pitch;

    return lack > 0 ? square_of(lack / MARGIN_SD) / 2 : 0;
}

static int is_used(const struct answer *a, size_t count, int along_x, unsigned line)
{
    for (size_t i = 0; i < count; i++) {
        const unsigned columns = a->grid.columns, place = (unsigned)a->place[i];

        if (a->place[i] != GSN_NO_PLACE && (along_x ? place % columns : place / columns) == line)
            return 1;
    }
    return 0;
}

static double empty_lines_cost(const struct answer *a, size_t count, int along_x, unsigned lines)
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

static struct span line_span(const struct answer *a, int along_x, unsigned line)
{
    const struct gsn_panel_grid *g = &a->grid;
    const unsigned from = along_x ? line : line * g->columns;
    const unsigned to = from + (along_x ? (g->rows - 1) * g->columns : g->columns - 1);
    const struct gsn_point p = slot_centre(g, (int)from), q = slot_centre(g, (int)to);

    return along_x ? (struct span){ fmin(p.x, q.x), fmax(p.x, q.x) }
                   : (struct span){ fmin(p.y, q.y), fmax(p.y, q.y) };
}

/* What is known of panels along one axis before one looks at the sections. */
static double axis_prior(const struct problem *p, const struct answer *a, int along_x)
{
    const unsigned lines = along_x ? p->prior->columns : p->prior->rows;
    const double length = along_x ? p->prior->width : p->prior->height;
    const double pitch = along_x ? a->grid.pitch_x : a->grid.pitch_y;
    double cost;

    if (lines == 1)
        return 0;
    cost = square_of(log(length / lines / pitch) / FULL_SD) / 2 +
           empty_lines_cost(a, p->count, along_x, lines);
    if (!is_used(a, p->count, along_x, 0))
        cost += margin_cost(line_span(a, along_x, 0).low, pitch);
    if (!is_used(a, p->count, along_x, lines - 1))
        cost += margin_cost(length - line_span(a, along_x, lines - 1).high, pitch);
    return cost;
}

static double prior_cost(const struct problem *p, const struct answer *a)
{
    double cost = square_of(a->grid.turn / TURN_SD) / 2 + axis_prior(p, a, 1) + axis_prior(p, a, 0);

    if (p->prior->rows > 1 && p->prior->columns > 1)
        cost += square_of(log(a->grid.pitch_x / a->grid.pitch_y) / ALIKE_SD) / 2;
    return cost;
}

/* ---- the grid and the assignment that suit each other -----------------------------------------
 */

/* Each centre to the slot that costs it least, when no two want the same one: then that is the best
 * there is. */
static int assign_nearest(const struct problem *p, struct answer *a, char *taken)
{
    const int places = (int)(p->prior->rows * p->prior->columns);

    memset(taken, 0, (size_t)places);
    for (size_t i = 0; i < p->count; i++) {
        double least = stranger_cost(p, i);

        a->place[i] = GSN_NO_PLACE;
        for (int k = 0; k < places; k++) {
            const double cost = slot_cost(p, &a->grid, i, k);

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

static int assign_all(const struct problem *p, struct answer *a, struct gsn_error *err)
{
    const size_t places = (size_t)p->prior->rows * p->prior->columns;
    gsn_auto_mem(char) taken = gsn_alloc_array(places, 1);
    gsn_auto_mem(double) cost = NULL;
    size_t wide = places + p->count;
    int r;

    if (!taken)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the slots of a panel");
    if (assign_nearest(p, a, taken))
        return GSN_OK;
    cost = gsn_alloc_array(p->count * wide, sizeof *cost);
    if (!cost)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the slots of a panel");
    for (size_t i = 0; i < p->count; i++)
        for (size_t k = 0; k < wide; k++)
            cost[i * wide + k] =
                k < places ? slot_cost(p, &a->grid, i, (int)k) : stranger_cost(p, i);
    r = gsn_assign(cost, p->count, wide, a->place, err);
    for (size_t i = 0; r >= 0 && i < p->count; i++)
        if (a->place[i] >= (int)places ||
            slot_cost(p, &a->grid, i, a->place[i]) > stranger_cost(p, i))
            a->place[i] = GSN_NO_PLACE;
    return r;
}

struct sums {
    double n, u, v, x, y;
};

static struct sums mean_assigned(const struct problem *p, const struct answer *a)
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
static void fit_pitches(const struct problem *p, struct answer *a, const struct sums *mean)
{
    const double c = cos(a->grid.turn), s = sin(a->grid.turn);
    double uu = 0, vv = 0, ux = 0, vy = 0, cross = 0;
    double dot = square_of(p->hand / TURN_SD);

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

static void fit_grid(const struct problem *p, struct answer *a)
{
    const struct sums mean = mean_assigned(p, a);
    struct gsn_point shift;

    if (!(mean.n > 0))
        return;
    fit_pitches(p, a, &mean);
    a->grid.first = (struct gsn_point){ 0, 0 };
    shift = (struct gsn_point){ mean.u * a->grid.pitch_x, mean.v * a->grid.pitch_y };
    a->grid.first.x = mean.x - cos(a->grid.turn) * shift.x + sin(a->grid.turn) * shift.y;
    a->grid.first.y = mean.y - sin(a->grid.turn) * shift.x - cos(a->grid.turn) * shift.y;
}

static double total_cost(const struct problem *p, const struct answer *a)
{
    double cost = 0;
    int first = INT_MAX;

    for (size_t i = 0; i < p->count; i++) {
        cost += a->place[i] == GSN_NO_PLACE ? stranger_cost(p, i)
                                            : slot_cost(p, &a->grid, i, a->place[i]);
        if (a->place[i] != GSN_NO_PLACE && a->place[i] < first)
            first = a->place[i];
    }
    if (!(a->grid.pitch_x >= PITCH_MIN * p->prior->size * 0.95) ||
        !(a->grid.pitch_y >= PITCH_MIN * p->prior->size * 0.95))
        return INFINITY;
    if (p->prior->first != GSN_NO_PLACE && first != p->prior->first)
        return INFINITY;
    return cost + prior_cost(p, a);
}

/* From a first guess to the grid and the assignment that suit each other. Fails with GSN_E_NOMEM.
 */
static int fit_answer(const struct problem *p, struct answer *a, struct gsn_error *err)
{
    for (int round = 0; round < ROUNDS; round++) {
        const int r = assign_all(p, a, err);

        if (r < 0)
            return r;
        fit_grid(p, a);
        if (!(a->grid.pitch_x > 0) || !(a->grid.pitch_y > 0))
            break;
    }
    a->cost = total_cost(p, a);
    return GSN_OK;
}

/* ---- lines along one axis ---------------------------------------------------------------------
 */

/* Every twentieth of a pitch's logarithm, every tenth of a pitch. */
static const double PITCH_STEP = 1.05, PLACE_STEP = 0.1;

static long find_line(const struct axis *axis, unsigned lines, double at)
{
    return lround(fmin(fmax((at - axis->first) / axis->pitch, 0), (double)lines - 1));
}

static double coordinate_of(const struct problem *p, size_t i, int along_x)
{
    return along_x ? p->centre[i].x : p->centre[i].y;
}

static double axis_cost(const struct problem *p, int along_x, unsigned lines, struct axis *axis)
{
    double cost = 0;

    for (size_t i = 0; i < p->count; i++) {
        const double at = coordinate_of(p, i, along_x);
        const double off = at - axis->first - (double)find_line(axis, lines, at) * axis->pitch;

        cost += fmin(square_of(off / p->hand) / 2, stranger_cost(p, i));
    }
    return cost;
}

static int same_lines(const struct problem *p, int along_x, unsigned lines, const struct axis *a,
                      const struct axis *b)
{
    for (size_t i = 0; i < p->count; i++) {
        const double at = coordinate_of(p, i, along_x);

        if (find_line(a, lines, at) != find_line(b, lines, at))
            return 0;
    }
    return 1;
}

/* Puts an axis among the best few, which are sorted; of those with the same lines the best stays.
 */
static void keep_axis(const struct problem *p, int along_x, unsigned lines, struct axis *kept,
                      size_t *count, const struct axis *axis)
{
    size_t at = *count;

    for (size_t k = 0; k < *count; k++) {
        if (!same_lines(p, along_x, lines, &kept[k], axis))
            continue;
        if (kept[k].cost <= axis->cost)
            return;
        memmove(&kept[k], &kept[k + 1], (*count - k - 1) * sizeof *kept);
        at = --*count;
        break;
    }
    while (at > 0 && kept[at - 1].cost > axis->cost)
        at--;
    if (at == AXES)
        return;
    if (*count < AXES)
        ++*count;
    memmove(&kept[at + 1], &kept[at], (*count - at - 1) * sizeof *kept);
    kept[at] = *axis;
}

/* The best few that put the centres into different lines, best first; their number. */
static size_t find_axes(const struct problem *p, int along_x, struct axis kept[AXES])
{
    const unsigned lines = along_x ? p->prior->columns : p->prior->rows;
    const double length = along_x ? p->prior->width : p->prior->height;
    const double most = lines > 1 ? length / (lines - 1) : PITCH_MIN * p->prior->size;
    size_t count = 0;

    for (double pitch = PITCH_MIN * p->prior->size; pitch <= most; pitch *= PITCH_STEP) {
        const double last = length - (lines - 1) * pitch;

        for (double first = 0; first <= last; first += PLACE_STEP * pitch) {
            struct axis axis = { .first = first, .pitch = pitch };

            axis.cost = axis_cost(p, along_x, lines, &axis);
            keep_axis(p, along_x, lines, kept, &count, &axis);
        }
    }
    return count;
}

/* ---- which of the answers, and where it is in doubt -------------------------------------------
 */

/* Odds of 100 to 1: less is doubt. */
static const double CLEAR = 4.6;

static size_t count_differing(const struct answer *a, const struct answer *b, size_t count)
{
    size_t n = 0;

    for (size_t i = 0; i < count; i++)
        n += a->place[i] != b->place[i];
    return n;
}

/* Notes where a grid that is nearly as good has the centres: few that differ are doubtful. */
static void note_rival(const struct answer *rival, const struct answer *best, size_t count,
                       struct gsn_slot_assignment *assigned)
{
    for (size_t i = 0; i < count; i++)
        if (rival->place[i] != best->place[i] && rival->place[i] != GSN_NO_PLACE)
            assigned[i].other = rival->place[i];
}

/* What another centre would pay to make room, by moving to where it costs it least. */
static double room_cost(const struct problem *p, const struct answer *a, int place, int freed,
                        size_t mover)
{
    const int places = (int)(p->prior->rows * p->prior->columns);

    for (size_t j = 0; j < p->count; j++) {
        double least = stranger_cost(p, j);

        if (j == mover || a->place[j] != place)
            continue;
        for (int k = 0; k < places; k++) {
            int is_free = k == freed || k != place;

            for (size_t l = 0; is_free && k != freed && l < p->count; l++)
                is_free = a->place[l] != k;
            if (is_free)
                least = fmin(least, slot_cost(p, &a->grid, j, k));
        }
        return least - slot_cost(p, &a->grid, j, place);
    }
    return 0;
}

/* A section between two slots is doubtful where the second costs little more, all paid. */
static void note_doubts(const struct problem *p, const struct answer *a,
                        struct gsn_slot_assignment *assigned)
{
    const int places = (int)(p->prior->rows * p->prior->columns);

    for (size_t i = 0; i < p->count; i++) {
        double least = CLEAR;
        double own;

        if (a->place[i] == GSN_NO_PLACE)
            continue;
        own = slot_cost(p, &a->grid, i, a->place[i]);
        for (int k = 0; k < places; k++) {
            const double more = slot_cost(p, &a->grid, i, k) - own;

            if (k == a->place[i] || more >= least ||
                more + room_cost(p, a, k, a->place[i], i) >= least)
                continue;
            least = more;
            assigned[i].other = k;
        }
    }
}

/* The section that both grids have and that comes first on the panel. */
static size_t find_first(const struct answer *a, const struct answer *b, size_t count)
{
    size_t first = count;

    for (size_t i = 0; i < count; i++)
        if (a->place[i] != GSN_NO_PLACE && b->place[i] != GSN_NO_PLACE &&
            (first == count || a->place[i] < a->place[first]))
            first = i;
    return first;
}

static int fail_undecided(const struct problem *p, const struct answer *best,
                          const struct answer *rival, struct gsn_error *err)
{
    const size_t i = find_first(best, rival, p->count);
    unsigned a, b;

    if (i == p->count)
        return gsn_fail(err, GSN_E_WITHHELD,
                        "which %u x %u slots the %zu pieces on it lie in cannot be told: look at "
                        "the glass, and mount it again",
                        p->prior->rows, p->prior->columns, p->count);
    a = p->prior->slot[best->place[i]] + 1;
    b = p->prior->slot[rival->place[i]] + 1;
    return gsn_fail(err, GSN_E_WITHHELD,
                    "the sections found (%zu) fit %u x %u slots in two ways, and which cannot be "
                    "told: the first of them lies in slot %u or in slot %u; look at the glass and "
                    "say in which",
                    p->count, p->prior->rows, p->prior->columns, a < b ? a : b, a < b ? b : a);
}

static size_t count_strangers(const struct problem *p, const struct answer *a)
{
    size_t count = 0;

    for (size_t i = 0; i < p->count; i++)
        count += a->place[i] == GSN_NO_PLACE && !(p->prior->loose && p->prior->loose[i]);
    return count;
}

static int fail_no_room(const struct problem *p, const struct answer *best, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT,
                    "%zu of %zu sections found fit no slot of a layout of %u x %u: correct "
                    "\"layout\" in job.json and import it again, or mount the panel again",
                    count_strangers(p, best), p->count, p->prior->rows, p->prior->columns);
}

/* A label, or a scrap as large as a section, is a stranger among many. */
static int has_room(const struct problem *p, const struct answer *best)
{
    const size_t strangers = count_strangers(p, best);

    return isfinite(best->cost) && (strangers <= 1 || 4 * strangers <= p->count);
}

/* The best of the answers, and where it is in doubt. Fails as gsn_panel_grid_fit() does. */
static int choose_answer(const struct problem *p, const struct answer *answers, size_t number,
                         struct gsn_panel_grid *ret_grid, struct gsn_slot_assignment *ret_assigned,
                         struct gsn_error *err)
{
    const struct answer *best = &answers[0], *rival = NULL;
    gsn_auto_mem(struct gsn_slot_assignment) assigned = gsn_alloc_array(p->count, sizeof *assigned);

    if (!assigned)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the slots of a panel");
    for (size_t k = 1; k < number; k++)
        if (answers[k].cost < best->cost)
            best = &answers[k];
    if (!has_room(p, best))
        return fail_no_room(p, best, err);
    for (size_t i = 0; i < p->count; i++)
        assigned[i] = (struct gsn_slot_assignment){ best->place[i], GSN_NO_PLACE };
    note_doubts(p, best, assigned);
    for (size_t k = 0; k < number; k++) {
        const struct answer *other = &answers[k];

        if (!(other->cost - best->cost < CLEAR))
            continue;
        if (2 * count_differing(other, best, p->count) >= p->count &&
            (!rival || other->cost < rival->cost))
            rival = other;
        note_rival(other, best, p->count, assigned);
    }
    if (rival)
        return fail_undecided(p, best, rival, err);
    *ret_grid = best->grid;
    memcpy(ret_assigned, assigned, p->count * sizeof *assigned);
    return GSN_OK;
}

/* All answers, one for each pair of axes that are worth a look. */
static int find_answers(const struct problem *p, const struct axis *by_x, size_t count_x,
                        const struct axis *by_y, size_t count_y, struct answer *answers,
                        struct gsn_error *err)
{
    for (size_t i = 0; i < count_x; i++)
        for (size_t k = 0; k < count_y; k++) {
            struct answer *a = &answers[i * count_y + k];
            int r;

            a->grid = (struct gsn_panel_grid){ .rows = p->prior->rows,
                                               .columns = p->prior->columns,
                                               .first = { by_x[i].first, by_y[k].first },
                                               .pitch_x = by_x[i].pitch,
                                               .pitch_y = by_y[k].pitch };
            r = fit_answer(p, a, err);
            if (r < 0)
                return r;
        }
    return GSN_OK;
}

int gsn_panel_grid_fit(const struct gsn_point *centre, size_t count,
                       const struct gsn_grid_prior *prior, struct gsn_panel_grid *ret_grid,
                       struct gsn_slot_assignment *ret_assigned, struct gsn_error *err)
{
    const struct problem p = { centre, count, prior, HAND * prior->size };
    struct axis by_x[AXES] = { 0 }, by_y[AXES] = { 0 };
    size_t count_x, count_y;
    gsn_auto_mem(struct answer) answers = NULL;
    gsn_auto_mem(int) places = NULL;
    int r;

    assert(centre && count > 0 && prior->rows > 0 && prior->columns > 0 && prior->size > 0);

    count_x = find_axes(&p, 1, by_x);
    count_y = find_axes(&p, 0, by_y);
    answers = gsn_alloc_array(count_x * count_y, sizeof *answers);
    places = gsn_alloc_array(count_x * count_y * count, sizeof *places);
    if (!answers || !places)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the slots of a panel");
    if (count_x == 0 || count_y == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "sections of %.0f x %.0f of this picture leave no room for %u x %u slots: "
                        "correct \"layout\" or \"px_um\" in job.json",
                        prior->size, prior->size, prior->rows, prior->columns);
    for (size_t k = 0; k < count_x * count_y; k++)
        answers[k].place = places + k * count;
    r = find_answers(&p, by_x, count_x, by_y, count_y, answers, err);
    return r < 0 ? r : choose_answer(&p, answers, count_x * count_y, ret_grid, ret_assigned, err);
}
