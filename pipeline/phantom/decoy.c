/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Decoys: each kind is one or many soft discs, or a soft ring, added to the optical density of the
 * glass. A grain smaller than a pixel is drawn as large as one and paler by the same area. Cost:
 * the pixels covered. */
#include "pipeline/phantom/decoy.h"

#include "pipeline/phantom/stain.h"

#include <math.h>

enum { GRAINS = 24, CELLS = 60, DROPLETS = 4 };

static const double EDGE_UM = 14, CELL_UM = 8;
static const double BROWN[3] = { .45, .75, 1.05 }, INK[3] = { 1.15, .85, .55 };
static const double RIM_OD = .7, RIM_EDGE_UM = 10, BUBBLE_PALE = .85;

const char *gsn_phantom_decoy_name(enum gsn_phantom_decoy_kind kind)
{
    static const char *const name[GSN_PHANTOM_DECOY_KINDS] = {
        [GSN_PHANTOM_DEBRIS] = "debris",         [GSN_PHANTOM_PIGMENT] = "pigment",
        [GSN_PHANTOM_NUCLEI] = "nuclei",         [GSN_PHANTOM_INK_DOT] = "ink_dot",
        [GSN_PHANTOM_BUBBLE_RIM] = "bubble_rim",
    };
    return name[kind];
}

/* A soft disc, or a soft ring about paler glass. */
struct blob {
    struct gsn_point at;
    double radius, edge;
    double od[3]; /* added where the blob is */
    double rim;   /* sigma of the ring; 0: a disc */
};

/* 0..1: a soft disc, or a soft line along its border. */
static double share_of(const struct blob *b, double distance)
{
    const double away = distance - b->radius;

    if (b->rim > 0)
        return exp(-away * away / (2 * b->rim * b->rim));
    return gsn_phantom_step(-away / b->edge);
}

static void draw_blob(const struct gsn_phantom_glass *glass, const struct blob *b)
{
    const double px = glass->px_um, reach = b->radius + 3 * b->rim + b->edge + px;
    const int64_t left = (int64_t)floor((b->at.x - reach) / px),
                  right = (int64_t)ceil((b->at.x + reach) / px);
    const int64_t top = (int64_t)floor((b->at.y - reach) / px),
                  low = (int64_t)ceil((b->at.y + reach) / px);

    for (int64_t y = top < 0 ? 0 : top; y < low && y < glass->height; y++)
        for (int64_t x = left < 0 ? 0 : left; x < right && x < glass->width; x++) {
            const double distance =
                hypot(((double)x + 0.5) * px - b->at.x, ((double)y + 0.5) * px - b->at.y);
            const double share = share_of(b, distance);
            float *od = glass->od + 3 * ((size_t)y * glass->width + (size_t)x);

            for (int c = 0; c < 3; c++) {
                if (b->rim > 0 && distance < b->radius)
                    od[c] *= (float)BUBBLE_PALE;
                od[c] += (float)(share * b->od[c]);
            }
        }
}

/* Many small discs in a Gaussian heap whose deviation is half the radius. What is smaller than a
 * pixel is drawn as large as one and the paler for it. */
static void draw_heap(const struct gsn_phantom_glass *glass, const struct gsn_phantom_decoy *decoy,
                      struct gsn_phantom_random *random, int count, double grain_um,
                      const double od[3])
{
    for (int i = 0; i < count; i++) {
        const double size = grain_um * gsn_phantom_between(random, .6, 1.4);
        const double drawn = fmax(size, glass->px_um / 2), pale = (size / drawn) * (size / drawn);
        struct blob b = { .radius = drawn, .edge = fmax(drawn / 2, glass->px_um / 2) };
        double pair[2];

        gsn_phantom_normals(random, pair);
        b.at = (struct gsn_point){ decoy->at_um.x + decoy->radius_um / 2 * pair[0],
                                   decoy->at_um.y + decoy->radius_um / 2 * pair[1] };
        for (int c = 0; c < 3; c++)
            b.od[c] = pale * od[c];
        draw_blob(glass, &b);
    }
}

static void draw_ink(const struct gsn_phantom_glass *glass, const struct gsn_phantom_decoy *decoy,
                     struct gsn_phantom_random *random)
{
    struct blob b = { decoy->at_um, decoy->radius_um, EDGE_UM, { INK[0], INK[1], INK[2] }, 0 };

    draw_blob(glass, &b);
    for (int i = 0; i < DROPLETS; i++) {
        const double phi = gsn_phantom_between(random, 0, 2 * M_PI);
        const double far = decoy->radius_um * gsn_phantom_between(random, 1.2, 1.8);

        b.at =
            (struct gsn_point){ decoy->at_um.x + far * cos(phi), decoy->at_um.y + far * sin(phi) };
        b.radius = decoy->radius_um * gsn_phantom_between(random, .08, .25);
        draw_blob(glass, &b);
    }
}

static void draw_round(const struct gsn_phantom_glass *glass, const struct gsn_phantom_decoy *decoy,
                       const double od[3], double amount, double rim_um)
{
    struct blob b = { decoy->at_um, decoy->radius_um, EDGE_UM, { 0 }, rim_um };

    for (int c = 0; c < 3; c++)
        b.od[c] = amount * od[c];
    draw_blob(glass, &b);
}

void gsn_phantom_decoy_draw(const struct gsn_phantom_plan *plan, int k, int i,
                            const struct gsn_phantom_glass *glass)
{
    const struct gsn_phantom_decoy *decoy = &plan->section[k].decoy[i];
    const struct gsn_phantom_recipe *recipe = gsn_phantom_recipe();
    const double grey[3] = { 1, 1, 1 };
    struct gsn_phantom_random random =
        gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_DECOYS, k, (uint32_t)i + 1);
    double burnt[3], nuclear[3];

    gsn_phantom_dye_vector(GSN_PHANTOM_MARK, burnt);
    gsn_phantom_dye_vector(GSN_PHANTOM_NUCLEAR, nuclear);
    switch (decoy->kind) {
    case GSN_PHANTOM_DEBRIS:
        draw_round(glass, decoy, burnt, recipe->mark_amount, 0);
        break;
    case GSN_PHANTOM_PIGMENT:
        draw_heap(glass, decoy, &random, GRAINS, decoy->radius_um / 5, BROWN);
        break;
    case GSN_PHANTOM_NUCLEI:
        for (int c = 0; c < 3; c++)
            nuclear[c] *= recipe->nuclear_amount;
        draw_heap(glass, decoy, &random, CELLS, CELL_UM, nuclear);
        break;
    case GSN_PHANTOM_INK_DOT:
        draw_ink(glass, decoy, &random);
        break;
    default:
        draw_round(glass, decoy, grey, RIM_OD, RIM_EDGE_UM);
        break;
    }
}
