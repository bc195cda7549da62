/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Calibration panels: patches of an even optical density on blank glass, drawn by the same stain,
 * label and light as panels with sections, so that a reader finds in them what the specimen was
 * dyed with.
 *
 * Steps: (1) the places of the patches, a row of densities above a row of single dyes; (2) the
 * density of each from the batch's gains and dye vectors; (3) label, light, noise, file; (4) the
 * tables of truth/ and, where a variant states them, the files that job.json names.
 *
 * Failure: memory and disk. Cost: that of one panel each. */
#include "pipeline/phantom/calibration.h"

#include "pipeline/core/file.h"
#include "pipeline/phantom/buffer.h"
#include "pipeline/phantom/delivery.h"
#include "pipeline/phantom/panel.h"
#include "pipeline/phantom/stain.h"

#include <math.h>
#include <stdio.h>

/* Upper left corner of the first patch; the next is a pitch to the right. */
static const struct gsn_point FIRST_UM = { 5500, 10800 };
static const double PITCH_UM = 6000, SIDE_UM = 3000;
/* The glass, whatever the layout of the panels with sections. */
static const double WIDTH_UM = 36800, HEIGHT_UM = 24960;

static struct gsn_phantom_patch patch_at(const struct gsn_phantom_plan *plan, int row, int column)
{
    const double frame = gsn_phantom_frame_um(plan);
    const struct gsn_phantom_patch patch = {
        .x = (uint32_t)lround((frame + FIRST_UM.x + column * PITCH_UM) / plan->px_um),
        .y = (uint32_t)lround((frame + FIRST_UM.y + row * PITCH_UM) / plan->px_um),
        .width = (uint32_t)lround(SIDE_UM / plan->px_um),
        .height = (uint32_t)lround(SIDE_UM / plan->px_um),
    };
    return patch;
}

struct gsn_phantom_patch gsn_phantom_patch_of(const struct gsn_phantom_plan *plan, int i)
{
    struct gsn_phantom_patch patch = patch_at(plan, 0, i);

    patch.density = (double)i / (GSN_PHANTOM_PATCHES - 1);
    return patch;
}

struct gsn_phantom_patch gsn_phantom_dye_patch_of(const struct gsn_phantom_plan *plan,
                                                  enum gsn_phantom_dye dye)
{
    return patch_at(plan, 1, (int)dye);
}

/* Batch 0 is the bath itself, without what its panels differ by. */
static struct gsn_phantom_batch batch_of(const struct gsn_phantom_plan *plan, int batch)
{
    struct gsn_phantom_batch bath = { .red_gain = plan->specimen.red_gain,
                                      .yellow_gain = plan->specimen.yellow_gain };

    if (batch > 0)
        return plan->batch[batch - 1];
    for (int i = 0; i < GSN_PHANTOM_DYES; i++)
        gsn_phantom_variant_dye(&plan->variant, (enum gsn_phantom_dye)i, bath.dye[i]);
    for (int c = 0; c < 3; c++)
        bath.white[c] = gsn_phantom_white[c];
    return bath;
}

static void dye_patch_od(const struct gsn_phantom_plan *plan, int batch, enum gsn_phantom_dye dye,
                         double ret_od[3])
{
    const struct gsn_phantom_batch b = batch_of(plan, batch);
    const struct gsn_phantom_recipe *recipe = gsn_phantom_recipe();
    const double amount[] = { [GSN_PHANTOM_RED] = b.red_gain * recipe->red_amount,
                              [GSN_PHANTOM_YELLOW] = b.yellow_gain * recipe->yellow_amount,
                              [GSN_PHANTOM_NUCLEAR] = recipe->nuclear_amount };

    for (int c = 0; c < 3; c++)
        ret_od[c] = amount[dye] * b.dye[dye][c];
}

void gsn_phantom_patch_od(const struct gsn_phantom_plan *plan, int batch, int i, double ret_od[3])
{
    const struct gsn_phantom_batch b = batch_of(plan, batch);
    const struct gsn_phantom_stain stain = { .red_gain = b.red_gain,
                                             .yellow_gain = b.yellow_gain,
                                             .dye = b.dye };
    const struct gsn_phantom_field field = { .tissue = 1,
                                             .intact = gsn_phantom_patch_of(plan, i).density };
    const struct gsn_phantom_local local = { 0 };

    gsn_phantom_optical_density(&field, &stain, &local, ret_od);
}

static void lay_patch(struct gsn_phantom_patch patch, const double od[3],
                      const struct gsn_phantom_glass *glass)
{
    for (uint32_t y = patch.y; y < patch.y + patch.height; y++)
        for (uint32_t x = patch.x; x < patch.x + patch.width; x++)
            for (size_t c = 0; c < 3; c++)
                glass->od[3 * ((size_t)y * glass->width + x) + c] = (float)od[c];
}

int gsn_phantom_calibration_draw(const struct gsn_phantom_plan *plan, int batch, unsigned threads,
                                 struct gsn_image **ret_image, struct gsn_error *err)
{
    enum { NOISE = 200 }; /* beyond the streams of all panels */
    const double frame = 2 * gsn_phantom_frame_um(plan);
    const uint32_t width = (uint32_t)lround((WIDTH_UM + frame) / plan->px_um);
    const uint32_t height = (uint32_t)lround((HEIGHT_UM + frame) / plan->px_um);
    const struct gsn_phantom_batch of = batch_of(plan, batch);
    gsn_auto_mem(float) od = gsn_alloc_array((size_t)width * height, 3 * sizeof *od);
    const struct gsn_phantom_glass glass = { width, height, plan->px_um, od };
    char name[16];
    double of_patch[3];
    int r;

    if (!od)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a panel of %u x %u", width, height);
    for (int i = 0; batch > 0 && i < GSN_PHANTOM_PATCHES; i++) {
        gsn_phantom_patch_od(plan, batch, i, of_patch);
        lay_patch(gsn_phantom_patch_of(plan, i), of_patch, &glass);
    }
    for (enum gsn_phantom_dye dye = GSN_PHANTOM_RED; dye <= GSN_PHANTOM_NUCLEAR; dye++) {
        dye_patch_od(plan, batch, dye, of_patch);
        lay_patch(gsn_phantom_dye_patch_of(plan, dye), of_patch, &glass);
    }
    (void)snprintf(name, sizeof name, "C%02d", batch > 0 ? batch : 1);
    r = gsn_phantom_label_write(plan, name, &glass, err);
    if (r < 0)
        return r;
    return gsn_phantom_expose(plan, &glass, of.white, NOISE + batch, 8, threads, ret_image, err);
}

static int write_panel(const struct gsn_phantom_plan *plan, int batch, const char *extension,
                       unsigned threads, const char *folder, const char *name,
                       struct gsn_error *err)
{
    const struct gsn_phantom_file file = { .panel = batch,
                                           .orientation = 1,
                                           .bits = 8,
                                           .passes = 1,
                                           .kept = 1,
                                           .tag_um = plan->px_um,
                                           .extension = extension };
    gsn_auto(gsn_image) image = NULL;
    gsn_auto_phantom_buffer bytes = { 0 };
    int r;

    r = gsn_phantom_calibration_draw(plan, batch, threads, &image, err);
    if (r >= 0)
        r = gsn_phantom_delivery_encode(plan, &file, image, &bytes, err);
    if (r < 0)
        return gsn_fail_at(err, "%s", name);
    return gsn_phantom_buffer_write(&bytes, folder, name, err);
}

static void tell_patches(const struct gsn_phantom_plan *plan, int batch, const char *name,
                         struct gsn_phantom_buffer *table)
{
    for (int i = 0; i < GSN_PHANTOM_PATCHES; i++) {
        const struct gsn_phantom_patch p = gsn_phantom_patch_of(plan, i);
        double od[3];

        gsn_phantom_patch_od(plan, batch, i, od);
        gsn_phantom_buffer_print(table, "%s,%d,%.15g,%u,%u,%u,%u,%.9f,%.9f,%.9f\n", name, batch,
                                 p.density, p.x, p.y, p.width, p.height, od[0], od[1], od[2]);
    }
}

static void tell_dyes(const struct gsn_phantom_plan *plan, int batch, const char *name,
                      struct gsn_phantom_buffer *table)
{
    static const char *const dyes[] = { "red", "yellow", "dark" };

    for (enum gsn_phantom_dye dye = GSN_PHANTOM_RED; dye <= GSN_PHANTOM_NUCLEAR; dye++) {
        const struct gsn_phantom_patch p = gsn_phantom_dye_patch_of(plan, dye);
        double od[3];

        dye_patch_od(plan, batch, dye, od);
        gsn_phantom_buffer_print(table, "%s,%d,%s,%u,%u,%u,%u,%.9f,%.9f,%.9f\n", name, batch,
                                 dyes[dye], p.x, p.y, p.width, p.height, od[0], od[1], od[2]);
    }
}

/* What job.json names lies beside it, without loss. */
static int write_stated(const struct gsn_phantom_plan *plan, unsigned threads, const char *folder,
                        struct gsn_error *err)
{
    const enum gsn_phantom_calibrated by = plan->variant.calibrated;
    const int first = by == GSN_PHANTOM_BY_DYES ? 0 : 1;
    const int last = by == GSN_PHANTOM_BY_DYES ? 0 : plan->panels;

    for (int batch = first; by != GSN_PHANTOM_NOT_CALIBRATED && batch <= last; batch++) {
        gsn_auto_mem(char) name = gsn_format(GSN_PHANTOM_STUDY "-%s-C%02d.png", plan->specimen.name,
                                             batch > 0 ? batch : 1);
        int r;

        if (!name)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for a calibration panel");
        r = write_panel(plan, batch, "png", threads, folder, name, err);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

int gsn_phantom_calibration_write(const struct gsn_phantom_plan *plan, unsigned threads,
                                  const char *folder, struct gsn_error *err)
{
    gsn_auto_mem(char) place = gsn_format("%s/calibration", folder);
    gsn_auto_mem(char) truth = gsn_format("%s/truth", folder);
    gsn_auto_phantom_buffer table = { 0 }, dyes = { 0 };
    int r;

    r = write_stated(plan, threads, folder, err);
    if (r < 0 || !plan->level.handled)
        return r;
    if (!place || !truth)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", folder);
    r = gsn_file_mkdir(place, err);
    if (r < 0)
        return r;
    gsn_phantom_buffer_print(&table, "file,panel,D,x_px,y_px,w_px,h_px,od_r,od_g,od_b\n");
    gsn_phantom_buffer_print(&dyes, "file,panel,dye,x_px,y_px,w_px,h_px,od_r,od_g,od_b\n");
    for (int batch = 1; batch <= plan->panels; batch++) {
        gsn_auto_mem(char) name = gsn_format(GSN_PHANTOM_STUDY "-%s-C%02d.%s", plan->specimen.name,
                                             batch, plan->level.extension);

        if (!name)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for calibration panel %d", batch);
        r = write_panel(plan, batch, plan->level.extension, threads, place, name, err);
        if (r < 0)
            return r;
        tell_patches(plan, batch, name, &table);
        tell_dyes(plan, batch, name, &dyes);
    }
    r = gsn_phantom_buffer_write(&dyes, truth, "calibration_dyes.csv", err);
    return r < 0 ? r : gsn_phantom_buffer_write(&table, truth, "calibration.csv", err);
}
