/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A section's tissue in bands of detail, as pairwise.c compares them.
 *
 * Steps: (1) the picture becomes total optical density in square cells, white being the brightest
 * hundredth of them. (2) A Laplacian pyramid (Burt and Adelson 1983): each level is blurred and
 * halved for the next, and its band is the difference of two blurs, 2/3 and two cells wide. (3)
 * Local normalisation: each cell is divided by the contrast within nine cells, so that all of the
 * tissue has a say and not its strongest edges alone. (4) Slopes by central differences. (5) The
 * centre and the radius of gyration of the detail, and the coarsest level less its surroundings for
 * the search.
 *
 * Fails when a section has fewer than 16 x 16 cells, is nothing but glass, or memory runs out. */
#include "pipeline/register/tissue/bands.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "pipeline/core/robust.h"
#include "pipeline/imaging/filter.h"
#include "pipeline/imaging/smooth.h"

enum { LEAST_CELLS = 16, SURROUNDINGS = 6, SAMPLED = 4096 };

/* The brightest hundredth of the cells is glass, wherever there is any. */
static const double BRIGHTEST = 0.99;
/* The contrast around a cell is that within nine cells; glass, where there is none, is not blown
 * up: a third of the section's mean is added. */
enum { REACH = 4 };
static const double EVEN = 0.3;

/* ---- picture -> density ------------------------------------------------------------------- */

/* Adds one row of samples, weight of it, to the cells that share it: cell x reaches from x * cell
 * to (x + 1) * cell, and a pixel that two cells share counts in both by its share, so that a cell's
 * middle is where its place says. */
static void add_row(const struct gsn_image *image, uint32_t y, double cell, uint32_t w,
                    double weight, float *sum)
{
    const size_t channels = image->channels;
    const size_t row = (size_t)y * image->width * channels;

    for (uint32_t x = 0; x < w; x++) {
        const double left = x * cell, right = fmin((x + 1) * cell, image->width);
        const uint32_t first = (uint32_t)left, last = (uint32_t)(ceil(right) - 1);
        const float begin = (float)(weight * (left - first));
        const float end = (float)(weight * (last + 1 - right));

        for (size_t c = 0; c < channels; c++) {
            const size_t i = row + first * channels + c, k = row + last * channels + c;
            uint32_t part = 0;
            float outer;

            if (image->bits == 8) {
                const uint8_t *at = image->samples;

                for (size_t j = i; j <= k; j += channels)
                    part += at[j];
                outer = begin * (float)at[i] + end * (float)at[k];
            } else {
                const uint16_t *at = image->samples;

                for (size_t j = i; j <= k; j += channels)
                    part += at[j];
                outer = begin * (float)at[i] + end * (float)at[k];
            }
            sum[x * channels + c] += (float)weight * (float)part - outer;
        }
    }
}

/* Turns the means of one channel into optical density and adds them up. */
static void add_density(const float *mean, size_t cells, float *density)
{
    const size_t every = cells / SAMPLED + 1;
    double sample[SAMPLED];
    size_t count = 0;
    float white;

    for (size_t i = 0; i < cells; i += every)
        sample[count++] = mean[i];
    white = fmaxf((float)gsn_order_pick(sample, count, (size_t)(BRIGHTEST * (double)(count - 1))),
                  1e-6f);
    for (size_t i = 0; i < cells; i++)
        density[i] += log10f(white / fmaxf(mean[i], white * 1e-3f));
}

/* The means of the cells, channel after channel. */
static void average_cells(const struct gsn_image *image, double cell, uint32_t w, uint32_t h,
                          float *row, float *mean)
{
    const size_t channels = image->channels;

    for (uint32_t v = 0; v < h; v++) {
        const double top = v * cell, bottom = fmin((v + 1) * cell, image->height);

        memset(row, 0, w * channels * sizeof *row);
        for (uint32_t y = (uint32_t)top; y < bottom; y++)
            add_row(image, y, cell, w, fmin(y + 1, bottom) - fmax(y, top), row);
        for (size_t x = 0; x < w; x++)
            for (size_t c = 0; c < channels; c++)
                mean[(c * h + v) * w + x] = row[x * channels + c] / (float)(cell * cell);
    }
}

int gsn_tissue_reduce(const struct gsn_image *image, double cell, struct gsn_plane **ret_density,
                      struct gsn_error *err)
{
    const uint32_t w = (uint32_t)(image->width / cell), h = (uint32_t)(image->height / cell);
    const size_t cells = (size_t)w * h, channels = image->channels;
    gsn_auto(gsn_plane) density = NULL;
    gsn_auto_mem(float) row = gsn_alloc_array(w * channels, sizeof *row);
    gsn_auto_mem(float) mean = gsn_alloc_array(channels * cells, sizeof *mean);
    int r;

    assert(cell >= 1 && ret_density);

    if (w < LEAST_CELLS || h < LEAST_CELLS)
        return gsn_fail(err, GSN_E_INPUT, "a picture of %u x %u pixels is too small to be laid",
                        image->width, image->height);
    if (!row || !mean)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissue of a section");
    r = gsn_plane_new(w, h, &density, err);
    if (r < 0)
        return r;
    average_cells(image, cell, w, h, row, mean);
    for (size_t c = 0; c < channels; c++)
        add_density(mean + c * cells, cells, density->value);
    *ret_density = gsn_steal(&density);
    return GSN_OK;
}

/* ---- density -> bands --------------------------------------------------------------------- */

/* By the binomial of variance passes / 2 cells. */
static void blur_level(const float *from, float *onto, size_t w, size_t h, int passes)
{
    memcpy(onto, from, w * h * sizeof *onto);
    gsn_smooth_binomial(onto, w, h, passes);
}

static void compute_slopes(struct gsn_tissue_band *band)
{
    const size_t w = band->w, h = band->h;

    for (size_t y = 1; y + 1 < h; y++)
        for (size_t x = 1; x + 1 < w; x++) {
            const float *at = band->value + y * w + x;

            band->dx[y * w + x] = 0.5f * (at[1] - at[-1]);
            band->dy[y * w + x] = 0.5f * (at[w] - *(at - w));
        }
}

static int new_band(struct gsn_tissue_band *band, size_t w, size_t h)
{
    band->w = w;
    band->h = h;
    band->value = gsn_alloc_array(w * h, sizeof *band->value);
    band->dx = gsn_alloc_array(w * h, sizeof *band->dx);
    band->dy = gsn_alloc_array(w * h, sizeof *band->dy);
    return band->value && band->dx && band->dy;
}

/* Divides by the contrast around, so that all of the tissue has a say and not its strongest edges
 * alone, which may be one structure that slants through the block. */
static int normalise_locally(struct gsn_tissue_band *band, float *scratch, struct gsn_error *err)
{
    const float box = (2 * REACH + 1) * (2 * REACH + 1);
    const size_t cells = band->w * band->h;
    float *square = scratch + cells;
    double sum = 0;
    float least;
    int r;

    for (size_t i = 0; i < cells; i++) {
        square[i] = band->value[i] * band->value[i];
        sum += (double)square[i];
    }
    least = (float)(EVEN * sum / (double)cells);
    r = gsn_box_sum(square, (uint32_t)band->w, (uint32_t)band->h, REACH, scratch, err);
    for (size_t i = 0; r >= 0 && least > 0 && i < cells; i++)
        band->value[i] /= sqrtf(fmaxf(scratch[i], 0) / box + least);
    return r;
}

/* What is finer than the next level: the difference of two blurs, 2/3 and two cells wide. */
static int make_band(const float *level, float *scratch, struct gsn_tissue_band *band,
                     struct gsn_error *err)
{
    const size_t cells = band->w * band->h;
    float *narrow = band->value, *wide = scratch + cells;
    int r;

    blur_level(level, narrow, band->w, band->h, 1);
    blur_level(narrow, wide, band->w, band->h, 4);
    for (size_t i = 0; i < cells; i++)
        band->value[i] -= wide[i];
    r = normalise_locally(band, scratch, err);
    compute_slopes(band);
    return r;
}

/* The coarsest level less its wider surroundings: outline and large structures. */
static void make_whole(const float *level, float *scratch, struct gsn_tissue *t)
{
    const struct gsn_tissue_band *last = &t->band[t->levels - 1];
    const size_t cells = last->w * last->h;
    double square = 0;

    blur_level(level, t->whole, last->w, last->h, 1);
    blur_level(level, scratch + cells, last->w, last->h, SURROUNDINGS * SURROUNDINGS);
    for (size_t i = 0; i < cells; i++) {
        t->whole[i] -= scratch[cells + i];
        square += (double)(t->whole[i] * t->whole[i]);
    }
    for (size_t i = 0; square > 0 && i < cells; i++)
        t->whole[i] = last->value[i] + 0.5f * t->whole[i] / (float)sqrt(square / (double)cells);
}

/* Detail's centre and radius of gyration, of the second coarsest band: there outline, holes and
 * texture weigh alike. */
static int measure_centre(struct gsn_tissue *t, struct gsn_error *err)
{
    const size_t level = t->levels > 1 ? t->levels - 2 : 0;
    const struct gsn_tissue_band *band = &t->band[level];
    const double scale = ldexp(1, (int)level);
    double sum = 0, x1 = 0, y1 = 0, square = 0;

    for (size_t i = 0; i < band->w * band->h; i++) {
        const double e = fabs((double)band->value[i]);
        const double x = ((double)(i % band->w) + 0.5) * scale;
        const double y = ((double)(i / band->w) + 0.5) * scale;

        sum += e;
        x1 += e * x;
        y1 += e * y;
        square += e * (x * x + y * y);
    }
    if (!(sum > 0))
        return gsn_fail(err, GSN_E_INPUT, "nothing but empty glass: no tissue to lay it by");
    t->centre = (struct gsn_point){ x1 / sum, y1 / sum };
    t->radius = sqrt(
        fmax(square / sum - t->centre.x * t->centre.x - t->centre.y * t->centre.y, scale * scale));
    return GSN_OK;
}

static size_t count_levels(size_t w, size_t h)
{
    size_t levels = 1;

    while (levels < GSN_TISSUE_LEVELS && (w > GSN_TISSUE_COARSE || h > GSN_TISSUE_COARSE)) {
        w /= 2;
        h /= 2;
        levels++;
    }
    return levels;
}

static int make_bands(struct gsn_tissue *t, float *level, float *scratch, struct gsn_error *err)
{
    int r;

    for (size_t l = 0;; l++) {
        struct gsn_tissue_band *band = &t->band[l];
        const size_t cells = band->w * band->h;

        r = make_band(level, scratch, band, err);
        if (r < 0)
            return r;
        if (l + 1 == t->levels) {
            make_whole(level, scratch, t);
            return measure_centre(t, err);
        }
        blur_level(level, scratch + cells, band->w, band->h, 1);
        r = gsn_halve(scratch + cells, (uint32_t)band->w, (uint32_t)band->h, level, err);
        if (r < 0)
            return r;
    }
}

int gsn_tissue_new(const struct gsn_plane *density, double cell, struct gsn_tissue **ret_tissue,
                   struct gsn_error *err)
{
    const size_t cells = (size_t)density->width * density->height;
    gsn_auto(gsn_tissue) t = NULL;
    gsn_auto_mem(float) level = NULL;
    gsn_auto_mem(float) scratch = NULL;
    int r;

    assert(cell > 0 && ret_tissue);

    if (density->width < LEAST_CELLS || density->height < LEAST_CELLS)
        return gsn_fail(err, GSN_E_INPUT, "a section of %u x %u cells is too small to be laid",
                        density->width, density->height);
    t = gsn_alloc_array(1, sizeof *t);
    level = gsn_alloc_array(cells, sizeof *level);
    scratch = gsn_alloc_array(2 * cells, sizeof *scratch);
    if (!t || !level || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissue of a section");
    t->cell = cell;
    t->levels = count_levels(density->width, density->height);
    for (size_t l = 0; l < t->levels; l++)
        if (!new_band(&t->band[l], density->width >> l, density->height >> l))
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissue of a section");
    t->whole = gsn_alloc_array(t->band[t->levels - 1].w * t->band[t->levels - 1].h, sizeof(float));
    if (!t->whole)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissue of a section");
    for (size_t i = 0; i < cells; i++)
        level[i] = isnan(density->value[i]) ? 0 : fmaxf(density->value[i], 0);
    r = make_bands(t, level, scratch, err);
    if (r < 0)
        return r;
    *ret_tissue = gsn_steal(&t);
    return GSN_OK;
}

void gsn_tissue_free(struct gsn_tissue *t)
{
    if (!t)
        return;
    for (size_t l = 0; l < GSN_TISSUE_LEVELS; l++) {
        gsn_free(t->band[l].value);
        gsn_free(t->band[l].dx);
        gsn_free(t->band[l].dy);
    }
    gsn_free(t->whole);
    gsn_free(t);
}

struct gsn_point gsn_tissue_centre(const struct gsn_tissue *t)
{
    return (struct gsn_point){ t->centre.x * t->cell, t->centre.y * t->cell };
}

double gsn_tissue_radius(const struct gsn_tissue *t)
{
    return t->radius * t->cell;
}
