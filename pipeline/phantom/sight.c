/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which material each pixel of a slot shows, and where a point of the material is seen: pose, warp,
 * and the tear, fold or lost piece of the section. First the outline of each defect on its panel,
 * as truth/defects.csv has it, then the way from a pixel to the block and back. */
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

void gsn_phantom_sight_make(const struct gsn_phantom_plan *plan, int k,
                            struct gsn_phantom_sight *ret_sight)
{
    const struct gsn_phantom_section *section = &plan->section[k];
    struct gsn_phantom_sight sight = { .plan = plan, .section = section };

    sight.cut_z_um =
        gsn_phantom_section_z(&plan->variant.geometry, section->shows < 0 ? k : section->shows);
    for (size_t i = 0; i < plan->defects; i++)
        if (plan->defect[i].k == k && plan->defect[i].kind <= GSN_PHANTOM_LOST_PIECE)
            sight.rent = &plan->defect[i];
    if (plan->level.warp_rms_um > 0)
        gsn_phantom_plan_warp(plan, k, &sight.warp);
    *ret_sight = sight;
}

static struct gsn_point warp_at(const struct gsn_phantom_sight *sight, struct gsn_point p)
{
    const double px_um = sight->plan->px_um;

    if (sight->plan->level.warp_rms_um <= 0)
        return (struct gsn_point){ 0, 0 };
    return gsn_phantom_warp_at(&sight->warp, (struct gsn_point){ p.x * px_um, p.y * px_um });
}

struct gsn_point gsn_phantom_sight_block(const struct gsn_phantom_sight *sight, struct gsn_point p)
{
    const struct gsn_point n = warp_at(sight, p);
    struct gsn_point at = gsn_phantom_material(sight->section, sight->plan->px_um, p);

    at.x += n.x;
    at.y += n.y;
    return at;
}

struct gsn_point gsn_phantom_sight_panel(const struct gsn_phantom_sight *sight,
                                         struct gsn_point block)
{
    /* n changes by a tenth of a micrometre in one at most: nine digits in as many rounds. */
    enum { ROUNDS = 24 };
    const struct gsn_affine *map = &sight->section->to_panel;
    struct gsn_point p = gsn_affine_apply(map, block);

    for (int i = 0; i < ROUNDS; i++) {
        const struct gsn_point n = warp_at(sight, p);

        p = gsn_affine_apply(map, (struct gsn_point){ block.x - n.x, block.y - n.y });
    }
    return p;
}

struct gsn_phantom_reading gsn_phantom_sight_read(const struct gsn_phantom_sight *sight,
                                                  struct gsn_point p)
{
    return gsn_phantom_defect_read(sight->rent, gsn_phantom_sight_block(sight, p));
}

/* Where material is seen; 0 when nowhere. */
static int find_sight(const struct gsn_phantom_sight *sight, struct gsn_point material,
                      struct gsn_point *ret_p)
{
    struct gsn_point x;

    if (!gsn_phantom_defect_find(sight->rent, material, &x))
        return 0;
    *ret_p = gsn_phantom_sight_panel(sight, x);
    return 1;
}

/* --- marks --- */

/* Whether a point of the material is seen alone and uncovered; NULL, or by what it is hidden. */
static const struct gsn_phantom_defect *hider(const struct gsn_phantom_sight *sight,
                                              struct gsn_point material)
{
    const struct gsn_phantom_plan *plan = sight->plan;
    struct gsn_point p;

    if (!find_sight(sight, material, &p) || gsn_phantom_sight_read(sight, p).layers != 1)
        return sight->rent;
    for (size_t i = 0; i < plan->defects; i++) {
        const struct gsn_phantom_defect *d = &plan->defect[i];
        const struct gsn_point um = { p.x * plan->px_um, p.y * plan->px_um };

        if (d->k == sight->section->k && d->kind < GSN_PHANTOM_ACCIDENTS &&
            gsn_phantom_defect_opaque(d, plan->px_um, um))
            return d;
    }
    return NULL;
}

/* A tear that runs through a mark spoils it however narrow it is. */
static int is_torn(const struct gsn_phantom_sight *sight, const struct gsn_phantom_mark *mark)
{
    const struct gsn_phantom_defect *rent = sight->rent;
    struct gsn_point p;

    if (!rent || rent->kind != GSN_PHANTOM_TEAR)
        return 0;
    p = gsn_phantom_turn_into(mark->centre, rent->turn);
    return gsn_phantom_tear_gap(rent, p.y + mark->radius_um) > 0 &&
           fabs(p.x - rent->at.x) < mark->radius_um;
}

const char *gsn_phantom_sight_mark(const struct gsn_phantom_sight *sight, int mark,
                                   struct gsn_point *ret_p)
{
    enum { RINGS = 4, SPOKES = 16 };
    const double most_hidden = 0.25;
    const struct gsn_phantom_mark *m = &sight->section->mark[mark];
    const struct gsn_phantom_defect *by = NULL;
    int hidden = 0;

    if (!find_sight(sight, m->centre, ret_p))
        *ret_p = gsn_phantom_sight_panel(sight, m->centre);
    if (sight->section->shows < 0)
        return gsn_phantom_defect_name(sight->section->panel == sight->plan->missing_panel
                                           ? GSN_PHANTOM_MISSING_PANEL
                                           : GSN_PHANTOM_EMPTY_SLOT);
    if (m->missing)
        return "missing";
    if (is_torn(sight, m))
        return gsn_phantom_defect_name(GSN_PHANTOM_TEAR);
    for (int i = 0; i < RINGS * SPOKES; i++) {
        /* Rings of equal area. */
        const double r = m->radius_um * sqrt((i / SPOKES + 0.5) / RINGS);
        const double phi = 2 * M_PI * i / SPOKES;
        const struct gsn_point at = { m->centre.x + r * cos(phi), m->centre.y + r * sin(phi) };
        const struct gsn_phantom_defect *d = hider(sight, at);

        hidden += d != NULL;
        by = d ? d : by;
    }
    return by && hidden > most_hidden * RINGS * SPOKES ? gsn_phantom_defect_name(by->kind) : "";
}

/* --- the region --- */

static int is_clean(const struct gsn_phantom_sight *sight, const struct gsn_phantom_defect *d,
                    struct gsn_point p)
{
    const double px_um = sight->plan->px_um;
    const struct gsn_point um = { p.x * px_um, p.y * px_um };
    const struct gsn_point x = gsn_phantom_sight_block(sight, p);
    const struct gsn_phantom_reading reading = gsn_phantom_defect_read(d, x);

    return reading.layers == 1 && !reading.moved && !gsn_phantom_defect_covers(d, px_um, um) &&
           gsn_phantom_in_region(
               &sight->plan->variant.geometry,
               gsn_vec3_make(reading.at[0].x, reading.at[0].y, sight->section->z_um));
}

double gsn_phantom_sight_hidden(const struct gsn_phantom_sight *sight,
                                const struct gsn_phantom_defect *defect)
{
    const struct gsn_phantom_geometry *g = &sight->plan->variant.geometry;
    const double z = sight->section->z_um, px_um = sight->plan->px_um;
    /* A fold draws the region in by up to 500 um, a tear pushes it out by up to 300. */
    const double reach = (g->region_radius + 600) / px_um;
    const struct gsn_point middle =
        gsn_phantom_sight_panel(sight, (struct gsn_point){ g->lesion.x, g->lesion.y });
    size_t whole = 0, seen = 0;

    if (fabs(z - g->lesion.z) > g->region_half_height)
        return 0;
    for (double y = floor(middle.y - reach) + 0.5; y < middle.y + reach; y++)
        for (double x = floor(middle.x - reach) + 0.5; x < middle.x + reach; x++) {
            const struct gsn_point p = { x, y };
            const struct gsn_point at = gsn_phantom_sight_block(sight, p);

            whole += (size_t)gsn_phantom_in_region(g, gsn_vec3_make(at.x, at.y, z));
            seen += (size_t)is_clean(sight, defect, p);
        }
    return whole > seen ? (double)(whole - seen) / (double)whole : 0;
}
