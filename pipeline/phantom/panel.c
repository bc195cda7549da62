/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/phantom/panel.h"

#include "pipeline/core/parallel.h"
#include "pipeline/phantom/expose.h"
#include "pipeline/phantom/overlay.h"

#include <stdio.h>

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
