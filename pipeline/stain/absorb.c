/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/absorb.h"

#include "pipeline/stain/light.h"
#include "pipeline/stain/rows.h"

#include <assert.h>
#include <math.h>

struct gsn_absorber {
    const struct gsn_image *image;
    const struct gsn_glass *glass;
    float *table; /* log10 of light of each code */
};

struct gsn_red_reader {
    const struct gsn_absorber *absorber;
    struct gsn_red_weights weights;
    gsn_red_row *run;
};

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

/* log10 of light of all three channels added up, of count pixels from at on. */
static void total_row(const struct gsn_image *image, const float *table, size_t at, size_t count,
                      float *to)
{
    if (image->bits == 8) {
        const uint8_t *from = (const uint8_t *)image->samples + 3 * at;

        for (size_t x = 0; x < count; x++)
            to[x] = table[from[3 * x]] + table[from[3 * x + 1]] + table[from[3 * x + 2]];
    } else {
        const uint16_t *from = (const uint16_t *)image->samples + 3 * at;

        for (size_t x = 0; x < count; x++)
            to[x] = table[from[3 * x]] + table[from[3 * x + 1]] + table[from[3 * x + 2]];
    }
}

/* to[] becomes the glass less what it held; from pixel x0 on. */
static void below_glass(const float g[3], uint32_t width, uint32_t x0, size_t count, float *to)
{
    const float step = (float)(2.0 / width);

    for (size_t x = 0; x < count; x++) {
        const float u = step * ((float)(int)(x0 + x) + 0.5f) - 1;

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

int gsn_absorb_total(const struct gsn_image *image, const struct gsn_glass *glass,
                     struct gsn_plane **ret_total, struct gsn_error *err)
{
    const size_t width = image->width;
    gsn_auto_mem(float) table = NULL;
    gsn_auto(gsn_plane) total = NULL;
    int r = check(image, glass, err);

    if (r >= 0)
        r = float_table(glass->light, image->bits, &table, err);
    if (r >= 0)
        r = gsn_plane_new(image->width, image->height, &total, err);
    if (r < 0)
        return r;
    for (uint32_t y = 0; y < image->height; y++) {
        float *to = total->value + y * width, g[3];

        glass_row(glass, y, 3, g);
        total_row(image, table, y * width, width, to);
        below_glass(g, image->width, 0, width, to);
    }
    *ret_total = gsn_steal(&total);
    return GSN_OK;
}

/* Every apart-th pixel of row y. */
static void thin_row(const struct gsn_absorber *absorber, uint32_t y, unsigned apart, size_t count,
                     float *const to[3])
{
    const struct gsn_image *image = absorber->image;
    const float step = 2.0F / (float)image->width;

    for (unsigned c = 0; c < 3; c++) {
        float g[3];

        glass_row(absorber->glass, y, c, g);
        for (size_t i = 0; i < count; i++) {
            const uint32_t x = (uint32_t)i * apart;
            const float u = step * ((float)x + 0.5f) - 1;

            to[c][i] = g[0] + u * (g[1] + u * g[2]) - absorber->table[gsn_image_at(image, x, y, c)];
        }
    }
}

int gsn_absorb_thin(const struct gsn_image *image, const struct gsn_glass *glass, unsigned apart,
                    struct gsn_plane *ret_od[3], struct gsn_error *err)
{
    gsn_auto(gsn_absorber) absorber = NULL;
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) green = NULL;
    gsn_auto(gsn_plane) blue = NULL;
    struct gsn_plane **const plane[3] = { &red, &green, &blue };
    const uint32_t width = (image->width + apart - 1) / apart;
    const uint32_t height = (image->height + apart - 1) / apart;
    int r = gsn_absorber_new(image, glass, &absorber, err);

    for (int c = 0; c < 3 && r >= 0; c++)
        r = gsn_plane_new(width, height, plane[c], err);
    if (r < 0)
        return r;
    for (uint32_t y = 0; y < height; y++) {
        const size_t at = (size_t)y * width;
        float *const to[3] = { red->value + at, green->value + at, blue->value + at };

        if (apart == 1)
            gsn_absorber_row(absorber, 0, y, width, to);
        else
            thin_row(absorber, y * apart, apart, width, to);
    }
    for (int c = 0; c < 3; c++)
        ret_od[c] = gsn_steal(plane[c]);
    return GSN_OK;
}

/* ---- row by row --------------------------------------------------------------------------- */

int gsn_absorber_new(const struct gsn_image *image, const struct gsn_glass *glass,
                     struct gsn_absorber **ret_absorber, struct gsn_error *err)
{
    gsn_auto(gsn_absorber) absorber = NULL;
    int r = check(image, glass, err);

    if (r < 0)
        return r;
    absorber = gsn_alloc_array(1, sizeof *absorber);
    if (!absorber)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for optical densities");
    absorber->image = image;
    absorber->glass = glass;
    r = float_table(glass->light, image->bits, &absorber->table, err);
    if (r >= 0)
        *ret_absorber = gsn_steal(&absorber);
    return r;
}

void gsn_absorber_free(struct gsn_absorber *absorber)
{
    if (!absorber)
        return;
    gsn_free(absorber->table);
    gsn_free(absorber);
}

/* log10 of light of all three channels, each pixel touched once. */
static void light_rows(const struct gsn_absorber *absorber, size_t at, size_t count,
                       float *const to[3])
{
    const float *table = absorber->table;
    float *restrict r = to[0], *restrict g = to[1], *restrict b = to[2];

    if (absorber->image->bits == 8) {
        const uint8_t *from = (const uint8_t *)absorber->image->samples + 3 * at;

        for (size_t x = 0; x < count; x++) {
            r[x] = table[from[3 * x]];
            g[x] = table[from[3 * x + 1]];
            b[x] = table[from[3 * x + 2]];
        }
    } else {
        const uint16_t *from = (const uint16_t *)absorber->image->samples + 3 * at;

        for (size_t x = 0; x < count; x++) {
            r[x] = table[from[3 * x]];
            g[x] = table[from[3 * x + 1]];
            b[x] = table[from[3 * x + 2]];
        }
    }
}

void gsn_absorber_row(const struct gsn_absorber *absorber, uint32_t x, uint32_t y, size_t count,
                      float *const od[3])
{
    const uint32_t width = absorber->image->width;

    light_rows(absorber, (size_t)y * width + x, count, od);
    for (unsigned c = 0; c < 3; c++) {
        float g[3];

        glass_row(absorber->glass, y, c, g);
        below_glass(g, width, x, count, od[c]);
    }
}

/* log10 of light of every apart-th red sample. Rows as far apart as the pixels come next, and no
 * processor guesses them. */
static void light_thin(const struct gsn_absorber *absorber, size_t first, uint32_t apart,
                       size_t count, float *restrict to)
{
    const size_t stride = 3 * (size_t)apart,
                 ahead = apart > 1 ? stride * absorber->image->width : 0;
    const float *table = absorber->table;

    if (absorber->image->bits == 8) {
        const uint8_t *from = (const uint8_t *)absorber->image->samples + first;

        for (size_t i = 0; i < count; i++, from += stride) {
            __builtin_prefetch(from + ahead);
            to[i] = table[*from];
        }
    } else {
        const uint16_t *from = (const uint16_t *)absorber->image->samples + first;

        for (size_t i = 0; i < count; i++, from += stride)
            to[i] = table[*from];
    }
}

void gsn_absorber_red(const struct gsn_absorber *absorber, uint32_t x, uint32_t y, uint32_t apart,
                      size_t count, float *to)
{
    const uint32_t width = absorber->image->width;
    const float step = 2.0F / (float)width;
    float g[3];

    light_thin(absorber, 3 * ((size_t)y * width + x), apart, count, to);
    glass_row(absorber->glass, y, 0, g);
    for (size_t i = 0; i < count; i++) {
        const float u = step * ((float)(int)(x + i * apart) + 0.5f) - 1;

        to[i] = g[0] + u * (g[1] + u * g[2]) - to[i];
    }
}

int gsn_absorber_at_end(const struct gsn_absorber *absorber, uint32_t x, uint32_t y, size_t count)
{
    const struct gsn_image *image = absorber->image;
    const size_t first = 3 * ((size_t)y * image->width + x);
    unsigned found = 0;

    if (image->bits == 8) {
        const uint8_t *code = (const uint8_t *)image->samples + first;

        for (size_t i = 0; i < 3 * count; i++)
            found |= (uint8_t)(code[i] + 1) < 2;
    } else {
        const uint16_t *code = (const uint16_t *)image->samples + first;

        for (size_t i = 0; i < 3 * count; i++)
            found |= (uint16_t)(code[i] + 1) < 2;
    }
    return found != 0;
}

int gsn_absorber_clipped(const struct gsn_absorber *absorber, uint32_t x, uint32_t y)
{
    const struct gsn_image *image = absorber->image;
    const unsigned top = image->bits == 8 ? 255 : 65535;
    unsigned at_top = 0, at_zero = 0;

    for (unsigned c = 0; c < 3; c++) {
        const unsigned sample = gsn_image_at(image, x, y, c);

        at_top += sample == top;
        at_zero += sample == 0;
    }
    return at_zero > 0 || (at_top > 0 && at_top < 3);
}

int gsn_red_reader_new(const struct gsn_absorber *absorber, const struct gsn_dyes *dyes,
                       struct gsn_red_reader **ret_reader, struct gsn_error *err)
{
    struct gsn_unmixer mix;
    struct gsn_red_reader *reader;
    const int r = gsn_unmixer_init(&mix, dyes, err);

    if (r < 0)
        return r;
    reader = gsn_alloc_array(1, sizeof *reader);
    if (!reader)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for densities");
    reader->absorber = absorber;
    reader->weights = gsn_red_weights_of(&mix, dyes->full_red_od);
    reader->run = gsn_red_row_best();
    *ret_reader = reader;
    return GSN_OK;
}

void gsn_red_reader_free(struct gsn_red_reader *reader)
{
    gsn_free(reader);
}

/* Of count pixels from (x, y) on; NaN where they are tissue and clipped. scratch: 3 x count. */
static void read_row(const struct gsn_red_reader *reader, uint32_t x, uint32_t y, size_t count,
                     float *scratch, float *to)
{
    const struct gsn_absorber *absorber = reader->absorber;
    float *const od[3] = { scratch, scratch + count, scratch + 2 * count };

    gsn_absorber_row(absorber, x, y, count, od);
    reader->run(&reader->weights, od[0], od[1], od[2], count, to);
    if (!gsn_absorber_at_end(absorber, x, y, count))
        return;
    for (size_t i = 0; i < count; i++)
        if (od[0][i] + od[1][i] + od[2][i] > GSN_TISSUE_OD &&
            gsn_absorber_clipped(absorber, x + (uint32_t)i, y))
            to[i] = NAN;
}

int gsn_red_box(const struct gsn_red_reader *reader, const struct gsn_pixel_box *box,
                unsigned apart, struct gsn_plane **ret_density, struct gsn_error *err)
{
    const uint32_t width = (uint32_t)box->width;
    const uint32_t height = ((uint32_t)box->height + apart - 1) / apart;
    gsn_auto(gsn_plane) density = NULL;
    gsn_auto_mem(float) scratch = gsn_alloc_array(3 * (size_t)width, sizeof *scratch);
    int r;

    if (!scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for densities");
    r = gsn_plane_new(width, height, &density, err);
    if (r < 0)
        return r;
    for (uint32_t y = 0; y < height; y++)
        read_row(reader, (uint32_t)box->x, (uint32_t)box->y + y * apart, width, scratch,
                 density->value + (size_t)y * width);
    *ret_density = gsn_steal(&density);
    return GSN_OK;
}
