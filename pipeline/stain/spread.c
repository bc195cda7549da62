/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/spread.h"

#include "pipeline/stain/unmix.h"

#include <math.h>
#include <string.h>

/* Slopes by differences: turns of half a degree, whites of half a percent. Smaller than any error
 * they are used for, larger than what floats of densities lose. */
static const double TURN = 0.5 * M_PI / 180, WHITE_OD = 0.002;

enum { MOST_FOR_SLOPES = 5000 };

static int is_in(struct gsn_plane *const od[3], const struct gsn_image *mask, size_t i)
{
    return (!mask || ((const uint8_t *)mask->samples)[i] != 0) && isfinite(od[0]->value[i]) &&
           isfinite(od[1]->value[i]) && isfinite(od[2]->value[i]);
}

struct total {
    double sum;
    size_t count, seen;
};

/* Over every `stride`-th pixel, the densities raised by `shift`. */
static int mean_of(struct gsn_plane *const od[3], const struct gsn_image *mask,
                   const struct gsn_dyes *dyes, const double shift[3], size_t stride,
                   struct total *ret, struct gsn_error *err)
{
    const size_t count = (size_t)od[0]->width * od[0]->height;
    struct gsn_unmixer mix;
    const int r = gsn_unmixer_init(&mix, dyes, err);

    *ret = (struct total){ 0 };
    for (size_t i = 0; r >= 0 && i < count; i++) {
        double amount[3];

        if (!is_in(od, mask, i) || ret->seen++ % stride != 0)
            continue;
        const double d[3] = { od[0]->value[i] + shift[0], od[1]->value[i] + shift[1],
                              od[2]->value[i] + shift[2] };

        gsn_unmixer_apply(&mix, d, amount);
        ret->sum += amount[0] / dyes->full_red_od;
        ret->count++;
    }
    return r;
}

static int slope(struct gsn_plane *const od[3], const struct gsn_image *mask,
                 const struct gsn_dyes dyes[2], const double shift[2][3], size_t stride,
                 double between, double *ret_slope, struct gsn_error *err)
{
    struct total side[2];

    for (int way = 0; way < 2; way++) {
        const int r = mean_of(od, mask, &dyes[way], shift[way], stride, &side[way], err);

        if (r < 0)
            return r;
    }
    *ret_slope =
        (side[1].sum / (double)side[1].count - side[0].sum / (double)side[0].count) / between;
    return GSN_OK;
}

static int slopes(struct gsn_plane *const od[3], const struct gsn_image *mask,
                  const struct gsn_dyes *dyes, size_t stride, struct gsn_red_mean *red,
                  struct gsn_error *err)
{
    int r = GSN_OK;

    for (int m = 0; m < GSN_DYE_TURNS && r >= 0; m++) {
        static const double none[2][3] = { { 0 } };
        double turn[2][GSN_DYE_TURNS] = { { 0 } };

        turn[0][m] = -TURN;
        turn[1][m] = TURN;

        const struct gsn_dyes turned[2] = { gsn_dyes_turned(dyes, turn[0]),
                                            gsn_dyes_turned(dyes, turn[1]) };

        r = slope(od, mask, turned, none, stride, 2 * TURN, &red->by_turn[m], err);
    }
    for (int c = 0; c < 3 && r >= 0; c++) {
        const struct gsn_dyes same[2] = { *dyes, *dyes };
        double shift[2][3] = { { 0 } };

        shift[0][c] = -WHITE_OD;
        shift[1][c] = WHITE_OD;
        r = slope(od, mask, same, (const double(*)[3])shift, stride, 2 * WHITE_OD,
                  &red->by_white[c], err);
    }
    return r;
}

int gsn_red_mean(struct gsn_plane *const od[3], const struct gsn_image *mask,
                 const struct gsn_dyes *dyes, struct gsn_red_mean *ret_mean, struct gsn_error *err)
{
    static const double none[3] = { 0 };
    struct gsn_red_mean red = { 0 };
    struct total all;
    int r;

    for (int c = 1; c < 3; c++)
        if (od[c]->width != od[0]->width || od[c]->height != od[0]->height)
            return gsn_fail(err, GSN_E_INPUT, "the optical densities differ in size");
    if (mask && (mask->width != od[0]->width || mask->height != od[0]->height ||
                 mask->channels != 1 || mask->bits != 8))
        return gsn_fail(err, GSN_E_INPUT, "the mask is not an 8-bit grey image of %u x %u",
                        od[0]->width, od[0]->height);
    r = mean_of(od, mask, dyes, none, 1, &all, err);
    if (r < 0)
        return r;
    if (all.count == 0)
        return gsn_fail(err, GSN_E_STAIN, "there is no tissue to measure");
    red.mean = all.sum / (double)all.count;
    r = slopes(od, mask, dyes, all.count / MOST_FOR_SLOPES + 1, &red, err);
    if (r >= 0)
        *ret_mean = red;
    return r;
}

/* g' C g */
static double through(const double covariance[GSN_DYE_TURNS][GSN_DYE_TURNS],
                      const double g[GSN_DYE_TURNS])
{
    double sum = 0;

    for (int m = 0; m < GSN_DYE_TURNS; m++)
        for (int n = 0; n < GSN_DYE_TURNS; n++)
            sum += g[m] * covariance[m][n] * g[n];
    return sum;
}

double gsn_red_error(const struct gsn_red_mean *red, const struct gsn_dyes_fit *fit,
                     double white_od)
{
    double variance = through(fit->covariance, red->by_turn);

    for (int c = 0; c < 3; c++)
        variance += red->by_white[c] * white_od * red->by_white[c] * white_od;
    return sqrt(variance) / fabs(red->mean);
}
