/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/phantom/panel.h"

#include "pipeline/core/parallel.h"
#include "tests/phantom/label.h"
#include "tests/phantom/matrix.h"
#include "tests/phantom/overlay.h"

#include <math.h>
#include <stdio.h>

static const double LABEL_INK = 1.2; /* optical density, the same in all channels */
static const struct gsn_point LABEL_NAME_UM = { 320, 1600 }, LABEL_PANEL_UM = { 320, 2400 };
/* Of the Data Matrix: its upper left corner, with more than its quiet zone around it; how large a
 * module is wanted; and of how many pixels it is at least, because libdmtx reads none of two. */
static const struct gsn_point MATRIX_UM = { 320, 3200 };
static const double MODULE_UM = 96, LEAST_MODULE_PX = 3;

struct canvas {
    const struct gsn_phantom_plan *plan;
    int panel;
    struct gsn_phantom_sheet *sheet; /* by slot */
    float *od;                       /* three per pixel */
    struct gsn_image *image;
};

static uint32_t to_px(double um, double px_um, uint32_t most)
{
    return (uint32_t)fmin(fmax(round(um / px_um), 0), most);
}

static int draw_section(size_t slot, void *context, struct gsn_error *err)
{
    const struct canvas *canvas = context;

    return gsn_phantom_section_draw(canvas->plan,
                                    (canvas->panel - 1) * GSN_PHANTOM_SLOTS + (int)slot,
                                    &canvas->sheet[slot], err);
}

/* Where sections overlap the light passes both. */
static void lay_sheet(const struct canvas *canvas, const struct gsn_phantom_sheet *sheet)
{
    const struct gsn_phantom_window *w = &sheet->window;
    const size_t samples = 3 * (size_t)(w->x1 - w->x0);

    for (uint32_t y = w->y0; sheet->od && y < w->y1; y++) {
        const float *from = sheet->od + (y - w->y0) * samples;
        float *onto = canvas->od + 3 * ((size_t)y * canvas->plan->width + w->x0);

        for (size_t i = 0; i < samples; i++)
            onto[i] += from[i];
    }
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
    const double *white = plan->batch[canvas->panel - 1].white;
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
        out[i] = to_code(white[i % 3] * light * passed + plan->level->noise_sd * noise[i % 2]);
    }
    return GSN_OK;
}

static int draw_glass(struct canvas *canvas, unsigned threads, struct gsn_error *err)
{
    const struct gsn_phantom_plan *plan = canvas->plan;
    const struct gsn_phantom_glass glass = { plan->width, plan->height, plan->px_um, canvas->od };
    int r = gsn_parallel_for(GSN_PHANTOM_SLOTS, threads, draw_section, canvas, err);

    for (int i = 0; r >= 0 && i < GSN_PHANTOM_SLOTS; i++)
        lay_sheet(canvas, &canvas->sheet[i]);
    if (r >= 0)
        r = gsn_phantom_overlay_draw(plan, canvas->panel, &glass, err);
    if (r >= 0)
        r = write_label(canvas, err);
    if (r < 0)
        return gsn_fail_at(err, "panel %d", canvas->panel);
    return gsn_parallel_for(plan->height, threads, expose_row, canvas, err);
}

int gsn_phantom_panel_draw(const struct gsn_phantom_plan *plan, int panel, unsigned threads,
                           struct gsn_image **ret_image,
                           struct gsn_phantom_extent ret_extent[GSN_PHANTOM_SLOTS],
                           struct gsn_error *err)
{
    struct gsn_phantom_sheet sheet[GSN_PHANTOM_SLOTS] = { 0 };
    gsn_auto_mem(float) od = NULL;
    gsn_auto(gsn_image) image = NULL;
    struct canvas canvas = { .plan = plan, .panel = panel, .sheet = sheet };
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
    r = draw_glass(&canvas, threads, err);
    for (int i = 0; i < GSN_PHANTOM_SLOTS; i++) {
        if (r >= 0)
            ret_extent[i] = sheet[i].extent;
        gsn_phantom_sheet_done(&sheet[i]);
    }
    if (r < 0)
        return r;
    *ret_image = gsn_steal(&image);
    return GSN_OK;
}
