/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_texture.h"

#include "pipeline/core/robust.h"
#include "pipeline/register/sequence_parts.h"

#include <math.h>
#include <string.h>

/* A patch is compared at all shifts up to REACH, as two mounts of a section are warped each in its
 * own way. A patch of 16 is half a millimetre: small enough to be shifted as a whole, large enough
 * that chance agrees by a fifth at most shifts. */
enum { PATCH = 16, REACH = 5, SHIFTS = 2 * REACH + 1, WINDOW = PATCH + 2 * REACH };
/* Whole vectors. */
enum { ROW = 12 };
/* What is finer than this is texture. */
enum { SMOOTHINGS = 2 };
enum { MOST_PATCHES = 4096 };

/* What two mounts of a section share under a good scanner. Where the limit is above, neighbours
 * share so much that nothing could tell a section that is there twice. */
static const double TWO_MOUNTS = 0.6;
/* Median absolute deviation to standard deviation of normal numbers. */
static const double MAD_TO_SD = 1.4826;
/* Of the plane's mean over what is not glass: below it is no tissue. */
static const double TISSUE = 0.1;
/* Edges of the anatomy are clipped to this many standard deviations: neighbours share them. */
static const double CLIP = 3;
/* Share of a patch that must be tissue; of the window around it in the other section. */
static const double FULL = 0.8, FULL_WINDOW = 0.5;

typedef float four __attribute__((vector_size(16)));

int gsn_sequence_texture_new(size_t n, size_t columns, size_t rows,
                             struct gsn_sequence_texture **ret_texture, struct gsn_error *err)
{
    gsn_auto(gsn_sequence_texture) t = gsn_alloc_array(1, sizeof *t);

    if (t) {
        *t = (struct gsn_sequence_texture){ .n = n, .columns = columns, .rows = rows };
        t->value = gsn_alloc_array((n + 2) * columns * rows, sizeof *t->value);
        t->share = gsn_alloc_array(columns * rows + MOST_PATCHES, sizeof *t->share);
    }
    if (!t || !t->value || !t->share)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the texture of %zu sections", n);
    *ret_texture = gsn_steal(&t);
    return GSN_OK;
}

void gsn_sequence_texture_free(struct gsn_sequence_texture *t)
{
    if (!t)
        return;
    gsn_free(t->value);
    gsn_free(t->share);
    gsn_free(t);
}

/* ---- what a section has finer than its anatomy --------------------------------------------- */

/* Below this a cell is glass, or so poor in dye that its noise is all there is. */
static double least_tissue(const float *density, size_t cells)
{
    double sum = 0, count = 0;

    for (size_t c = 0; c < cells; c++)
        if (density[c] > 0) {
            sum += (double)density[c];
            count++;
        }
    return count > 0 ? TISSUE * sum / count : INFINITY;
}

/* The difference to the plane's own smooth part, in robust standard deviations. */
void gsn_sequence_texture_fill(struct gsn_sequence_texture *t, size_t i, const float *density)
{
    const size_t cells = t->columns * t->rows;
    float *value = t->value + i * cells, *smooth = t->value + t->n * cells,
          *weight = smooth + cells;
    double *spread = t->share + MOST_PATCHES;
    const float least = (float)least_tissue(density, cells);
    size_t count = 0;
    double sd;

    for (size_t c = 0; c < cells; c++) {
        weight[c] = isnan(density[c]) ? 0.0f : 1.0f;
        smooth[c] = isnan(density[c]) ? 0 : density[c];
    }
    gsn_sequence_smooth(smooth, t->columns, t->rows, SMOOTHINGS);
    gsn_sequence_smooth(weight, t->columns, t->rows, SMOOTHINGS);
    for (size_t c = 0; c < cells; c++) {
        value[c] = density[c] > least ? density[c] - smooth[c] / weight[c] : 0;
        if (density[c] > least)
            spread[count++] = fabs((double)value[c]);
    }
    sd = count ? MAD_TO_SD * gsn_median(spread, count) : 0;
    for (size_t c = 0; c < cells; c++)
        value[c] = sd > 0 ? (float)fmax(-CLIP, fmin((double)value[c] / sd, CLIP)) : 0;
}

/* ---- how much of it two sections share ----------------------------------------------------- */

static double share_of_tissue(const struct gsn_sequence_texture *t, const float *corner,
                              size_t side)
{
    size_t count = 0;

    for (size_t y = 0; y < side; y++)
        for (size_t x = 0; x < side; x++)
            count += corner[y * t->columns + x] != 0;
    return (double)count / (double)(side * side);
}

/* Sums of squares over every patch of a window. */
static void energies(const struct gsn_sequence_texture *t, const float *window,
                     double ret_energy[SHIFTS][SHIFTS])
{
    double sum[WINDOW + 1][WINDOW + 1] = { { 0 } };

    for (int y = 0; y < WINDOW; y++)
        for (int x = 0; x < WINDOW; x++) {
            const double v = (double)window[(size_t)y * t->columns + (size_t)x];

            sum[y + 1][x + 1] = sum[y][x + 1] + sum[y + 1][x] - sum[y][x] + v * v;
        }
    for (int v = 0; v < SHIFTS; v++)
        for (int u = 0; u < SHIFTS; u++)
            ret_energy[v][u] =
                sum[v + PATCH][u + PATCH] - sum[v][u + PATCH] - sum[v + PATCH][u] + sum[v][u];
}

/* A line of a patch times a row of the window, at ROW shifts. Written with vectors, as this is
 * where the time goes and the compiler would turn the loops inside out. */
static void add_products(const float line[PATCH], const float row[PATCH + ROW],
                         float ret_product[ROW])
{
    four sum[ROW / 4];

    memcpy(sum, ret_product, sizeof sum);
    for (int x = 0; x < PATCH; x++)
        for (int k = 0; k < ROW / 4; k++) {
            four at;

            memcpy(&at, row + x + 4 * k, sizeof at);
            sum[k] += line[x] * at;
        }
    memcpy(ret_product, sum, sizeof sum);
}

/* Products of a patch with every patch of a window. */
static void products(const struct gsn_sequence_texture *t, const float *patch, const float *window,
                     float ret_product[SHIFTS][ROW])
{
    float row[WINDOW + ROW] = { 0 };

    memset(ret_product, 0, SHIFTS * sizeof *ret_product);
    for (int w = 0; w < WINDOW; w++) {
        memcpy(row, window + (size_t)w * t->columns, WINDOW * sizeof *row);
        for (int v = w < PATCH ? 0 : w - PATCH + 1; v < SHIFTS && v <= w; v++) {
            const float *line = patch + (size_t)(w - v) * t->columns;

            add_products(line, row, ret_product[v]);
        }
    }
}

/* The largest correlation of a patch with the patches around its place in the other section. */
static double agreement(const struct gsn_sequence_texture *t, const float *patch,
                        const float *window)
{
    float product[SHIFTS][ROW];
    double energy[SHIFTS][SHIFTS], own = 0, most = 0;

    for (size_t y = 0; y < PATCH; y++)
        for (size_t x = 0; x < PATCH; x++)
            own += pow((double)patch[y * t->columns + x], 2);
    energies(t, window, energy);
    products(t, patch, window, product);
    for (int v = 0; v < SHIFTS; v++)
        for (int u = 0; u < SHIFTS; u++)
            if (energy[v][u] * own > 0)
                most = fmax(most, (double)product[v][u] / sqrt(energy[v][u] * own));
    return most;
}

size_t gsn_sequence_texture_compare(struct gsn_sequence_texture *t, size_t i, size_t j, size_t step)
{
    const size_t cells = t->columns * t->rows;
    size_t count = 0, at = 0;

    for (size_t y = REACH; y + PATCH + REACH <= t->rows; y += PATCH)
        for (size_t x = REACH; x + PATCH + REACH <= t->columns; x += PATCH) {
            const float *a = t->value + i * cells + y * t->columns + x;
            const float *b = t->value + j * cells + (y - REACH) * t->columns + x - REACH;

            if (at++ % step != 0 || count >= MOST_PATCHES || share_of_tissue(t, a, PATCH) < FULL ||
                share_of_tissue(t, b, WINDOW) < FULL_WINDOW)
                continue;
            t->share[count++] = agreement(t, a, b);
        }
    return count;
}

size_t gsn_sequence_texture_patches(const struct gsn_sequence_texture *t)
{
    return (t->columns / PATCH) * (t->rows / PATCH);
}

double gsn_sequence_texture_shared(struct gsn_sequence_texture *t, size_t i, size_t j, size_t step,
                                   const struct gsn_sequence_summary *summary)
{
    const size_t count = gsn_sequence_texture_compare(t, i, j, step);

    return count >= summary->least ? summary->of(t->share, count) : NAN;
}

/* ---- what only two mounts share ------------------------------------------------------------- */

int gsn_sequence_texture_judge(struct gsn_sequence_texture *t,
                               const struct gsn_sequence_summary *summary, int *ret_told,
                               double *ret_usual, double *ret_least, struct gsn_error *err)
{
    gsn_auto_mem(double) share = gsn_alloc_array(t->n, sizeof *share);
    size_t pairs = 0;
    double usual;

    if (!share)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the texture of %zu sections", t->n);
    for (size_t i = 0; i + 1 < t->n; i++) {
        const double of_pair = gsn_sequence_texture_shared(t, i, i + 1, 1, summary);

        if (!isnan(of_pair))
            share[pairs++] = of_pair;
    }
    *ret_told = 0;
    if (2 * pairs < t->n)
        return GSN_OK;
    usual = gsn_median(share, pairs);
    for (size_t i = 0; i < pairs; i++)
        share[i] = fabs(share[i] - usual);
    *ret_usual = usual;
    *ret_least =
        fmax(summary->same, usual + summary->deviations * MAD_TO_SD * gsn_median(share, pairs));
    *ret_told = *ret_least <= TWO_MOUNTS;
    return GSN_OK;
}
