/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/calibration_panel.h"

#include "pipeline/calibration_patches.h"
#include "pipeline/stain/calibration.h"
#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/vector_estimation.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static const double MOST_CLIPPED = 0.01, MOST_OVEREXPOSED = 0.05;
/* Of the white of a panel: test_glass finds it within a tenth of a percent. */
static const double WHITE_ERROR_OD = 0.0005;
/* Codes, of 255, that the colour of an even patch is off by at the qualities that scanners use:
 * steps of its mean brightness and of its mean two colours, turned into R, G and B. */
static const double JPEG_CODES = 0.5;
/* The darkest channel of white glass against its brightest. */
static const double LEAST_WHITE = 0.6;

/* ---- what a patch shows ------------------------------------------------------------------ */

static int check_clipped(const struct gsn_scan *scan, const struct gsn_pixel_box *box,
                         const struct gsn_stated_patch *stated, struct gsn_error *err)
{
    gsn_auto(gsn_od_reader) absorber = NULL;
    size_t clipped = 0;
    int r = gsn_od_reader_new(scan->picture->image, &scan->glass, &absorber, err);

    if (r < 0)
        return r;
    for (int y = box->y; y < box->y + box->height; y++)
        for (int x = box->x; x < box->x + box->width; x++)
            clipped += (size_t)gsn_od_reader_clipped(absorber, (uint32_t)x, (uint32_t)y);
    if ((double)clipped > MOST_CLIPPED * box->width * box->height)
        return gsn_fail(err, GSN_E_STAIN,
                        "patch %u of row %u is clipped (%.0f %% of it is at an end of the codes): "
                        "scan it with another exposure, or stain it less",
                        stated->place, stated->row,
                        100.0 * (double)clipped / ((double)box->width * box->height));
    return GSN_OK;
}

/* The sum of the densities of a row's cells, added to sum. */
static void add_row(const float *const od[3], int width, double sum[GSN_PATCH_SIDE][3])
{
    for (int column = 0; column < GSN_PATCH_SIDE; column++)
        for (int x = column * width / GSN_PATCH_SIDE; x < (column + 1) * width / GSN_PATCH_SIDE;
             x++)
            for (int c = 0; c < 3; c++)
                sum[column][c] += (double)od[c][x];
}

/* Means of the cells of the box. */
static int read_cells(const struct gsn_scan *scan, const struct gsn_pixel_box *box,
                      struct gsn_patch *patch, struct gsn_error *err)
{
    const size_t width = (size_t)box->width;
    gsn_auto_mem(float) row = gsn_alloc_array(3 * width, sizeof *row);
    gsn_auto(gsn_od_reader) absorber = NULL;
    const int r = gsn_od_reader_new(scan->picture->image, &scan->glass, &absorber, err);

    if (r < 0)
        return r;
    if (!row)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a row of a patch");
    for (int i = 0; i < GSN_PATCH_SIDE; i++) {
        const int y0 = i * box->height / GSN_PATCH_SIDE,
                  y1 = (i + 1) * box->height / GSN_PATCH_SIDE;
        double sum[GSN_PATCH_SIDE][3] = { { 0 } };

        for (int y = y0; y < y1; y++) {
            float *const od[3] = { row, row + width, row + 2 * width };

            gsn_od_reader_row(absorber, (uint32_t)box->x, (uint32_t)(box->y + y), width, od);
            add_row((const float *const *)od, box->width, sum);
        }
        for (int k = 0; k < GSN_PATCH_SIDE; k++) {
            const int x0 = k * box->width / GSN_PATCH_SIDE,
                      x1 = (k + 1) * box->width / GSN_PATCH_SIDE;

            for (int c = 0; c < 3; c++)
                patch->od[i * GSN_PATCH_SIDE + k][c] = sum[k][c] / ((double)(y1 - y0) * (x1 - x0));
        }
    }
    return GSN_OK;
}

/* What all cells of a patch are off by together. An even patch in a JPEG has the colour that its
 * blocks were rounded to. */
static void fill_floor(const struct gsn_scan *scan, const struct gsn_pixel_box *box,
                       struct gsn_patch *patch)
{
    const double rounded = strcmp(scan->picture->kind, "JPEG") == 0 ? JPEG_CODES : 0;
    const uint32_t x = (uint32_t)(box->x + box->width / 2);
    const uint32_t y = (uint32_t)(box->y + box->height / 2);

    for (unsigned c = 0; c < 3; c++) {
        const double od = patch->od[GSN_PATCH_CELLS / 2][c];
        const double light = fmin(gsn_flat_field_at(&scan->glass, x, y, c) * pow(10, -od), 1);
        const double more = gsn_light_encode(scan->glass.light, light) + rounded / 255;
        const double moved =
            gsn_light_of_sample(scan->glass.light, (unsigned)(65535 * fmin(more, 1)), 16);

        patch->floor_od[c] = hypot(WHITE_ERROR_OD, rounded > 0 ? log10(moved / light) : 0);
    }
}

static int read_patch(const struct gsn_scan *scan, const struct gsn_pixel_box *box,
                      const struct gsn_stated_patch *stated, struct gsn_patch *ret_patch,
                      struct gsn_error *err)
{
    int r;

    *ret_patch = (struct gsn_patch){
        .kind = stated->kind, .density = stated->density, .row = stated->row, .place = stated->place
    };
    if (box->width < GSN_PATCH_SIDE || box->height < GSN_PATCH_SIDE)
        return gsn_fail(err, GSN_E_STAIN,
                        "patch %u of row %u is only %d pixels wide: scan it finer", stated->place,
                        stated->row, box->width);
    r = check_clipped(scan, box, stated, err);
    if (r >= 0)
        r = read_cells(scan, box, ret_patch, err);
    if (r >= 0)
        fill_floor(scan, box, ret_patch);
    return r;
}

static int read_patches(const struct gsn_scan *scan, const struct gsn_stated_calibration *stated,
                        struct gsn_patch *patches, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_pixel_box) box = gsn_alloc_array(stated->patch_count, sizeof *box);
    int r = box ? gsn_calibration_patches_find(scan, stated, box, err)
                : gsn_fail(err, GSN_E_NOMEM, "out of memory for a calibration panel");

    for (size_t i = 0; r >= 0 && i < stated->patch_count; i++)
        r = read_patch(scan, &box[i], &stated->patch[i], &patches[i], err);
    return r;
}

/* ---- the panel --------------------------------------------------------------------------- */

static int check_glass(const struct gsn_flat_field *glass, struct gsn_error *err)
{
    const double *w = glass->white;
    const double least = fmin(w[0], fmin(w[1], w[2])), most = fmax(w[0], fmax(w[1], w[2]));

    if (!(least >= LEAST_WHITE * most))
        return gsn_fail(err, GSN_E_STAIN,
                        "its glass is not white (codes %.0f, %.0f, %.0f): it is stained, or the "
                        "scanner's white balance is off",
                        w[0], w[1], w[2]);
    if (glass->overexposed > MOST_OVEREXPOSED)
        return gsn_fail(err, GSN_E_STAIN,
                        "%.0f %% of its glass is overexposed, so its white is not known: lower the "
                        "exposure and scan it again",
                        100 * glass->overexposed);
    return GSN_OK;
}

static int has_dyes(const struct gsn_stated_calibration *stated)
{
    for (size_t i = 0; i < stated->patch_count; i++)
        if (stated->patch[i].kind != GSN_PATCH_STANDARD)
            return 1;
    return 0;
}

static unsigned longest_row(const struct gsn_stated_calibration *stated)
{
    unsigned most = 0;

    for (size_t i = 0; i < stated->patch_count; i++)
        most = stated->patch[i].place > most ? stated->patch[i].place : most;
    return most;
}

static int read_panel(struct gsn_decoder *decoder, int picture_fd,
                      const struct gsn_protocol *protocol, struct gsn_calibration_panel *panel,
                      struct gsn_error *err)
{
    struct gsn_protocol as_glass = *protocol;
    gsn_auto(gsn_scan) scan = NULL;
    struct gsn_dyes_prior expected;
    int r;

    /* Layout and marks are those of the sections. */
    as_glass.rows = panel->stated->patch[panel->stated->patch_count - 1].row;
    as_glass.columns = longest_row(panel->stated);
    as_glass.has_markers = 0;
    r = gsn_scan_open(decoder, picture_fd, &as_glass, NULL, &scan, err);
    if (r >= 0)
        r = check_glass(&scan->glass, err);
    if (r >= 0)
        r = read_patches(scan, panel->stated, panel->patch, err);
    if (r < 0)
        return r;
    panel->patch_count = panel->stated->patch_count;
    panel->light = scan->glass.light;
    memcpy(panel->white, scan->glass.white, sizeof panel->white);
    panel->has_dyes = has_dyes(panel->stated);
    expected = gsn_dyes_prior_builtin(panel->light);
    return panel->has_dyes
               ? gsn_calibration_dyes(panel->patch, panel->patch_count, &expected, &panel->fit, err)
               : GSN_OK;
}

int gsn_calibration_panel_read(struct gsn_decoder *decoder, int picture_fd,
                               const struct gsn_protocol *protocol,
                               const struct gsn_stated_calibration *stated,
                               struct gsn_calibration_panel **ret_panel, struct gsn_error *err)
{
    gsn_auto(gsn_calibration_panel) panel = gsn_alloc_array(1, sizeof *panel);
    int r;

    if (!panel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a calibration panel");
    panel->stated = stated;
    r = read_panel(decoder, picture_fd, protocol, panel, err);
    if (r < 0)
        return gsn_fail_at(err, "calibration panel %s", stated->file);
    *ret_panel = gsn_steal(&panel);
    return GSN_OK;
}

void gsn_calibration_panel_free(struct gsn_calibration_panel *panel)
{
    gsn_free(panel);
}

/* ---- on a slide -------------------------------------------------------------------------- */

static double glass_apart(const double a[3], const double b[3])
{
    double most = 0;

    for (int c = 0; c < 3; c++)
        most = fmax(most, fabs(log10(a[c] / b[c])));
    return most;
}

/* What the slide says of its dyes itself. That it cannot is a sentence, no failure; that it is of
 * another stain is one. */
static int compare(const struct gsn_calibration_panel *panel, const struct gsn_scan *scan,
                   const struct gsn_image *tissue, struct gsn_calibrated *calibrated,
                   struct gsn_error *err)
{
    const struct gsn_dyes_prior prior = gsn_dyes_prior_builtin(scan->glass.light);
    gsn_auto(gsn_stain_sample) sample = NULL;
    struct gsn_dyes_fit own;
    struct gsn_error why = { 0 };
    double apart_deg;
    int r = gsn_stain_sample_new(&sample, err);

    if (r >= 0)
        r = gsn_stain_sample_add(sample, scan->od, tissue, &scan->glass, err);
    if (r >= 0)
        r = gsn_stain_fits(sample, &panel->fit.dyes, &apart_deg, err);
    if (r < 0)
        return r;
    r = gsn_dyes_estimate(sample, &prior, &own, &why);
    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    if (r >= 0)
        calibrated->apart = gsn_dyes_compare(&panel->fit, &own);
    else
        (void)snprintf(calibrated->why, sizeof calibrated->why, "%.199s", why.text);
    calibrated->compared = r >= 0;
    return GSN_OK;
}

int gsn_calibration_apply(const struct gsn_calibration_panel *panel, const struct gsn_scan *scan,
                          const struct gsn_image *tissue, const struct gsn_protocol *protocol,
                          struct gsn_dyes_fit *ret_fit, struct gsn_calibrated *ret_calibrated,
                          struct gsn_error *err)
{
    struct gsn_calibrated calibrated = { .panel = panel, .gain = { .gain = 1 }, .zero = NAN };
    struct gsn_dyes_fit fit;
    int r;

    if (panel->light != scan->glass.light)
        return gsn_fail(err, GSN_E_STAIN,
                        "calibration panel %s and this panel do not code light alike: scan both "
                        "with the same settings, or state \"transfer\"",
                        panel->stated->file);
    calibrated.white_od = glass_apart(panel->white, scan->glass.white);
    r = panel->has_dyes ? compare(panel, scan, tissue, &calibrated, err)
                        : gsn_scan_dyes(scan, tissue, protocol, &fit, err);
    if (r >= 0 && panel->has_dyes)
        fit = panel->fit;
    if (r >= 0 && gsn_stated_calibration_has_standards(panel->stated)) {
        r = gsn_calibration_gain(panel->patch, panel->patch_count, &fit.dyes, &calibrated.gain,
                                 &calibrated.zero, err);
        if (r < 0)
            (void)gsn_fail_at(err, "calibration panel %s", panel->stated->file);
    }
    if (r < 0)
        return r;
    *ret_fit = fit;
    *ret_calibrated = calibrated;
    return GSN_OK;
}
