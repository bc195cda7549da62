/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The defects of sections as maps of the plane: what is seen at a place, and where a material point
 * is seen.
 *
 * Tear and fold act across a line, each in a frame turned so that x crosses it; a lost piece is a
 * polygon, asked by the even-odd rule, that lies elsewhere under a rigid motion. Strokes of hairs
 * and pens are curves of Catmull and Rom through their points, as straight pieces. What covers a
 * place is told by distance.
 *
 * Failure: none. Cost: constant, but for the corners of a polygon and the pieces of a stroke. */
#include "pipeline/phantom/defect.h"

#include <math.h>

/* How far the lips of a tear have drawn apart, of the gap that is seen. */
static const double TEAR_OPENING = 0.9;
/* Sigma of a bubble's rim in pixels; three of them are taken as covered. */
static const double RIM_PX = 3, RIM_REACH = 3;

const char *gsn_phantom_defect_name(enum gsn_phantom_defect_kind kind)
{
    static const char *const name[GSN_PHANTOM_DEFECT_KINDS] = {
        [GSN_PHANTOM_TEAR] = "tear",
        [GSN_PHANTOM_FOLD] = "fold",
        [GSN_PHANTOM_LOST_PIECE] = "lost_piece",
        [GSN_PHANTOM_CHATTER] = "chatter",
        [GSN_PHANTOM_HAIR] = "hair",
        [GSN_PHANTOM_BUBBLE] = "bubble",
        [GSN_PHANTOM_COVERSLIP_EDGE] = "coverslip_edge",
        [GSN_PHANTOM_PEN] = "pen",
        [GSN_PHANTOM_DEFOCUS] = "defocus",
        [GSN_PHANTOM_TOUCHING] = "touching",
        [GSN_PHANTOM_DUPLICATE] = "duplicate",
        [GSN_PHANTOM_EMPTY_SLOT] = "empty_slot",
        [GSN_PHANTOM_MISSING_PANEL] = "missing_panel",
    };
    return name[kind];
}

struct gsn_point gsn_phantom_turn_into(struct gsn_point p, double turn)
{
    const double c = cos(turn), s = sin(turn);

    return (struct gsn_point){ c * p.x + s * p.y, c * p.y - s * p.x };
}

struct gsn_point gsn_phantom_turn_back(struct gsn_point p, double turn)
{
    return gsn_phantom_turn_into(p, -turn);
}

double gsn_phantom_tear_gap(const struct gsn_phantom_defect *tear, double y)
{
    return fmax(0, (y - tear->at.y) * tear->slope);
}

/* --- what moves material, each in its turned frame --- */

static int lies_inside(const struct gsn_phantom_defect *piece, struct gsn_point p)
{
    int in = 0;

    for (size_t i = 0, j = piece->count - 1; i < piece->count; j = i++) {
        const struct gsn_point a = piece->point[i], b = piece->point[j];

        if ((a.y > p.y) != (b.y > p.y) && p.x < (b.x - a.x) * (p.y - a.y) / (b.y - a.y) + a.x)
            in = !in;
    }
    return in;
}

static struct gsn_phantom_reading read_tear(const struct gsn_phantom_defect *d, struct gsn_point x)
{
    struct gsn_phantom_reading reading = { 0 };
    struct gsn_point p = gsn_phantom_turn_into(x, d->turn);
    const double gap = gsn_phantom_tear_gap(d, p.y);

    if (fabs(p.x - d->at.x) < gap)
        return reading;
    p.x -= copysign(TEAR_OPENING * gap, p.x - d->at.x);
    reading.at[reading.layers++] = gsn_phantom_turn_back(p, d->turn);
    return reading;
}

static struct gsn_phantom_reading read_fold(const struct gsn_phantom_defect *d, struct gsn_point x)
{
    struct gsn_phantom_reading reading = { .layers = 1, .at = { x } };
    struct gsn_point p = gsn_phantom_turn_into(x, d->turn);

    if (p.x < d->at.x)
        return reading;
    if (p.x < d->at.x + d->width) {
        p.x = 2 * d->at.x - p.x;
        reading.at[reading.layers++] = gsn_phantom_turn_back(p, d->turn);
        return reading;
    }
    p.x += 2 * d->width;
    reading.at[0] = gsn_phantom_turn_back(p, d->turn);
    return reading;
}

static struct gsn_phantom_reading read_piece(const struct gsn_phantom_defect *d, struct gsn_point x)
{
    const struct gsn_point here = { x.x - d->at.x, x.y - d->at.y };
    const struct gsn_point there = { x.x - d->place.x, x.y - d->place.y };
    const struct gsn_point p = gsn_phantom_turn_into(there, d->place_turn);
    struct gsn_phantom_reading reading = { 0 };

    if (!lies_inside(d, here))
        reading.at[reading.layers++] = x;
    if (lies_inside(d, p)) {
        reading.moved = 1;
        reading.at[reading.layers++] = (struct gsn_point){ p.x + d->at.x, p.y + d->at.y };
    }
    return reading;
}

struct gsn_phantom_reading gsn_phantom_defect_read(const struct gsn_phantom_defect *defect,
                                                   struct gsn_point x)
{
    if (defect && defect->kind == GSN_PHANTOM_TEAR)
        return read_tear(defect, x);
    if (defect && defect->kind == GSN_PHANTOM_FOLD)
        return read_fold(defect, x);
    if (defect && defect->kind == GSN_PHANTOM_LOST_PIECE)
        return read_piece(defect, x);
    return (struct gsn_phantom_reading){ .layers = 1, .at = { x } };
}

static int find_tear(const struct gsn_phantom_defect *d, struct gsn_point *p)
{
    const double gap = gsn_phantom_tear_gap(d, p->y);

    if (fabs(p->x - d->at.x) < (1 - TEAR_OPENING) * gap)
        return 0;
    p->x += copysign(TEAR_OPENING * gap, p->x - d->at.x);
    return 1;
}

static int find_fold(const struct gsn_phantom_defect *d, struct gsn_point *p)
{
    if (p->x < d->at.x + d->width)
        return 1;
    if (p->x < d->at.x + 3 * d->width)
        return 0;
    p->x -= 2 * d->width;
    return 1;
}

int gsn_phantom_defect_find(const struct gsn_phantom_defect *defect, struct gsn_point material,
                            struct gsn_point *ret_x)
{
    struct gsn_point p = material;
    int found = 1;

    if (defect && (defect->kind == GSN_PHANTOM_TEAR || defect->kind == GSN_PHANTOM_FOLD)) {
        p = gsn_phantom_turn_into(p, defect->turn);
        found = defect->kind == GSN_PHANTOM_TEAR ? find_tear(defect, &p) : find_fold(defect, &p);
        p = gsn_phantom_turn_back(p, defect->turn);
    }
    if (defect && defect->kind == GSN_PHANTOM_LOST_PIECE)
        found = !lies_inside(defect, (struct gsn_point){ p.x - defect->at.x, p.y - defect->at.y });
    if (found)
        *ret_x = p;
    return found;
}

/* --- what lies on the glass --- */

/* Catmull and Rom's curve through the points, the ends doubled. */
static struct gsn_point trace_curve(const struct gsn_phantom_defect *d, double t)
{
    const size_t last = d->count - 1;
    const size_t i = (size_t)fmin(floor(t), (double)last - 1);
    const double u = t - (double)i;
    const struct gsn_point a = d->point[i > 0 ? i - 1 : 0], b = d->point[i];
    const struct gsn_point c = d->point[i + 1], e = d->point[i + 2 > last ? last : i + 2];
    const double wa = ((2 - u) * u - 1) * u / 2, wb = ((3 * u - 5) * u * u + 2) / 2;
    const double wc = ((4 - 3 * u) * u + 1) * u / 2, we = (u - 1) * u * u / 2;

    return (struct gsn_point){ wa * a.x + wb * b.x + wc * c.x + we * e.x,
                               wa * a.y + wb * b.y + wc * c.y + we * e.y };
}

void gsn_phantom_stroke(const struct gsn_phantom_defect *defect,
                        struct gsn_point ret_line[GSN_PHANTOM_STROKE + 1])
{
    for (int i = 0; i <= GSN_PHANTOM_STROKE; i++)
        ret_line[i] = trace_curve(defect, (double)(defect->count - 1) * i / GSN_PHANTOM_STROKE);
}

double gsn_phantom_stroke_distance(const struct gsn_point line[GSN_PHANTOM_STROKE + 1],
                                   struct gsn_point p)
{
    double least = INFINITY;

    for (int i = 0; i < GSN_PHANTOM_STROKE; i++) {
        const double dx = line[i + 1].x - line[i].x, dy = line[i + 1].y - line[i].y;
        const double x = p.x - line[i].x, y = p.y - line[i].y;
        const double along = (x * dx + y * dy) / fmax(dx * dx + dy * dy, 1e-9);
        const double t = fmin(fmax(along, 0), 1);

        least = fmin(least, (x - t * dx) * (x - t * dx) + (y - t * dy) * (y - t * dy));
    }
    return sqrt(least);
}

static int under_stroke(const struct gsn_phantom_defect *d, struct gsn_point p)
{
    struct gsn_point line[GSN_PHANTOM_STROKE + 1];

    gsn_phantom_stroke(d, line);
    return gsn_phantom_stroke_distance(line, p) < d->width / 2;
}

static int under_dust(const struct gsn_phantom_defect *d, struct gsn_point p)
{
    for (int i = 0; i < GSN_PHANTOM_DUST; i++)
        if (hypot(p.x - d->dust[i].at.x, p.y - d->dust[i].at.y) < d->dust[i].radius)
            return 1;
    return 0;
}

int gsn_phantom_defect_covers(const struct gsn_phantom_defect *d, double px_um, struct gsn_point p)
{
    const double distance = hypot(p.x - d->at.x, p.y - d->at.y);

    switch (d->kind) {
    case GSN_PHANTOM_BUBBLE:
        return distance < d->radius + RIM_REACH * RIM_PX * px_um;
    case GSN_PHANTOM_DEFOCUS:
        return distance < d->radius;
    case GSN_PHANTOM_HAIR:
        return under_dust(d, p) || under_stroke(d, p);
    case GSN_PHANTOM_PEN:
        return under_stroke(d, p);
    case GSN_PHANTOM_COVERSLIP_EDGE:
        return fabs((p.y - d->at.y) * cos(d->turn) - (p.x - d->at.x) * sin(d->turn)) < d->width / 2;
    case GSN_PHANTOM_DUPLICATE:
    case GSN_PHANTOM_EMPTY_SLOT:
    case GSN_PHANTOM_MISSING_PANEL:
        return 1;
    default:
        return 0;
    }
}

int gsn_phantom_defect_opaque(const struct gsn_phantom_defect *d, double px_um, struct gsn_point p)
{
    if (d->kind == GSN_PHANTOM_DEFOCUS)
        return 0;
    if (d->kind == GSN_PHANTOM_BUBBLE)
        return fabs(hypot(p.x - d->at.x, p.y - d->at.y) - d->radius) < RIM_REACH * RIM_PX * px_um;
    return gsn_phantom_defect_covers(d, px_um, p);
}
