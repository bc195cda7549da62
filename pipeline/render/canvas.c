/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Drawing on a picture in memory: rectangles, lines, colour maps, and the sheet around.
 *
 * Method: rectangles are set pixel by pixel, lines are stroked by cairo all at once as weights of 8
 * bits, letters are pango's (lettering.h). The colour map is viridis (S. van der Walt, N. Smith
 * 2015, CC0) at 17 even places, linear between; values that are NaN are hatched.
 *
 * A sheet has the title above, the colour scale to the right, a scale bar and a note below; the
 * scale bar has the largest length of 1, 2 or 5 times a power of ten that fits. What a line of
 * letters needs is measured, and the sheet is made as wide as that.
 *
 * Failure: GSN_E_NOMEM; a sheet also GSN_E_NOTFOUND without the fonts; drawing outside of a picture
 * is cut.
 * Cost: linear in the pixels that are set; a sheet opens the fonts once. */
#include "pipeline/render/canvas.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>

#include "pipeline/render/lettering_internal.h"

/* --- drawing --- */

static const struct gsn_colour no_data_light = { 214, 214, 216 };
static const struct gsn_colour no_data_dark = { 186, 186, 190 };

/* Viridis at 17 even places (matplotlib's map, in the public domain as CC0), linear between. */
static const struct gsn_colour viridis[17] = {
    { 68, 1, 84 },    { 72, 24, 106 },  { 71, 45, 123 },  { 66, 64, 134 },  { 59, 82, 139 },
    { 51, 99, 141 },  { 44, 114, 142 }, { 38, 130, 142 }, { 33, 145, 140 }, { 31, 160, 136 },
    { 40, 174, 128 }, { 63, 188, 115 }, { 94, 201, 98 },  { 132, 212, 75 }, { 173, 220, 48 },
    { 216, 226, 25 }, { 253, 231, 37 },
};

static uint8_t blend_sample(uint8_t from, uint8_t to, double t)
{
    return (uint8_t)(from + (to - from) * t + 0.5);
}

static struct gsn_colour mix_colours(struct gsn_colour a, struct gsn_colour b, double t)
{
    return (struct gsn_colour){ blend_sample(a.r, b.r, t), blend_sample(a.g, b.g, t),
                                blend_sample(a.b, b.b, t) };
}

struct gsn_colour gsn_colour_of(enum gsn_colour_map map, double share)
{
    const double most = sizeof viridis / sizeof *viridis - 1;
    double place;
    size_t below;

    if (isnan(share))
        return no_data_light;
    share = fmin(1.0, fmax(0.0, share));
    if (map == GSN_MAP_GREY) {
        const uint8_t grey = (uint8_t)(255.0 * share + 0.5);

        return (struct gsn_colour){ grey, grey, grey };
    }
    place = share * most;
    below = (size_t)fmin(most - 1.0, place);
    return mix_colours(viridis[below], viridis[below + 1], place - (double)below);
}

int gsn_canvas_new(uint32_t width, uint32_t height, struct gsn_colour background,
                   struct gsn_image **ret_image, struct gsn_error *err)
{
    gsn_auto(gsn_image) image = NULL;
    const int r = gsn_image_new(width, height, 3, 8, &image, err);

    if (r < 0)
        return r;
    gsn_canvas_box(image, 0, 0, (int)width, (int)height, background);
    *ret_image = gsn_steal(&image);
    return GSN_OK;
}

/* The three samples of a pixel, NULL outside. */
static uint8_t *pixel_at(const struct gsn_image *image, int x, int y)
{
    if (x < 0 || y < 0 || (uint32_t)x >= image->width || (uint32_t)y >= image->height)
        return NULL;
    return (uint8_t *)image->samples + 3 * ((size_t)y * image->width + (size_t)x);
}

void gsn_canvas_put(struct gsn_image *image, int x, int y, struct gsn_colour colour)
{
    uint8_t *to = pixel_at(image, x, y);

    assert(image->channels == 3 && image->bits == 8);
    if (!to)
        return;
    to[0] = colour.r;
    to[1] = colour.g;
    to[2] = colour.b;
}

void gsn_canvas_mix(struct gsn_image *image, int x, int y, struct gsn_colour colour, double weight)
{
    const uint8_t *at = pixel_at(image, x, y);

    weight = fmin(1.0, fmax(0.0, weight));
    if (at)
        gsn_canvas_put(image, x, y,
                       mix_colours((struct gsn_colour){ at[0], at[1], at[2] }, colour, weight));
}

void gsn_canvas_box(struct gsn_image *image, int x, int y, int width, int height,
                    struct gsn_colour colour)
{
    for (int j = y; j < y + height; j++) {
        for (int i = x; i < x + width; i++)
            gsn_canvas_put(image, i, j, colour);
    }
}

/* A frame one pixel wide, outside of the box. */
static void draw_frame(struct gsn_image *image, int x, int y, int width, int height,
                       struct gsn_colour colour)
{
    gsn_canvas_box(image, x - 1, y - 1, width + 2, 1, colour);
    gsn_canvas_box(image, x - 1, y + height, width + 2, 1, colour);
    gsn_canvas_box(image, x - 1, y, 1, height, colour);
    gsn_canvas_box(image, x + width, y, 1, height, colour);
}

void gsn_canvas_no_data(struct gsn_image *image, int x, int y)
{
    /* Stripes of 2 pixels in 8, rising to the right. */
    const int stripe = ((x + y) % 8 + 8) % 8;

    gsn_canvas_put(image, x, y, stripe < 2 ? no_data_dark : no_data_light);
}

struct gsn_pen {
    cairo_surface_t *weights;
    cairo_t *cairo;
};

int gsn_pen_new(const struct gsn_image *image, struct gsn_pen **ret_pen, struct gsn_error *err)
{
    gsn_auto(gsn_pen) pen = gsn_alloc_array(1, sizeof *pen);

    if (!pen)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for lines");
    pen->weights =
        cairo_image_surface_create(CAIRO_FORMAT_A8, (int)image->width, (int)image->height);
    pen->cairo = cairo_create(pen->weights);
    *ret_pen = gsn_steal(&pen);
    return GSN_OK;
}

void gsn_pen_free(struct gsn_pen *pen)
{
    if (!pen)
        return;
    cairo_destroy(pen->cairo);
    cairo_surface_destroy(pen->weights);
    gsn_free(pen);
}

void gsn_pen_line(struct gsn_pen *pen, double x0, double y0, double x1, double y1)
{
    cairo_move_to(pen->cairo, x0, y0);
    cairo_line_to(pen->cairo, x1, y1);
}

int gsn_pen_ink(struct gsn_pen *pen, struct gsn_image *image, double width,
                struct gsn_colour colour, struct gsn_error *err)
{
    cairo_set_line_width(pen->cairo, width);
    cairo_set_line_cap(pen->cairo, CAIRO_LINE_CAP_ROUND);
    cairo_stroke(pen->cairo);
    if (cairo_status(pen->cairo) != CAIRO_STATUS_SUCCESS)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while drawing lines");
    return gsn_lettering_ink(image, 0, 0, pen->weights, colour, err);
}

void gsn_canvas_paste(struct gsn_image *image, const struct gsn_image *picture, int x, int y)
{
    assert(picture->channels == 3 && picture->bits == 8);
    for (uint32_t j = 0; j < picture->height; j++) {
        for (uint32_t i = 0; i < picture->width; i++) {
            const uint8_t *from = pixel_at(picture, (int)i, (int)j);

            gsn_canvas_put(image, x + (int)i, y + (int)j,
                           (struct gsn_colour){ from[0], from[1], from[2] });
        }
    }
}

/* --- the sheet a picture is mounted on --- */

static const struct gsn_colour paper = { 255, 255, 255 };
static const struct gsn_colour ink = { 40, 40, 46 };
static const struct gsn_colour faint = { 200, 200, 204 };

static const double title_px = 13, label_px = 12; /* as the words of the page around */

enum {
    MARGIN = 12,
    GAP = 4, /* between a line of letters and what it belongs to */
    TICK = 3,
    BAR = 14,         /* width of the colour scale */
    LEAST_WIDTH = 96, /* of a sheet, so that a picture of few pixels still carries its letters */
};

static int larger_of(int a, int b)
{
    return a > b ? a : b;
}

/* 1, 2 or 5 times a power of ten: the smallest that is not below. */
static double round_step(double least)
{
    const double power = pow(10.0, floor(log10(least)));
    const double digit = least / power;

    return power * (digit <= 1.0 ? 1.0 : digit <= 2.0 ? 2.0 : digit <= 5.0 ? 5.0 : 10.0);
}

/* Just the digits that multiples of the step have. */
static void write_number(char *text, size_t size, double value, double step)
{
    const int digits = (int)fmax(0.0, ceil(-log10(step) - 1e-9));

    if (fabs(value) >= 1e6 || digits > 5)
        (void)snprintf(text, size, "%.3g", value);
    else
        (void)snprintf(text, size, "%.*f", digits, value);
}

/* The largest round length of at most most_px. */
static void measure_scale_bar(double um_per_px, int most_px, int *ret_px, char label[32])
{
    const double most_um = um_per_px * most_px, power = pow(10.0, floor(log10(most_um)));
    const double digit = most_um / power;
    const double um = power * (digit >= 5.0 ? 5.0 : digit >= 2.0 ? 2.0 : 1.0);

    *ret_px = (int)(um / um_per_px + 0.5);
    if (um >= 1000.0)
        (void)snprintf(label, 32, "%g mm", um / 1000.0);
    else
        (void)snprintf(label, 32, "%g \xc2\xb5m", um);
}

/* The numbers beside a colour scale: multiples of a round step, no nearer than their letters. */
struct ticks {
    double step, first;
    int count;
};

static struct ticks place_ticks(double low, double high, int height, int line)
{
    const double step = round_step((high - low) / fmax(1.0, fmin(6.0, height / (1.2 * line))));
    const double first = ceil(low / step - 1e-9);

    return (struct ticks){ step, first, (int)(floor(high / step + 1e-9) - first) + 1 };
}

/* + 0.0 makes a zero of a minus zero. */
static double tick_value(const struct ticks *ticks, int k, char label[32])
{
    const double value = (ticks->first + k) * ticks->step + 0.0;

    write_number(label, 32, value, ticks->step);
    return value;
}

/* Where everything on a sheet lies; see gsn_plate_new(). */
struct layout {
    int line, x, y, width, height; /* of a line of letters; of the picture */
    int bar_x, bar_y, bar_height;
    struct ticks ticks;
    int scale_px; /* 0: no scale bar */
    char scale_label[32];
    int note_x, foot_y, sheet_width, sheet_height;
};

/* To the right of the colour scale, and of what stands above it. */
static int measure_scale(struct gsn_lettering *letters, const struct gsn_plate *plate,
                         const struct ticks *ticks)
{
    int most = 0;

    for (int k = 0; k < ticks->count; k++) {
        char label[32];

        (void)tick_value(ticks, k, label);
        most = larger_of(most, gsn_lettering_width(letters, GSN_FACE_PLAIN, label_px, label));
    }
    most += BAR + TICK + GAP;
    return plate->unit ? larger_of(most, gsn_lettering_width(letters, GSN_FACE_PLAIN, label_px,
                                                             plate->unit))
                       : most;
}

static void lay_out(struct gsn_lettering *letters, const struct gsn_plate *plate, struct layout *at)
{
    const int has_bar = plate->um_per_px > 0.0;
    const int title = gsn_lettering_height(letters, GSN_FACE_BOLD, title_px);
    int body = at->width, head = 0, foot = 0;

    at->line = gsn_lettering_height(letters, GSN_FACE_PLAIN, label_px);
    at->x = MARGIN;
    at->y = MARGIN;
    if (plate->title) {
        head = gsn_lettering_width(letters, GSN_FACE_BOLD, title_px, plate->title);
        at->y += title + GAP;
    }
    if (plate->has_scale) {
        at->bar_x = at->x + at->width + MARGIN;
        at->bar_y = at->y + (plate->unit ? at->line + 2 * GAP : at->line / 2);
        at->bar_height = larger_of(3 * at->line, at->y + at->height - at->line / 2 - at->bar_y);
        at->ticks = place_ticks(plate->low, plate->high, at->bar_height, at->line);
        body += MARGIN + measure_scale(letters, plate, &at->ticks);
        at->sheet_height = at->bar_y + at->bar_height + at->line / 2;
    }
    if (has_bar) {
        measure_scale_bar(plate->um_per_px, larger_of(at->width / 4, 40), &at->scale_px,
                          at->scale_label);
        foot = larger_of(at->scale_px,
                         gsn_lettering_width(letters, GSN_FACE_PLAIN, label_px, at->scale_label));
    }
    if (plate->note) {
        const int note = gsn_lettering_width(letters, GSN_FACE_PLAIN, label_px, plate->note);

        /* The scale bar, a gap and the note side by side, the note to the right if there is room.
         */
        foot += note + (has_bar ? 2 * MARGIN : 0);
        at->note_x = at->x + larger_of(at->width, foot) - note;
    }
    at->sheet_height = larger_of(at->sheet_height, at->y + at->height);
    at->foot_y = at->sheet_height + 2 * GAP;
    if (has_bar || plate->note)
        at->sheet_height = at->foot_y + at->line + (has_bar ? GAP : 0);
    at->sheet_height += MARGIN;
    at->sheet_width = larger_of(larger_of(body, larger_of(head, foot)), LEAST_WIDTH) + 2 * MARGIN;
}

static int letter(struct gsn_lettering *letters, struct gsn_image *sheet, int x, int y,
                  const char *text, struct gsn_error *err)
{
    return gsn_lettering_draw(letters, sheet, x, y, GSN_FACE_PLAIN, label_px, text, ink, err);
}

static int draw_scale(struct gsn_lettering *letters, struct gsn_image *sheet,
                      const struct gsn_plate *plate, const struct layout *at, struct gsn_error *err)
{
    int r = GSN_OK;

    for (int j = 0; j < at->bar_height; j++)
        gsn_canvas_box(sheet, at->bar_x, at->bar_y + j, BAR, 1,
                       gsn_colour_of(plate->map, 1.0 - (j + 0.5) / (double)at->bar_height));
    draw_frame(sheet, at->bar_x, at->bar_y, BAR, at->bar_height, ink);
    for (int k = 0; r >= 0 && k < at->ticks.count; k++) {
        char label[32];
        const double value = tick_value(&at->ticks, k, label);
        const int y =
            at->bar_y +
            (int)((at->bar_height - 1) * (plate->high - value) / (plate->high - plate->low) + 0.5);

        gsn_canvas_box(sheet, at->bar_x + BAR + 1, y, TICK, 1, ink);
        r = letter(letters, sheet, at->bar_x + BAR + TICK + GAP, y - at->line / 2, label, err);
    }
    if (r >= 0 && plate->unit)
        r = letter(letters, sheet, at->bar_x, at->y, plate->unit, err);
    return r;
}

int gsn_plate_new(const struct gsn_plate *plate, uint32_t width, uint32_t height,
                  struct gsn_image **ret_sheet, int *ret_x, int *ret_y, struct gsn_error *err)
{
    struct layout at = { .width = (int)width, .height = (int)height };
    gsn_auto(gsn_lettering) letters = NULL;
    gsn_auto(gsn_image) sheet = NULL;
    int r = gsn_lettering_new(GSN_FONT_FOLDER, &letters, err);

    if (r < 0)
        return r;
    lay_out(letters, plate, &at);
    r = gsn_canvas_new((uint32_t)at.sheet_width, (uint32_t)at.sheet_height, paper, &sheet, err);
    if (r < 0)
        return r;
    draw_frame(sheet, at.x, at.y, at.width, at.height, faint);
    if (plate->title)
        r = gsn_lettering_draw(letters, sheet, at.x, MARGIN, GSN_FACE_BOLD, title_px, plate->title,
                               ink, err);
    if (r >= 0 && plate->has_scale)
        r = draw_scale(letters, sheet, plate, &at, err);
    if (r >= 0 && at.scale_px) {
        r = letter(letters, sheet, at.x, at.foot_y, at.scale_label, err);
        gsn_canvas_box(sheet, at.x, at.foot_y + at.line + 1, at.scale_px, 3, ink);
    }
    if (r >= 0 && plate->note)
        r = letter(letters, sheet, at.note_x, at.foot_y, plate->note, err);
    if (r < 0)
        return r;
    *ret_sheet = gsn_steal(&sheet);
    *ret_x = at.x;
    *ret_y = at.y;
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
