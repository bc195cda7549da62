/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/phantom/expose.h"

#include "pipeline/core/parallel.h"
#include "tests/phantom/label.h"
#include "tests/phantom/matrix.h"

#include <math.h>
#include <stdio.h>

static const double LABEL_INK = 1.2; /* optical density, the same in all channels */
static const struct gsn_point LABEL_NAME_UM = { 320, 1600 }, LABEL_PANEL_UM = { 320, 2400 };
/* Of the Data Matrix: its upper left corner, with more than its quiet zone around it; how large a
 * module is wanted; and of how many pixels it is at least, because libdmtx reads none of two. */
static const struct gsn_point MATRIX_UM = { 320, 3200 };
static const double MODULE_UM = 96, LEAST_MODULE_PX = 3;

static uint32_t to_px(double um, double px_um, uint32_t most)
{
    return (uint32_t)fmin(fmax(round(um / px_um), 0), most);
}

static void ink(const struct gsn_phantom_glass *glass, uint32_t x, uint32_t y)
{
    for (size_t c = 0; c < 3; c++)
        glass->od[3 * ((size_t)y * glass->width + x) + c] = (float)LABEL_INK;
}

static void write_text(const struct gsn_phantom_glass *glass, const char *text,
                       struct gsn_point corner_um)
{
    const double strip_um = gsn_phantom_slot_centre_um(0).x - gsn_phantom_slot_half_um;

    for (uint32_t y = 0; y < glass->height; y++)
        for (uint32_t x = 0; (x + 1) * glass->px_um < strip_um; x++) {
            const double u = (x + 0.5) * glass->px_um, v = (y + 0.5) * glass->px_um;

            if (gsn_phantom_label_has(text, u - corner_um.x, v - corner_um.y))
                ink(glass, x, y);
        }
}

static void write_matrix(const struct gsn_phantom_glass *glass,
                         const struct gsn_phantom_matrix *matrix)
{
    const double px_um = glass->px_um;
    const uint32_t x0 = to_px(MATRIX_UM.x, px_um, glass->width);
    const uint32_t y0 = to_px(MATRIX_UM.y, px_um, glass->height);
    const uint32_t module = (uint32_t)fmax(round(MODULE_UM / px_um), LEAST_MODULE_PX);
    const uint32_t side = GSN_PHANTOM_MATRIX_SIDE * module;

    for (uint32_t y = 0; y < side; y++)
        for (uint32_t x = 0; x < side; x++)
            if (matrix->dark[y / module][x / module])
                ink(glass, x0 + x, y0 + y);
}

int gsn_phantom_label_write(const struct gsn_phantom_plan *plan, const char *panel,
                            const struct gsn_phantom_glass *glass, struct gsn_error *err)
{
    struct gsn_phantom_matrix matrix;
    char name[32], whole[64];
    int r;

    (void)snprintf(name, sizeof name, GSN_PHANTOM_STUDY "-%s", plan->specimen->name);
    (void)snprintf(whole, sizeof whole, "%s-%s", name, panel);
    r = gsn_phantom_matrix_make(whole, &matrix, err);
    if (r < 0)
        return gsn_fail_at(err, "label");
    write_text(glass, name, LABEL_NAME_UM);
    write_text(glass, panel, LABEL_PANEL_UM);
    write_matrix(glass, &matrix);
    return GSN_OK;
}

/* One picture while it is taken. */
struct exposure {
    const struct gsn_phantom_plan *plan;
    const struct gsn_phantom_glass *glass;
    int batch, noise;
    struct gsn_image *image;
};

static double to_code(double value, double most)
{
    return floor(fmin(fmax(value, 0), most) + 0.5);
}

/* Pixel = I0 illum 10^-OD + noise, for one row; each row has its own stream of noise. */
static int expose_row(size_t row, void *context, struct gsn_error *err)
{
    const struct exposure *exposure = context;
    const struct gsn_phantom_plan *plan = exposure->plan;
    const size_t samples = 3 * (size_t)plan->width;
    const float *od = exposure->glass->od + row * samples;
    const double *white = plan->batch[exposure->batch - 1].white;
    uint8_t *out = (uint8_t *)exposure->image->samples + row * samples;
    uint16_t *deep = (uint16_t *)exposure->image->samples + row * samples;
    struct gsn_phantom_random random =
        gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_NOISE, exposure->noise, (uint32_t)row);
    const double v = ((double)row + 0.5) / plan->height - 0.45;
    double noise[2] = { 0 };

    (void)err;
    for (size_t i = 0; i < samples; i++) {
        const double u = ((double)(i / 3) + 0.5) / plan->width - 0.55;
        const double light = 1 - 2 * plan->level->illumination * (u * u + v * v);
        const double passed = od[i] > 0 ? pow(10, -(double)od[i]) : 1;
        double code;

        if (plan->level->noise_sd > 0 && i % 2 == 0)
            gsn_phantom_normals(&random, noise);
        code = white[i % 3] * light * passed + plan->level->noise_sd * noise[i % 2];
        if (exposure->image->bits == 8)
            out[i] = (uint8_t)to_code(code, 255);
        else
            deep[i] = (uint16_t)to_code(code * 257, 65535);
    }
    return GSN_OK;
}

int gsn_phantom_expose(const struct gsn_phantom_plan *plan, const struct gsn_phantom_glass *glass,
                       int batch, int noise, uint32_t bits, unsigned threads,
                       struct gsn_image **ret_image, struct gsn_error *err)
{
    struct exposure exposure = { .plan = plan, .glass = glass, .batch = batch, .noise = noise };
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
