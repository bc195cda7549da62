/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/phantom/panel.h"

#include "pipeline/core/parallel.h"
#include "tests/phantom/label.h"
#include "tests/phantom/matrix.h"
#include "tests/phantom/stain.h"
#include "tests/phantom/texture.h"

#include <math.h>
#include <stdio.h>

static const double LABEL_INK = 1.2; /* optical density, the same in all channels */
static const struct gsn_point LABEL_NAME_UM = { 320, 1600 }, LABEL_PANEL_UM = { 320, 2400 };
/* Of the Data Matrix: its upper left corner, with more than its quiet zone around it; how large a
 * module is wanted; and of how many pixels it is at least, because libdmtx reads none of two. */
static const struct gsn_point MATRIX_UM = { 320, 3200 };
static const double MODULE_UM = 96, LEAST_MODULE_PX = 3;

/* Pixels x0 <= x < x1, y0 <= y < y1. Windows of neighbouring slots share their border only. */
struct window {
    uint32_t x0, y0, x1, y1;
};

struct canvas {
    const struct gsn_phantom_plan *plan;
    int panel;
    float *od; /* three per pixel */
    struct gsn_image *image;
    struct gsn_phantom_extent *extent;
};

/* One section while it is drawn. */
struct brush {
    const struct gsn_phantom_plan *plan;
    const struct gsn_phantom_section *section;
    struct window window;
    struct gsn_phantom_stain stain;
    const struct gsn_plane *red, *yellow; /* NULL at levels without texture */
    struct gsn_phantom_random nuclei;
};

static uint32_t to_px(double um, double px_um, uint32_t most)
{
    return (uint32_t)fmin(fmax(round(um / px_um), 0), most);
}

static struct window window_of(const struct gsn_phantom_plan *plan, int slot)
{
    const struct gsn_point centre = gsn_phantom_slot_centre_um(slot);
    const double half = gsn_phantom_slot_half_um;
    const struct window window = {
        to_px(centre.x - half, plan->px_um, plan->width),
        to_px(centre.y - half, plan->px_um, plan->height),
        to_px(centre.x + half, plan->px_um, plan->width),
        to_px(centre.y + half, plan->px_um, plan->height),
    };
    return window;
}

/* l, over the section image: across it in a direction that turns from section to section. */
static double ramp_place(const struct brush *brush, double x, double y)
{
    const struct window *w = &brush->window;
    const double k = 0.7 * brush->section->k;

    return ((x - w->x0) / (w->x1 - w->x0) - 0.5) * cos(k) +
           ((y - w->y0) / (w->y1 - w->y0) - 0.5) * sin(k);
}

static void draw_tissue(struct brush *brush, struct gsn_point p,
                        const struct gsn_phantom_field *field, double od[3])
{
    const double texel_px = GSN_PHANTOM_TEXEL_UM / brush->plan->px_um;
    const double u = (p.x - brush->window.x0) / texel_px, v = (p.y - brush->window.y0) / texel_px;
    struct gsn_phantom_local local = { .ramp_place = ramp_place(brush, p.x, p.y) };

    if (brush->red && brush->yellow) {
        local.red_texture = brush->plan->level->texture * gsn_phantom_texture_at(brush->red, u, v);
        local.yellow_texture =
            brush->plan->level->texture * gsn_phantom_texture_at(brush->yellow, u, v);
    }
    local.nuclei =
        gsn_phantom_poisson(&brush->nuclei, gsn_phantom_nuclei_mean(field, brush->stain.depth));
    gsn_phantom_optical_density(field, &brush->stain, &local, od);
}

static void widen(struct gsn_phantom_extent *extent, uint32_t x, uint32_t y)
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
static void burn_marks(struct gsn_point at, double od[3])
{
    const struct gsn_phantom_geometry *g = gsn_phantom_geometry();
    const struct gsn_phantom_recipe *recipe = gsn_phantom_recipe();
    const double reach = recipe->mark_ring_um + recipe->mark_edge_um;

    for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
        const double distance = hypot(at.x - g->mark[i].x, at.y - g->mark[i].y);

        if (distance < reach)
            gsn_phantom_burn(distance, od);
    }
}

static void draw_pixels(struct brush *brush, float *plane, struct gsn_phantom_extent *ret_extent)
{
    const struct gsn_phantom_plan *plan = brush->plan;
    struct gsn_phantom_extent extent = { 0 };

    for (uint32_t y = brush->window.y0; y < brush->window.y1; y++)
        for (uint32_t x = brush->window.x0; x < brush->window.x1; x++) {
            const struct gsn_point p = { x + 0.5, y + 0.5 };
            const struct gsn_point at = gsn_phantom_material(brush->section, plan->px_um, p);
            float *out = plane + 3 * ((size_t)y * plan->width + x);
            struct gsn_phantom_field field;
            double od[3] = { 0 };

            gsn_phantom_field_at(gsn_vec3_make(at.x, at.y, brush->section->z_um), &field);
            if (field.tissue > 0)
                draw_tissue(brush, p, &field, od);
            if (field.tissue >= 0.5)
                widen(&extent, x, y);
            burn_marks(at, od);
            for (int c = 0; c < 3; c++)
                out[c] = (float)od[c];
        }
    *ret_extent = extent;
}

static int make_textures(const struct brush *brush, struct gsn_plane **ret_red,
                         struct gsn_plane **ret_yellow, struct gsn_error *err)
{
    const uint32_t side = (uint32_t)(2 * gsn_phantom_slot_half_um / GSN_PHANTOM_TEXEL_UM) + 4;
    struct gsn_phantom_random red_draws =
        gsn_phantom_plan_random(brush->plan, GSN_PHANTOM_STREAM_RED_TEXTURE, brush->section->k, 0);
    struct gsn_phantom_random yellow_draws = gsn_phantom_plan_random(
        brush->plan, GSN_PHANTOM_STREAM_YELLOW_TEXTURE, brush->section->k, 0);
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

static int draw_section(size_t slot, void *context, struct gsn_error *err)
{
    const struct canvas *canvas = context;
    const struct gsn_phantom_plan *plan = canvas->plan;
    const int k = (canvas->panel - 1) * GSN_PHANTOM_SLOTS + (int)slot;
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    struct brush brush = { .plan = plan,
                           .section = &plan->section[k],
                           .window = window_of(plan, (int)slot),
                           .stain = { .red_gain = plan->specimen->red_gain,
                                      .yellow_gain = plan->specimen->yellow_gain,
                                      .ramp = plan->level->ramp,
                                      .depth = plan->specimen->depth } };

    brush.nuclei = gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_NUCLEI, k, 0);
    if (plan->level->texture > 0) {
        const int r = make_textures(&brush, &red, &yellow, err);

        if (r < 0)
            return gsn_fail_at(err, "section %d", k);
    }
    brush.red = red;
    brush.yellow = yellow;
    draw_pixels(&brush, canvas->od, &canvas->extent[slot]);
    return GSN_OK;
}

static void ink(const struct canvas *canvas, uint32_t x, uint32_t y)
{
    for (size_t c = 0; c < 3; c++)
        canvas->od[3 * ((size_t)y * canvas->plan->width + x) + c] = (float)LABEL_INK;
}

static void write_text(const struct canvas *canvas, const char *text, struct gsn_point corner_um)
{
    const struct gsn_phantom_plan *plan = canvas->plan;
    const double strip_um = gsn_phantom_slot_centre_um(0).x - gsn_phantom_slot_half_um;

    for (uint32_t y = 0; y < plan->height; y++)
        for (uint32_t x = 0; (x + 1) * plan->px_um < strip_um; x++) {
            const double u = (x + 0.5) * plan->px_um, v = (y + 0.5) * plan->px_um;

            if (gsn_phantom_label_has(text, u - corner_um.x, v - corner_um.y))
                ink(canvas, x, y);
        }
}

static void write_matrix(const struct canvas *canvas, const struct gsn_phantom_matrix *matrix)
{
    const double px_um = canvas->plan->px_um;
    const uint32_t x0 = to_px(MATRIX_UM.x, px_um, canvas->plan->width);
    const uint32_t y0 = to_px(MATRIX_UM.y, px_um, canvas->plan->height);
    const uint32_t module = (uint32_t)fmax(round(MODULE_UM / px_um), LEAST_MODULE_PX);
    const uint32_t side = GSN_PHANTOM_MATRIX_SIDE * module;

    for (uint32_t y = 0; y < side; y++)
        for (uint32_t x = 0; x < side; x++)
            if (matrix->dark[y / module][x / module])
                ink(canvas, x0 + x, y0 + y);
}

static int write_label(const struct canvas *canvas, struct gsn_error *err)
{
    struct gsn_phantom_matrix matrix;
    char name[32], panel[16], whole[64];
    int r;

    (void)snprintf(name, sizeof name, GSN_PHANTOM_STUDY "-%s", canvas->plan->specimen->name);
    (void)snprintf(panel, sizeof panel, "P%02d", canvas->panel);
    (void)snprintf(whole, sizeof whole, "%s-%s", name, panel);
    r = gsn_phantom_matrix_make(whole, &matrix, err);
    if (r < 0)
        return gsn_fail_at(err, "label");
    write_text(canvas, name, LABEL_NAME_UM);
    write_text(canvas, panel, LABEL_PANEL_UM);
    write_matrix(canvas, &matrix);
    return GSN_OK;
}

static uint8_t to_code(double value)
{
    return (uint8_t)floor(fmin(fmax(value, 0), 255) + 0.5);
}

/* Pixel = I0 illum 10^-OD + noise, for one row; each row has its own stream of noise. */
static int expose_row(size_t row, void *context, struct gsn_error *err)
{
    const struct canvas *canvas = context;
    const struct gsn_phantom_plan *plan = canvas->plan;
    const size_t samples = 3 * (size_t)plan->width;
    const float *od = canvas->od + row * samples;
    uint8_t *out = (uint8_t *)canvas->image->samples + row * samples;
    struct gsn_phantom_random random =
        gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_NOISE, canvas->panel, (uint32_t)row);
    const double v = ((double)row + 0.5) / plan->height - 0.45;
    double noise[2] = { 0 };

    (void)err;
    for (size_t i = 0; i < samples; i++) {
        const double u = ((double)(i / 3) + 0.5) / plan->width - 0.55;
        const double light = 1 - 2 * plan->level->illumination * (u * u + v * v);
        const double passed = od[i] > 0 ? pow(10, -(double)od[i]) : 1;

        if (plan->level->noise_sd > 0 && i % 2 == 0)
            gsn_phantom_normals(&random, noise);
        out[i] = to_code(gsn_phantom_white[i % 3] * light * passed +
                         plan->level->noise_sd * noise[i % 2]);
    }
    return GSN_OK;
}

int gsn_phantom_panel_draw(const struct gsn_phantom_plan *plan, int panel, unsigned threads,
                           struct gsn_image **ret_image,
                           struct gsn_phantom_extent ret_extent[GSN_PHANTOM_SLOTS],
                           struct gsn_error *err)
{
    struct gsn_phantom_extent extent[GSN_PHANTOM_SLOTS];
    gsn_auto_mem(float) od = NULL;
    gsn_auto(gsn_image) image = NULL;
    struct canvas canvas = { .plan = plan, .panel = panel, .extent = extent };
    int r;

    od = gsn_alloc_array((size_t)plan->width * plan->height, 3 * sizeof *od);
    if (!od)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a panel of %u x %u", plan->width,
                        plan->height);
    r = gsn_image_new(plan->width, plan->height, 3, 8, &image, err);
    if (r < 0)
        return r;
    canvas.od = od;
    canvas.image = image;
    r = gsn_parallel_for(GSN_PHANTOM_SLOTS, threads, draw_section, &canvas, err);
    if (r < 0)
        return gsn_fail_at(err, "panel %d", panel);
    r = write_label(&canvas, err);
    if (r < 0)
        return gsn_fail_at(err, "panel %d", panel);
    r = gsn_parallel_for(plan->height, threads, expose_row, &canvas, err);
    if (r < 0)
        return r;
    for (int i = 0; i < GSN_PHANTOM_SLOTS; i++)
        ret_extent[i] = extent[i];
    *ret_image = gsn_steal(&image);
    return GSN_OK;
}
