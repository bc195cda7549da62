/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_search.h"

#include <math.h>
#include <string.h>

enum {
    NEAR = GSN_SEQUENCE_NEAR,
    SIDE = GSN_SEQUENCE_SIDE,
    EVERY = GSN_SEQUENCE_EVERY,
    SUSPECTS = 8
};

/* Two planes' cells differ by no more than this, in standard deviations of one's noise. */
static const double MOST = 3;

size_t gsn_sequence_apart(size_t a, size_t b)
{
    return a > b ? a - b : b - a;
}

/* Planes up to SIDE from either place are laid again with it, and as many more look at them. */
static int concerns(size_t i, size_t f, const size_t place[2])
{
    for (int k = 0; k < 2; k++)
        if (gsn_sequence_apart(i, place[k]) <= 2 * SIDE + 1 ||
            gsn_sequence_apart(i + f, place[k]) <= 2 * SIDE + 1)
            return 1;
    return 0;
}

void gsn_sequence_compare_near(struct gsn_sequence_search *a, const size_t place[2])
{
    const size_t n = a->t->n;

    for (size_t i = 0; i < n; i++)
        for (size_t f = 1; f <= NEAR && i + f < n; f++)
            if (!place || concerns(i, f, place))
                a->near[i * NEAR + f - 1] = gsn_sequence_change_between(a->t, i, i + f);
}

size_t gsn_sequence_sample(const struct gsn_sequence_tissue *t)
{
    return (t->columns * t->rows + EVERY - 1) / EVERY;
}

/* The line through the sections around a place, itself left out, and where it tells. */
static struct gsn_sequence_line foretell(const struct gsn_sequence_tissue *t, size_t place,
                                         float *ret_sample)
{
    const struct gsn_sequence_line line =
        gsn_sequence_line_at(t->z, t->n, place, place, t->z[place]);

    memset(t->told, 1, gsn_sequence_sample(t));
    gsn_sequence_foretell(t, &line, place, EVERY, ret_sample, t->told);
    return line;
}

/* The plane at a place, and how much each cell counts. */
static void take(const struct gsn_sequence_tissue *t, size_t place, float *ret_sample,
                 float *ret_weight)
{
    const size_t first = t->place[place] * t->columns * t->rows, sample = gsn_sequence_sample(t);

    for (size_t c = 0; c < sample; c++) {
        ret_sample[c] = t->value[first + EVERY * c];
        ret_weight[c] = t->known[first + EVERY * c] ? 1 / t->noise2[EVERY * c] : 0;
    }
}

/* Squared distance over one section's noise. */
static double distance(const float *one, const float *other, const float *weight, size_t sample)
{
    const float most = (float)(MOST * MOST);
    double sum = 0;

    for (size_t c = 0; c < sample; c++) {
        const float off = one[c] - other[c], square = off * off * weight[c];

        sum += (double)(square < most ? square : most);
    }
    return sum;
}

void gsn_sequence_add_misfit(struct gsn_sequence_search *a, size_t place, float *sum)
{
    const size_t sample = gsn_sequence_sample(a->t);
    float *foretold = a->t->off_too, *plane = a->t->off, *weight = a->t->energy;
    const unsigned char *told = a->t->told;
    const struct gsn_sequence_line line = foretell(a->t, place, foretold);
    const float scale = (float)(1 / (1 + gsn_sequence_line_noise(&line)));
    const float most = (float)(MOST * MOST);

    take(a->t, place, plane, weight);
    for (size_t c = 0; c < sample; c++) {
        const float off = plane[c] - foretold[c], square = off * off * weight[c] * scale;

        sum[c] += (float)told[c] * (square < most ? square : most);
    }
}

/* Two that changed places far from each other fit worst of all, but for the ends, which are only
 * foretold from one side. */
static void suspect(struct gsn_sequence_search *a)
{
    const size_t n = a->t->n;

    for (size_t k = 0; k < n; k++) {
        size_t worse = 0;

        for (size_t i = 0; i < n; i++)
            worse += !a->used[i] && a->fit[i * n + i] > a->fit[k * n + k];
        a->suspect[k] = worse < SUSPECTS;
    }
}

void gsn_sequence_compare_far(struct gsn_sequence_search *a)
{
    const size_t n = a->t->n, sample = gsn_sequence_sample(a->t);
    float *plane = a->t->off, *weight = a->t->energy;

    for (size_t m = 0; m < n; m++)
        (void)foretell(a->t, m, a->sample + m * sample);
    for (size_t k = 0; k < n; k++) {
        take(a->t, k, plane, weight);
        for (size_t m = 0; m < n; m++)
            a->fit[k * n + m] = distance(plane, a->sample + m * sample, weight, sample);
    }
    for (size_t c = 0; c < sample; c++)
        weight[c] = 1 / a->t->noise2[EVERY * c];
    for (size_t m = 0; m < n; m++)
        for (size_t k = 0; k < m; k++)
            a->apart[k * n + m] =
                distance(a->sample + k * sample, a->sample + m * sample, weight, sample);
    suspect(a);
}

double gsn_sequence_standing(const struct gsn_sequence_search *a, size_t i, size_t j)
{
    const size_t n = a->t->n;
    const double off =
        a->fit[i * n + i] + a->fit[j * n + j] - a->fit[i * n + j] - a->fit[j * n + i];

    return a->apart[i * n + j] > 0 ? -off / (2 * a->apart[i * n + j]) : 0;
}
