/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Texture by overlapping patches of a photograph.
 *
 * Steps: (1) patches of 64 texels, cut from the tile at random and mirrored at random, are laid
 * every 32, with Hann windows scaled so that the squares of the weights at a texel sum to 1:
 * independent patches then keep their variance; (2) the mean over 33 x 33 texels is subtracted, by
 * running sums, so that the texture changes no mean amount of dye.
 *
 * Failure: GSN_E_NOMEM. Cost: four patches a texel and two running sums. */
#include "pipeline/phantom/texture.h"

#include "pipeline/phantom/tiles.h"

#include <math.h>

enum { PATCH = 64, PITCH = 32, BOX = 33, STEPS_PER_DEVIATION = 40 };

struct tile {
    uint32_t width, height;
    size_t offset; /* in gsn_phantom_tiles */
};

static const struct tile TILE[GSN_PHANTOM_TILES] = {
    [GSN_PHANTOM_T1] = { 180, 170, 0 },
    [GSN_PHANTOM_T2] = { 300, 430, 180 * 170 },
};

_Static_assert(GSN_PHANTOM_TILES_SIZE == 180 * 170 + 300 * 430, "tiles.bin has another size");

/* Hann weights, divided so that the squares of the two that meet at a texel sum to 1: that is
 * sum(w t) / sqrt(sum w^2), one axis at a time. */
static void make_weights(float weight[PATCH])
{
    double hann[PATCH];

    for (uint32_t i = 0; i < PATCH; i++)
        hann[i] = 0.5 - 0.5 * cos(2 * M_PI * (i + 0.5) / PATCH);
    for (uint32_t i = 0; i < PATCH; i++)
        weight[i] = (float)(hann[i] / hypot(hann[i], hann[(i + PITCH) % PATCH]));
}

/* Adds one patch, mirrored at random, with its upper left texel at (left, top), which may lie
 * outside the quilt. */
static void sew_patch(const struct tile *tile, const float weight[PATCH],
                      struct gsn_phantom_random *random, int64_t left, int64_t top,
                      struct gsn_plane *quilt)
{
    const uint32_t x0 = gsn_phantom_below(random, tile->width - PATCH + 1);
    const uint32_t y0 = gsn_phantom_below(random, tile->height - PATCH + 1);
    const uint32_t mirror = gsn_phantom_below(random, 4);
    const int64_t first = left < 0 ? -left : 0;
    const int64_t last = left + PATCH > quilt->width ? quilt->width - left : PATCH;

    for (uint32_t j = 0; j < PATCH; j++) {
        const int64_t y = top + j;
        const uint32_t v = y0 + (mirror & 2 ? PATCH - 1 - j : j);
        const int8_t *texel = gsn_phantom_tiles + tile->offset + (size_t)v * tile->width + x0;
        const float scale = weight[j] / STEPS_PER_DEVIATION;

        if (y < 0 || y >= quilt->height)
            continue;
        for (int64_t i = first; i < last; i++)
            quilt->value[y * quilt->width + left + i] +=
                scale * weight[i] * texel[mirror & 1 ? PATCH - 1 - i : i];
    }
}

/* Running mean over BOX neighbours in a row; at the ends over those there are. */
static void mean_row(const float *row, size_t count, float *ret_mean)
{
    double sum = 0;
    size_t first = 0, last = 0;

    for (size_t i = 0; i < count; i++) {
        for (; last < count && last <= i + BOX / 2; last++)
            sum += (double)row[last];
        for (; first + BOX / 2 < i; first++)
            sum -= (double)row[first];
        ret_mean[i] = (float)(sum / (double)(last - first));
    }
}

static void add_row(double *sum, const float *row, size_t count, double sign)
{
    for (size_t x = 0; x < count; x++)
        sum[x] += sign * (double)row[x];
}

/* Subtracts the mean over BOX x BOX texels: along the rows first, then down the columns, which
 * keep a running sum each. */
static int subtract_mean(struct gsn_plane *quilt, struct gsn_error *err)
{
    const size_t width = quilt->width, height = quilt->height;
    gsn_auto_mem(float) mean = gsn_alloc_array(width * height, sizeof *mean);
    gsn_auto_mem(double) sum = gsn_alloc_array(width, sizeof *sum);
    size_t first = 0, last = 0;

    if (!mean || !sum)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a texture of %zu x %zu", width,
                        height);
    for (size_t y = 0; y < height; y++)
        mean_row(quilt->value + y * width, width, mean + y * width);
    for (size_t y = 0; y < height; y++) {
        for (; last < height && last <= y + BOX / 2; last++)
            add_row(sum, mean + last * width, width, 1);
        for (; first + BOX / 2 < y; first++)
            add_row(sum, mean + first * width, width, -1);
        for (size_t x = 0; x < width; x++)
            quilt->value[y * width + x] -= (float)(sum[x] / (double)(last - first));
    }
    return GSN_OK;
}

int gsn_phantom_quilt(enum gsn_phantom_tile tile, uint32_t width, uint32_t height,
                      struct gsn_phantom_random *random, struct gsn_plane **ret_quilt,
                      struct gsn_error *err)
{
    gsn_auto(gsn_plane) quilt = NULL;
    float weight[PATCH];
    int r;

    make_weights(weight);
    r = gsn_plane_new(width, height, &quilt, err);
    if (r < 0)
        return r;
    for (int64_t top = -PITCH; top < height; top += PITCH)
        for (int64_t left = -PITCH; left < width; left += PITCH)
            sew_patch(&TILE[tile], weight, random, left, top, quilt);
    r = subtract_mean(quilt, err);
    if (r < 0)
        return r;
    *ret_quilt = gsn_steal(&quilt);
    return GSN_OK;
}

double gsn_phantom_texture_at(const struct gsn_plane *quilt, double x, double y)
{
    const double u = fmin(fmax(x - 0.5, 0), quilt->width - 1.0);
    const double v = fmin(fmax(y - 0.5, 0), quilt->height - 1.0);
    const size_t i = (size_t)u, j = (size_t)v;
    const size_t right = i + 1 < quilt->width ? 1 : 0;
    const size_t down = j + 1 < quilt->height ? quilt->width : 0;
    const float *at = quilt->value + j * quilt->width + i;
    const double fx = u - (double)i, fy = v - (double)j;

    return (1 - fy) * ((1 - fx) * (double)at[0] + fx * (double)at[right]) +
           fy * ((1 - fx) * (double)at[down] + fx * (double)at[down + right]);
}
