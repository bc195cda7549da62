/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_colour.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "pipeline/core/linalg.h"

enum { CHANNELS = 3, CODES = 256 };
/* Where the mark surely is, and where the tissue around it, in radii. A radius may be a third off.
 */
static const double INSIDE = 0.5, RING_FROM = 1.35, RING_TO = 2.0;
/* Blocks of a fifth of a radius stand for a piece of edge; what changes from one to the next is
 * what the fit cannot know of the tissue under it. */
static const double BLOCKS_PER_RADIUS = 5;
enum { BLOCK_MOST = 8, LAG = 1 };
/* A block that goes this far towards the mark, or away from it, is debris or a hole. */
static const double DARK = 0.35, PALE = 0.6;
/* Variance of rounding a sample, in codes of 256, and the share of the overall variance that is
 * always believed in: no mixture is trusted to cancel more than that. */
static const double ROUNDING = 1.0 / 12, RIDGE = 0.003;

struct blocks {
    size_t width, height, side; /* blocks, and pixels along one */
    float *mean;                /* CHANNELS per block; the first is NaN for one that is not used */
};

static double sample_at(const struct gsn_image *image, size_t at)
{
    return image->bits == 8 ? ((const uint8_t *)image->samples)[at]
                            : ((const uint16_t *)image->samples)[at] / 257.0;
}

/* Mean of the mark's inside. */
static void inside_of(const struct gsn_image *window, struct gsn_point centre, double radius,
                      double *ret_mean)
{
    const double reach = INSIDE * radius;
    double n = 0, sum[CHANNELS] = { 0 };

    for (uint32_t y = (uint32_t)fmax(centre.y - reach, 0);
         y < window->height && y < centre.y + reach; y++) {
        for (uint32_t x = (uint32_t)fmax(centre.x - reach, 0);
             x < window->width && x < centre.x + reach; x++) {
            const double dx = x + 0.5 - centre.x, dy = y + 0.5 - centre.y;

            if (dx * dx + dy * dy > reach * reach)
                continue;
            for (size_t c = 0; c < window->channels; c++)
                sum[c] += sample_at(window, ((size_t)y * window->width + x) * window->channels + c);
            n += 1;
        }
    }
    for (size_t c = 0; c < window->channels; c++)
        ret_mean[c] = sum[c] / fmax(n, 1);
}

static void average(const struct gsn_image *window, struct gsn_point centre, double radius,
                    struct blocks *blocks)
{
    const size_t side = blocks->side, line = window->width * window->channels;

    for (size_t b = 0; b < blocks->width * blocks->height; b++) {
        const size_t x0 = b % blocks->width * side, y0 = b / blocks->width * side;
        const double dx = ((double)x0 + 0.5 * (double)side - centre.x) / radius;
        const double dy = ((double)y0 + 0.5 * (double)side - centre.y) / radius;
        const double rr = dx * dx + dy * dy;
        float *mean = blocks->mean + CHANNELS * b;

        mean[0] = NAN;
        if (rr < RING_FROM * RING_FROM || rr > RING_TO * RING_TO)
            continue;
        for (size_t c = 0; c < window->channels; c++) {
            double sum = 0;

            for (size_t y = y0; y < y0 + side; y++)
                for (size_t x = x0; x < x0 + side; x++)
                    sum += sample_at(window, y * line + x * window->channels + c);
            mean[c] = (float)(sum / (double)(side * side));
        }
    }
}

/* Channel by channel, to a code: enough to tell tissue from what is not. */
static void median_of(const struct blocks *blocks, size_t channels, double *ret_median)
{
    for (size_t c = 0; c < channels; c++) {
        unsigned histogram[CODES] = { 0 };
        size_t n = 0, below = 0, code = 0;

        for (size_t b = 0; b < blocks->width * blocks->height; b++) {
            if (isnan(blocks->mean[CHANNELS * b]))
                continue;
            histogram[(size_t)blocks->mean[CHANNELS * b + c]]++;
            n++;
        }
        for (; code + 1 < CODES && 2 * (below + histogram[code]) < n; code++)
            below += histogram[code];
        ret_median[c] = (double)code + 0.5;
    }
}

/* Blocks that hold something else than tissue take no part. */
static void reject(struct blocks *blocks, size_t channels, const double *tissue,
                   const double *contrast)
{
    double length = 0;

    for (size_t c = 0; c < channels; c++)
        length += contrast[c] * contrast[c];
    for (size_t b = 0; b < blocks->width * blocks->height; b++) {
        float *mean = blocks->mean + CHANNELS * b;
        double along = 0;

        for (size_t c = 0; c < channels; c++)
            along += contrast[c] * (tissue[c] - mean[c]);
        if (along > DARK * length || along < -PALE * length)
            mean[0] = NAN;
    }
}

static void add_difference(const float *a, const float *b, size_t channels,
                           double sum[CHANNELS][CHANNELS], double *n)
{
    if (isnan(a[0]) || isnan(b[0]))
        return;
    for (size_t i = 0; i < channels; i++)
        for (size_t k = 0; k < channels; k++)
            sum[i][k] += 0.5 * ((double)a[i] - (double)b[i]) * ((double)a[k] - (double)b[k]);
    *n += 1;
}

static void covariance_of(const struct blocks *blocks, size_t channels,
                          double ret_cov[CHANNELS][CHANNELS])
{
    double n = 0, trace = 0;

    memset(ret_cov, 0, CHANNELS * sizeof *ret_cov);
    for (size_t y = 0; y < blocks->height; y++) {
        for (size_t x = 0; x < blocks->width; x++) {
            const float *at = blocks->mean + CHANNELS * (y * blocks->width + x);

            if (x + LAG < blocks->width)
                add_difference(at, at + LAG * CHANNELS, channels, ret_cov, &n);
            if (y + LAG < blocks->height)
                add_difference(at, at + LAG * CHANNELS * blocks->width, channels, ret_cov, &n);
        }
    }
    for (size_t i = 0; i < channels; i++) {
        for (size_t k = 0; k < channels; k++)
            ret_cov[i][k] /= fmax(n, 1);
        trace += ret_cov[i][i];
    }
    for (size_t i = 0; i < channels; i++)
        ret_cov[i][i] += ROUNDING + RIDGE * trace;
}

/* level less the weighted samples of 8 bits, which are most pictures'. */
static void mix_bytes(const uint8_t *restrict from, size_t count, size_t channels, float level,
                      const float *weight, float *restrict to)
{
    for (size_t i = 0; channels == 1 && i < count; i++)
        to[i] = level - weight[0] * from[i];
    for (size_t i = 0; channels == 3 && i < count; i++)
        to[i] = level - (weight[0] * from[3 * i] + weight[1] * from[3 * i + 1] +
                         weight[2] * from[3 * i + 2]);
}

static void mix(const struct gsn_image *window, const double *tissue, const double *weight,
                struct gsn_plane *plane)
{
    const size_t channels = window->channels, count = (size_t)plane->width * plane->height;
    float single[CHANNELS] = { 0 };
    double level = 0;

    for (size_t c = 0; c < channels; c++) {
        level += weight[c] * tissue[c];
        single[c] = (float)weight[c];
    }
    if (window->bits == 8) {
        mix_bytes(window->samples, count, channels, (float)level, single, plane->value);
        return;
    }
    for (size_t i = 0; i < count; i++) {
        double sum = level;

        for (size_t c = 0; c < channels; c++)
            sum -= weight[c] * sample_at(window, i * channels + c);
        plane->value[i] = (float)sum;
    }
}

int gsn_mark_mix(const struct gsn_image *window, struct gsn_point centre, double radius_px,
                 struct gsn_plane **ret_plane, double *ret_contrast, struct gsn_error *err)
{
    const size_t side = (size_t)fmin(fmax(floor(radius_px / BLOCKS_PER_RADIUS), 1), BLOCK_MOST);
    struct blocks blocks = { window->width / side, window->height / side, side, NULL };
    const size_t count = blocks.width * blocks.height + 1, channels = window->channels;
    gsn_auto_mem(float) mean = gsn_alloc_array(CHANNELS * count, sizeof *mean);
    gsn_auto(gsn_plane) plane = NULL;
    double mark[CHANNELS], tissue[CHANNELS] = { 0 }, contrast[CHANNELS], weight[CHANNELS];
    double cov[CHANNELS][CHANNELS], length = 0;
    int r;

    assert(window && radius_px > 0 && ret_plane && ret_contrast);

    if (!mean)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the window of a mark");
    r = gsn_plane_new(window->width, window->height, &plane, err);
    if (r < 0)
        return r;
    blocks.mean = mean;
    inside_of(window, centre, radius_px, mark);
    average(window, centre, radius_px, &blocks);
    median_of(&blocks, channels, tissue);
    for (size_t c = 0; c < channels; c++)
        weight[c] = contrast[c] = tissue[c] - mark[c];
    reject(&blocks, channels, tissue, contrast);
    covariance_of(&blocks, channels, cov);
    /* ROUNDING keeps it definite; else the plain contrast serves. */
    (void)gsn_solve_spd(&cov[0][0], channels, CHANNELS, weight);
    for (size_t c = 0; c < channels; c++)
        length += weight[c] * contrast[c];
    for (size_t c = 0; c < channels; c++)
        weight[c] /= fmax(length, 1e-9);
    mix(window, tissue, weight, plane);
    *ret_contrast = log10((tissue[0] + 0.5) / (mark[0] + 0.5));
    *ret_plane = gsn_steal(&plane);
    return GSN_OK;
}
