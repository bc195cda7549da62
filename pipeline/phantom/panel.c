/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A panel as the scanner delivers it: sections drawn on glass, what lies on the glass over them,
 * the label written, and the lamp switched on: optical density becomes light, light becomes codes.
 */
#include "pipeline/phantom/panel.h"

#include "pipeline/core/parallel.h"
#include "pipeline/phantom/label.h"
#include "pipeline/phantom/overlay.h"

#include <math.h>
#include <stdio.h>

static const double BED_CODE = 6;
static const double LABEL_INK = 1.2; /* optical density, the same in all channels */
static const struct gsn_point LABEL_NAME_UM = { 320, 1600 }, LABEL_PANEL_UM = { 320, 2400 };

/* The label itself, and the strip that it is stuck on. */
static const double LABEL_TOP_UM = 1200, LABEL_LOW_UM = 5200, LABEL_RIGHT_UM = 3200,
                    STRIP_UM = 4200;

/* Of the Data Matrix: its upper left corner, with more than its quiet zone around it; how large a
 * module is wanted; and of how many pixels it is at least, because libdmtx reads none of two. */
static const struct gsn_point MATRIX_UM = { 320, 3200 };
static const double MODULE_UM = 96, LEAST_MODULE_PX = 3;

static void draw_ink(const struct gsn_phantom_glass *glass, uint32_t x, uint32_t y)
{
    for (size_t c = 0; c < 3; c++)
        glass->od[3 * ((size_t)y * glass->width + x) + c] = (float)LABEL_INK;
}

static void write_text(const struct gsn_phantom_glass *glass, double frame_um, const char *text,
                       struct gsn_point corner_um)
{
    const double strip_um = frame_um + STRIP_UM;

    for (uint32_t y = 0; y < glass->height; y++)
        for (uint32_t x = 0; (x + 1) * glass->px_um < strip_um; x++) {
            const double u = (x + 0.5) * glass->px_um, v = (y + 0.5) * glass->px_um;

            if (gsn_phantom_label_has(text, u - frame_um - corner_um.x, v - frame_um - corner_um.y))
                draw_ink(glass, x, y);
        }
}

static void write_matrix(const struct gsn_phantom_glass *glass, double frame_um,
                         const struct gsn_phantom_matrix *matrix)
{
    const double px_um = glass->px_um;
    const uint32_t x0 = gsn_phantom_to_px(frame_um + MATRIX_UM.x, px_um, glass->width);
    const uint32_t y0 = gsn_phantom_to_px(frame_um + MATRIX_UM.y, px_um, glass->height);
    const uint32_t module = (uint32_t)fmax(round(MODULE_UM / px_um), LEAST_MODULE_PX);
    const uint32_t side = GSN_PHANTOM_MATRIX_SIDE * module;

    for (uint32_t y = 0; y < side; y++)
        for (uint32_t x = 0; x < side; x++)
            if (matrix->dark[y / module][x / module])
                draw_ink(glass, x0 + x, y0 + y);
}

/* Sticks the label on its head: each pixel of it changes places with the one across its middle. */
static void turn_label(const struct gsn_phantom_glass *glass, double frame_um)
{
    const uint32_t left = gsn_phantom_to_px(frame_um, glass->px_um, glass->width);
    const uint32_t right = gsn_phantom_to_px(frame_um + LABEL_RIGHT_UM, glass->px_um, glass->width);
    const uint32_t top = gsn_phantom_to_px(frame_um + LABEL_TOP_UM, glass->px_um, glass->height);
    const uint32_t low = gsn_phantom_to_px(frame_um + LABEL_LOW_UM, glass->px_um, glass->height);
    const size_t count = (size_t)(right - left) * (low - top);

    for (size_t i = 0; i < count / 2; i++) {
        const size_t j = count - 1 - i, wide = right - left;
        float *a = glass->od + 3 * ((top + i / wide) * glass->width + left + i % wide);
        float *b = glass->od + 3 * ((top + j / wide) * glass->width + left + j % wide);

        for (int c = 0; c < 3; c++) {
            const float kept = a[c];

            a[c] = b[c];
            b[c] = kept;
        }
    }
}

int gsn_phantom_label_write(const struct gsn_phantom_plan *plan, const char *panel,
                            const struct gsn_phantom_glass *glass, struct gsn_error *err)
{
    struct gsn_phantom_matrix matrix;
    const double frame_um = gsn_phantom_frame_um(plan);
    char name[32], whole[64];
    int r;

    if (plan->variant.label == GSN_PHANTOM_UNLABELLED)
        return GSN_OK;
    (void)snprintf(name, sizeof name, GSN_PHANTOM_STUDY "-%s", plan->specimen.name);
    (void)snprintf(whole, sizeof whole, "%s-%s", name, panel);
    r = gsn_phantom_matrix_make(whole, &matrix, err);
    if (r < 0)
        return gsn_fail_at(err, "label");
    write_text(glass, frame_um, name, LABEL_NAME_UM);
    write_text(glass, frame_um, panel, LABEL_PANEL_UM);
    write_matrix(glass, frame_um, &matrix);
    if (plan->variant.label == GSN_PHANTOM_TURNED)
        turn_label(glass, frame_um);
    return GSN_OK;
}

/* One picture while it is taken. */
struct exposure {
    const struct gsn_phantom_plan *plan;
    const struct gsn_phantom_glass *glass;
    const double *white;
    int noise;
    struct gsn_image *image;
};

static double to_code(double value, double most)
{
    return floor(fmin(fmax(value, 0), most) + 0.5);
}

/* Pixel = I0 illum 10^-OD + noise, for one row; each row has its own stream of noise. Around the
 * glass the scanner's bed is black. */
static int expose_row(size_t row, void *context, struct gsn_error *err)
{
    const struct exposure *exposure = context;
    const struct gsn_phantom_plan *plan = exposure->plan;
    const uint32_t width = exposure->glass->width, height = exposure->glass->height;
    const uint32_t frame = (uint32_t)plan->variant.black_frame_px;
    const size_t samples = 3 * (size_t)width;
    const float *od = exposure->glass->od + row * samples;
    const double exposed = plan->variant.exposure;
    uint8_t *out = (uint8_t *)exposure->image->samples + row * samples;
    uint16_t *deep = (uint16_t *)exposure->image->samples + row * samples;
    struct gsn_phantom_random random =
        gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_NOISE, exposure->noise, (uint32_t)row);
    const double v = ((double)row + 0.5) / height - 0.45;
    double noise[2] = { 0 };

    (void)err;
    for (size_t i = 0; i < samples; i++) {
        const double u = ((double)(i / 3) + 0.5) / width - 0.55;
        const double light = 1 - 2 * plan->level.illumination * (u * u + v * v);
        const double passed = od[i] > 0 ? pow(10, -(double)od[i]) : 1;
        const int bed =
            row < frame || row >= height - frame || i / 3 < frame || i / 3 >= width - frame;
        double code;

        if (plan->level.noise_sd > 0 && i % 2 == 0)
            gsn_phantom_normals(&random, noise);
        code = (bed ? BED_CODE : exposed * exposure->white[i % 3] * light * passed) +
               plan->level.noise_sd * noise[i % 2];
        if (exposure->image->bits == 8)
            out[i] = (uint8_t)to_code(code, 255);
        else
            deep[i] = (uint16_t)to_code(code * 257, 65535);
    }
    return GSN_OK;
}

int gsn_phantom_expose(const struct gsn_phantom_plan *plan, const struct gsn_phantom_glass *glass,
                       const double white[3], int noise, uint32_t bits, unsigned threads,
                       struct gsn_image **ret_image, struct gsn_error *err)
{
    struct exposure exposure = { .plan = plan, .glass = glass, .white = white, .noise = noise };
    gsn_auto(gsn_image) image = NULL;
    int r;

    r = gsn_image_new(glass->width, glass->height, 3, bits, &image, err);
    if (r < 0)
        return r;
    exposure.image = image;
    r = gsn_parallel_for(glass->height, threads, expose_row, &exposure, err);
    if (r < 0)
        return r;
    *ret_image = gsn_steal(&image);
    return GSN_OK;
}

struct canvas {
    const struct gsn_phantom_plan *plan;
    const struct gsn_phantom_file *file;
    struct gsn_phantom_sheet *sheet; /* by slot */
    float *od;                       /* three per pixel */
};

static int draw_section(size_t slot, void *context, struct gsn_error *err)
{
    const struct canvas *canvas = context;

    return gsn_phantom_section_draw(canvas->plan,
                                    (canvas->file->panel - 1) * canvas->plan->slots + (int)slot,
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

static int draw_glass(struct canvas *canvas, unsigned threads, struct gsn_error *err)
{
    const struct gsn_phantom_plan *plan = canvas->plan;
    const struct gsn_phantom_glass glass = { plan->width, plan->height, plan->px_um, canvas->od };
    char name[16];
    int r = gsn_parallel_for((size_t)plan->slots, threads, draw_section, canvas, err);

    (void)snprintf(name, sizeof name, "P%02d", canvas->file->panel);
    for (int i = 0; r >= 0 && i < plan->slots; i++)
        lay_sheet(canvas, &canvas->sheet[i]);
    if (r >= 0)
        r = gsn_phantom_overlay_draw(plan, canvas->file->panel, &glass, err);
    return r < 0 ? r : gsn_phantom_label_write(plan, name, &glass, err);
}

/* Streams of noise: a second scan has that of none of the panels. */
static int noise_of(const struct gsn_phantom_file *file)
{
    enum { AGAIN = 100 };

    return file->panel + (file->again ? AGAIN : 0);
}

int gsn_phantom_panel_draw(const struct gsn_phantom_plan *plan, const struct gsn_phantom_file *file,
                           unsigned threads, struct gsn_image **ret_image,
                           struct gsn_phantom_extent *ret_extent, struct gsn_error *err)
{
    struct gsn_phantom_sheet sheet[GSN_PHANTOM_SLOTS_MOST] = { 0 };
    struct gsn_phantom_extent extent[GSN_PHANTOM_SLOTS_MOST];
    gsn_auto_mem(float) od = gsn_alloc_array((size_t)plan->width * plan->height, 3 * sizeof *od);
    struct canvas canvas = { .plan = plan, .file = file, .sheet = sheet, .od = od };
    const struct gsn_phantom_glass glass = { plan->width, plan->height, plan->px_um, od };
    int r;

    if (!od)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a panel of %u x %u", plan->width,
                        plan->height);
    r = draw_glass(&canvas, threads, err);
    for (int i = 0; i < plan->slots; i++) {
        extent[i] = sheet[i].extent;
        gsn_phantom_sheet_done(&sheet[i]);
    }
    if (r >= 0)
        r = gsn_phantom_expose(plan, &glass, plan->batch[file->panel - 1].white, noise_of(file),
                               (uint32_t)file->bits, threads, ret_image, err);
    if (r < 0)
        return gsn_fail_at(err, "panel %d", file->panel);
    for (int i = 0; i < plan->slots; i++)
        ret_extent[i] = extent[i];
    return GSN_OK;
}
