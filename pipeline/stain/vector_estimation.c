/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The most probable stain vectors of a sample: maximum a posteriori by Fisher scoring on the six
 * turns, with the classes of tissue (mixture.h) refitted by expectation-maximisation in between.
 *
 *   1. With one, two, three classes: Fisher steps, halved until the objective rises, until no turn
 *      moves by 0.03 degrees. As many classes stay as the evidence goes for (Schwarz 1978).
 *   2. How far the classes are from the pixels where they fit best says what a pixel is worth
 *      (the coarsened posterior of Miller and Dunson 2019, 10.1080/01621459.2018.1469995): a model
 *      that is d nats off tells no more, however many pixels there are. Step 1 again with that.
 *   3. The covariance is that of Laplace's approximation: the curvature over two degrees, by
 *      differences of the scores. Where the likelihood bends the wrong way the pixels tell nothing
 *      and the prior's width stays.
 *
 * Fails below 1000 pixels, and where two dyes come out less than 6 degrees apart. Of large samples
 * 4000 pixels are taken. */
#include "pipeline/stain/vector_estimation.h"

#include "pipeline/core/geom.h"
#include "pipeline/core/linalg.h"
#include "pipeline/core/mem.h"
#include "pipeline/stain/mixture.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define LONGEST_STEP (3 * GSN_RADIANS)
#define SETTLED (0.03 * GSN_RADIANS)

enum { ROUNDS = 30, REFITS = 3, HALVINGS = 6, MOST_PIXELS = 4000 };

/* In the first search, which tells how well the classes fit at their best, pixels count as so many
 * that know nothing of each other. */
static const double INDEPENDENT = 200;

struct vector_search {
    const struct gsn_stain_sample *sample;
    const struct gsn_dyes *dyes; /* the prior's */
    double precision[GSN_DYE_ROTATIONS];
    double turn[GSN_DYE_ROTATIONS];
    struct gsn_mixture classes;
    double weight; /* of each pixel */
    double best;   /* the objective here */
};

/* ---- what the pixels tell ---------------------------------------------------------------- */

/* A model that is d nats per pixel off the truth puts an unknown off by up to sqrt(2 d) of what one
 * pixel tells it to, however many pixels there are. One direction shows d, and there are three
 * amounts. */
static const double MISFIT_SHARES = 6;

/* For the second derivatives: about what the vectors are known to, so that the curvature is the one
 * over that reach. */
#define REACH (2 * M_PI / 180)

enum { SLOPE_REFITS = 8 };

/* What each pixel of a sample is worth whose best classes at any turns are those of the search. */
/* Tissue is no mixture of log-normal classes, so many pixels are off together. Each counts by so
 * much that all of them tell no more than the misfit lets them (the coarsened posterior of Miller
 * and Dunson 2019, 10.1080/01621459.2018.1469995). */
static double weigh_pixel(const struct vector_search *search)
{
    struct gsn_dyes_inverse optics;
    double misfit;

    (void)gsn_dyes_invert(search->dyes, search->turn, &optics);
    misfit = gsn_mixture_misfit(&search->classes, search->sample, &optics);
    return 1 / (1 + MISFIT_SHARES * misfit * (double)search->sample->count);
}

/* Slopes of the likelihood at other turns, the classes following. */
static void slopes_at(const struct vector_search *s, const double turn[GSN_DYE_ROTATIONS],
                      struct gsn_mixture_scores *scores)
{
    struct gsn_mixture classes = s->classes;
    struct gsn_dyes_inverse optics;

    (void)gsn_dyes_invert(s->dyes, turn, &optics);
    for (int i = 0; i < SLOPE_REFITS; i++)
        gsn_mixture_refit(&classes, s->sample, &optics);
    gsn_mixture_score(&classes, s->sample, &optics, scores);
}

/* What the pixels add to the prior's precision, in units of that. */
static void find_curvature(const struct vector_search *s, struct gsn_mixture_scores *scores,
                           double ret[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS])
{
    double bend[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS];

    for (int n = 0; n < GSN_DYE_ROTATIONS; n++) {
        double side[2][GSN_DYE_ROTATIONS];

        for (int way = 0; way < 2; way++) {
            double turn[GSN_DYE_ROTATIONS];

            memcpy(turn, s->turn, sizeof turn);
            turn[n] += way ? REACH : -REACH;
            slopes_at(s, turn, scores);
            memcpy(side[way], scores->total, sizeof side[way]);
        }
        for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
            bend[m][n] = (side[0][m] - side[1][m]) / (2 * REACH);
    }
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
        for (int n = 0; n < GSN_DYE_ROTATIONS; n++)
            ret[m][n] =
                s->weight * (bend[m][n] + bend[n][m]) / 2 / sqrt(s->precision[m] * s->precision[n]);
}

/* Of the turns found, rad^2; never wider than the prior. scores: scratch. */
/* Where the likelihood bends the wrong way, the pixels tell nothing. */
static void find_covariance(const struct vector_search *s, struct gsn_mixture_scores *scores,
                            double ret_covariance[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS])
{
    double told[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS], value[GSN_DYE_ROTATIONS],
        axis[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS];

    find_curvature(s, scores, told);
    gsn_eigen_symmetric(&told[0][0], GSN_DYE_ROTATIONS, value, &axis[0][0]);
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
        for (int n = 0; n < GSN_DYE_ROTATIONS; n++) {
            double sum = 0;

            for (int k = 0; k < GSN_DYE_ROTATIONS; k++)
                sum += axis[m][k] * axis[n][k] / (1 + fmax(value[k], 0));
            ret_covariance[m][n] = sum / sqrt(s->precision[m] * s->precision[n]);
        }
}

/* ---- the search -------------------------------------------------------------------------- */

static double objective_at(const struct vector_search *s, const struct gsn_mixture *classes,
                           const double turn[GSN_DYE_ROTATIONS])
{
    struct gsn_dyes_inverse optics;
    double sum;

    if (!gsn_dyes_invert(s->dyes, turn, &optics))
        return -INFINITY;
    sum = s->weight * gsn_mixture_likelihood(classes, s->sample, &optics);
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
        sum -= s->precision[m] * turn[m] * turn[m] / 2;
    return sum;
}

/* The objective at other turns, once the classes have followed there. */
static double objective_following(const struct vector_search *s,
                                  const double turn[GSN_DYE_ROTATIONS],
                                  struct gsn_mixture *ret_classes)
{
    struct gsn_dyes_inverse optics;

    if (!gsn_dyes_invert(s->dyes, turn, &optics))
        return -INFINITY;
    *ret_classes = s->classes;
    for (int i = 0; i < REFITS; i++)
        gsn_mixture_refit(ret_classes, s->sample, &optics);
    return objective_at(s, ret_classes, turn);
}

/* One Fisher step; returns the longest turn made in it. */
static double take_fisher_step(struct vector_search *s, struct gsn_mixture_scores *scores)
{
    double a[GSN_DYE_ROTATIONS * GSN_DYE_ROTATIONS], b[GSN_DYE_ROTATIONS], longest = 0;
    struct gsn_dyes_inverse optics;

    (void)gsn_dyes_invert(s->dyes, s->turn, &optics);
    gsn_mixture_score(&s->classes, s->sample, &optics, scores);
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++) {
        for (int n = 0; n < GSN_DYE_ROTATIONS; n++)
            a[m * GSN_DYE_ROTATIONS + n] = s->weight * scores->information[m][n];
        a[m * GSN_DYE_ROTATIONS + m] += s->precision[m];
        b[m] = s->weight * scores->total[m] - s->precision[m] * s->turn[m];
    }
    if (gsn_solve_spd(a, GSN_DYE_ROTATIONS, GSN_DYE_ROTATIONS, b) < 0)
        return 0;
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
        longest = fmax(longest, fabs(b[m]));

    double scale = fmin(1, LONGEST_STEP / longest);

    for (int i = 0; i < HALVINGS; i++, scale /= 2) {
        struct gsn_mixture classes;
        double turn[GSN_DYE_ROTATIONS], there;

        for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
            turn[m] = s->turn[m] + scale * b[m];
        there = objective_following(s, turn, &classes);
        if (there > s->best) {
            memcpy(s->turn, turn, sizeof turn);
            s->classes = classes;
            s->best = there;
            return scale * longest;
        }
    }
    return 0;
}

/* How far the evidence for so many classes goes (Schwarz 1978): what they explain, less what their
 * unknowns would explain of chance. */
static double evidence_of(const struct vector_search *s)
{
    const double unknowns = (double)gsn_mixture_unknowns(&s->classes);

    return s->best - unknowns / 2 * log(s->weight * (double)s->sample->count);
}

static int search_with(size_t classes, struct vector_search *s, struct gsn_mixture_scores *scores,
                       struct gsn_error *err)
{
    struct gsn_dyes_inverse optics;

    if (!gsn_dyes_invert(s->dyes, s->turn, &optics))
        return gsn_fail(err, GSN_E_STAIN, "the dyes of %s lie in one plane", s->dyes->name);
    gsn_mixture_start(&s->classes, classes, s->sample, &optics);
    s->best = objective_following(s, s->turn, &s->classes);
    for (int i = 0; i < ROUNDS; i++)
        if (take_fisher_step(s, scores) < SETTLED && i > 2)
            break;
    return GSN_OK;
}

/* With as many classes as the evidence goes for. */
static int search_best(struct vector_search *s, struct gsn_mixture_scores *scores,
                       struct gsn_error *err)
{
    const struct vector_search start = *s;
    int r = GSN_OK;

    for (size_t classes = 1; classes <= GSN_MIXTURE_CLASSES && r >= 0; classes++) {
        struct vector_search other = start;

        r = search_with(classes, &other, scores, err);
        if (r >= 0 && classes > 1 && !(evidence_of(&other) > evidence_of(s)))
            break;
        *s = other;
    }
    return r;
}

/* ---- the fit ----------------------------------------------------------------------------- */

static int check_apart(const struct gsn_dyes *dyes, struct gsn_error *err)
{
    static const char *const names[3] = { "red", "yellow", "dark" };
    const double *v[3] = { dyes->red, dyes->yellow, dyes->dark };

    for (int k = 0; k < 3; k++) {
        const double apart = gsn_dyes_angle_deg(v[k], v[(k + 1) % 3]);

        if (!(apart > GSN_DYES_APART_DEG))
            return gsn_fail(err, GSN_E_STAIN,
                            "the %s and the %s dye of this slide come out only %.1f degrees apart: "
                            "it shows one of them twice",
                            names[k], names[(k + 1) % 3], apart);
    }
    return GSN_OK;
}

/* Twice: how well the classes fit where they fit best says what a pixel is worth. */
static int fit_turns(struct vector_search *s, const struct gsn_dyes_prior *prior,
                     struct gsn_dyes_fit *ret_fit, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_mixture_scores) scores = gsn_alloc_array(1, sizeof *scores);
    struct gsn_dyes_fit fit = { .pixels = s->sample->count };
    struct vector_search first = *s;
    int r;

    if (!scores)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the dyes of a slide");
    r = search_best(&first, scores, err);
    if (r < 0)
        return r;
    s->weight = weigh_pixel(&first);
    r = search_best(s, scores, err);
    if (r < 0)
        return r;
    find_covariance(s, scores, fit.covariance);
    fit.dyes = gsn_dyes_rotated(&prior->dyes, s->turn);
    fit.classes = s->classes.count;
    fit.strays = s->classes.strays;
    fit.worth = s->weight * (double)s->sample->count;
    (void)snprintf(fit.dyes.name, sizeof fit.dyes.name, "inferred-2");
    r = check_apart(&fit.dyes, err);
    if (r < 0)
        return r;
    gsn_dyes_describe(prior, &fit);
    *ret_fit = fit;
    return GSN_OK;
}

/* gives: an even choice of the pixels. */
static int thin_sample(const struct gsn_stain_sample *sample, struct gsn_stain_sample **ret_few,
                       struct gsn_error *err)
{
    const size_t stride = (sample->count + MOST_PIXELS - 1) / MOST_PIXELS;
    gsn_auto(gsn_stain_sample) few = NULL;
    int r = gsn_stain_sample_new(&few, err);

    if (r < 0)
        return r;
    few->pixel = gsn_alloc_array(sample->count / stride + 1, sizeof *few->pixel);
    if (!few->pixel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the dyes of a slide");
    for (size_t i = 0; i < sample->count; i += stride)
        few->pixel[few->count++] = sample->pixel[i];
    *ret_few = gsn_steal(&few);
    return GSN_OK;
}

int gsn_dyes_estimate(const struct gsn_stain_sample *sample, const struct gsn_dyes_prior *prior,
                      struct gsn_dyes_fit *ret_fit, struct gsn_error *err)
{
    gsn_auto(gsn_stain_sample) few = NULL;
    struct vector_search search = { .dyes = &prior->dyes };
    int r;

    if (sample->count < GSN_SAMPLE_LEAST)
        return gsn_fail(err, GSN_E_STAIN,
                        "only %zu pixels are stained; at least %d are needed to tell the dyes",
                        sample->count, GSN_SAMPLE_LEAST);
    r = thin_sample(sample, &few, err);
    if (r < 0)
        return r;
    search.sample = few;
    search.weight = fmin(1, INDEPENDENT / (double)few->count);
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
        search.precision[m] = 1 / (prior->deviation_deg[m / 2] * GSN_RADIANS *
                                   prior->deviation_deg[m / 2] * GSN_RADIANS);
    return fit_turns(&search, prior, ret_fit, err);
}
