/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Colour deconvolution (Ruifrok and Johnston 2001) with amounts that are not negative: min
 * |V a - d|^2 with a >= 0 for three dyes.
 *
 * The minimum is the plain least-squares solution on the dyes it uses, and every such solution
 * without a negative amount is allowed; so the best of the at most eight is exact (the exhaustive
 * form of Lawson and Hanson's NNLS). The residual is |d|^2 - a.b with b = V' d: the largest a.b
 * wins. The inverses of the Gram matrices of all subsets are made once.
 *
 * Two dyes less than 0.6 degrees apart, or three that lie in one plane, are refused. Planes are cut
 * into bands of rows for the threads; results do not depend on how many there are. */
#include "pipeline/stain/unmixing.h"

#include "pipeline/core/geom.h"
#include "pipeline/core/parallel.h"
#include "pipeline/stain/optical_density.h"

#include <math.h>
#include <string.h>

/* Below this sine of an angle between two dyes (0.6 degrees) the amounts mean nothing. */
#define LEAST_SINE 0.01

static int invert_pair(struct gsn_unmixer *mix, int i, int j, struct gsn_error *err)
{
    const double g = gsn_dot3(mix->dye[i], mix->dye[j]), det = 1 - g * g;
    double(*into)[3] = mix->inverse[1 << i | 1 << j];

    if (det < LEAST_SINE * LEAST_SINE)
        return gsn_fail(err, GSN_E_STAIN, "two of the three dyes have nearly the same colour");
    into[i][i] = into[j][j] = 1 / det;
    into[i][j] = into[j][i] = -g / det;
    return GSN_OK;
}

static int invert_all(struct gsn_unmixer *mix, struct gsn_error *err)
{
    const double a = gsn_dot3(mix->dye[0], mix->dye[1]), b = gsn_dot3(mix->dye[0], mix->dye[2]),
                 c = gsn_dot3(mix->dye[1], mix->dye[2]);
    const double det = 1 + 2 * a * b * c - a * a - b * b - c * c;
    double(*into)[3] = mix->inverse[7];

    /* The determinant is the squared volume the three span. */
    if (det < LEAST_SINE * LEAST_SINE)
        return gsn_fail(err, GSN_E_STAIN,
                        "the three dyes lie in one plane, so one of them could be "
                        "made of the other two");
    into[0][0] = (1 - c * c) / det;
    into[1][1] = (1 - b * b) / det;
    into[2][2] = (1 - a * a) / det;
    into[0][1] = into[1][0] = (b * c - a) / det;
    into[0][2] = into[2][0] = (a * c - b) / det;
    into[1][2] = into[2][1] = (a * b - c) / det;
    return GSN_OK;
}

int gsn_unmixer_init(struct gsn_unmixer *mix, const struct gsn_dyes *dyes, struct gsn_error *err)
{
    int r = GSN_OK;

    memset(mix, 0, sizeof *mix);
    memcpy(mix->dye[0], dyes->red, sizeof dyes->red);
    memcpy(mix->dye[1], dyes->yellow, sizeof dyes->yellow);
    memcpy(mix->dye[2], dyes->dark, sizeof dyes->dark);
    for (int i = 0; i < 3; i++) {
        if (!(fabs(gsn_dot3(mix->dye[i], mix->dye[i]) - 1) < 1e-6))
            return gsn_fail(err, GSN_E_STAIN, "dye %d of %s is not a vector of length 1", i + 1,
                            dyes->name);
        mix->inverse[1 << i][i][i] = 1;
    }
    if (!(dyes->full_red_od > 0))
        return gsn_fail(err, GSN_E_STAIN, "%s says no red density that counts as full", dyes->name);
    for (int i = 0; i < 3 && r >= 0; i++)
        r = invert_pair(mix, i, (i + 1) % 3, err);
    return r < 0 ? r : invert_all(mix, err);
}

void gsn_unmixer_apply(const struct gsn_unmixer *mix, const double od[3], double ret_amount[3])
{
    const double b[3] = { gsn_dot3(mix->dye[0], od), gsn_dot3(mix->dye[1], od),
                          gsn_dot3(mix->dye[2], od) };
    double best = 0;

    ret_amount[0] = ret_amount[1] = ret_amount[2] = 0;
    for (int subset = 7; subset > 0; subset--) {
        const double(*inverse)[3] = mix->inverse[subset];
        const double a[3] = { gsn_dot3(inverse[0], b), gsn_dot3(inverse[1], b),
                              gsn_dot3(inverse[2], b) };

        if (a[0] < 0 || a[1] < 0 || a[2] < 0 || gsn_dot3(a, b) <= best)
            continue;
        best = gsn_dot3(a, b);
        memcpy(ret_amount, a, sizeof a);
        if (subset == 7) /* nothing beats the unconstrained minimum */
            return;
    }
}

double gsn_unmixer_left(const struct gsn_unmixer *mix, const double od[3])
{
    double amount[3], left = 0;

    gsn_unmixer_apply(mix, od, amount);
    for (int c = 0; c < 3; c++) {
        const double d = od[c] - amount[0] * mix->dye[0][c] - amount[1] * mix->dye[1][c] -
                         amount[2] * mix->dye[2][c];

        left += d * d;
    }
    return sqrt(left);
}

int gsn_unmix_one(const double od[3], const struct gsn_dyes *dyes, double ret_amount[3],
                  struct gsn_error *err)
{
    struct gsn_unmixer mix;
    const int r = gsn_unmixer_init(&mix, dyes, err);

    if (r >= 0)
        gsn_unmixer_apply(&mix, od, ret_amount);
    return r;
}

/* ---- planes ------------------------------------------------------------------------------ */

/* Rows handed to a thread at once: enough to outweigh the hand-over. */
enum { ROWS = 32 };

static size_t count_bands(uint32_t height)
{
    return ((size_t)height + ROWS - 1) / ROWS;
}

static uint32_t band_end(size_t band, uint32_t height)
{
    const size_t end = (band + 1) * ROWS;

    return end < height ? (uint32_t)end : height;
}

struct unmix_work {
    const struct gsn_unmixer *mix;
    struct gsn_plane *const *od;
    struct gsn_plane *out[3]; /* NULL where not wanted */
    double full_red_od;
};

static int unmix_band(size_t band, void *context, struct gsn_error *err)
{
    const struct unmix_work *work = context;
    const size_t width = work->od[0]->width;
    const size_t end = width * band_end(band, work->od[0]->height);

    (void)err;
    for (size_t i = width * band * ROWS; i < end; i++) {
        const double od[3] = { work->od[0]->value[i], work->od[1]->value[i],
                               work->od[2]->value[i] };
        double amount[3];

        gsn_unmixer_apply(work->mix, od, amount);
        amount[0] /= work->full_red_od;
        for (int k = 0; k < 3; k++)
            if (work->out[k])
                work->out[k]->value[i] = (float)amount[k];
    }
    return GSN_OK;
}

int gsn_unmix(struct gsn_plane *const od[3], const struct gsn_dyes *dyes, unsigned threads,
              struct gsn_plane **ret_red, struct gsn_plane **ret_yellow,
              struct gsn_plane **ret_dark, struct gsn_error *err)
{
    const uint32_t width = od[0]->width, height = od[0]->height;
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    gsn_auto(gsn_plane) dark = NULL;
    struct gsn_unmixer mix;
    int r;

    r = gsn_od_check(od, NULL, err);
    if (r >= 0)
        r = gsn_unmixer_init(&mix, dyes, err);
    if (r >= 0)
        r = gsn_plane_new(width, height, &red, err);
    if (r >= 0 && ret_yellow)
        r = gsn_plane_new(width, height, &yellow, err);
    if (r >= 0 && ret_dark)
        r = gsn_plane_new(width, height, &dark, err);
    if (r < 0)
        return r;

    struct unmix_work work = { &mix, od, { red, yellow, dark }, dyes->full_red_od };

    r = gsn_parallel_for(count_bands(height), threads, unmix_band, &work, err);
    if (r < 0)
        return r;
    *ret_red = gsn_steal(&red);
    if (ret_yellow)
        *ret_yellow = gsn_steal(&yellow);
    if (ret_dark)
        *ret_dark = gsn_steal(&dark);
    return GSN_OK;
}
