/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/calibration_patches.h"

#include "pipeline/register/panel/reduce.h"
#include "pipeline/register/panel/segment.h"
#include "pipeline/stain/optical_density.h"

#include <math.h>
#include <stdlib.h>

/* Smaller things are dust, print or a drop. */
static const double SMALLEST_UM = 600;
/* A disc fills 0.785 of its box, a square all of it; print and scratches much less. */
static const double FULL = 0.7, LONGEST = 2;
/* A printed code is as dark in one cell as it is pale in the next. */
static const double MOTTLED = 0.35;
/* Patches are alike in area within this factor. */
static const double SAME_AREA = 1.6;
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
static struct gsn_pixel_box inner(const struct gsn_component *piece)
{
    const int x = (int)lround(RIM * piece->width), y = (int)lround(RIM * piece->height);

    return (struct gsn_pixel_box){ piece->x + x, piece->y + y, piece->width - 2 * x,
                                   piece->height - 2 * y };
}

static int is_mottled(const struct gsn_plane *total, const struct gsn_component *piece)
{
    const struct gsn_pixel_box box = inner(piece);
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

/* How many pieces have about the area of this one. */
static size_t alike(const struct gsn_component *piece, size_t count, size_t own)
{
    const double area = (double)piece[own].area;
    size_t sum = 0;

    for (size_t i = 0; i < count; i++)
        sum +=
            (double)piece[i].area <= SAME_AREA * area && area <= SAME_AREA * (double)piece[i].area;
    return sum;
}

/* Leaves out what is not of the area that most share. */
static void keep_alike(struct field *field)
{
    size_t best = 0, most = 0, kept = 0;
    double area;

    for (size_t i = 0; i < field->count; i++)
        if (alike(field->piece, field->count, i) > most) {
            most = alike(field->piece, field->count, i);
            best = i;
        }
    area = field->count > 0 ? (double)field->piece[best].area : 0;
    for (size_t i = 0; i < field->count; i++) {
        const struct gsn_component piece = field->piece[i];

        if ((double)piece.area <= SAME_AREA * area && area <= SAME_AREA * (double)piece.area)
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

static size_t stated_in_row(const struct gsn_stated_calibration *stated, unsigned row)
{
    size_t count = 0;

    for (size_t i = 0; i < stated->patch_count; i++)
        count += stated->patch[i].row == row;
    return count;
}

/* Sorts the pieces as the patches are stated. */
static int arrange(struct field *field, const struct gsn_stated_calibration *stated,
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
    const struct gsn_pixel_box cells = inner(piece);
    const int step = (int)field->step;

    return (struct gsn_pixel_box){ cells.x * step, cells.y * step, cells.width * step,
                                   cells.height * step };
}

int gsn_calibration_patches_find(const struct gsn_scan *scan,
                                 const struct gsn_stated_calibration *stated,
                                 struct gsn_pixel_box *ret_boxes, struct gsn_error *err)
{
    struct field field = { .scan = scan };
    int r = make_total(&field, err);

    if (r >= 0)
        r = find_pieces(&field, err);
    if (r >= 0)
        r = arrange(&field, stated, err);
    for (size_t i = 0; r >= 0 && i < stated->patch_count; i++)
        ret_boxes[i] = in_pixels(&field, &field.piece[i]);
    field_done(&field);
    return r;
}
