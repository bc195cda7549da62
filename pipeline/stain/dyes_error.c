/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How well the pixels of a slide tell its dye vectors. */
#include "pipeline/stain/dyes_parts.h"

#include <math.h>
#include <string.h>

#include "pipeline/core/linalg.h"

enum { N = GSN_DYE_TURNS };

/* A model that is d nats per pixel off the truth puts an unknown off by up to sqrt(2 d) of what one
 * pixel tells it to, however many pixels there are. One direction shows d, and there are three
 * amounts. */
static const double MISFIT_SHARES = 6;

/* For the second derivatives: about what the vectors are known to, so that the curvature is the one
 * over that reach. */
#define REACH (2 * M_PI / 180)

enum { REFITS = 8 };

/* Tissue is no mixture of log-normal classes, so many pixels are off together. Each counts by so
 * much that all of them tell no more than the misfit lets them (the coarsened posterior of Miller
 * and Dunson 2019, 10.1080/01621459.2018.1469995). */
double gsn_dyes_weight(const struct gsn_dyes_search *search)
{
    struct gsn_optics optics;
    double misfit;

    (void)gsn_dyes_look_through(search->dyes, search->turn, &optics);
    misfit = gsn_classes_misfit(&search->classes, search->sample, &optics);
    return 1 / (1 + MISFIT_SHARES * misfit * (double)search->sample->count);
}

/* Slopes of the likelihood at other turns, the classes following. */
static void slopes_at(const struct gsn_dyes_search *s, const double turn[N],
                      struct gsn_scores *scores)
{
    struct gsn_classes classes = s->classes;
    struct gsn_optics optics;

    (void)gsn_dyes_look_through(s->dyes, turn, &optics);
    for (int i = 0; i < REFITS; i++)
        gsn_classes_refit(&classes, s->sample, &optics);
    gsn_classes_score(&classes, s->sample, &optics, scores);
}

/* What the pixels add to the prior's precision, in units of that. */
static void curvature(const struct gsn_dyes_search *s, struct gsn_scores *scores, double ret[N][N])
{
    double bend[N][N];

    for (int n = 0; n < N; n++) {
        double side[2][N];

        for (int way = 0; way < 2; way++) {
            double turn[N];

            memcpy(turn, s->turn, sizeof turn);
            turn[n] += way ? REACH : -REACH;
            slopes_at(s, turn, scores);
            memcpy(side[way], scores->total, sizeof side[way]);
        }
        for (int m = 0; m < N; m++)
            bend[m][n] = (side[0][m] - side[1][m]) / (2 * REACH);
    }
    for (int m = 0; m < N; m++)
        for (int n = 0; n < N; n++)
            ret[m][n] =
                s->weight * (bend[m][n] + bend[n][m]) / 2 / sqrt(s->precision[m] * s->precision[n]);
}

/* Where the likelihood bends the wrong way, the pixels tell nothing. */
void gsn_dyes_covariance(const struct gsn_dyes_search *s, struct gsn_scores *scores,
                         double ret_covariance[N][N])
{
    double told[N][N], value[N], axis[N][N];

    curvature(s, scores, told);
    gsn_eigen_symmetric(&told[0][0], N, value, &axis[0][0]);
    for (int m = 0; m < N; m++)
        for (int n = 0; n < N; n++) {
            double sum = 0;

            for (int k = 0; k < N; k++)
                sum += axis[m][k] * axis[n][k] / (1 + fmax(value[k], 0));
            ret_covariance[m][n] = sum / sqrt(s->precision[m] * s->precision[n]);
        }
}
