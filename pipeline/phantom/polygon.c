/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/phantom/sight.h"

#include <math.h>

static struct gsn_point from_frame(const struct gsn_phantom_sight *sight, double x, double y,
                                   double turn)
{
    return gsn_phantom_sight_panel(sight, gsn_phantom_turn_back((struct gsn_point){ x, y }, turn));
}

/* How far the tissue reaches along y of a turned frame, at x, from the end where sign points. */
static double tissue_end(const struct gsn_phantom_sight *sight, double x, double turn, double sign)
{
    const struct gsn_phantom_geometry *g = &sight->plan->variant.geometry;
    const double step = 20;
    double y = hypot(g->ax, g->ay);

    for (; y > 0; y -= step) {
        const struct gsn_point p = gsn_phantom_turn_back((struct gsn_point){ x, sign * y }, turn);

        if (pow(fabs(p.x) / g->ax, g->p) + pow(fabs(p.y) / g->ay, g->p) < 1)
            break;
    }
    return sign * y;
}

static size_t outline_disc(struct gsn_point centre, double radius, double px_um,
                           struct gsn_point *ret_p)
{
    enum { CORNERS = 24 };
    /* The polygon has the area of the disc. */
    const double corner = 2 * M_PI / CORNERS, r = radius * sqrt(corner / sin(corner));

    for (int i = 0; i < CORNERS; i++)
        ret_p[i] = (struct gsn_point){ (centre.x + r * cos(i * corner)) / px_um,
                                       (centre.y + r * sin(i * corner)) / px_um };
    return CORNERS;
}

static size_t outline_square(struct gsn_point centre, double half, double px_um,
                             struct gsn_point *ret_p)
{
    static const int sign[4][2] = { { -1, -1 }, { 1, -1 }, { 1, 1 }, { -1, 1 } };

    for (int i = 0; i < 4; i++)
        ret_p[i] = (struct gsn_point){ (centre.x + sign[i][0] * half) / px_um,
                                       (centre.y + sign[i][1] * half) / px_um };
    return 4;
}

/* Both sides of a stroke. */
static size_t outline_ribbon(const struct gsn_phantom_defect *d, double px_um,
                             struct gsn_point *ret_p)
{
    enum { LAST = GSN_PHANTOM_STROKE };
    struct gsn_point line[LAST + 1];

    gsn_phantom_stroke(d, line);
    for (int i = 0; i <= LAST; i++) {
        const struct gsn_point a = line[i > 0 ? i - 1 : 0], b = line[i < LAST ? i + 1 : LAST];
        const double length = fmax(hypot(b.x - a.x, b.y - a.y), 1e-9);
        const double x = -(b.y - a.y) / length * d->width / 2;
        const double y = (b.x - a.x) / length * d->width / 2;

        ret_p[i] = (struct gsn_point){ (line[i].x + x) / px_um, (line[i].y + y) / px_um };
        ret_p[2 * LAST + 1 - i] =
            (struct gsn_point){ (line[i].x - x) / px_um, (line[i].y - y) / px_um };
    }
    return 2 * LAST + 2;
}

static size_t outline_tear(const struct gsn_phantom_sight *sight,
                           const struct gsn_phantom_defect *d, struct gsn_point *ret_p)
{
    const double end = fmax(tissue_end(sight, d->at.x, d->turn, 1), d->at.y);
    const double gap = gsn_phantom_tear_gap(d, end);

    ret_p[0] = from_frame(sight, d->at.x, d->at.y, d->turn);
    ret_p[1] = from_frame(sight, d->at.x + gap, end, d->turn);
    ret_p[2] = from_frame(sight, d->at.x - gap, end, d->turn);
    return 3;
}

static size_t outline_fold(const struct gsn_phantom_sight *sight,
                           const struct gsn_phantom_defect *d, struct gsn_point *ret_p)
{
    const double near = d->at.x, far = d->at.x + d->width;

    ret_p[0] = from_frame(sight, near, tissue_end(sight, near, d->turn, -1), d->turn);
    ret_p[1] = from_frame(sight, far, tissue_end(sight, near, d->turn, -1), d->turn);
    ret_p[2] = from_frame(sight, far, tissue_end(sight, near, d->turn, 1), d->turn);
    ret_p[3] = from_frame(sight, near, tissue_end(sight, near, d->turn, 1), d->turn);
    return 4;
}

static size_t outline_edge(const struct gsn_phantom_sight *sight,
                           const struct gsn_phantom_defect *d, struct gsn_point *ret_p)
{
    static const int sign[4][2] = { { -1, -1 }, { 1, -1 }, { 1, 1 }, { -1, 1 } };
    const double x0 = gsn_phantom_slot_centre_um(sight->plan, sight->section->slot).x;

    for (int i = 0; i < 4; i++) {
        const double x = x0 + sign[i][0] * gsn_phantom_slot_half_um;
        const double y = d->at.y + (x - d->at.x) * tan(d->turn) + sign[i][1] * d->width / 2;

        ret_p[i] = (struct gsn_point){ x / sight->plan->px_um, y / sight->plan->px_um };
    }
    return 4;
}

static size_t outline_piece(const struct gsn_phantom_sight *sight,
                            const struct gsn_phantom_defect *d, struct gsn_point *ret_p)
{
    for (size_t i = 0; i < d->count; i++)
        ret_p[i] = gsn_phantom_sight_panel(
            sight, (struct gsn_point){ d->at.x + d->point[i].x, d->at.y + d->point[i].y });
    return d->count;
}

size_t gsn_phantom_sight_polygon(const struct gsn_phantom_sight *sight,
                                 const struct gsn_phantom_defect *d,
                                 struct gsn_point ret_p[GSN_PHANTOM_POLYGON])
{
    const double px_um = sight->plan->px_um;

    switch (d->kind) {
    case GSN_PHANTOM_TEAR:
        return outline_tear(sight, d, ret_p);
    case GSN_PHANTOM_FOLD:
        return outline_fold(sight, d, ret_p);
    case GSN_PHANTOM_LOST_PIECE:
        return outline_piece(sight, d, ret_p);
    case GSN_PHANTOM_COVERSLIP_EDGE:
        return outline_edge(sight, d, ret_p);
    case GSN_PHANTOM_HAIR:
    case GSN_PHANTOM_PEN:
        return outline_ribbon(d, px_um, ret_p);
    case GSN_PHANTOM_BUBBLE:
    case GSN_PHANTOM_DEFOCUS:
        return outline_disc(d->at, d->radius, px_um, ret_p);
    case GSN_PHANTOM_TOUCHING:
        return outline_square(d->at, d->radius, px_um, ret_p);
    case GSN_PHANTOM_CHATTER:
        return outline_square(d->at, 2700, px_um, ret_p);
    default:
        return outline_square(d->at, gsn_phantom_slot_half_um, px_um, ret_p);
    }
}
