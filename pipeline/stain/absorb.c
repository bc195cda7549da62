/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/absorb.h"

#include "pipeline/stain/light.h"

#include <assert.h>

static int check(const struct gsn_image *image, const struct gsn_glass *glass,
                 struct gsn_error *err)
{
    if (image->channels != 3)
        return gsn_fail(err, GSN_E_INPUT, "a grey picture tells no dyes apart");
    if (image->width != glass->width || image->height != glass->height)
        return gsn_fail(err, GSN_E_INPUT,
                        "the glass was measured on %u x %u pixels, not on %u x %u", glass->width,
                        glass->height, image->width, image->height);
    return GSN_OK;
}

/* gives: the table of light.h in single precision. */
static int float_table(enum gsn_light light, unsigned bits, float **ret_table,
                       struct gsn_error *err)
{
    const size_t count = (size_t)1 << bits;
    gsn_auto_mem(double) exact = NULL;
    float *table;
    const int r = gsn_light_table(light, bits, &exact, err);

    if (r < 0)
        return r;
    table = gsn_alloc(count * sizeof *table);
    if (!table)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a table of %zu codes", count);
    for (size_t i = 0; i < count; i++)
        table[i] = (float)exact[i];
    *ret_table = table;
    return GSN_OK;
}

/* log10 of light of channel c, or of all three added up for c = 3, of count pixels from at on. */
static void light_row(const struct gsn_image *image, const float *table, size_t at, size_t count,
                      unsigned c, float *to)
{
    const int all = c == 3;

    if (image->bits == 8) {
        const uint8_t *from = (const uint8_t *)image->samples + 3 * at;

        for (size_t x = 0; all && x < count; x++)
            to[x] = table[from[3 * x]] + table[from[3 * x + 1]] + table[from[3 * x + 2]];
        for (size_t x = 0; !all && x < count; x++)
            to[x] = table[from[3 * x + c]];
    } else {
        const uint16_t *from = (const uint16_t *)image->samples + 3 * at;

        for (size_t x = 0; all && x < count; x++)
            to[x] = table[from[3 * x]] + table[from[3 * x + 1]] + table[from[3 * x + 2]];
        for (size_t x = 0; !all && x < count; x++)
            to[x] = table[from[3 * x + c]];
    }
}

/* to[] becomes the glass less what it held; from pixel x0 on. */
static void below_glass(const float g[3], uint32_t width, uint32_t x0, size_t count, float *to)
{
    const float step = (float)(2.0 / width);

    for (size_t x = 0; x < count; x++) {
        const float u = step * ((float)(x0 + x) + 0.5f) - 1;

        to[x] = g[0] + u * (g[1] + u * g[2]) - to[x];
    }
}

/* Of one channel, or of all three added up for c = 3. */
static void glass_row(const struct gsn_glass *glass, uint32_t y, unsigned c, float ret[3])
{
    double sum[3] = { 0 };

    for (unsigned k = 0; k < 3; k++) {
        double row[3];

        if (c != 3 && c != k)
            continue;
        gsn_glass_row(glass, y, k, row);
        for (int i = 0; i < 3; i++)
            sum[i] += row[i];
    }
    for (int i = 0; i < 3; i++)
        ret[i] = (float)sum[i];
}

static void absorb_rows(const struct gsn_image *image, const struct gsn_glass *glass,
                        const float *table, const struct gsn_pixel_box *box, unsigned c, float *to)
{
    const size_t width = (size_t)box->width;

    for (int y = box->y; y < box->y + box->height; y++, to += width) {
        float g[3];

        glass_row(glass, (uint32_t)y, c, g);
        light_row(image, table, (size_t)y * image->width + (size_t)box->x, width, c, to);
        below_glass(g, image->width, (uint32_t)box->x, width, to);
    }
}

int gsn_absorb_total(const struct gsn_image *image, const struct gsn_glass *glass,
                     struct gsn_plane **ret_total, struct gsn_error *err)
{
    const struct gsn_pixel_box all = { 0, 0, (int)image->width, (int)image->height };
    gsn_auto_mem(float) table = NULL;
    gsn_auto(gsn_plane) total = NULL;
    int r = check(image, glass, err);

    if (r >= 0)
        r = float_table(glass->light, image->bits, &table, err);
    if (r >= 0)
        r = gsn_plane_new(image->width, image->height, &total, err);
    if (r < 0)
        return r;
    absorb_rows(image, glass, table, &all, 3, total->value);
    *ret_total = gsn_steal(&total);
    return GSN_OK;
}

int gsn_absorb_box(const struct gsn_image *image, const struct gsn_glass *glass,
                   const struct gsn_pixel_box *box, unsigned planes, struct gsn_plane *ret_od[3],
                   struct gsn_error *err)
{
    gsn_auto_mem(float) table = NULL;
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) green = NULL;
    gsn_auto(gsn_plane) blue = NULL;
    struct gsn_plane **const plane[3] = { &red, &green, &blue };
    int r = check(image, glass, err);

    assert(planes >= 1 && planes <= 3 && box->x >= 0 && box->y >= 0);
    assert(box->width > 0 && box->width <= (int)image->width - box->x);
    assert(box->height > 0 && box->height <= (int)image->height - box->y);

    if (r >= 0)
        r = float_table(glass->light, image->bits, &table, err);
    for (unsigned c = 0; c < planes && r >= 0; c++)
        r = gsn_plane_new((uint32_t)box->width, (uint32_t)box->height, plane[c], err);
    if (r < 0)
        return r;
    for (unsigned c = 0; c < planes; c++) {
        absorb_rows(image, glass, table, box, c, (*plane[c])->value);
        ret_od[c] = gsn_steal(plane[c]);
    }
    return GSN_OK;
}
