/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_search.h"

#include <math.h>
#include <string.h>

enum { NEAR = GSN_SEQUENCE_NEAR };
/* Side of the squares of cells that say each for itself how well planes fit: 200 um. */
enum { SQUARE = 6 };

/* How ill the planes around two places fit there, by cells of the sample. */
static void misfits(struct gsn_sequence_search *a, const struct gsn_sequence_swap *swap,
                    float *ret_sum)
{
    size_t at[GSN_SEQUENCE_AFFECTED];
    const size_t count = gsn_sequence_affected(a->t->n, swap->place, at);

    memset(ret_sum, 0, gsn_sequence_sample(a->t) * sizeof *ret_sum);
    for (size_t i = 0; i < count; i++)
        gsn_sequence_add_misfit(a, at[i], ret_sum);
}

/* How much one sum over the sample is above another, in standard errors. */
static double in_errors(const struct gsn_sequence_tissue *t, const float *one, const float *other)
{
    const size_t sample = gsn_sequence_sample(t), across = (t->columns + SQUARE - 1) / SQUARE;
    const size_t squares = across * ((t->rows + SQUARE - 1) / SQUARE);
    double sum = 0, left = 0;

    memset(t->square, 0, squares * sizeof *t->square);
    for (size_t i = 0; i < sample; i++) {
        const size_t x = GSN_SEQUENCE_EVERY * i % t->columns / SQUARE;
        const size_t y = GSN_SEQUENCE_EVERY * i / t->columns / SQUARE;

        t->square[y * across + x].first += (double)(one[i] - other[i]);
    }
    for (size_t k = 0; k < squares; k++) {
        sum += t->square[k].first;
        left += t->square[k].first * t->square[k].first;
    }
    return left > 0 ? sum / sqrt(left) : 0;
}

/* What the changes show from the first of two places to what lies next behind it, and from what
 * lies next before the second to that: a swap of the two turns them over. */
static double shown_between(const struct gsn_sequence_search *a,
                            const struct gsn_sequence_swap *swap)
{
    const size_t i = swap->place[0], j = swap->place[1];
    double sum = 0;

    if (j > i + GSN_SEQUENCE_ONE_WAY)
        return 0;
    for (size_t k = i + 1; k < j && k <= i + NEAR; k++)
        sum += gsn_sequence_change_between(a->t, i, k).shown;
    for (size_t k = i + NEAR < j ? j - NEAR : i + 1; k < j; k++)
        sum += gsn_sequence_change_between(a->t, k, j).shown;
    return sum;
}

void gsn_sequence_weigh(struct gsn_sequence_search *a, struct gsn_sequence_swap *swap)
{
    float *as_is = a->sample, *exchanged = a->sample + gsn_sequence_sample(a->t);
    double between;

    gsn_sequence_keep(a, swap);
    gsn_sequence_lay_around(a, swap->place);
    between = -shown_between(a, swap);
    misfits(a, swap, as_is);
    gsn_sequence_put_back(a, swap);
    gsn_sequence_trade(a, swap);
    gsn_sequence_lay_around(a, swap->place);
    between += shown_between(a, swap);
    misfits(a, swap, exchanged);
    gsn_sequence_trade(a, swap);
    gsn_sequence_put_back(a, swap);
    swap->turned = between / 2 - swap->change.shown;
    swap->fit = in_errors(a->t, as_is, exchanged);
}
