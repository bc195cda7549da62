/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Binomial and Gaussian smoothing, all rows and then all columns.
 *
 * Ours and not OpenCV's: cv::sepFilter2D and cv::GaussianBlur of floats differ in the last bits
 * between processors with and without fused multiply and add, and the same input is to give the
 * same bytes on every machine. The binomial goes over strips of columns, so that a compiler makes
 * vectors of them. Neither fails. */
#include "pipeline/imaging/smooth.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* Pixels of a row that are worked out together. */
enum { STRIP = 64 };

/* The Gaussian is cut off here, in standard deviations. */
enum { CUT = 3, REACH = CUT * GSN_SMOOTH_WIDEST };

/* Once by (1 2 1) / 4 along a row, ends held. */
static void smooth_row(float *cell, size_t count)
{
    float old[STRIP + 2], before = cell[0];

    for (size_t first = 0; first < count; first += STRIP) {
        const size_t width = count - first < STRIP ? count - first : STRIP;

        old[0] = before;
        memcpy(old + 1, cell + first, width * sizeof *old);
        old[width + 1] = first + width < count ? cell[first + width] : old[width];
        before = old[width];
        for (size_t k = 0; k < width; k++)
            cell[first + k] = 0.25f * old[k] + 0.5f * old[k + 1] + 0.25f * old[k + 2];
    }
}

/* The same along some columns side by side. */
static void smooth_columns(float *cell, size_t width, size_t columns, size_t rows)
{
    float before[STRIP];

    memcpy(before, cell, width * sizeof *before);
    for (size_t y = 0; y < rows; y++) {
        float *row = cell + y * columns;
        const float *after = y + 1 < rows ? row + columns : row;

        for (size_t k = 0; k < width; k++) {
            const float own = row[k];

            row[k] = 0.25f * before[k] + 0.5f * own + 0.25f * after[k];
            before[k] = own;
        }
    }
}

void gsn_smooth_binomial(float *plane, size_t width, size_t height, int times)
{
    for (int pass = 0; pass < times; pass++) {
        for (size_t y = 0; y < height; y++)
            smooth_row(plane + y * width, width);
        for (size_t x = 0; x < width; x += STRIP)
            smooth_columns(plane + x, width - x < STRIP ? width - x : STRIP, width, height);
    }
}

/* One line of count pixels that lie step apart; weight: of -reach .. reach. */
static void smooth_line(const float *from, float *to, long count, long step, const double *weight,
                        long reach)
{
    double all = 0;

    for (long d = -reach; d <= reach; d++)
        all += weight[d + reach];
    for (long k = 0; k < count; k++) {
        double sum = 0;

        for (long d = -reach; d <= reach; d++)
            if (k + d >= 0 && k + d < count)
                sum += weight[d + reach] * (double)from[(k + d) * step];
        to[k * step] = (float)(sum / all);
    }
}

void gsn_smooth_gaussian(float *plane, size_t width, size_t height, double sigma, float *scratch)
{
    const long w = (long)width, h = (long)height, reach = (long)ceil(CUT * sigma);
    double weight[2 * REACH + 1];

    assert(sigma > 0 && reach <= REACH);

    for (long d = -reach; d <= reach; d++)
        weight[d + reach] = exp(-0.5 * (double)(d * d) / (sigma * sigma));
    for (long y = 0; y < h; y++)
        smooth_line(plane + y * w, scratch + y * w, w, 1, weight, reach);
    for (long x = 0; x < w; x++)
        smooth_line(scratch + x, plane + x, h, w, weight, reach);
}
