/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The pixels of one stained section.
 *
 * Steps: (1) the window of the panel that the section may reach; (2) its two textures, as quilts of
 * its own stream; (3) for each pixel the material that it shows (sight.c): none, one layer, or two
 * of a fold; (4) for each layer the field of the block, dyes by texture, ramp and a Poisson number
 * of nuclei, marks burnt in last, and the optical densities added; (5) chatter of the knife as
 * waves of thickness.
 *
 * Failure: GSN_E_NOMEM. Cost: the field at every pixel of the window. */
#include "pipeline/phantom/section.h"

#include "pipeline/core/mem.h"

#include "pipeline/phantom/sight.h"
#include "pipeline/phantom/stain.h"
#include "pipeline/phantom/texture.h"

#include <math.h>

/* One section while it is drawn. */
struct brush {
    const struct gsn_phantom_plan *plan;
    struct gsn_phantom_sight sight;
    struct gsn_phantom_window slot;
    struct gsn_phantom_stain stain;
    const struct gsn_plane *red, *yellow; /* NULL at levels without texture */
    struct gsn_phantom_random nuclei;
};

static struct gsn_phantom_window window_of(const struct gsn_phantom_plan *plan, int slot)
{
    const struct gsn_point centre = gsn_phantom_slot_centre_um(plan, slot);
    const double half = gsn_phantom_slot_half_um;
    const struct gsn_phantom_window window = {
        gsn_phantom_to_px(centre.x - half, plan->px_um, plan->width),
        gsn_phantom_to_px(centre.y - half, plan->px_um, plan->height),
        gsn_phantom_to_px(centre.x + half, plan->px_um, plan->width),
        gsn_phantom_to_px(centre.y + half, plan->px_um, plan->height),
    };
    return window;
}

/* l, over the section image: across it in a direction that turns from section to section. */
static double ramp_place(const struct brush *brush, double x, double y)
{
    const struct gsn_phantom_window *w = &brush->slot;
    const double k = 0.7 * brush->sight.section->k;

    return ((x - w->x0) / (w->x1 - w->x0) - 0.5) * cos(k) +
           ((y - w->y0) / (w->y1 - w->y0) - 0.5) * sin(k);
}

/* Where in the quilt a pixel lies: at the levels that are handled the grain is the tissue's own
 * and moves with it, at the others it lies in the picture. */
static struct gsn_point grain_at(const struct brush *brush, struct gsn_point p, struct gsn_point at)
{
    const double texel_px = GSN_PHANTOM_TEXEL_UM / brush->plan->px_um;
    const struct gsn_point picture = { (p.x - brush->slot.x0) / texel_px,
                                       (p.y - brush->slot.y0) / texel_px };
    const struct gsn_point tissue = { (at.x + gsn_phantom_slot_half_um) / GSN_PHANTOM_TEXEL_UM,
                                      (at.y + gsn_phantom_slot_half_um) / GSN_PHANTOM_TEXEL_UM };

    return brush->plan->level.handled ? tissue : picture;
}

static void draw_tissue(struct brush *brush, struct gsn_point p, struct gsn_point at,
                        const struct gsn_phantom_field *field, double od[3])
{
    const double amount = brush->plan->level.texture;
    struct gsn_phantom_local local = { .ramp_place = ramp_place(brush, p.x, p.y) };

    if (brush->red && brush->yellow) {
        const struct gsn_point t = grain_at(brush, p, at);

        local.red_texture = amount * gsn_phantom_texture_at(brush->red, t.x, t.y);
        local.yellow_texture = amount * gsn_phantom_texture_at(brush->yellow, t.x, t.y);
    }
    local.nuclei =
        gsn_phantom_poisson(&brush->nuclei, gsn_phantom_nuclei_mean(field, brush->stain.depth));
    gsn_phantom_optical_density(field, &brush->stain, &local, od);
}

static void widen_extent(struct gsn_phantom_extent *extent, uint32_t x, uint32_t y)
{
    uint32_t right = extent->x + extent->width, low = extent->y + extent->height;

    if (extent->area_px++ == 0) {
        *extent = (struct gsn_phantom_extent){ x, y, 1, 1, 1 };
        return;
    }
    right = x + 1 > right ? x + 1 : right;
    low = y + 1 > low ? y + 1 : low;
    extent->x = x < extent->x ? x : extent->x;
    extent->y = y < extent->y ? y : extent->y;
    extent->width = right - extent->x;
    extent->height = low - extent->y;
}

/* Marks are burnt last, in material coordinates, so that no texture lies on them. */
static void burn_marks(const struct gsn_phantom_plan *plan,
                       const struct gsn_phantom_section *section, struct gsn_point at, double od[3])
{
    const struct gsn_phantom_burning *b = &plan->variant.burning;
    /* Beyond this no mark reaches, however large and long it was burnt. */
    const double reach = b->ring_um + b->edge_um + 0.3 * b->radius_um +
                         (plan->variant.aspect > 0 ? 0.3 * b->ring_um : 0);

    for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
        const struct gsn_phantom_mark *mark = &section->mark[i];
        const struct gsn_point away = { at.x - mark->centre.x, at.y - mark->centre.y };
        struct gsn_point p;

        if (mark->missing || fabs(away.x) > reach || fabs(away.y) > reach)
            continue;
        p = gsn_phantom_turn_into(away, mark->turn);
        gsn_phantom_burn(b,
                         hypot(p.x / sqrt(mark->ratio), p.y * sqrt(mark->ratio)) -
                             (mark->radius_um - b->radius_um),
                         od);
    }
}

/* One layer of the section: adds its optical density at the material point. Returns F. */
static double draw_layer(struct brush *brush, struct gsn_point p, struct gsn_point at, float out[3])
{
    struct gsn_phantom_field field;
    double od[3] = { 0 };

    gsn_phantom_field_at(&brush->plan->variant.geometry,
                         gsn_vec3_make(at.x, at.y, brush->sight.cut_z_um), &field);
    gsn_phantom_field_thicken(&field, brush->plan->specimen.bone_gain);
    if (field.tissue > 0)
        draw_tissue(brush, p, at, &field, od);
    burn_marks(brush->plan, brush->sight.section, at, od);
    for (int c = 0; c < 3; c++)
        out[c] += (float)od[c];
    return field.tissue;
}

static void draw_pixels(struct brush *brush, struct gsn_phantom_sheet *sheet)
{
    const struct gsn_phantom_window *w = &sheet->window;

    for (uint32_t y = w->y0; y < w->y1; y++)
        for (uint32_t x = w->x0; x < w->x1; x++) {
            const struct gsn_point p = { x + 0.5, y + 0.5 };
            const struct gsn_phantom_reading reading = gsn_phantom_sight_read(&brush->sight, p);
            float *out = sheet->od + 3 * ((size_t)(y - w->y0) * (w->x1 - w->x0) + (x - w->x0));

            for (int i = 0; i < reading.layers; i++) {
                const double tissue = draw_layer(brush, p, reading.at[i], out);

                if (i == 0 && tissue >= 0.5 && !(reading.moved && reading.layers == 1))
                    widen_extent(&sheet->extent, x, y);
            }
        }
}

/* The knife shook: thick and thin by turns, every 90 um. */
static void add_chatter(const struct gsn_phantom_plan *plan, const struct gsn_phantom_defect *d,
                        struct gsn_phantom_sheet *sheet)
{
    const double wave_um = 90, depth = 0.12;
    const struct gsn_phantom_window *w = &sheet->window;
    float *od = sheet->od;

    for (uint32_t y = w->y0; y < w->y1; y++)
        for (uint32_t x = w->x0; x < w->x1; x++) {
            const struct gsn_point um = { (x + 0.5) * plan->px_um, (y + 0.5) * plan->px_um };
            const double v = gsn_phantom_turn_into(um, d->turn).x;
            const float factor = (float)(1 + depth * cos(2 * M_PI * v / wave_um));

            for (int c = 0; c < 3; c++)
                *od++ *= factor;
        }
}

static int make_textures(const struct brush *brush, struct gsn_plane **ret_red,
                         struct gsn_plane **ret_yellow, struct gsn_error *err)
{
    const uint32_t side = (uint32_t)(2 * gsn_phantom_slot_half_um / GSN_PHANTOM_TEXEL_UM) + 4;
    struct gsn_phantom_random red_draws = gsn_phantom_plan_random(
        brush->plan, GSN_PHANTOM_STREAM_RED_TEXTURE, brush->sight.section->shows, 0);
    struct gsn_phantom_random yellow_draws = gsn_phantom_plan_random(
        brush->plan, GSN_PHANTOM_STREAM_YELLOW_TEXTURE, brush->sight.section->shows, 0);
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    int r;

    r = gsn_phantom_quilt(GSN_PHANTOM_T1, side, side, &red_draws, &red, err);
    if (r < 0)
        return r;
    r = gsn_phantom_quilt(GSN_PHANTOM_T2, side, side, &yellow_draws, &yellow, err);
    if (r < 0)
        return r;
    *ret_red = gsn_steal(&red);
    *ret_yellow = gsn_steal(&yellow);
    return GSN_OK;
}

/* The slot; and when the section may reach out of it, the square around the section as well, but
 * never the label's writing. */
static struct gsn_phantom_window sheet_window(const struct gsn_phantom_plan *plan,
                                              const struct gsn_phantom_section *section)
{
    const double reach_px = 3100 / plan->px_um; /* half a diagonal of the tissue is 2800 um */
    const double writing_px = 3600 / plan->px_um, frame_px = plan->variant.black_frame_px;
    const struct gsn_phantom_window slot = window_of(plan, section->slot);
    const struct gsn_point c = section->centre_px;

    if (!plan->level.handled)
        return slot;
    return (struct gsn_phantom_window){
        (uint32_t)fmax(fmin(slot.x0, c.x - reach_px), frame_px + writing_px),
        (uint32_t)fmax(fmin(slot.y0, c.y - reach_px), frame_px),
        (uint32_t)fmin(fmax(slot.x1, c.x + reach_px), plan->width - frame_px),
        (uint32_t)fmin(fmax(slot.y1, c.y + reach_px), plan->height - frame_px),
    };
}

void gsn_phantom_sheet_done(struct gsn_phantom_sheet *sheet)
{
    gsn_free(sheet->od);
    *sheet = (struct gsn_phantom_sheet){ 0 };
}

static int draw_sheet(const struct gsn_phantom_plan *plan, int k, struct gsn_phantom_sheet *sheet,
                      struct gsn_error *err)
{
    const struct gsn_phantom_section *section = &plan->section[k];
    const struct gsn_phantom_batch *batch = &plan->batch[section->panel - 1];
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    struct brush brush = { .plan = plan,
                           .slot = window_of(plan, section->slot),
                           .stain = { .red_gain = batch->red_gain,
                                      .yellow_gain = batch->yellow_gain,
                                      .ramp = plan->level.ramp,
                                      .depth = plan->specimen.depth,
                                      .dye = batch->dye } };

    gsn_phantom_sight_make(plan, k, &brush.sight);
    brush.nuclei = gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_NUCLEI, section->shows, 0);
    if (plan->level.texture > 0) {
        const int r = make_textures(&brush, &red, &yellow, err);

        if (r < 0)
            return r;
    }
    brush.red = red;
    brush.yellow = yellow;
    draw_pixels(&brush, sheet);
    for (size_t i = 0; i < plan->defects; i++)
        if (plan->defect[i].kind == GSN_PHANTOM_CHATTER && plan->defect[i].k == k)
            add_chatter(plan, &plan->defect[i], sheet);
    return GSN_OK;
}

int gsn_phantom_section_draw(const struct gsn_phantom_plan *plan, int k,
                             struct gsn_phantom_sheet *ret_sheet, struct gsn_error *err)
{
    struct gsn_phantom_sheet sheet = { .window = sheet_window(plan, &plan->section[k]) };
    const struct gsn_phantom_window *w = &sheet.window;
    int r;

    if (plan->section[k].shows < 0) {
        *ret_sheet = sheet;
        return GSN_OK;
    }
    sheet.od = gsn_alloc_array((size_t)(w->x1 - w->x0) * (w->y1 - w->y0), 3 * sizeof *sheet.od);
    if (!sheet.od)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for section %d", k);
    r = draw_sheet(plan, k, &sheet, err);
    if (r < 0) {
        gsn_phantom_sheet_done(&sheet);
        return gsn_fail_at(err, "section %d", k);
    }
    *ret_sheet = sheet;
    return GSN_OK;
}
