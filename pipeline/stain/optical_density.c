/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Optical density by a table and the flat field: D = log10(white(x, y)) - log10(light(code)).
 *
 * The logarithm of light is looked up once per sample; that of the white is a quadratic in x along
 * a row, whose three coefficients are worked out once per row (flat_field.h). So a density costs a
 * table look-up and two multiply-adds, about 1.9 ns for the three of a pixel. Readers are constant
 * after they are made and may be shared by threads.
 *
 * What separates tissue from glass (gsn_od_tissue) is found in the histogram of the total
 * density's square root: Otsu's cut first (1979, 10.1109/TSMC.1979.4310076), then the emptiest
 * stretch below it, for pale tissue lies nearer to glass than to dense tissue. */
#include "pipeline/stain/optical_density.h"

#include "pipeline/core/mem.h"
#include "pipeline/imaging/threshold.h"

#include <math.h>

struct gsn_od_reader {
    const struct gsn_image *image;
    const struct gsn_flat_field *glass;
    float *table; /* log10 of light of each code */
};

static int check_picture(const struct gsn_image *image, const struct gsn_flat_field *glass,
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
static void glass_row(const struct gsn_flat_field *glass, uint32_t y, unsigned c, float ret[3])
{
    double sum[3] = { 0 };

    for (unsigned k = 0; k < 3; k++) {
        double row[3];

        if (c != 3 && c != k)
            continue;
        gsn_flat_field_row(glass, y, k, row);
        for (int i = 0; i < 3; i++)
            sum[i] += row[i];
    }
    for (int i = 0; i < 3; i++)
        ret[i] = (float)sum[i];
}

int gsn_od_total(const struct gsn_image *image, const struct gsn_flat_field *glass,
                 struct gsn_plane **ret_total, struct gsn_error *err)
{
    const size_t width = image->width;
    gsn_auto_mem(float) table = NULL;
    gsn_auto(gsn_plane) total = NULL;
    int r = check_picture(image, glass, err);

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
static void thin_row(const struct gsn_od_reader *absorber, uint32_t y, unsigned apart, size_t count,
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

int gsn_od_thin(const struct gsn_image *image, const struct gsn_flat_field *glass, unsigned apart,
                struct gsn_plane *ret_od[3], struct gsn_error *err)
{
    gsn_auto(gsn_od_reader) absorber = NULL;
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) green = NULL;
    gsn_auto(gsn_plane) blue = NULL;
    struct gsn_plane **const plane[3] = { &red, &green, &blue };
    const uint32_t width = (image->width + apart - 1) / apart;
    const uint32_t height = (image->height + apart - 1) / apart;
    int r = gsn_od_reader_new(image, glass, &absorber, err);

    for (int c = 0; c < 3 && r >= 0; c++)
        r = gsn_plane_new(width, height, plane[c], err);
    if (r < 0)
        return r;
    for (uint32_t y = 0; y < height; y++) {
        const size_t at = (size_t)y * width;
        float *const to[3] = { red->value + at, green->value + at, blue->value + at };

        if (apart == 1)
            gsn_od_reader_row(absorber, 0, y, width, to);
        else
            thin_row(absorber, y * apart, apart, width, to);
    }
    for (int c = 0; c < 3; c++)
        ret_od[c] = gsn_steal(plane[c]);
    return GSN_OK;
}

/* ---- row by row -------------------------------------------------------------------------- */

int gsn_od_reader_new(const struct gsn_image *image, const struct gsn_flat_field *glass,
                      struct gsn_od_reader **ret_absorber, struct gsn_error *err)
{
    gsn_auto(gsn_od_reader) absorber = NULL;
    int r = check_picture(image, glass, err);

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

void gsn_od_reader_free(struct gsn_od_reader *absorber)
{
    if (!absorber)
        return;
    gsn_free(absorber->table);
    gsn_free(absorber);
}

/* log10 of light of all three channels, each pixel touched once. */
static void light_rows(const struct gsn_od_reader *absorber, size_t at, size_t count,
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

void gsn_od_reader_row(const struct gsn_od_reader *absorber, uint32_t x, uint32_t y, size_t count,
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
static void light_thin(const struct gsn_od_reader *absorber, size_t first, uint32_t apart,
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

void gsn_od_reader_red(const struct gsn_od_reader *absorber, uint32_t x, uint32_t y, uint32_t apart,
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

int gsn_od_reader_at_end(const struct gsn_od_reader *absorber, uint32_t x, uint32_t y, size_t count)
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

int gsn_od_reader_clipped(const struct gsn_od_reader *absorber, uint32_t x, uint32_t y)
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

/* ---- tissue and glass -------------------------------------------------------------------- */

int gsn_od_check(struct gsn_plane *const od[3], const struct gsn_image *mask, struct gsn_error *err)
{
    for (int c = 1; c < 3; c++)
        if (od[c]->width != od[0]->width || od[c]->height != od[0]->height)
            return gsn_fail(err, GSN_E_INPUT,
                            "the optical densities differ in size: %u x %u, %u x %u", od[0]->width,
                            od[0]->height, od[c]->width, od[c]->height);
    if (mask && (mask->width != od[0]->width || mask->height != od[0]->height ||
                 mask->channels != 1 || mask->bits != 8))
        return gsn_fail(err, GSN_E_INPUT, "the mask is not an 8-bit grey image of %u x %u",
                        od[0]->width, od[0]->height);
    return GSN_OK;
}

/* The middle of the emptiest stretch of the histogram below `end`, of the first where several are
 * equally empty; values start at 0. */
static double find_valley(const float *values, size_t count, double end)
{
    enum { BINS = 128, AROUND = 3 };
    size_t bin[BINS] = { 0 }, least = SIZE_MAX;
    int first = 0, last = 0;

    for (size_t i = 0; i < count; i++)
        if (values[i] < end)
            bin[(size_t)(values[i] / end * BINS)]++;
    for (int i = AROUND; i < BINS - AROUND; i++) {
        size_t sum = 0;

        for (int j = i - AROUND; j <= i + AROUND; j++)
            sum += bin[j];
        if (sum < least) {
            least = sum;
            first = i;
            last = i;
        } else if (sum == least && last + 1 == i) {
            last = i;
        }
    }
    return end * ((first + last) / 2 + 0.5) / BINS;
}

/* The palest stain that a scan of 8 bits tells from glass, R + G + B. */
#define PALEST 0.05

int gsn_od_tissue(struct gsn_plane *const od[3], const struct gsn_flat_field *glass,
                  struct gsn_plane **ret_total, double *ret_threshold, struct gsn_error *err)
{
    const size_t count = (size_t)od[0]->width * od[0]->height;
    gsn_auto(gsn_plane) total = NULL;
    gsn_auto_mem(float) root = NULL;
    double split;
    int r = gsn_od_check(od, NULL, err);

    if (r >= 0)
        r = gsn_plane_new(od[0]->width, od[0]->height, &total, err);
    if (r < 0)
        return r;
    root = gsn_alloc_array(count, sizeof *root);
    if (!root)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissue threshold");

    /* The root spreads what is pale and draws dark marks nearer to the tissue. */
    for (size_t i = 0; i < count; i++) {
        total->value[i] = od[0]->value[i] + od[1]->value[i] + od[2]->value[i];
        root[i] = sqrtf(fmaxf(total->value[i], 0));
    }
    split = gsn_otsu(root, count);
    if (split > 0)
        split = find_valley(root, count, split);
    /* The noises of three channels add in squares. */
    *ret_threshold = fmax(fmax(split * split, 6 * sqrt(3) * glass->noise_od), PALEST);
    *ret_total = gsn_steal(&total);
    return GSN_OK;
}
