/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Illumination drift: bands that the flat field leaves on the blank glass.
 *
 * Blocks of 8 x 8 pixels that are grey and about 0 are glass; the median of the blocks along a row
 * (and, across, along a column) is what that band is off by. The drift is the brightest less the
 * darkest band, each taken as the middle one of three neighbours, so that dirt in one is none of
 * the lamp's; the residual is the root mean square over all blocks. At most 96 bands of 96 blocks
 * are looked at. Fewer than six glass blocks tell no band, fewer than three bands no drift: NaN. */
#include "pipeline/stain/illumination_drift.h"

#include "pipeline/core/robust.h"

#include <math.h>
#include <string.h>

/* Optical densities. Flicker of a seventh stays within GLASS; what is coloured by more than HUE is
 * pale tissue, for a lamp dims all three channels. */
static const double GLASS = 0.06, HUE = 0.015;

enum {
    BLOCK = 8,  /* pixels, per axis: the noise of a pixel is an eighth of itself in their mean */
    BANDS = 96, /* at most, each of whole blocks */
    ALONG = 96, /* blocks looked at in a band */
    LEAST = 6,  /* glass blocks that tell a band's light */
};

struct look {
    struct gsn_plane *const *od;
    const struct gsn_pixel_box *box;
    double sum_of_squares;
    size_t count;
};

/* Mean of a block; NaN where it is not glass. */
static double glass_of_block(const struct look *look, int x0, int y0)
{
    double mean[3] = { 0 }, low = INFINITY, high = -INFINITY;

    for (int c = 0; c < 3; c++) {
        const struct gsn_plane *plane = look->od[c];

        for (int y = y0; y < y0 + BLOCK; y++)
            for (int x = x0; x < x0 + BLOCK; x++)
                mean[c] += plane->value[(size_t)y * plane->width + (size_t)x];
        mean[c] /= BLOCK * BLOCK;
        low = fmin(low, mean[c]);
        high = fmax(high, mean[c]);
    }
    if (low < -GLASS || high > GLASS || high - low > HUE)
        return NAN;
    return (mean[0] + mean[1] + mean[2]) / 3;
}

/* The median over the glass blocks of one band; NaN where there are too few. */
static double median_of_band(struct look *look, int along, int at)
{
    const int length = along ? look->box->width : look->box->height;
    const int blocks = length / BLOCK, step = (blocks + ALONG - 1) / ALONG;
    double value[ALONG];
    size_t n = 0;

    for (int i = 0; i < blocks && n < ALONG; i += step) {
        const int u = i * BLOCK;
        const double one =
            glass_of_block(look, look->box->x + (along ? u : at), look->box->y + (along ? at : u));

        if (isnan(one))
            continue;
        value[n++] = one;
        look->sum_of_squares += along ? one * one : 0;
        look->count += along != 0;
    }
    return n < LEAST ? (double)NAN : gsn_order_pick(value, n, n / 2);
}

/* Brightest minus darkest band. A band counts as the middle one of three neighbours: dirt in one is
 * none of the lamp's. */
static double spread_of_bands(struct look *look, int along)
{
    const int length = along ? look->box->height : look->box->width;
    const int blocks = length / BLOCK, step = (blocks + BANDS - 1) / BANDS;
    double last[3], low = INFINITY, high = -INFINITY;
    size_t seen = 0;

    for (int i = 0; i < blocks; i += step) {
        const double one = median_of_band(look, along, i * BLOCK);
        double three[3], middle;

        if (isnan(one))
            continue;
        last[seen++ % 3] = one;
        if (seen < 3)
            continue;
        memcpy(three, last, sizeof three);
        middle = gsn_order_pick(three, 3, 1);
        low = fmin(low, middle);
        high = fmax(high, middle);
    }
    return seen < 3 ? (double)NAN : high - low;
}

struct gsn_illumination gsn_illumination_drift(struct gsn_plane *const od[3],
                                               const struct gsn_pixel_box *box)
{
    struct look look = { .od = od, .box = box };
    struct gsn_illumination lamp = { .rows = spread_of_bands(&look, 1) };

    lamp.columns = spread_of_bands(&look, 0);
    lamp.residual = look.count ? sqrt(look.sum_of_squares / (double)look.count) : (double)NAN;
    return lamp;
}
