/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_search.h"

#include <math.h>
#include <string.h>

enum { NEAR = GSN_SEQUENCE_NEAR, SIDE = GSN_SEQUENCE_SIDE, EVERY = 3, SUSPECTS = 8 };

/* Two planes' cells differ by no more than this, in standard deviations of one's noise. */
static const double MOST = 3;

static size_t away(size_t a, size_t b)
{
    return a > b ? a - b : b - a;
}

static int concerns(size_t i, size_t f, const size_t place[2])
{
    for (int k = 0; k < 2; k++)
        if (away(i, place[k]) <= SIDE + 1 || away(i + f, place[k]) <= SIDE + 1)
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

/* The line through the sections around a place, itself left out. */
static void foretell(const struct gsn_sequence_tissue *t, size_t place, float *ret_plane)
{
    const size_t cells = t->columns * t->rows;
    const struct gsn_sequence_line line =
        gsn_sequence_line_at(t->z, t->n, place, place, t->z[place]);

    memset(ret_plane, 0, cells * sizeof *ret_plane);
    for (size_t k = 0; k < line.count; k++) {
        const float *plane = t->value + t->place[line.at[k]] * cells;
        const float weight = (float)line.weight[k];

        for (size_t c = 0; c < cells; c += EVERY)
            ret_plane[c] += weight * plane[c];
    }
}

static double misfit(const struct gsn_sequence_tissue *t, size_t place, const float *foretold)
{
    const size_t cells = t->columns * t->rows;
    const float *plane = t->value + t->place[place] * cells, most = (float)MOST;
    const unsigned char *known = t->known + t->place[place] * cells;
    double sum = 0;

    for (size_t c = 0; c < cells; c += EVERY) {
        const float off = fminf(fabsf(plane[c] - foretold[c]), most * t->deviation[c]);

        sum += known[c] ? (double)(off * off / t->noise2[c]) : 0;
    }
    return sum;
}

/* Squared distance between what two places foretell, over one section's noise. */
static double apart(const struct gsn_sequence_tissue *t, const float *here, const float *there)
{
    const size_t cells = t->columns * t->rows;
    const float most = (float)MOST;
    double sum = 0;

    for (size_t c = 0; c < cells; c += EVERY) {
        const float off = fminf(fabsf(here[c] - there[c]), most * t->deviation[c]);

        sum += (double)(off * off / t->noise2[c]);
    }
    return sum;
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
    const size_t n = a->t->n;

    for (size_t m = 0; m < n; m++) {
        foretell(a->t, m, a->t->change);
        for (size_t k = 0; k < n; k++)
            a->fit[k * n + m] = misfit(a->t, k, a->t->change);
        for (size_t k = 0; k < m; k++) {
            foretell(a->t, k, a->t->off);
            a->apart[k * n + m] = apart(a->t, a->t->change, a->t->off);
        }
    }
    suspect(a);
}

double gsn_sequence_standing(const struct gsn_sequence_search *a, size_t i, size_t j)
{
    const size_t n = a->t->n;
    const double off =
        a->fit[i * n + i] + a->fit[j * n + j] - a->fit[i * n + j] - a->fit[j * n + i];

    return a->apart[i * n + j] > 0 ? -off / (2 * a->apart[i * n + j]) : 0;
}
