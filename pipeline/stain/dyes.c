/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The most probable dye vectors of a sample: maximum a posteriori by Fisher scoring on the six
 * turns, with the classes of tissue refitted by expectation-maximisation in between.
 *
 * An amount a seen with noise s enters as z = log((a + sqrt(a^2 + 4 s^2)) / 2), which is log a
 * where a is well above the noise and stays finite where noise made it negative (Rocke and Durbin
 * 2003, 10.1093/bioinformatics/btg107). The classes are normal in the three z. */
#include "pipeline/stain/dyes_parts.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "pipeline/core/linalg.h"

#define RAD (M_PI / 180)
#define PRIOR_DEG 5.0
#define LONGEST_STEP (3 * RAD)
#define SETTLED (0.03 * RAD)
#define LEAST_APART_DEG 6.0 /* vectors of one dye seen twice lie nearer than that */

enum { ROUNDS = 30, REFITS = 3, HALVINGS = 6, MOST_PIXELS = 4000 };

/* In the first search, which tells how well the classes fit at their best, pixels count as so many
 * that know nothing of each other. */
static const double INDEPENDENT = 200;

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double a[3], const double b[3], double ret[3])
{
    for (int c = 0; c < 3; c++)
        ret[c] = a[(c + 1) % 3] * b[(c + 2) % 3] - a[(c + 2) % 3] * b[(c + 1) % 3];
}

static void unit(double v[3])
{
    const double length = sqrt(dot(v, v));

    for (int c = 0; c < 3; c++)
        v[c] /= length;
}

/* ---- turns ------------------------------------------------------------------------------- */

void gsn_dyes_ways(const double v[3], double ret_way[2][3])
{
    /* No dye, absorbing what it may, lies nearer than 45 degrees to this, so neighbouring vectors
     * have neighbouring ways. */
    static const double axis[3] = { M_SQRT1_2, -M_SQRT1_2, 0 };

    cross(v, axis, ret_way[0]);
    unit(ret_way[0]);
    cross(v, ret_way[0], ret_way[1]);
}

static void turn_one(const double v[3], const double turn[2], double ret[3])
{
    double way[2][3];

    gsn_dyes_ways(v, way);
    for (int c = 0; c < 3; c++)
        ret[c] = fmax(v[c] + turn[0] * way[0][c] + turn[1] * way[1][c], 0);
    unit(ret);
}

struct gsn_dyes gsn_dyes_turned(const struct gsn_dyes *dyes, const double turn[GSN_DYE_TURNS])
{
    struct gsn_dyes turned = *dyes;

    turn_one(dyes->red, &turn[0], turned.red);
    turn_one(dyes->yellow, &turn[2], turned.yellow);
    turn_one(dyes->dark, &turn[4], turned.dark);
    return turned;
}

int gsn_dyes_look_through(const struct gsn_dyes *dyes, const double turn[GSN_DYE_TURNS],
                          struct gsn_optics *ret)
{
    const struct gsn_dyes turned = gsn_dyes_turned(dyes, turn);
    const double *from[3] = { dyes->red, dyes->yellow, dyes->dark };
    const double *v[3] = { turned.red, turned.yellow, turned.dark };
    double det, way[2][3];

    for (int k = 0; k < 3; k++)
        cross(v[(k + 1) % 3], v[(k + 2) % 3], ret->inverse[k]);
    det = dot(v[0], ret->inverse[0]);
    for (int k = 0; k < 3; k++)
        for (int c = 0; c < 3; c++)
            ret->inverse[k][c] /= det;
    ret->log_det = log(fabs(det));
    for (int m = 0; m < GSN_DYE_TURNS; m++) {
        const int k = m / 2;
        double along;

        gsn_dyes_ways(from[k], way);
        along = dot(way[m % 2], v[k]);
        for (int c = 0; c < 3; c++)
            ret->slope[m][c] = way[m % 2][c] - along * v[k][c];
    }
    return fabs(det) > 1e-3;
}

/* ---- fit --------------------------------------------------------------------------------- */

static double objective(const struct gsn_dyes_search *s, const struct gsn_classes *classes,
                        const double turn[GSN_DYE_TURNS])
{
    struct gsn_optics optics;
    double sum;

    if (!gsn_dyes_look_through(s->dyes, turn, &optics))
        return -INFINITY;
    sum = s->weight * gsn_classes_likelihood(classes, s->sample, &optics);
    for (int m = 0; m < GSN_DYE_TURNS; m++)
        sum -= s->precision[m] * turn[m] * turn[m] / 2;
    return sum;
}

/* The objective at other turns, once the classes have followed there. */
static double objective_following(const struct gsn_dyes_search *s, const double turn[GSN_DYE_TURNS],
                                  struct gsn_classes *ret_classes)
{
    struct gsn_optics optics;

    if (!gsn_dyes_look_through(s->dyes, turn, &optics))
        return -INFINITY;
    *ret_classes = s->classes;
    for (int i = 0; i < REFITS; i++)
        gsn_classes_refit(ret_classes, s->sample, &optics);
    return objective(s, ret_classes, turn);
}

/* One Fisher step; returns the longest turn made in it. */
static double step(struct gsn_dyes_search *s, struct gsn_scores *scores)
{
    double a[GSN_DYE_TURNS * GSN_DYE_TURNS], b[GSN_DYE_TURNS], longest = 0;
    struct gsn_optics optics;

    (void)gsn_dyes_look_through(s->dyes, s->turn, &optics);
    gsn_classes_score(&s->classes, s->sample, &optics, scores);
    for (int m = 0; m < GSN_DYE_TURNS; m++) {
        for (int n = 0; n < GSN_DYE_TURNS; n++)
            a[m * GSN_DYE_TURNS + n] = s->weight * scores->information[m][n];
        a[m * GSN_DYE_TURNS + m] += s->precision[m];
        b[m] = s->weight * scores->total[m] - s->precision[m] * s->turn[m];
    }
    if (gsn_solve_spd(a, GSN_DYE_TURNS, GSN_DYE_TURNS, b) < 0)
        return 0;
    for (int m = 0; m < GSN_DYE_TURNS; m++)
        longest = fmax(longest, fabs(b[m]));

    double scale = fmin(1, LONGEST_STEP / longest);

    for (int i = 0; i < HALVINGS; i++, scale /= 2) {
        struct gsn_classes classes;
        double turn[GSN_DYE_TURNS], there;

        for (int m = 0; m < GSN_DYE_TURNS; m++)
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

static double angle_deg(const double a[3], const double b[3])
{
    return acos(fmin(dot(a, b), 1)) / RAD;
}

static int check_apart(const struct gsn_dyes *dyes, struct gsn_error *err)
{
    static const char *const names[3] = { "red", "yellow", "dark" };
    const double *v[3] = { dyes->red, dyes->yellow, dyes->dark };

    for (int k = 0; k < 3; k++) {
        const double apart = angle_deg(v[k], v[(k + 1) % 3]);

        if (!(apart > LEAST_APART_DEG))
            return gsn_fail(err, GSN_E_STAIN,
                            "the %s and the %s dye of this slide come out only %.1f degrees apart: "
                            "it shows one of them twice",
                            names[k], names[(k + 1) % 3], apart);
    }
    return GSN_OK;
}

static void describe(const struct gsn_dyes_prior *prior, struct gsn_dyes_fit *fit)
{
    const struct gsn_dyes *a = &prior->dyes, *b = &fit->dyes;

    fit->moved_deg[0] = angle_deg(a->red, b->red);
    fit->moved_deg[1] = angle_deg(a->yellow, b->yellow);
    fit->moved_deg[2] = angle_deg(a->dark, b->dark);
    for (int k = 0; k < 3; k++)
        fit->deviation_deg[k] =
            sqrt(fit->covariance[2 * k][2 * k] + fit->covariance[2 * k + 1][2 * k + 1]) / RAD;
}

/* How far the evidence for so many classes goes (Schwarz 1978): what they explain, less what their
 * unknowns would explain of chance. */
static double evidence(const struct gsn_dyes_search *s)
{
    const double unknowns = (double)gsn_classes_unknowns(&s->classes);

    return s->best - unknowns / 2 * log(s->weight * (double)s->sample->count);
}

static int search_with(size_t classes, struct gsn_dyes_search *s, struct gsn_scores *scores,
                       struct gsn_error *err)
{
    struct gsn_optics optics;

    if (!gsn_dyes_look_through(s->dyes, s->turn, &optics))
        return gsn_fail(err, GSN_E_STAIN, "the dyes of %s lie in one plane", s->dyes->name);
    gsn_classes_start(&s->classes, classes, s->sample, &optics);
    s->best = objective_following(s, s->turn, &s->classes);
    for (int i = 0; i < ROUNDS; i++)
        if (step(s, scores) < SETTLED && i > 2)
            break;
    return GSN_OK;
}

/* With as many classes as the evidence goes for. */
static int search_best(struct gsn_dyes_search *s, struct gsn_scores *scores, struct gsn_error *err)
{
    const struct gsn_dyes_search start = *s;
    int r = GSN_OK;

    for (size_t classes = 1; classes <= GSN_CLASSES && r >= 0; classes++) {
        struct gsn_dyes_search other = start;

        r = search_with(classes, &other, scores, err);
        if (r >= 0 && classes > 1 && !(evidence(&other) > evidence(s)))
            break;
        *s = other;
    }
    return r;
}

/* Twice: how well the classes fit where they fit best says what a pixel is worth. */
static int fit_turns(struct gsn_dyes_search *s, const struct gsn_dyes_prior *prior,
                     struct gsn_dyes_fit *ret_fit, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_scores) scores = gsn_alloc_array(1, sizeof *scores);
    struct gsn_dyes_fit fit = { .pixels = s->sample->count };
    struct gsn_dyes_search first = *s;
    int r;

    if (!scores)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the dyes of a slide");
    r = search_best(&first, scores, err);
    if (r < 0)
        return r;
    s->weight = gsn_dyes_weight(&first);
    r = search_best(s, scores, err);
    if (r < 0)
        return r;
    gsn_dyes_covariance(s, scores, fit.covariance);
    fit.dyes = gsn_dyes_turned(&prior->dyes, s->turn);
    fit.classes = s->classes.count;
    fit.strays = s->classes.strays;
    fit.worth = s->weight * (double)s->sample->count;
    (void)snprintf(fit.dyes.name, sizeof fit.dyes.name, "inferred-2");
    r = check_apart(&fit.dyes, err);
    if (r < 0)
        return r;
    describe(prior, &fit);
    *ret_fit = fit;
    return GSN_OK;
}

/* gives: an even choice of the pixels. */
static int thin(const struct gsn_stain_sample *sample, struct gsn_stain_sample **ret_few,
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
    struct gsn_dyes_search search = { .dyes = &prior->dyes };
    int r;

    if (sample->count < GSN_SAMPLE_LEAST)
        return gsn_fail(err, GSN_E_STAIN,
                        "only %zu pixels are stained; at least %d are needed to tell the dyes",
                        sample->count, GSN_SAMPLE_LEAST);
    r = thin(sample, &few, err);
    if (r < 0)
        return r;
    search.sample = few;
    search.weight = fmin(1, INDEPENDENT / (double)few->count);
    for (int m = 0; m < GSN_DYE_TURNS; m++)
        search.precision[m] =
            1 / (prior->deviation_deg[m / 2] * RAD * prior->deviation_deg[m / 2] * RAD);
    return fit_turns(&search, prior, ret_fit, err);
}

struct gsn_dyes_prior gsn_dyes_prior_builtin(enum gsn_light light)
{
    struct gsn_dyes_prior prior = { .dyes = gsn_dyes_builtin(),
                                    .deviation_deg = { PRIOR_DEG, PRIOR_DEG, PRIOR_DEG } };

    prior.dyes.light = light;
    return prior;
}

struct gsn_dyes_fit gsn_dyes_as_stated(const struct gsn_dyes_prior *prior)
{
    struct gsn_dyes_fit fit = { .dyes = prior->dyes };

    for (int m = 0; m < GSN_DYE_TURNS; m++)
        fit.covariance[m][m] =
            prior->deviation_deg[m / 2] * RAD * prior->deviation_deg[m / 2] * RAD;
    describe(prior, &fit);
    return fit;
}
