/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/plate.h"

#include <math.h>

static const struct gsn_colour paper = { 255, 255, 255 };
static const struct gsn_colour ink = { 40, 40, 46 };
static const struct gsn_colour faint = { 200, 200, 204 };

enum {
    MARGIN = 12,
    TITLE = 22,       /* height of the title line */
    FOOT = 34,        /* height of the line with scale bar and note */
    BAR = 14,         /* width of the colour scale */
    LEAST_WIDTH = 96, /* pictures narrower than this still carry their letters */
};

static int larger(int a, int b)
{
    return a > b ? a : b;
}

int gsn_plate_new(const struct gsn_plate *plate, uint32_t width, uint32_t height,
                  struct gsn_image **ret_sheet, int *ret_x, int *ret_y, struct gsn_error *err)
{
    const int w = (int)width, h = (int)height, x = MARGIN, y = plate->title ? TITLE + 4 : MARGIN;
    const int bar_px = plate->um_per_px > 0.0 ? larger(w / 4, 40) : 0;
    const int bar_top = y + (plate->unit ? 2 * GSN_CANVAS_CELL_HEIGHT : 4);
    const int note_width = plate->note ? gsn_canvas_text_width(plate->note, 1) : 0;
    const int title_width = plate->title ? gsn_canvas_text_width(plate->title, 1) : 0;
    const int body = w + (plate->has_scale ? MARGIN + BAR + GSN_CANVAS_SCALE_ROOM : 0);
    /* The foot needs the scale bar, a gap and the note side by side. */
    const int text = larger(title_width, bar_px + (bar_px ? MARGIN : 0) + note_width);
    const int full = larger(larger(body, text), LEAST_WIDTH) + 2 * MARGIN;
    const int foot = plate->note || bar_px ? FOOT : MARGIN;
    gsn_auto(gsn_image) sheet = NULL;
    const int r = gsn_canvas_new((uint32_t)full, (uint32_t)(y + h + foot), paper, &sheet, err);

    if (r < 0)
        return r;
    if (plate->title)
        gsn_canvas_text(sheet, x, 9, 1, plate->title, ink);
    gsn_canvas_frame(sheet, x, y, w, h, faint);
    if (plate->has_scale)
        gsn_canvas_colour_bar(sheet, x + w + MARGIN, bar_top, BAR, larger(40, y + h - bar_top - 4),
                              plate->map, plate->low, plate->high, plate->unit, ink);
    if (bar_px > 0)
        gsn_canvas_scale_bar(sheet, x, y + h + FOOT - 8, plate->um_per_px, bar_px, ink);
    if (plate->note)
        gsn_canvas_text(sheet, x + larger(w, text) - note_width, y + h + 12, 1, plate->note, ink);
    *ret_sheet = gsn_steal(&sheet);
    *ret_x = x;
    *ret_y = y;
    return GSN_OK;
}

void gsn_plate_fill(struct gsn_image *sheet, int x, int y, const struct gsn_plane *plane,
                    enum gsn_colour_map map, double low, double high)
{
    for (uint32_t j = 0; j < plane->height; j++) {
        for (uint32_t i = 0; i < plane->width; i++) {
            const double value = (double)plane->value[(size_t)j * plane->width + i];

            if (isnan(value))
                gsn_canvas_no_data(sheet, x + (int)i, y + (int)j);
            else
                gsn_canvas_put(sheet, x + (int)i, y + (int)j,
                               gsn_colour_of(map, (value - low) / (high - low)));
        }
    }
}

void gsn_plate_range(const struct gsn_plane *plane, double *low, double *high)
{
    double least = INFINITY, most = -INFINITY;

    if (*low < *high)
        return;
    for (size_t i = 0; i < (size_t)plane->width * plane->height; i++) {
        least = fmin(least, (double)plane->value[i]);
        most = fmax(most, (double)plane->value[i]);
    }
    if (least > most)
        least = most = 0.0;
    /* One colour for one value, in the middle of a scale that says so. */
    *low = least < most ? least : least - 0.5 * fmax(1e-3, fabs(least));
    *high = least < most ? most : most + 0.5 * fmax(1e-3, fabs(most));
}
