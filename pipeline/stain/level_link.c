/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/classes.h"
#include "pipeline/core/linalg.h"
#include "pipeline/stain/level_tissues.h"

#include <math.h>
#include <string.h>

enum { KINDS = GSN_LEVEL_TISSUES };

/* What animals of one kind are taken to differ by in tissue that nobody treated: of its density,
 * and in density by the cells in it, whose nuclei are neither red nor yellow. Nobody has measured
 * either; a study's own controls will. */
static const double ANIMALS = 0.02, CELLS = 0.005;
/* Two or three tissues tell a variance badly: where they differ by more than their errors, the
 * difference is rather believed than halved. */
static const double GENEROUS = 4;
/* Baths that are even still differ: less than this is not worth a name. */
static const struct gsn_level LEAST_SPREAD = { 1e-3, 5e-4 };

/* The tissues that both show. */
struct pairs {
    size_t count;
    double here[KINDS], there[KINDS];
    double covariance[KINDS * KINDS]; /* of their differences; count x count */
};

static void pair_up(const struct gsn_level_tissues *here, const struct gsn_level_tissues *there,
                    struct pairs *p)
{
    size_t kind[KINDS];

    *p = (struct pairs){ 0 };
    for (size_t t = 0; t < KINDS; t++)
        if (!isnan(here->value[t]) && !isnan(there->value[t])) {
            p->here[p->count] = here->value[t];
            p->there[p->count] = there->value[t];
            kind[p->count++] = t;
        }
    for (size_t i = 0; i < p->count; i++)
        for (size_t j = 0; j < p->count; j++) {
            const double animals = ANIMALS * p->there[i];

            p->covariance[i * p->count + j] =
                here->covariance[kind[i]][kind[j]] + there->covariance[kind[i]][kind[j]] +
                (i == j ? 2 * (animals * animals + CELLS * CELLS) : 0);
        }
}

/* How many times spread, squared, the tissues' differences allow for; 1 at least. */
static double widening(const struct pairs *p, const struct gsn_level *spread)
{
    double excess = 0, expected = 0;

    for (size_t i = 0; i < p->count; i++) {
        const double v = p->covariance[i * p->count + i];
        const double d = p->here[i] - p->there[i], g = spread->gain * p->there[i];

        excess += d * d / v - 1;
        expected += (g * g + spread->offset * spread->offset) / v;
    }
    return expected > 0 ? fmax(1, GENEROUS * excess / expected) : 1;
}

/* x becomes covariance^-1 x. */
static int divide(const struct pairs *p, double x[KINDS])
{
    double covariance[KINDS * KINDS];

    memcpy(covariance, p->covariance, sizeof covariance);
    return gsn_solve_spd(covariance, p->count, p->count, x) == 0;
}

/* Generalised least squares of the differences by a straight line, whose gain and offset have these
 * variances beforehand. */
static int fit_line(const struct pairs *p, const double prior[2], struct gsn_level_link *link)
{
    double slope[KINDS] = { 0 }, one[KINDS] = { 0 };
    double n00 = 1 / prior[0], n01 = 0, n11 = 1 / prior[1], r0 = 0, r1 = 0, det;

    for (size_t i = 0; i < p->count; i++) {
        slope[i] = p->there[i];
        one[i] = 1;
    }
    if (!divide(p, slope) || !divide(p, one))
        return 0;
    for (size_t i = 0; i < p->count; i++) {
        const double off = p->here[i] - p->there[i];

        n00 += slope[i] * p->there[i];
        n01 += one[i] * p->there[i];
        n11 += one[i];
        r0 += slope[i] * off;
        r1 += one[i] * off;
    }
    det = n00 * n11 - n01 * n01;
    *link = (struct gsn_level_link){ .gain = 1 + (n11 * r0 - n01 * r1) / det,
                                     .offset = (n00 * r1 - n01 * r0) / det,
                                     .covariance = { n11 / det, -n01 / det, n00 / det },
                                     .tissues = p->count };
    return 1;
}

static double disagreement(const struct pairs *p, const struct gsn_level_link *link)
{
    double off[KINDS] = { 0 }, scaled[KINDS] = { 0 }, sum = 0;

    for (size_t i = 0; i < p->count; i++)
        off[i] = scaled[i] = p->here[i] - link->gain * p->there[i] - link->offset;
    (void)divide(p, scaled); /* as the fit did */
    for (size_t i = 0; i < p->count; i++)
        sum += off[i] * scaled[i] / (double)p->count;
    return sqrt(fmax(0, sum));
}

int gsn_level_between(const struct gsn_level_tissues *here, const struct gsn_level_tissues *there,
                      const struct gsn_level *spread, struct gsn_level_link *ret_link,
                      struct gsn_error *err)
{
    const struct gsn_level least = { fmax(spread->gain, LEAST_SPREAD.gain),
                                     fmax(spread->offset, LEAST_SPREAD.offset) };
    struct gsn_level_link link;
    struct pairs pairs;
    double wide;

    pair_up(here, there, &pairs);
    if (pairs.count < 2)
        return gsn_fail(err, GSN_E_STAIN,
                        "the two specimens share %zu kind%s of untreated tissue, two are needed to "
                        "compare their stain",
                        pairs.count, pairs.count == 1 ? "" : "s");
    wide = widening(&pairs, &least);
    if (!fit_line(
            &pairs,
            (const double[]){ wide * least.gain * least.gain, wide * least.offset * least.offset },
            &link))
        return gsn_fail(err, GSN_E_STAIN,
                        "the errors of the untreated tissues contradict each other, so the stain "
                        "of the two specimens cannot be compared");
    link.disagreement = disagreement(&pairs, &link);
    *ret_link = link;
    return GSN_OK;
}

double gsn_level_link_error(const struct gsn_level_link *link, double density)
{
    const double *c = link->covariance;

    return sqrt(fmax(0, density * density * c[0] + 2 * density * c[1] + c[2]));
}
