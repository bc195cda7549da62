/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/phantom/texture.h"

#include "tests/phantom/tiles.h"

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

static double hann(uint32_t i)
{
    return 0.5 - 0.5 * cos(2 * M_PI * (i + 0.5) / PATCH);
}

/* Adds one patch, mirrored at random, with its upper left texel at (left, top), which may lie
 * outside the quilt. */
static void sew(const struct tile *tile, struct gsn_phantom_random *random, int64_t left,
                int64_t top, struct gsn_plane *quilt)
{
    const uint32_t x0 = gsn_phantom_below(random, tile->width - PATCH + 1);
    const uint32_t y0 = gsn_phantom_below(random, tile->height - PATCH + 1);
    const uint32_t mirror = gsn_phantom_below(random, 4);
    double weight[PATCH];

    for (uint32_t i = 0; i < PATCH; i++)
        weight[i] = hann(i);
    for (uint32_t j = 0; j < PATCH; j++) {
        const int64_t y = top + j;
        const uint32_t v = y0 + (mirror & 2 ? PATCH - 1 - j : j);

        if (y < 0 || y >= quilt->height)
            continue;
        for (uint32_t i = 0; i < PATCH; i++) {
            const int64_t x = left + i;
            const uint32_t u = x0 + (mirror & 1 ? PATCH - 1 - i : i);
            const int8_t texel = gsn_phantom_tiles[tile->offset + (size_t)v * tile->width + u];

            if (x >= 0 && x < quilt->width)
                quilt->value[y * quilt->width + x] +=
                    (float)(weight[i] * weight[j] * texel / STEPS_PER_DEVIATION);
        }
    }
}

/* Divides by sqrt(sum w^2); the sum is a product of one over x and one over y. */
static void even_out(struct gsn_plane *quilt)
{
    double sum[PITCH];

    for (uint32_t i = 0; i < PITCH; i++)
        sum[i] = hann(i) * hann(i) + hann(i + PITCH) * hann(i + PITCH);
    for (uint32_t y = 0; y < quilt->height; y++)
        for (uint32_t x = 0; x < quilt->width; x++)
            quilt->value[(size_t)y * quilt->width + x] /=
                (float)sqrt(sum[x % PITCH] * sum[y % PITCH]);
}

/* Running mean over BOX items that lie stride apart; at the ends over those there are. */
static void mean_line(const float *line, size_t count, size_t stride, float *ret_mean)
{
    double sum = 0;
    size_t first = 0, last = 0;

    for (size_t i = 0; i < count; i++) {
        for (; last < count && last <= i + BOX / 2; last++)
            sum += (double)line[last * stride];
        for (; first + BOX / 2 < i; first++)
            sum -= (double)line[first * stride];
        ret_mean[i * stride] = (float)(sum / (double)(last - first));
    }
}

static int subtract_mean(struct gsn_plane *quilt, struct gsn_error *err)
{
    const size_t width = quilt->width, height = quilt->height, count = width * height;
    gsn_auto_mem(float) rows = gsn_alloc_array(count, sizeof *rows);
    gsn_auto_mem(float) both = gsn_alloc_array(count, sizeof *both);

    if (!rows || !both)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a texture of %zu x %zu", width,
                        height);
    for (size_t y = 0; y < height; y++)
        mean_line(quilt->value + y * width, width, 1, rows + y * width);
    for (size_t x = 0; x < width; x++)
        mean_line(rows + x, height, width, both + x);
    for (size_t i = 0; i < count; i++)
        quilt->value[i] -= both[i];
    return GSN_OK;
}

int gsn_phantom_quilt(enum gsn_phantom_tile tile, uint32_t width, uint32_t height,
                      struct gsn_phantom_random *random, struct gsn_plane **ret_quilt,
                      struct gsn_error *err)
{
    gsn_auto(gsn_plane) quilt = NULL;
    int r;

    r = gsn_plane_new(width, height, &quilt, err);
    if (r < 0)
        return r;
    for (int64_t top = -PITCH; top < height; top += PITCH)
        for (int64_t left = -PITCH; left < width; left += PITCH)
            sew(&TILE[tile], random, left, top, quilt);
    even_out(quilt);
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
