/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel_units.h"

#include "pipeline/register/panel_cut.h"

#include <assert.h>
#include <math.h>

/* Sections that are taken apart in one piece; more are a label or a flood of ink. */
enum { MOST_IN_PIECE = 8, ROUNDS = 30 };
/* In areas of a section: pieces of a torn one, and what they make up together. */
static const double TORN_LEAST = 0.2, TORN_MOST = 0.8, TORN_TOGETHER = 1.25;
/* Sections whose centres are further apart than this, in their size, do not touch. */
static const double REACH = 1.8;

void gsn_panel_units_free(struct gsn_panel_units *units)
{
    if (!units)
        return;
    gsn_free(units->unit);
    gsn_free(units);
}

void gsn_part_add(struct gsn_part *sum, const struct gsn_part *part)
{
    if (part->area == 0)
        return;
    if (sum->area == 0) {
        *sum = *part;
        return;
    }
    sum->area += part->area;
    sum->sum_x += part->sum_x;
    sum->sum_y += part->sum_y;
    sum->x0 = part->x0 < sum->x0 ? part->x0 : sum->x0;
    sum->y0 = part->y0 < sum->y0 ? part->y0 : sum->y0;
    sum->x1 = part->x1 > sum->x1 ? part->x1 : sum->x1;
    sum->y1 = part->y1 > sum->y1 ? part->y1 : sum->y1;
}

struct gsn_point gsn_part_centre(const struct gsn_part *part)
{
    const double area = (double)part->area;

    return (struct gsn_point){ part->sum_x / area, part->sum_y / area };
}

double gsn_part_distance(const struct gsn_part *a, const struct gsn_part *b)
{
    const int x = a->x0 > b->x1 ? a->x0 - b->x1 : b->x0 > a->x1 ? b->x0 - a->x1 : 0;
    const int y = a->y0 > b->y1 ? a->y0 - b->y1 : b->y0 > a->y1 ? b->y0 - a->y1 : 0;

    return hypot(x, y);
}

static struct gsn_part part_of_piece(const struct gsn_component *piece)
{
    return (struct gsn_part){ .area = piece->area,
                              .x0 = piece->x,
                              .y0 = piece->y,
                              .x1 = piece->x + piece->width,
                              .y1 = piece->y + piece->height,
                              .sum_x = piece->cx * (double)piece->area,
                              .sum_y = piece->cy * (double)piece->area };
}

static void add_cells(struct gsn_part *part, int y, int x0, int x1)
{
    const double length = x1 - x0;
    const struct gsn_part cells = { .area = (size_t)(x1 - x0),
                                    .x0 = x0,
                                    .y0 = y,
                                    .x1 = x1,
                                    .y1 = y + 1,
                                    .sum_x = length * 0.5 * (x0 + x1),
                                    .sum_y = length * (y + 0.5) };

    gsn_part_add(part, &cells);
}

/* ---- sections that grew together --------------------------------------------------------- */

struct line {
    int is;
    struct gsn_point end[2];
    double width;
};

struct cluster {
    const struct gsn_components *pieces;
    size_t piece, count;
    struct gsn_point centre[MOST_IN_PIECE];
    struct line line[MOST_IN_PIECE][MOST_IN_PIECE]; /* of i < k */
};

/* Side of the point against a line: its sign alone counts. */
static double side(const struct line *line, struct gsn_point at)
{
    return (line->end[1].x - line->end[0].x) * (at.y - line->end[0].y) -
           (line->end[1].y - line->end[0].y) * (at.x - line->end[0].x);
}

static double distance(struct gsn_point a, struct gsn_point b)
{
    return hypot(a.x - b.x, a.y - b.y);
}

/* The nearest centre; between the two nearest the line decides where there is one. */
static size_t owner(const struct cluster *c, struct gsn_point at)
{
    size_t first = 0, second = c->count;
    const struct line *line;

    for (size_t i = 1; i < c->count; i++)
        if (distance(at, c->centre[i]) < distance(at, c->centre[first]))
            first = i;
    for (size_t i = 0; i < c->count; i++)
        if (i != first &&
            (second == c->count || distance(at, c->centre[i]) < distance(at, c->centre[second])))
            second = i;
    line = first < second ? &c->line[first][second] : &c->line[second][first];
    if (!line->is || side(line, at) * side(line, c->centre[first]) >= 0)
        return first;
    return second;
}

static void deal(const struct cluster *c, struct gsn_part part[MOST_IN_PIECE])
{
    const struct gsn_component *piece = &c->pieces->component[c->piece];

    for (size_t i = 0; i < MOST_IN_PIECE; i++)
        part[i] = (struct gsn_part){ 0 };
    for (size_t i = 0; i < piece->area; i++) {
        const uint32_t pixel = c->pieces->pixel[piece->first + i];
        const int x = (int)(pixel % c->pieces->width), y = (int)(pixel / c->pieces->width);

        add_cells(&part[owner(c, (struct gsn_point){ x + 0.5, y + 0.5 })], y, x, x + 1);
    }
}

/* Evenly along the longer axis of the piece. */
static void seed(struct cluster *c)
{
    const struct gsn_component *piece = &c->pieces->component[c->piece];
    double xx = 0, xy = 0, yy = 0, angle, sd;

    for (size_t i = 0; i < piece->area; i++) {
        const uint32_t pixel = c->pieces->pixel[piece->first + i];
        const double dx = pixel % c->pieces->width + 0.5 - piece->cx;
        const double dy = pixel / c->pieces->width + 0.5 - piece->cy;

        xx += dx * dx;
        xy += dx * dy;
        yy += dy * dy;
    }
    angle = 0.5 * atan2(2 * xy, xx - yy);
    sd = sqrt((0.5 * (xx + yy) + hypot(0.5 * (xx - yy), xy)) / (double)piece->area);
    for (size_t i = 0; i < c->count; i++) {
        /* A rod of length 2 sqrt(3) sd. */
        const double at = 2 * sqrt(3) * sd * (((double)i + 0.5) / (double)c->count - 0.5);

        c->centre[i] =
            (struct gsn_point){ piece->cx + at * cos(angle), piece->cy + at * sin(angle) };
    }
}

/* Centres of equal sections: the cells nearest to each, and the mean of those, in turn. */
static void find_centres(struct cluster *c)
{
    struct gsn_part part[MOST_IN_PIECE];

    seed(c);
    for (int round = 0; round < ROUNDS; round++) {
        double moved = 0;

        deal(c, part);
        for (size_t i = 0; i < c->count; i++) {
            const struct gsn_point now = part[i].area ? gsn_part_centre(&part[i]) : c->centre[i];

            moved = fmax(moved, distance(now, c->centre[i]));
            c->centre[i] = now;
        }
        if (moved < 0.1)
            break;
    }
}

static int find_lines(struct cluster *c, double size, struct gsn_error *err)
{
    for (size_t i = 0; i < c->count; i++)
        for (size_t k = i + 1; k < c->count; k++) {
            const struct gsn_point pair[2] = { c->centre[i], c->centre[k] };
            struct line *line = &c->line[i][k];
            int r;

            if (!(distance(pair[0], pair[1]) < REACH * size) || !(distance(pair[0], pair[1]) > 0))
                continue;
            r = gsn_panel_cut(c->pieces, c->piece, pair, line->end, &line->width, err);
            if (r < 0)
                return r;
            line->is = distance(line->end[0], line->end[1]) > 0;
        }
    return GSN_OK;
}

static void note_neck(struct gsn_panel_unit *unit, size_t beside, const struct line *line)
{
    if (!line->is || line->width < unit->neck)
        return;
    unit->beside = beside;
    unit->neck = line->width;
    unit->end[0] = line->end[0];
    unit->end[1] = line->end[1];
}

/* Adds the parts of a piece that holds count sections. */
static int take_apart(const struct gsn_components *pieces, size_t piece, size_t count, double size,
                      struct gsn_panel_units *units, struct gsn_error *err)
{
    struct cluster c = { .pieces = pieces, .piece = piece, .count = count };
    struct gsn_part part[MOST_IN_PIECE];
    const size_t first = units->count;
    int r;

    find_centres(&c);
    r = find_lines(&c, size, err);
    if (r < 0)
        return r;
    deal(&c, part);
    for (size_t i = 0; i < count; i++) {
        struct gsn_panel_unit *unit = &units->unit[first + i];

        *unit = (struct gsn_panel_unit){
            .part = part[i], .piece = piece, .cut = 1, .beside = first + i
        };
        for (size_t k = 0; k < count; k++)
            if (k != i)
                note_neck(unit, first + k, &c.line[i < k ? i : k][i < k ? k : i]);
    }
    units->count += count;
    return GSN_OK;
}

/* ---- torn sections ----------------------------------------------------------------------- */

static int is_torn(const struct gsn_panel_unit *unit, double area)
{
    const double share = (double)unit->part.area / area;

    return !unit->cut && share >= TORN_LEAST && share <= TORN_MOST;
}

/* Takes halves of one section together, the nearest first. */
static void join_torn(struct gsn_panel_units *units, double area, double near)
{
    for (size_t i = 0; i < units->count; i++) {
        struct gsn_panel_unit *own = &units->unit[i];
        double least = near;
        size_t best = i;

        for (size_t k = i + 1; is_torn(own, area) && k < units->count; k++) {
            const struct gsn_panel_unit *other = &units->unit[k];
            const double apart = gsn_part_distance(&own->part, &other->part);

            if (is_torn(other, area) && apart < least &&
                (double)(own->part.area + other->part.area) <= TORN_TOGETHER * area) {
                least = apart;
                best = k;
            }
        }
        if (best == i)
            continue;
        gsn_part_add(&own->part, &units->unit[best].part);
        units->unit[best].part = (struct gsn_part){ 0 };
    }
}

static size_t sections_in(const struct gsn_component *piece, double area, double most)
{
    const double share = (double)piece->area / area;

    if (share <= most)
        return 1;
    return (size_t)fmin(fmax(round(share), 2), MOST_IN_PIECE);
}

int gsn_panel_units_find(const struct gsn_components *pieces, double area, double most, double near,
                         struct gsn_panel_units **ret_units, struct gsn_error *err)
{
    gsn_auto(gsn_panel_units) units = gsn_alloc_array(1, sizeof *units);
    size_t room = 0;

    assert(pieces && area > 0 && ret_units);

    for (size_t i = 0; i < pieces->count; i++)
        room += sections_in(&pieces->component[i], area, most);
    if (units)
        units->unit = gsn_alloc_array(room, sizeof *units->unit);
    if (!units || !units->unit)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the pieces of a panel");
    for (size_t i = 0; i < pieces->count; i++) {
        const size_t count = sections_in(&pieces->component[i], area, most);
        int r = GSN_OK;

        if (count > 1)
            r = take_apart(pieces, i, count, sqrt(area), units, err);
        else
            units->unit[units->count++] =
                (struct gsn_panel_unit){ .part = part_of_piece(&pieces->component[i]), .piece = i };
        if (r < 0)
            return r;
    }
    join_torn(units, area, near);
    *ret_units = gsn_steal(&units);
    return GSN_OK;
}
