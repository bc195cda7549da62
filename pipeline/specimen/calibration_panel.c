/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Reads a calibration panel into dye vectors and a stain gain, and applies it to a slide.
 *
 * 1. Patches are dark pieces of even colour and of about one area. They are sorted into rows from
 * the top and, within a row, from the left, and must be as many in each row as the job states.
 * 2. Of each patch the inner part is read in cells of GSN_PATCH_SIDE by GSN_PATCH_SIDE, after
 * checks for glass that is not white, clipping and size; what a JPEG rounds a colour by is its
 * error.
 * 3. Patches of single dyes give the vectors, standards of known density the gain
 *    (stain/calibration.h).
 * 4. On a slide the vectors are compared with those that its own tissue shows; that they cannot be
 *    compared is a sentence, that the slide is of another stain is a failure.
 *
 * A calibration panel for several slides is read once. Fails with GSN_E_STAIN and a sentence that
 * names the file, the row and the patch. */
#include "pipeline/specimen/calibration_panel.h"

#include "pipeline/core/file.h"
#include "pipeline/register/panel/reduce.h"
#include "pipeline/register/panel/segment.h"
#include "pipeline/specimen/protocol.h"
#include "pipeline/specimen/scan.h"
#include "pipeline/specimen/specimen.h"
#include "pipeline/stain/calibration.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/stain_sample.h"
#include "pipeline/stain/stain_vectors.h"
#include "pipeline/stain/vector_estimation.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Smaller things are dust, print or a drop. */
static const double SMALLEST_UM = 600;

/* A disc fills 0.785 of its box, a square all of it; print and scratches much less. */
static const double FULL = 0.7, LONGEST = 2;

/* A printed code is as dark in one cell as it is pale in the next. */
static const double MOTTLED = 0.35;

/* Of a patch on each side: its rim is smeared, and the scan blurs it. */
static const double RIM = 0.2;

struct field {
    const struct gsn_scan *scan;
    unsigned step;           /* pixels in a cell */
    struct gsn_plane *total; /* owned; R + G + B optical density in cells */
    size_t count;
    struct gsn_component *piece; /* owned; those that may be patches, row by row */
};

static void field_done(struct field *field)
{
    gsn_plane_free(field->total);
    gsn_free(field->piece);
}

/* ---- what looks like a patch ------------------------------------------------------------- */

static int make_total(struct field *field, struct gsn_error *err)
{
    const struct gsn_image *image = field->scan->picture->image;
    gsn_auto(gsn_image) small = NULL;
    struct gsn_flat_field glass = field->scan->glass;
    int r;

    field->step = gsn_panel_step(field->scan->px_um);
    r = gsn_panel_reduce(image, field->step, &small, err);
    if (r < 0)
        return r;
    glass.width = small->width;
    glass.height = small->height;
    return gsn_od_total(small, &glass, &field->total, err);
}

/* The part of a piece that its rim does not reach, in cells. */
static struct gsn_pixel_box inner_box(const struct gsn_component *piece)
{
    const int x = (int)lround(RIM * piece->width), y = (int)lround(RIM * piece->height);

    return (struct gsn_pixel_box){ piece->x + x, piece->y + y, piece->width - 2 * x,
                                   piece->height - 2 * y };
}

static int is_mottled(const struct gsn_plane *total, const struct gsn_component *piece)
{
    const struct gsn_pixel_box box = inner_box(piece);
    const double count = (double)box.width * box.height;
    double sum = 0, squares = 0;

    for (int y = box.y; y < box.y + box.height; y++)
        for (int x = box.x; x < box.x + box.width; x++) {
            const double value = total->value[(size_t)y * total->width + (size_t)x];

            sum += value;
            squares += value * value;
        }
    return !(squares / count - sum / count * sum / count <=
             MOTTLED * MOTTLED * sum / count * sum / count);
}

static int is_patch(const struct field *field, const struct gsn_component *piece)
{
    const double cell_um = field->step * field->scan->px_um;
    const double width = piece->width * cell_um, height = piece->height * cell_um;
    const int at_edge = piece->x == 0 || piece->y == 0 ||
                        piece->x + piece->width == (int)field->total->width ||
                        piece->y + piece->height == (int)field->total->height;

    return !at_edge && width >= SMALLEST_UM && height >= SMALLEST_UM && width <= LONGEST * height &&
           height <= LONGEST * width &&
           (double)piece->area >= FULL * piece->width * piece->height &&
           !is_mottled(field->total, piece);
}

static int are_alike(double a, double b)
{
    return a <= GSN_PANEL_SAME_AREA * b && b <= GSN_PANEL_SAME_AREA * a;
}

/* How many pieces have about the area of this one. */
static size_t count_alike(const struct gsn_component *piece, size_t count, size_t own)
{
    const double area = (double)piece[own].area;
    size_t sum = 0;

    for (size_t i = 0; i < count; i++)
        sum += are_alike((double)piece[i].area, area) ? 1 : 0;
    return sum;
}

/* Leaves out what is not of the area that most share. */
static void keep_alike(struct field *field)
{
    size_t best = 0, most = 0, kept = 0;
    double area;

    for (size_t i = 0; i < field->count; i++)
        if (count_alike(field->piece, field->count, i) > most) {
            most = count_alike(field->piece, field->count, i);
            best = i;
        }
    area = field->count > 0 ? (double)field->piece[best].area : 0;
    for (size_t i = 0; i < field->count; i++) {
        const struct gsn_component piece = field->piece[i];

        if (are_alike((double)piece.area, area))
            field->piece[kept++] = piece;
    }
    field->count = kept;
}

static int find_pieces(struct field *field, struct gsn_error *err)
{
    const size_t count = (size_t)field->total->width * field->total->height;
    gsn_auto_mem(uint8_t) mask = gsn_alloc(count);
    gsn_auto(gsn_components) pieces = NULL;
    int r;

    if (!mask)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a calibration panel");
    for (size_t i = 0; i < count; i++)
        mask[i] = field->total->value[i] >= GSN_TISSUE_OD;
    r = gsn_segment_mask(mask, field->total->width, field->total->height, 0, &pieces, NULL, err);
    if (r < 0)
        return r;
    field->piece = gsn_alloc_array(pieces->count + 1, sizeof *field->piece);
    if (!field->piece)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a calibration panel");
    for (size_t i = 0; i < pieces->count; i++)
        if (is_patch(field, &pieces->component[i]))
            field->piece[field->count++] = pieces->component[i];
    keep_alike(field);
    return GSN_OK;
}

/* ---- which patch is which ---------------------------------------------------------------- */

static int by_height(const void *a, const void *b)
{
    const struct gsn_component *p = a, *q = b;

    return p->cy < q->cy ? -1 : p->cy > q->cy;
}

static int by_side(const void *a, const void *b)
{
    const struct gsn_component *p = a, *q = b;

    return p->cx < q->cx ? -1 : p->cx > q->cx;
}

/* How many pieces from first on lie in one row. */
static size_t row_length(const struct field *field, size_t first)
{
    size_t last = first + 1;

    while (last < field->count &&
           field->piece[last].cy - field->piece[last - 1].cy < 0.5 * field->piece[last - 1].height)
        last++;
    return last - first;
}

static size_t stated_in_row(const struct gsn_protocol_calibration *stated, unsigned row)
{
    size_t count = 0;

    for (size_t i = 0; i < stated->patch_count; i++)
        count += stated->patch[i].row == row;
    return count;
}

/* Sorts the pieces as the patches are stated. */
static int sort_by_rows(struct field *field, const struct gsn_protocol_calibration *stated,
                        struct gsn_error *err)
{
    const unsigned rows = stated->patch[stated->patch_count - 1].row;
    unsigned row = 0;

    qsort(field->piece, field->count, sizeof *field->piece, by_height);
    for (size_t first = 0; first < field->count;) {
        const size_t length = row_length(field, first);

        row++;
        if (row <= rows && length != stated_in_row(stated, row))
            return gsn_fail(err, GSN_E_STAIN,
                            "row %u is stated with %zu patches, %zu were found from (%.0f, %.0f) "
                            "px on: one is missing, too pale to be seen, or run into another",
                            row, stated_in_row(stated, row), length,
                            field->piece[first].cx * field->step,
                            field->piece[first].cy * field->step);
        qsort(field->piece + first, length, sizeof *field->piece, by_side);
        first += length;
    }
    if (row != rows)
        return gsn_fail(err, GSN_E_STAIN,
                        "%u row%s of patches %s stated, %u %s found: patches are missing, or too "
                        "pale to be seen",
                        rows, rows == 1 ? "" : "s", rows == 1 ? "is" : "are", row,
                        row == 1 ? "was" : "were");
    return GSN_OK;
}

static struct gsn_pixel_box in_pixels(const struct field *field, const struct gsn_component *piece)
{
    const struct gsn_pixel_box cells = inner_box(piece);
    const int step = (int)field->step;

    return (struct gsn_pixel_box){ cells.x * step, cells.y * step, cells.width * step,
                                   cells.height * step };
}

/* gives: ret_boxes, one for each stated patch, in panel pixels: the part of it that its rim does
 * not reach. borrows: everything. Fails with GSN_E_STAIN where the glass does not show the rows of
 * patches that are stated, GSN_E_NOMEM. */
static int find_patches(const struct gsn_scan *scan, const struct gsn_protocol_calibration *stated,
                        struct gsn_pixel_box *ret_boxes, struct gsn_error *err)
{
    struct field field = { .scan = scan };
    int r = make_total(&field, err);

    if (r >= 0)
        r = find_pieces(&field, err);
    if (r >= 0)
        r = sort_by_rows(&field, stated, err);
    for (size_t i = 0; r >= 0 && i < stated->patch_count; i++)
        ret_boxes[i] = in_pixels(&field, &field.piece[i]);
    field_done(&field);
    return r;
}

static const double MOST_CLIPPED = 0.01, MOST_OVEREXPOSED = 0.05;

/* Codes, of 255, that the colour of an even patch is off by at the qualities that scanners use:
 * steps of its mean brightness and of its mean two colours, turned into R, G and B. */
static const double JPEG_CODES = 0.5;

/* The darkest channel of white glass against its brightest. */
static const double LEAST_WHITE = 0.6;

/* ---- what a patch shows ------------------------------------------------------------------ */

static int check_clipped(const struct gsn_scan *scan, const struct gsn_pixel_box *box,
                         const struct gsn_protocol_patch *stated, struct gsn_error *err)
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

        patch->floor_od[c] = hypot(GSN_WHITE_ERROR_OD, rounded > 0 ? log10(moved / light) : 0);
    }
}

static int read_patch(const struct gsn_scan *scan, const struct gsn_pixel_box *box,
                      const struct gsn_protocol_patch *stated, struct gsn_patch *ret_patch,
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

static int read_patches(const struct gsn_scan *scan, const struct gsn_protocol_calibration *stated,
                        struct gsn_patch *patches, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_pixel_box) box = gsn_alloc_array(stated->patch_count, sizeof *box);
    int r = box ? find_patches(scan, stated, box, err)
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

static int has_dyes(const struct gsn_protocol_calibration *stated)
{
    for (size_t i = 0; i < stated->patch_count; i++)
        if (stated->patch[i].kind != GSN_PATCH_STANDARD)
            return 1;
    return 0;
}

static unsigned longest_row(const struct gsn_protocol_calibration *stated)
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
                               const struct gsn_protocol_calibration *stated,
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
static int compare_dyes(const struct gsn_calibration_panel *panel, const struct gsn_scan *scan,
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

/* The dye vectors to unmix a slide with: the calibration panel's where it has them, else as
 * gsn_scan_dyes(). tissue: of the size of the scan's thinned densities, 0 leaves a pixel out of
 * what the slide is asked; NULL takes all that is stained. Fails as gsn_scan_dyes(),
 * gsn_stain_fits() and gsn_calibration_gain() do, and with GSN_E_STAIN when the two were not
 * scanned in the same meaning of the samples. */
static int apply_calibration(const struct gsn_calibration_panel *panel, const struct gsn_scan *scan,
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
    r = panel->has_dyes ? compare_dyes(panel, scan, tissue, &calibrated, err)
                        : gsn_scan_dyes(scan, tissue, protocol, &fit, err);
    if (r >= 0 && panel->has_dyes)
        fit = panel->fit;
    if (r >= 0 && gsn_protocol_calibration_has_standards(panel->stated)) {
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

/* ---- the panels of a job ------------------------------------------------------------------ */

int gsn_calibrations_have_standards(const struct gsn_specimen *specimen)
{
    const struct gsn_protocol *p = specimen->protocol;

    for (size_t i = 0; i < specimen->panel_count; i++) {
        const struct gsn_protocol_calibration *stated = gsn_protocol_calibration_of(
            p->calibration, p->calibration_count, specimen->panel[i].number);

        if (specimen->panel[i].section_count > 0 &&
            (!stated || !gsn_protocol_calibration_has_standards(stated)))
            return 0;
    }
    return p->calibration_count > 0;
}

int gsn_calibrations_init(const struct gsn_specimen *specimen,
                          struct gsn_calibrations *calibrations, struct gsn_error *err)
{
    const size_t count = specimen->protocol->calibration_count;

    if (count == 0)
        return GSN_OK;
    calibrations->panel = gsn_alloc_array(count, sizeof(struct gsn_calibration_panel *));
    if (!calibrations->panel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the calibration panels");
    calibrations->count = count;
    return GSN_OK;
}

void gsn_calibrations_done(struct gsn_calibrations *calibrations)
{
    for (size_t i = 0; i < calibrations->count; i++)
        gsn_calibration_panel_free(calibrations->panel[i]);
    gsn_free(calibrations->panel);
}

/* A panel of several slides is read once. */
static int know_calibration(const struct gsn_specimen *specimen,
                            const struct gsn_specimen_options *options, size_t which,
                            struct gsn_calibrations *calibrations, struct gsn_error *err)
{
    const struct gsn_protocol_calibration *stated = &specimen->protocol->calibration[which];
    const char *sha256 = specimen->calibration_sha256 ? specimen->calibration_sha256[which] : NULL;
    gsn_auto_fd picture_fd = -1;
    int r;

    if (calibrations->panel[which])
        return GSN_OK;
    if (!sha256)
        return gsn_fail(err, GSN_E_STAIN,
                        "calibration panel %s did not come with the specimen: import it again with "
                        "the file beside job.json",
                        stated->file);
    r = specimen->open(specimen->context, sha256, &picture_fd, err);
    if (r < 0)
        return r;
    return gsn_calibration_panel_read(options->decoder, picture_fd, specimen->protocol, stated,
                                      &calibrations->panel[which], err);
}

int gsn_calibration_find_dyes(const struct gsn_specimen *specimen,
                              const struct gsn_specimen_options *options,
                              const struct gsn_scan *scan, const struct gsn_image *tissue,
                              unsigned panel, struct gsn_calibrations *calibrations,
                              struct gsn_dyes_fit *ret_fit, struct gsn_calibrated *ret_calibrated,
                              struct gsn_error *err)
{
    const struct gsn_protocol *p = specimen->protocol;
    const struct gsn_protocol_calibration *stated =
        gsn_protocol_calibration_of(p->calibration, p->calibration_count, panel);
    size_t which;
    int r;

    *ret_calibrated = (struct gsn_calibrated){ 0 };
    if (!stated)
        return gsn_scan_dyes(scan, tissue, p, ret_fit, err);
    which = (size_t)(stated - p->calibration);
    r = know_calibration(specimen, options, which, calibrations, err);
    return r < 0 ? r
                 : apply_calibration(calibrations->panel[which], scan, tissue, p, ret_fit,
                                     ret_calibrated, err);
}
