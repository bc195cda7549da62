/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Plans a specimen: everything that is drawn at random for it.
 *
 * Steps: (1) level and specimen as the variant has them, and as many panels as they fill; (2) poses
 * of the sections, stain and glass of each panel; (3) the files that the panels come in as
 * (delivery.c); (4) what goes wrong: lost sections, defects, marks and decoys. The particulars of
 * each defect (where it lies, how large it is) are drawn for a kind and a section that are settled;
 * then the kinds are dealt out like cards, so that a specimen sees each of them before it sees one
 * twice. Every section and every kind has a stream of random numbers of its own: one more defect
 * changes none of the others.
 *
 * Failure: names that nobody defined, sizes beyond the limits, memory. Cost: none to speak of. */
#include "pipeline/phantom/planning.h"

#include "pipeline/core/mem.h"
#include "pipeline/phantom/delivery.h"
#include "pipeline/phantom/stain.h"

#include <math.h>
#include <string.h>

#define RAD_PER_DEG (M_PI / 180)

/* Of a panel, beside its slots. */
static const double BORDER_X_UM = 4800, BORDER_Y_UM = 960;
static const double LEAST_PX_UM = 4, MOST_PX_UM = 48;

/* --- levels --- */

/* A bad bench, however its panels come in. */
#define BAD_BENCH                                                                                  \
    .turn_within_deg = 180, .flip_share = .10, .jitter_um = 1300, .size_sd = .02, .axis_sd = .01,  \
    .warp_rms_um = 30, .mark_missing_share = .08, .mark_wander_um = 6, .decoys_most = 6,           \
    .ln_red_sd = .20, .ln_yellow_sd = .25, .dye_turn_deg = 5, .white_sd = .03, .ramp = .10,        \
    .illumination = .15, .noise_sd = 3, .texture = 1.3, .defects_least = 6, .defects_most = 8,     \
    .missing_least = 2, .missing_most = 3, .handled = 1, .extension = "jpg", .quality = 60

static const struct gsn_phantom_level LEVEL[] = {
    { .name = "L0", .extension = "png" },
    { .name = "L1",
      .turn_within_deg = 10,
      .jitter_um = 300,
      .illumination = .02,
      .noise_sd = 1.2,
      .texture = 1,
      .extension = "tif" },
    { .name = "L2",
      .turn_sd_deg = 12,
      .half_turn_share = .05,
      .flip_share = .03,
      .jitter_um = 600,
      .size_sd = .008,
      .axis_sd = .004,
      .warp_rms_um = 10,
      .mark_missing_share = .03,
      .mark_wander_um = 2,
      .decoys_most = 2,
      .ln_red_sd = .10,
      .ln_yellow_sd = .15,
      .dye_turn_deg = 2,
      .white_sd = .01,
      .ramp = .05,
      .illumination = .06,
      .noise_sd = 1.5,
      .texture = 1,
      .defects_least = 2,
      .defects_most = 3,
      .missing_least = 1,
      .missing_most = 1,
      .handled = 1,
      .extension = "jpg",
      .quality = 85 },
    { .name = "L3", .awkward = 1, BAD_BENCH },
    { .name = "L3-whole", BAD_BENCH },
};

static const struct gsn_phantom_level *find_level(const char *name)
{
    for (size_t i = 0; i < sizeof LEVEL / sizeof *LEVEL; i++)
        if (strcmp(LEVEL[i].name, name) == 0)
            return &LEVEL[i];
    return NULL;
}

/* --- poses and stains --- */

/* Within -most..most. */
static double draw_within(struct gsn_phantom_random *random, double most)
{
    return most * (2 * gsn_phantom_uniform(random) - 1);
}

/* What a hand adds to the pose: some sections lie upside down or turned over, and the water has
 * stretched them. */
static void handle_section(const struct gsn_phantom_level *level, struct gsn_phantom_random *random,
                           struct gsn_phantom_section *s)
{
    double size;

    s->theta += RAD_PER_DEG * gsn_phantom_normal(random, level->turn_sd_deg);
    s->theta += gsn_phantom_uniform(random) < level->half_turn_share ? M_PI : 0;
    s->flip = gsn_phantom_uniform(random) < level->flip_share;
    size = gsn_phantom_normal(random, level->size_sd);
    s->sx = 1 + size + gsn_phantom_normal(random, level->axis_sd);
    s->sy = 1 + size + gsn_phantom_normal(random, level->axis_sd);
}

static void place_section(struct gsn_phantom_plan *plan, int k)
{
    struct gsn_phantom_section *s = &plan->section[k];
    struct gsn_phantom_random random = gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_POSE, k, 0);
    struct gsn_point centre;

    *s = (struct gsn_phantom_section){ .k = k,
                                       .panel = k / plan->slots + 1,
                                       .slot = k % plan->slots,
                                       .shows = k,
                                       .z_um = gsn_phantom_section_z(&plan->variant.geometry, k),
                                       .sx = 1,
                                       .sy = 1 };
    centre = gsn_phantom_slot_centre_um(plan, s->slot);
    s->theta = RAD_PER_DEG * draw_within(&random, plan->level.turn_within_deg);
    s->centre_px.x = (centre.x + draw_within(&random, plan->level.jitter_um)) / plan->px_um;
    s->centre_px.y = (centre.y + draw_within(&random, plan->level.jitter_um)) / plan->px_um;
    if (plan->level.handled || plan->level.size_sd > 0)
        handle_section(&plan->level, &random, s);
    s->to_panel = gsn_phantom_panel_map(s, plan->px_um);
}

static void mix_batch(struct gsn_phantom_plan *plan, int panel)
{
    /* Above this a brighter glass would clip, which is a fault of the scanner, not of the glass. */
    const double brightest = 254;
    const struct gsn_phantom_level *level = &plan->level;
    struct gsn_phantom_batch *batch = &plan->batch[panel];
    struct gsn_phantom_random random =
        gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_BATCH, panel, 0);

    *batch = (struct gsn_phantom_batch){ .red_gain = plan->specimen.red_gain,
                                         .yellow_gain = plan->specimen.yellow_gain };
    for (int i = 0; i < GSN_PHANTOM_DYES; i++)
        gsn_phantom_variant_dye(&plan->variant, (enum gsn_phantom_dye)i, batch->dye[i]);
    for (int c = 0; c < 3; c++)
        batch->white[c] = gsn_phantom_white[c];
    if (!level->handled && level->dye_turn_deg == 0)
        return;
    batch->red_gain *= exp(gsn_phantom_normal(&random, level->ln_red_sd));
    batch->yellow_gain *= exp(gsn_phantom_normal(&random, level->ln_yellow_sd));
    for (int i = 0; i < GSN_PHANTOM_MARK; i++)
        gsn_phantom_turn_vector(
            &random, RAD_PER_DEG * gsn_phantom_normal(&random, level->dye_turn_deg), batch->dye[i]);
    for (int c = 0; c < 3; c++)
        batch->white[c] =
            fmin(brightest, batch->white[c] * (1 + gsn_phantom_normal(&random, level->white_sd)));
}

/* What the variant has instead of what the level and the specimen have. */
static void apply_variant(struct gsn_phantom_plan *plan)
{
    const struct gsn_phantom_variant *v = &plan->variant;

    plan->specimen.depth *= v->loss;
    plan->specimen.red_gain *= v->stain_strength;
    plan->specimen.yellow_gain *= v->stain_strength;
    plan->level.texture *= v->texture;
    if (v->panel_turn_deg >= 0)
        plan->level.dye_turn_deg = v->panel_turn_deg;
    if (v->size_share >= 0)
        plan->level.size_sd = v->size_share;
    if (v->jpeg_quality >= 0) {
        plan->level.extension = v->jpeg_quality > 0 ? "jpg" : "png";
        plan->level.quality = v->jpeg_quality;
    }
}

/* As many panels as the sections of the specimen and of its block fill. */
static void count_panels(struct gsn_phantom_plan *plan)
{
    const struct gsn_phantom_variant *v = &plan->variant;
    const int sections = plan->specimen.sections < v->geometry.sections ? plan->specimen.sections
                                                                        : v->geometry.sections;
    const double frame = 2 * gsn_phantom_frame_um(plan);
    const double pitch_um = 2 * gsn_phantom_slot_half_um;

    plan->slots = v->rows * v->columns;
    plan->panels = sections / plan->slots;
    plan->sections = plan->panels * plan->slots;
    plan->width = (uint32_t)lround((BORDER_X_UM + pitch_um * v->columns + frame) / plan->px_um);
    plan->height = (uint32_t)lround((BORDER_Y_UM + pitch_um * v->rows + frame) / plan->px_um);
}

/* --- the shapes of defects --- */

/* A place anywhere in a disc. */
static struct gsn_point draw_around(struct gsn_phantom_random *random, struct gsn_point centre,
                                    double radius)
{
    const double r = radius * sqrt(gsn_phantom_uniform(random));
    const double phi = gsn_phantom_between(random, 0, 2 * M_PI);

    return (struct gsn_point){ centre.x + r * cos(phi), centre.y + r * sin(phi) };
}

/* The middle of a section, um on its panel. */
static struct gsn_point find_centre_um(const struct gsn_phantom_plan *plan,
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

    d->at = draw_around(random, middle, 1700);
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
    draw_wandering(random, draw_around(random, centre, 2000), heading,
                   gsn_phantom_between(random, 350, 700), .9, d);
    d->at = d->point[0];
    for (int i = 0; i < GSN_PHANTOM_DUST; i++) {
        d->dust[i].at = draw_around(random, centre, 2600);
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

        draw_wandering(random, draw_around(random, from, 600), phi, length / 3, .3, d);
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

/* Fills in what its kind needs. Touching moves the section and its right neighbour, which must lie
 * in the same row. */
static void shape_defect(const struct gsn_phantom_plan *plan, struct gsn_phantom_random *random,
                         struct gsn_phantom_section *s, struct gsn_phantom_defect *d)
{
    const struct gsn_point centre = find_centre_um(plan, s);

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
        d->at = draw_around(random, centre, 2200);
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
        d->at = draw_around(random, centre, 2000);
        d->radius = gsn_phantom_between(random, 500, 1500);
        d->sigma_px = gsn_phantom_between(random, 1, 3);
        break;
    default:
        make_touch(plan, random, s, d);
        break;
    }
}

/* Sections that have been given a defect, of one panel. */
struct dealing {
    struct gsn_phantom_plan *plan;
    struct gsn_phantom_random *random;
    int panel; /* from 0 */
    int used[GSN_PHANTOM_SLOTS_MOST];
};

/* --- marks and decoys --- */

/* They belong to the section that is mounted: a section mounted twice brings the same marks. */
static void burn_marks(const struct gsn_phantom_plan *plan, struct gsn_phantom_section *s)
{
    const struct gsn_phantom_geometry *g = &plan->variant.geometry;
    const struct gsn_phantom_level *level = &plan->level;
    struct gsn_phantom_random random =
        gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_MARKS, s->shows < 0 ? s->k : s->shows, 0);
    const double longest = plan->variant.aspect > 0 ? plan->variant.aspect : 1.15;

    for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
        struct gsn_phantom_mark *mark = &s->mark[i];

        *mark = (struct gsn_phantom_mark){ .centre = g->mark[i],
                                           .radius_um = plan->variant.burning.radius_um,
                                           .ratio = 1,
                                           .missing = plan->variant.no_marks };
        if (!level->handled && plan->variant.aspect < 0)
            continue;
        mark->missing |= gsn_phantom_uniform(&random) < level->mark_missing_share;
        mark->centre.x += gsn_phantom_normal(&random, level->mark_wander_um);
        mark->centre.y += gsn_phantom_normal(&random, level->mark_wander_um);
        mark->radius_um *= level->handled ? gsn_phantom_between(&random, 0.9, 1.1) : 1;
        mark->ratio = gsn_phantom_between(&random, 1, longest);
        mark->turn = gsn_phantom_between(&random, 0, M_PI);
    }
}

/* A decoy on a mark would be a spoilt mark instead. */
static int near_mark(const struct gsn_phantom_plan *plan, const struct gsn_phantom_section *s,
                     struct gsn_point at_um)
{
    const double apart = 275 + plan->variant.burning.radius_um;

    for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
        const struct gsn_point p = gsn_affine_apply(&s->to_panel, s->mark[i].centre);

        if (hypot(p.x * plan->px_um - at_um.x, p.y * plan->px_um - at_um.y) < apart)
            return 1;
    }
    return 0;
}

static void strew_debris(const struct gsn_phantom_plan *plan, struct gsn_phantom_section *s)
{
    const double reach = 2600, least_um = 40, most_um = 130;
    const double size = plan->variant.burning.radius_um / gsn_phantom_burning()->radius_um;
    const int exactly = plan->variant.decoys;
    struct gsn_phantom_random random =
        gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_DECOYS, s->k, 0);
    const int drawn = (int)gsn_phantom_below(&random, (uint32_t)plan->level.decoys_most + 1);
    const int wanted = exactly < 0 ? drawn : exactly;

    while (s->decoys < wanted) {
        struct gsn_phantom_decoy *decoy = &s->decoy[s->decoys];

        decoy->kind =
            (enum gsn_phantom_decoy_kind)gsn_phantom_below(&random, GSN_PHANTOM_DECOY_KINDS);
        decoy->radius_um = gsn_phantom_between(&random, least_um, most_um);
        if (exactly >= 0) { /* round, and as large as a mark may be */
            decoy->kind = GSN_PHANTOM_DEBRIS;
            decoy->radius_um *= size;
        }
        decoy->at_um = draw_around(&random, find_centre_um(plan, s), reach);
        s->decoys += !near_mark(plan, s, decoy->at_um);
    }
}

/* --- sections that are not there --- */

static void add_defect(struct gsn_phantom_plan *plan, const struct gsn_phantom_defect *defect)
{
    if (plan->defects < GSN_PHANTOM_DEFECTS_MOST)
        plan->defect[plan->defects++] = *defect;
}

/* A lost section leaves its slot empty; now and then the one before it is mounted there again. */
static void lose_section(struct gsn_phantom_plan *plan, int k, struct gsn_phantom_random *random)
{
    const double duplicate_share = 0.25;
    struct gsn_phantom_section *s = &plan->section[k];
    const int again = gsn_phantom_uniform(random) < duplicate_share && s->slot > 0 &&
                      plan->section[k - 1].shows == k - 1;
    const struct gsn_phantom_defect defect = {
        .kind = again ? GSN_PHANTOM_DUPLICATE : GSN_PHANTOM_EMPTY_SLOT,
        .k = k,
        .at = gsn_phantom_slot_centre_um(plan, s->slot),
    };

    s->shows = again ? k - 1 : -1;
    add_defect(plan, &defect);
}

/* What a level says of twelve sections, for a panel of more or fewer. */
static int per_panel(const struct gsn_phantom_plan *plan, int in_twelve)
{
    return (in_twelve * plan->slots + GSN_PHANTOM_SLOTS / 2) / GSN_PHANTOM_SLOTS;
}

static void lose_some(struct dealing *deal)
{
    const struct gsn_phantom_level *level = &deal->plan->level;
    const int range = level->missing_most - level->missing_least + 1;
    const int slots = deal->plan->slots;
    int left = level->missing_least + (int)gsn_phantom_below(deal->random, (uint32_t)range);

    left = per_panel(deal->plan, left);
    while (left > 0) {
        const int slot = (int)gsn_phantom_below(deal->random, (uint32_t)slots);
        const int k = deal->panel * slots + slot;

        if (deal->used[slot] || (slot + 1 < slots && deal->plan->section[k + 1].shows == k))
            continue;
        lose_section(deal->plan, k, deal->random);
        deal->used[slot] = 1;
        left--;
    }
}

/* --- defects --- */

/* One edge runs over all sections of a row: each has an entry. */
static void note_row(struct dealing *deal, struct gsn_phantom_defect d)
{
    const int columns = deal->plan->variant.columns, first = d.k - d.k % columns;

    for (int k = first; k < first + columns; k++) {
        d.k = k;
        if (deal->plan->section[k].shows >= 0)
            add_defect(deal->plan, &d);
    }
}

static int may_befall(const struct dealing *deal, enum gsn_phantom_defect_kind kind, int slot)
{
    if (deal->used[slot])
        return 0;
    if (kind != GSN_PHANTOM_TOUCHING)
        return 1;
    return slot % deal->plan->variant.columns + 1 < deal->plan->variant.columns &&
           !deal->used[slot + 1];
}

/* 0 when no section is left that it could befall. */
static int draw_section(struct dealing *deal, enum gsn_phantom_defect_kind kind)
{
    const int slots = deal->plan->slots, first = deal->panel * slots;
    const int start = (int)gsn_phantom_below(deal->random, (uint32_t)slots);

    for (int i = 0; i < slots; i++) {
        const int slot = (start + i) % slots;
        struct gsn_phantom_defect d = { .kind = kind, .k = first + slot };

        if (!may_befall(deal, kind, slot))
            continue;
        shape_defect(deal->plan, deal->random, &deal->plan->section[d.k], &d);
        deal->used[slot] = 1;
        if (kind == GSN_PHANTOM_COVERSLIP_EDGE) {
            note_row(deal, d);
            return 1;
        }
        add_defect(deal->plan, &d);
        if (kind == GSN_PHANTOM_TOUCHING) {
            d.k++;
            deal->used[slot + 1] = 1;
            add_defect(deal->plan, &d);
        }
        return 1;
    }
    return 0;
}

static void lose_panel(struct gsn_phantom_plan *plan)
{
    const int first = (plan->missing_panel - 1) * plan->slots;

    for (int k = first; k < first + plan->slots; k++) {
        const struct gsn_phantom_defect defect = {
            .kind = GSN_PHANTOM_MISSING_PANEL,
            .k = k,
            .at = gsn_phantom_slot_centre_um(plan, k - first),
        };

        plan->section[k].shows = -1;
        add_defect(plan, &defect);
    }
}

/* The kinds in an order of their own: dealt out like cards, so that a specimen sees each of them
 * before it sees one twice. */
static void shuffle_kinds(struct gsn_phantom_random *random, int card[GSN_PHANTOM_ACCIDENTS])
{
    for (int i = 0; i < GSN_PHANTOM_ACCIDENTS; i++) {
        const int j = (int)gsn_phantom_below(random, (uint32_t)i + 1);

        card[i] = card[j];
        card[j] = i;
    }
}

static void deal_defects(struct gsn_phantom_plan *plan)
{
    const struct gsn_phantom_level *level = &plan->level;
    const int range = level->defects_most - level->defects_least + 1;
    struct gsn_phantom_random random =
        gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_DEFECTS, 0, 0);
    int card[GSN_PHANTOM_ACCIDENTS] = { 0 }, dealt = 0;

    for (int panel = 0; panel < plan->panels; panel++) {
        struct dealing deal = { .plan = plan, .random = &random, .panel = panel };
        int count;

        if (panel + 1 == plan->missing_panel) {
            lose_panel(plan);
            continue;
        }
        lose_some(&deal);
        count = level->defects_least + (int)gsn_phantom_below(&random, (uint32_t)range);
        count = per_panel(plan, count);
        /* What finds no section is put aside, which a whole hand of cards never is. */
        for (int last = dealt + 2 * GSN_PHANTOM_ACCIDENTS; count > 0 && dealt < last; dealt++) {
            if (dealt % GSN_PHANTOM_ACCIDENTS == 0)
                shuffle_kinds(&random, card);
            count -= draw_section(
                &deal, (enum gsn_phantom_defect_kind)card[dealt % GSN_PHANTOM_ACCIDENTS]);
        }
    }
}

static void draw_mishaps(struct gsn_phantom_plan *plan)
{
    if (plan->level.handled)
        deal_defects(plan);
    for (int k = 0; k < plan->sections; k++) {
        burn_marks(plan, &plan->section[k]);
        if (plan->level.handled || plan->variant.decoys >= 0)
            strew_debris(plan, &plan->section[k]);
    }
}

/* --- the plan --- */

int gsn_phantom_plan_make(const char *specimen, const char *level, uint64_t seed, double px_um,
                          struct gsn_phantom_plan *ret_plan, struct gsn_error *err)
{
    const struct gsn_phantom_variant usual = gsn_phantom_variant_usual();

    return gsn_phantom_plan_make_variant(specimen, level, seed, px_um, &usual, ret_plan, err);
}

int gsn_phantom_plan_make_variant(const char *specimen, const char *level, uint64_t seed,
                                  double px_um, const struct gsn_phantom_variant *variant,
                                  struct gsn_phantom_plan *ret_plan, struct gsn_error *err)
{
    const struct gsn_phantom_specimen *of = gsn_phantom_specimen_find(specimen);
    const struct gsn_phantom_level *at = find_level(level);
    gsn_auto_mem(struct gsn_phantom_plan) plan = gsn_alloc_array(1, sizeof *plan);

    if (!plan)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the plan of %s", specimen);
    if (!of)
        return gsn_fail(err, GSN_E_NOTFOUND,
                        "no specimen %s: there are S00 to S04, and of the study N1 to N4, S1 to "
                        "S4, U1 to U4, T2, T4 and T8",
                        specimen);
    if (!at)
        return gsn_fail(err, GSN_E_NOTFOUND, "no level %s: there are L0 to L3, and L3-whole",
                        level);
    if (px_um == 0)
        px_um = of->usual_px_um;
    if (!(px_um >= LEAST_PX_UM && px_um <= MOST_PX_UM))
        return gsn_fail(err, GSN_E_LIMIT, "a pixel of %g um: it must be %g to %g um", px_um,
                        LEAST_PX_UM, MOST_PX_UM);
    if (of->depth * variant->loss > 1)
        return gsn_fail(err, GSN_E_LIMIT,
                        "the lesion of %s is %g deep: its \"loss\" can be %.3f at most", specimen,
                        of->depth, 1 / of->depth);
    plan->specimen = *of;
    plan->level = *at;
    plan->seed = seed;
    plan->px_um = px_um;
    plan->variant = *variant;
    apply_variant(plan);
    count_panels(plan);
    if (plan->panels == 0)
        return gsn_fail(err, GSN_E_LIMIT, "%d sections do not fill a panel of %d",
                        variant->geometry.sections, plan->slots);
    for (int k = 0; k < plan->sections; k++)
        place_section(plan, k);
    for (int panel = 0; panel < plan->panels; panel++)
        mix_batch(plan, panel);
    gsn_phantom_delivery_draw(plan);
    draw_mishaps(plan);
    *ret_plan = *plan;
    return GSN_OK;
}
