/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/phantom/shape.h"

#include <math.h>

struct gsn_point gsn_phantom_around(struct gsn_phantom_random *random, struct gsn_point centre,
                                    double radius)
{
    const double r = radius * sqrt(gsn_phantom_uniform(random));
    const double phi = gsn_phantom_between(random, 0, 2 * M_PI);

    return (struct gsn_point){ centre.x + r * cos(phi), centre.y + r * sin(phi) };
}

struct gsn_point gsn_phantom_centre_um(const struct gsn_phantom_plan *plan,
                                       const struct gsn_phantom_section *s)
{
    return (struct gsn_point){ s->centre_px.x * plan->px_um, s->centre_px.y * plan->px_um };
}

static void shape_tear(struct gsn_phantom_random *random, struct gsn_phantom_defect *d)
{
    d->turn = gsn_phantom_between(random, 0, 2 * M_PI);
    d->at.x = gsn_phantom_between(random, -1200, 1200);
    d->at.y = gsn_phantom_between(random, 0, 1200);
    d->slope = gsn_phantom_between(random, .05, .15);
}

static void shape_fold(struct gsn_phantom_random *random, struct gsn_phantom_defect *d)
{
    d->turn = gsn_phantom_between(random, 0, 2 * M_PI);
    d->at.x = gsn_phantom_between(random, 600, 1600);
    d->width = gsn_phantom_between(random, 80, 250);
}

/* The piece floats off into a corner of the slot. */
static void shape_piece(const struct gsn_phantom_plan *plan, struct gsn_phantom_random *random,
                        const struct gsn_phantom_section *s, struct gsn_phantom_defect *d)
{
    const struct gsn_point slot = gsn_phantom_slot_centre_um(plan, s->slot), middle = { 0, 0 };
    const double corner = 3250, radius = gsn_phantom_between(random, 250, 500);
    const uint32_t which = gsn_phantom_below(random, 4);
    const struct gsn_point place_px = {
        (slot.x + (which & 1 ? corner : -corner)) / plan->px_um,
        (slot.y + (which & 2 ? corner : -corner)) / plan->px_um,
    };

    d->at = gsn_phantom_around(random, middle, 1700);
    d->count = 7;
    for (size_t i = 0; i < d->count; i++) {
        const double phi = 2 * M_PI * (double)i / (double)d->count;
        const double r = radius * gsn_phantom_between(random, .75, 1.25);

        d->point[i] = (struct gsn_point){ r * cos(phi), r * sin(phi) };
    }
    d->radius = radius;
    d->place = gsn_phantom_material(s, plan->px_um, place_px);
    d->place_turn = gsn_phantom_between(random, 0, 2 * M_PI);
}

/* A curve that wanders: each step turns by up to bend. */
static void draw_wandering(struct gsn_phantom_random *random, struct gsn_point from, double heading,
                           double step, double bend, struct gsn_phantom_defect *d)
{
    for (size_t i = 0; i < d->count; i++) {
        d->point[i] = from;
        heading += gsn_phantom_between(random, -bend, bend);
        from.x += step * cos(heading);
        from.y += step * sin(heading);
    }
}

static void shape_hair(struct gsn_phantom_random *random, struct gsn_point centre,
                       struct gsn_phantom_defect *d)
{
    const double heading = gsn_phantom_between(random, 0, 2 * M_PI);

    d->width = 12;
    d->count = 6;
    draw_wandering(random, gsn_phantom_around(random, centre, 2000), heading,
                   gsn_phantom_between(random, 350, 700), .9, d);
    d->at = d->point[0];
    for (int i = 0; i < GSN_PHANTOM_DUST; i++) {
        d->dust[i].at = gsn_phantom_around(random, centre, 2600);
        d->dust[i].radius = gsn_phantom_between(random, 12, 50);
    }
}

/* Across the section, or beside it within its slot. */
static void shape_pen(struct gsn_phantom_random *random, struct gsn_point slot,
                      struct gsn_point centre, struct gsn_phantom_defect *d)
{
    const double side = gsn_phantom_below(random, 2) ? 1 : -1;
    const double phi = gsn_phantom_between(random, 0, 2 * M_PI);
    const double length = gsn_phantom_between(random, 2000, 4500);

    d->width = gsn_phantom_between(random, 600, 1000);
    d->colour = (int)gsn_phantom_below(random, GSN_PHANTOM_PENS);
    d->count = 4;
    if (gsn_phantom_below(random, 2)) {
        const struct gsn_point from = { centre.x - length / 2 * cos(phi),
                                        centre.y - length / 2 * sin(phi) };

        draw_wandering(random, gsn_phantom_around(random, from, 600), phi, length / 3, .3, d);
    } else {
        const struct gsn_point from = { slot.x - length / 2, slot.y + side * 3100 };

        draw_wandering(random, from, 0, length / 3, .05, d);
    }
    d->at = d->point[0];
}

/* Lays a section and its right neighbour so close that their outlines meet: the half width of the
 * outline |x/Ax|^p + |y/Ay|^p = 1 in a direction is its support function. */
static double half_width(const struct gsn_phantom_geometry *g, const struct gsn_phantom_section *s)
{
    const double q = g->p / (g->p - 1);

    return pow(pow(fabs(g->ax * s->sx * cos(s->theta)), q) +
                   pow(fabs(g->ay * s->sy * sin(s->theta)), q),
               1 / q);
}

static void make_touch(const struct gsn_phantom_plan *plan, struct gsn_phantom_random *random,
                       struct gsn_phantom_section *left, struct gsn_phantom_defect *d)
{
    const struct gsn_phantom_geometry *g = &plan->variant.geometry;
    struct gsn_phantom_section *right = left + 1;
    const double overlap = gsn_phantom_between(random, 0, 80);
    const double px_um = plan->px_um;
    const double apart = half_width(g, left) + half_width(g, right) - overlap;
    const double excess = (right->centre_px.x - left->centre_px.x) * px_um - apart;

    left->centre_px.x += excess / 2 / px_um;
    right->centre_px.x -= excess / 2 / px_um;
    left->to_panel = gsn_phantom_panel_map(left, px_um);
    right->to_panel = gsn_phantom_panel_map(right, px_um);
    d->at = (struct gsn_point){ left->centre_px.x * px_um + half_width(g, left),
                                (left->centre_px.y + right->centre_px.y) / 2 * px_um };
    d->radius = 400;
}

void gsn_phantom_defect_shape(const struct gsn_phantom_plan *plan,
                              struct gsn_phantom_random *random, struct gsn_phantom_section *s,
                              struct gsn_phantom_defect *d)
{
    const struct gsn_point centre = gsn_phantom_centre_um(plan, s);

    switch (d->kind) {
    case GSN_PHANTOM_TEAR:
        shape_tear(random, d);
        break;
    case GSN_PHANTOM_FOLD:
        shape_fold(random, d);
        break;
    case GSN_PHANTOM_LOST_PIECE:
        shape_piece(plan, random, s, d);
        break;
    case GSN_PHANTOM_CHATTER:
        d->turn = gsn_phantom_between(random, 0, M_PI);
        d->at = centre;
        break;
    case GSN_PHANTOM_HAIR:
        shape_hair(random, centre, d);
        break;
    case GSN_PHANTOM_BUBBLE:
        d->at = gsn_phantom_around(random, centre, 2200);
        d->radius = gsn_phantom_between(random, 300, 1200);
        break;
    case GSN_PHANTOM_COVERSLIP_EDGE:
        d->at = gsn_phantom_slot_centre_um(plan, s->slot);
        d->at.y += (s->slot < plan->slots / 2 ? -1 : 1) * gsn_phantom_between(random, 1100, 2200);
        d->turn = gsn_phantom_between(random, -.01, .01);
        d->width = 40;
        break;
    case GSN_PHANTOM_PEN:
        shape_pen(random, gsn_phantom_slot_centre_um(plan, s->slot), centre, d);
        break;
    case GSN_PHANTOM_DEFOCUS:
        d->at = gsn_phantom_around(random, centre, 2000);
        d->radius = gsn_phantom_between(random, 500, 1500);
        d->sigma_px = gsn_phantom_between(random, 1, 3);
        break;
    default:
        make_touch(plan, random, s, d);
        break;
    }
}
