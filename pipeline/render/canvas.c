/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Drawing on a picture in memory: rectangles, lines, letters, colour maps, and the sheet around.
 *
 * Method: plain raster drawing with clipping; a bitmap face of 5 x 7 dots drawn for this program,
 * so that a report needs no font and has the same bytes everywhere. The colour map is viridis (S.
 * van der Walt, N. Smith 2015, CC0) at 17 even places, linear between; values that are NaN are
 * hatched.
 *
 * A sheet has the title above, the colour scale to the right, a scale bar and a note below; the
 * scale bar has the largest length of 1, 2 or 5 times a power of ten that fits.
 *
 * Failure: GSN_E_NOMEM for a sheet; drawing outside of a picture is cut.
 * Cost: linear in the pixels that are set. */
#include "pipeline/render/canvas.h"

#include <assert.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum { GLYPH_WIDTH = 5, GLYPH_ROWS = 9 };

/* Rows from top to bottom; bit 4 is the leftmost dot. */
struct glyph_bits {
    uint8_t row[GLYPH_ROWS];
};

/* --- the face --- */

/* Each glyph: seven rows from top to bottom, the lowest five bits from left to right; then how many
 * rows the glyph hangs below the usual place. Drawn for this program. */
struct glyph {
    uint8_t row[7], drop;
};

/* clang-format off */
static const struct glyph ascii[95] = {
    { { 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00 }, 0 }, /* space */
    { { 0x04, 0x04, 0x04, 0x04, 0x04, 0x00, 0x04 }, 0 }, /* ! */
    { { 0x0a, 0x0a, 0x0a, 0x00, 0x00, 0x00, 0x00 }, 0 }, /* " */
    { { 0x0a, 0x0a, 0x1f, 0x0a, 0x1f, 0x0a, 0x0a }, 0 }, /* # */
    { { 0x04, 0x0f, 0x14, 0x0e, 0x05, 0x1e, 0x04 }, 0 }, /* $ */
    { { 0x18, 0x19, 0x02, 0x04, 0x08, 0x13, 0x03 }, 0 }, /* % */
    { { 0x0c, 0x12, 0x14, 0x08, 0x15, 0x12, 0x0d }, 0 }, /* & */
    { { 0x04, 0x04, 0x08, 0x00, 0x00, 0x00, 0x00 }, 0 }, /* ' */
    { { 0x02, 0x04, 0x08, 0x08, 0x08, 0x04, 0x02 }, 0 }, /* ( */
    { { 0x08, 0x04, 0x02, 0x02, 0x02, 0x04, 0x08 }, 0 }, /* ) */
    { { 0x00, 0x04, 0x15, 0x0e, 0x15, 0x04, 0x00 }, 0 }, /* asterisk */
    { { 0x00, 0x04, 0x04, 0x1f, 0x04, 0x04, 0x00 }, 0 }, /* + */
    { { 0x00, 0x00, 0x00, 0x00, 0x0c, 0x04, 0x08 }, 1 }, /* , */
    { { 0x00, 0x00, 0x00, 0x1f, 0x00, 0x00, 0x00 }, 0 }, /* - */
    { { 0x00, 0x00, 0x00, 0x00, 0x00, 0x0c, 0x0c }, 0 }, /* . */
    { { 0x01, 0x01, 0x02, 0x04, 0x08, 0x10, 0x10 }, 0 }, /* slash */
    { { 0x0e, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0e }, 0 }, /* 0 */
    { { 0x04, 0x0c, 0x04, 0x04, 0x04, 0x04, 0x0e }, 0 }, /* 1 */
    { { 0x0e, 0x11, 0x01, 0x02, 0x04, 0x08, 0x1f }, 0 }, /* 2 */
    { { 0x1f, 0x02, 0x04, 0x02, 0x01, 0x11, 0x0e }, 0 }, /* 3 */
    { { 0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02 }, 0 }, /* 4 */
    { { 0x1f, 0x10, 0x1e, 0x01, 0x01, 0x11, 0x0e }, 0 }, /* 5 */
    { { 0x06, 0x08, 0x10, 0x1e, 0x11, 0x11, 0x0e }, 0 }, /* 6 */
    { { 0x1f, 0x01, 0x02, 0x04, 0x08, 0x08, 0x08 }, 0 }, /* 7 */
    { { 0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e }, 0 }, /* 8 */
    { { 0x0e, 0x11, 0x11, 0x0f, 0x01, 0x02, 0x0c }, 0 }, /* 9 */
    { { 0x00, 0x0c, 0x0c, 0x00, 0x0c, 0x0c, 0x00 }, 0 }, /* : */
    { { 0x00, 0x0c, 0x0c, 0x00, 0x0c, 0x04, 0x08 }, 0 }, /* ; */
    { { 0x02, 0x04, 0x08, 0x10, 0x08, 0x04, 0x02 }, 0 }, /* < */
    { { 0x00, 0x00, 0x1f, 0x00, 0x1f, 0x00, 0x00 }, 0 }, /* = */
    { { 0x08, 0x04, 0x02, 0x01, 0x02, 0x04, 0x08 }, 0 }, /* > */
    { { 0x0e, 0x11, 0x01, 0x02, 0x04, 0x00, 0x04 }, 0 }, /* ? */
    { { 0x0e, 0x11, 0x17, 0x15, 0x17, 0x10, 0x0e }, 0 }, /* @ */
    { { 0x0e, 0x11, 0x11, 0x1f, 0x11, 0x11, 0x11 }, 0 }, /* A */
    { { 0x1e, 0x11, 0x11, 0x1e, 0x11, 0x11, 0x1e }, 0 }, /* B */
    { { 0x0e, 0x11, 0x10, 0x10, 0x10, 0x11, 0x0e }, 0 }, /* C */
    { { 0x1c, 0x12, 0x11, 0x11, 0x11, 0x12, 0x1c }, 0 }, /* D */
    { { 0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x1f }, 0 }, /* E */
    { { 0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x10 }, 0 }, /* F */
    { { 0x0e, 0x11, 0x10, 0x17, 0x11, 0x11, 0x0f }, 0 }, /* G */
    { { 0x11, 0x11, 0x11, 0x1f, 0x11, 0x11, 0x11 }, 0 }, /* H */
    { { 0x0e, 0x04, 0x04, 0x04, 0x04, 0x04, 0x0e }, 0 }, /* I */
    { { 0x07, 0x02, 0x02, 0x02, 0x02, 0x12, 0x0c }, 0 }, /* J */
    { { 0x11, 0x12, 0x14, 0x18, 0x14, 0x12, 0x11 }, 0 }, /* K */
    { { 0x10, 0x10, 0x10, 0x10, 0x10, 0x10, 0x1f }, 0 }, /* L */
    { { 0x11, 0x1b, 0x15, 0x15, 0x11, 0x11, 0x11 }, 0 }, /* M */
    { { 0x11, 0x19, 0x15, 0x13, 0x11, 0x11, 0x11 }, 0 }, /* N */
    { { 0x0e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e }, 0 }, /* O */
    { { 0x1e, 0x11, 0x11, 0x1e, 0x10, 0x10, 0x10 }, 0 }, /* P */
    { { 0x0e, 0x11, 0x11, 0x11, 0x15, 0x12, 0x0d }, 0 }, /* Q */
    { { 0x1e, 0x11, 0x11, 0x1e, 0x14, 0x12, 0x11 }, 0 }, /* R */
    { { 0x0f, 0x10, 0x10, 0x0e, 0x01, 0x01, 0x1e }, 0 }, /* S */
    { { 0x1f, 0x04, 0x04, 0x04, 0x04, 0x04, 0x04 }, 0 }, /* T */
    { { 0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e }, 0 }, /* U */
    { { 0x11, 0x11, 0x11, 0x11, 0x11, 0x0a, 0x04 }, 0 }, /* V */
    { { 0x11, 0x11, 0x11, 0x15, 0x15, 0x1b, 0x11 }, 0 }, /* W */
    { { 0x11, 0x11, 0x0a, 0x04, 0x0a, 0x11, 0x11 }, 0 }, /* X */
    { { 0x11, 0x11, 0x0a, 0x04, 0x04, 0x04, 0x04 }, 0 }, /* Y */
    { { 0x1f, 0x01, 0x02, 0x04, 0x08, 0x10, 0x1f }, 0 }, /* Z */
    { { 0x0e, 0x08, 0x08, 0x08, 0x08, 0x08, 0x0e }, 0 }, /* [ */
    { { 0x10, 0x10, 0x08, 0x04, 0x02, 0x01, 0x01 }, 0 }, /* backslash */
    { { 0x0e, 0x02, 0x02, 0x02, 0x02, 0x02, 0x0e }, 0 }, /* ] */
    { { 0x04, 0x0a, 0x11, 0x00, 0x00, 0x00, 0x00 }, 0 }, /* ^ */
    { { 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x1f }, 1 }, /* _ */
    { { 0x08, 0x04, 0x02, 0x00, 0x00, 0x00, 0x00 }, 0 }, /* ` */
    { { 0x00, 0x00, 0x0e, 0x01, 0x0f, 0x11, 0x0f }, 0 }, /* a */
    { { 0x10, 0x10, 0x1e, 0x11, 0x11, 0x11, 0x1e }, 0 }, /* b */
    { { 0x00, 0x00, 0x0e, 0x10, 0x10, 0x11, 0x0e }, 0 }, /* c */
    { { 0x01, 0x01, 0x0f, 0x11, 0x11, 0x11, 0x0f }, 0 }, /* d */
    { { 0x00, 0x00, 0x0e, 0x11, 0x1f, 0x10, 0x0e }, 0 }, /* e */
    { { 0x06, 0x09, 0x08, 0x1c, 0x08, 0x08, 0x08 }, 0 }, /* f */
    { { 0x0f, 0x11, 0x11, 0x11, 0x0f, 0x01, 0x0e }, 2 }, /* g */
    { { 0x10, 0x10, 0x16, 0x19, 0x11, 0x11, 0x11 }, 0 }, /* h */
    { { 0x04, 0x00, 0x0c, 0x04, 0x04, 0x04, 0x0e }, 0 }, /* i */
    { { 0x00, 0x06, 0x02, 0x02, 0x02, 0x12, 0x0c }, 2 }, /* j */
    { { 0x10, 0x10, 0x12, 0x14, 0x18, 0x14, 0x12 }, 0 }, /* k */
    { { 0x0c, 0x04, 0x04, 0x04, 0x04, 0x04, 0x0e }, 0 }, /* l */
    { { 0x00, 0x00, 0x1a, 0x15, 0x15, 0x15, 0x15 }, 0 }, /* m */
    { { 0x00, 0x00, 0x16, 0x19, 0x11, 0x11, 0x11 }, 0 }, /* n */
    { { 0x00, 0x00, 0x0e, 0x11, 0x11, 0x11, 0x0e }, 0 }, /* o */
    { { 0x1e, 0x11, 0x11, 0x11, 0x1e, 0x10, 0x10 }, 2 }, /* p */
    { { 0x0f, 0x11, 0x11, 0x11, 0x0f, 0x01, 0x01 }, 2 }, /* q */
    { { 0x00, 0x00, 0x16, 0x19, 0x10, 0x10, 0x10 }, 0 }, /* r */
    { { 0x00, 0x00, 0x0f, 0x10, 0x0e, 0x01, 0x1e }, 0 }, /* s */
    { { 0x08, 0x08, 0x1e, 0x08, 0x08, 0x09, 0x06 }, 0 }, /* t */
    { { 0x00, 0x00, 0x11, 0x11, 0x11, 0x13, 0x0d }, 0 }, /* u */
    { { 0x00, 0x00, 0x11, 0x11, 0x11, 0x0a, 0x04 }, 0 }, /* v */
    { { 0x00, 0x00, 0x11, 0x11, 0x15, 0x15, 0x0a }, 0 }, /* w */
    { { 0x00, 0x00, 0x11, 0x0a, 0x04, 0x0a, 0x11 }, 0 }, /* x */
    { { 0x11, 0x11, 0x11, 0x11, 0x0f, 0x01, 0x0e }, 2 }, /* y */
    { { 0x00, 0x00, 0x1f, 0x02, 0x04, 0x08, 0x1f }, 0 }, /* z */
    { { 0x02, 0x04, 0x04, 0x08, 0x04, 0x04, 0x02 }, 0 }, /* { */
    { { 0x04, 0x04, 0x04, 0x04, 0x04, 0x04, 0x04 }, 0 }, /* | */
    { { 0x08, 0x04, 0x04, 0x02, 0x04, 0x04, 0x08 }, 0 }, /* } */
    { { 0x00, 0x00, 0x08, 0x15, 0x02, 0x00, 0x00 }, 0 }, /* ~ */
};

static const struct glyph square = { { 0x1f, 0x11, 0x11, 0x11, 0x11, 0x11, 0x1f }, 0 };

/* Beyond ASCII, by code point. */
static const struct {
    uint32_t code;
    struct glyph glyph;
} more[] = {
    { 0xb2, { { 0x0c, 0x12, 0x04, 0x08, 0x1e, 0x00, 0x00 }, 0 } },
    { 0xb3, { { 0x1c, 0x02, 0x0c, 0x02, 0x1c, 0x00, 0x00 }, 0 } },
    { 0xb5, { { 0x11, 0x11, 0x11, 0x13, 0x1d, 0x10, 0x10 }, 2 } },
    { 0xb0, { { 0x0c, 0x12, 0x12, 0x0c, 0x00, 0x00, 0x00 }, 0 } },
    { 0xd7, { { 0x00, 0x11, 0x0a, 0x04, 0x0a, 0x11, 0x00 }, 0 } },
};
/* clang-format on */

/* Takes one code point from UTF-8 text; a malformed byte is taken alone. */
static uint32_t take_code_point(const char **text)
{
    const unsigned char *c = (const unsigned char *)*text;

    if (c[0] >= 0xc2 && c[0] < 0xe0 && (c[1] & 0xc0) == 0x80) {
        *text += 2;
        return (c[0] & 0x1fU) << 6 | (c[1] & 0x3fU);
    }
    if (c[0] >= 0xe0 && c[0] < 0xf0 && (c[1] & 0xc0) == 0x80 && (c[2] & 0xc0) == 0x80) {
        *text += 3;
        return (c[0] & 0x0fU) << 12 | (c[1] & 0x3fU) << 6 | (c[2] & 0x3fU);
    }
    *text += 1;
    return c[0];
}

static const struct glyph *find(uint32_t code)
{
    if (code >= 32 && code < 127)
        return &ascii[code - 32];
    for (size_t i = 0; i < sizeof more / sizeof *more; i++) {
        if (more[i].code == code)
            return &more[i].glyph;
    }
    return &square;
}

/* Takes the next character off UTF-8 text; returns 0 at its end. What the face does not have is an
 * empty square. */
static int next_glyph(const char **text, struct glyph_bits *ret_bits)
{
    const struct glyph *glyph;

    if (**text == '\0')
        return 0;
    glyph = find(take_code_point(text));
    *ret_bits = (struct glyph_bits){ { 0 } };
    for (int y = 0; y < 7; y++)
        ret_bits->row[y + glyph->drop] = glyph->row[y];
    return 1;
}

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

/* Distance of a point from a segment. */
static double distance_to_segment(double px, double py, double x0, double y0, double x1, double y1)
{
    const double dx = x1 - x0, dy = y1 - y0, length2 = dx * dx + dy * dy;
    double t = 0.0;

    if (length2 > 0.0)
        t = fmin(1.0, fmax(0.0, ((px - x0) * dx + (py - y0) * dy) / length2));
    return hypot(px - x0 - t * dx, py - y0 - t * dy);
}

static int clamp_px(double at, uint32_t most)
{
    return (int)fmin((double)most, fmax(0.0, at));
}

/* Columns of row y that the line can reach, so that long lines cost their length and not the area
 * of their bounding box. */
static void row_span(double x0, double y0, double x1, double y1, double reach, int y, double *low,
                     double *high)
{
    const double dy = y1 - y0;

    *low = fmin(x0, x1);
    *high = fmax(x0, x1);
    if (fabs(dy) > 1e-9) {
        const double ta = fmin(1.0, fmax(0.0, (y - reach - y0) / dy));
        const double tb = fmin(1.0, fmax(0.0, (y + 1.0 + reach - y0) / dy));
        const double a = x0 + ta * (x1 - x0), b = x0 + tb * (x1 - x0);

        *low = fmin(a, b);
        *high = fmax(a, b);
    }
}

void gsn_canvas_line(struct gsn_image *image, double x0, double y0, double x1, double y1,
                     double width, struct gsn_colour colour)
{
    const double reach = 0.5 * width + 1.0;
    const int top = clamp_px(floor(fmin(y0, y1) - reach), image->height);
    const int bottom = clamp_px(ceil(fmax(y0, y1) + reach), image->height);

    for (int y = top; y < bottom; y++) {
        double low, high;

        row_span(x0, y0, x1, y1, reach, y, &low, &high);
        for (int x = clamp_px(floor(low - reach), image->width);
             x < clamp_px(ceil(high + reach), image->width); x++) {
            /* Coverage of a pixel by the edge at half the width, to first order. */
            const double cover =
                0.5 * width + 0.5 - distance_to_segment(x + 0.5, y + 0.5, x0, y0, x1, y1);

            if (cover > 0.0)
                gsn_canvas_mix(image, x, y, colour, fmin(cover, width));
        }
    }
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

void gsn_canvas_text(struct gsn_image *image, int x, int y, int scale, const char *text,
                     struct gsn_colour colour)
{
    struct glyph_bits bits;

    for (; next_glyph(&text, &bits); x += GSN_CANVAS_CELL_WIDTH * scale) {
        for (int j = 0; j < GLYPH_ROWS; j++) {
            for (int i = 0; i < GLYPH_WIDTH; i++) {
                if (bits.row[j] >> (GLYPH_WIDTH - 1 - i) & 1)
                    gsn_canvas_box(image, x + i * scale, y + j * scale, scale, scale, colour);
            }
        }
    }
}

int gsn_canvas_text_width(const char *text, int scale)
{
    struct glyph_bits bits;
    int cells = 0;

    while (next_glyph(&text, &bits))
        cells++;
    return cells * GSN_CANVAS_CELL_WIDTH * scale;
}

void gsn_canvas_scale_bar(struct gsn_image *image, int x, int y, double um_per_px, int most_px,
                          struct gsn_colour colour)
{
    const double most_um = um_per_px * most_px, power = pow(10.0, floor(log10(most_um)));
    const double digit = most_um / power;
    const double um = power * (digit >= 5.0 ? 5.0 : digit >= 2.0 ? 2.0 : 1.0);
    const int px = (int)(um / um_per_px + 0.5);
    char label[32];

    if (um >= 1000.0)
        (void)snprintf(label, sizeof label, "%g mm", um / 1000.0);
    else
        (void)snprintf(label, sizeof label, "%g \xc2\xb5m", um);
    gsn_canvas_box(image, x, y - 3, px, 3, colour);
    gsn_canvas_text(image, x, y - 4 - GSN_CANVAS_CELL_HEIGHT, 1, label, colour);
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

void gsn_canvas_colour_bar(struct gsn_image *image, int x, int y, int width, int height,
                           enum gsn_colour_map map, double low, double high, const char *unit,
                           struct gsn_colour ink)
{
    const double step = round_step((high - low) / 6.0);
    const double first = ceil(low / step - 1e-9);

    assert(low < high);
    for (int j = 0; j < height; j++)
        gsn_canvas_box(image, x, y + j, width, 1,
                       gsn_colour_of(map, 1.0 - (j + 0.5) / (double)height));
    draw_frame(image, x, y, width, height, ink);
    for (int k = 0; (first + k) * step <= high + 1e-9 * step; k++) {
        /* + 0.0 makes a zero of a minus zero. */
        const double value = (first + k) * step + 0.0;
        const int at = y + (int)((height - 1) * (high - value) / (high - low) + 0.5);
        char text[32];

        write_number(text, sizeof text, value, step);
        gsn_canvas_box(image, x + width + 1, at, 3, 1, ink);
        gsn_canvas_text(image, x + width + 7, at - 3, 1, text, ink);
    }
    if (unit)
        gsn_canvas_text(image, x, y - 2 * GSN_CANVAS_CELL_HEIGHT, 1, unit, ink);
}

/* --- the sheet a picture is mounted on --- */

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

static int larger_of(int a, int b)
{
    return a > b ? a : b;
}

int gsn_plate_new(const struct gsn_plate *plate, uint32_t width, uint32_t height,
                  struct gsn_image **ret_sheet, int *ret_x, int *ret_y, struct gsn_error *err)
{
    const int w = (int)width, h = (int)height, x = MARGIN, y = plate->title ? TITLE + 4 : MARGIN;
    const int bar_px = plate->um_per_px > 0.0 ? larger_of(w / 4, 40) : 0;
    const int bar_top = y + (plate->unit ? 2 * GSN_CANVAS_CELL_HEIGHT : 4);
    const int note_width = plate->note ? gsn_canvas_text_width(plate->note, 1) : 0;
    const int title_width = plate->title ? gsn_canvas_text_width(plate->title, 1) : 0;
    const int body = w + (plate->has_scale ? MARGIN + BAR + GSN_CANVAS_SCALE_ROOM : 0);
    /* The foot needs the scale bar, a gap and the note side by side. */
    const int text = larger_of(title_width, bar_px + (bar_px ? MARGIN : 0) + note_width);
    const int full = larger_of(larger_of(body, text), LEAST_WIDTH) + 2 * MARGIN;
    const int foot = plate->note || bar_px ? FOOT : MARGIN;
    gsn_auto(gsn_image) sheet = NULL;
    const int r = gsn_canvas_new((uint32_t)full, (uint32_t)(y + h + foot), paper, &sheet, err);

    if (r < 0)
        return r;
    if (plate->title)
        gsn_canvas_text(sheet, x, 9, 1, plate->title, ink);
    draw_frame(sheet, x, y, w, h, faint);
    if (plate->has_scale)
        gsn_canvas_colour_bar(sheet, x + w + MARGIN, bar_top, BAR,
                              larger_of(40, y + h - bar_top - 4), plate->map, plate->low,
                              plate->high, plate->unit, ink);
    if (bar_px > 0)
        gsn_canvas_scale_bar(sheet, x, y + h + FOOT - 8, plate->um_per_px, bar_px, ink);
    if (plate->note)
        gsn_canvas_text(sheet, x + larger_of(w, text) - note_width, y + h + 12, 1, plate->note,
                        ink);
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
