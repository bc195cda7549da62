/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/unmix.h"

#include <math.h>
#include <string.h>

/* Unmixing: min |V a - d|^2 with a >= 0 for three dyes. The minimum is the plain least-squares
 * solution on the dyes it uses, and every such solution without a negative amount is allowed; so
 * the best of the at most eight is exact. The residual is |d|^2 - a.b with b = V' d: the largest
 * a.b wins. */

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Below this sine of an angle between two dyes (0.6 degrees) the amounts mean nothing. */
#define LEAST_SINE 0.01

static int invert_pair(struct gsn_unmixer *mix, int i, int j, struct gsn_error *err)
{
    const double g = dot(mix->dye[i], mix->dye[j]), det = 1 - g * g;
    double(*into)[3] = mix->inverse[1 << i | 1 << j];

    if (det < LEAST_SINE * LEAST_SINE)
        return gsn_fail(err, GSN_E_STAIN, "two of the three dyes have nearly the same colour");
    into[i][i] = into[j][j] = 1 / det;
    into[i][j] = into[j][i] = -g / det;
    return GSN_OK;
}

static int invert_all(struct gsn_unmixer *mix, struct gsn_error *err)
{
    const double a = dot(mix->dye[0], mix->dye[1]), b = dot(mix->dye[0], mix->dye[2]),
                 c = dot(mix->dye[1], mix->dye[2]);
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
        if (!(fabs(dot(mix->dye[i], mix->dye[i]) - 1) < 1e-6))
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
    const double b[3] = { dot(mix->dye[0], od), dot(mix->dye[1], od), dot(mix->dye[2], od) };
    double best = 0;

    ret_amount[0] = ret_amount[1] = ret_amount[2] = 0;
    for (int subset = 7; subset > 0; subset--) {
        const double(*inverse)[3] = mix->inverse[subset];
        const double a[3] = { dot(inverse[0], b), dot(inverse[1], b), dot(inverse[2], b) };

        if (a[0] < 0 || a[1] < 0 || a[2] < 0 || dot(a, b) <= best)
            continue;
        best = dot(a, b);
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
