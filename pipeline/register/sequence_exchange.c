/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_search.h"

#include <string.h>

void gsn_sequence_trade(struct gsn_sequence_search *a, const struct gsn_sequence_swap *swap)
{
    size_t *place = a->t->place;
    const size_t plane = place[swap->place[0]];

    place[swap->place[0]] = place[swap->place[1]];
    place[swap->place[1]] = plane;
}

size_t gsn_sequence_affected(size_t n, const size_t place[2], size_t ret_at[GSN_SEQUENCE_AFFECTED])
{
    size_t count = 0;

    for (size_t k = 0; k < n; k++)
        if (gsn_sequence_apart(k, place[0]) <= GSN_SEQUENCE_SIDE ||
            gsn_sequence_apart(k, place[1]) <= GSN_SEQUENCE_SIDE)
            ret_at[count++] = k;
    return count;
}

/* The two first: the others were laid onto them. */
void gsn_sequence_lay_around(struct gsn_sequence_search *a, const size_t place[2])
{
    size_t at[GSN_SEQUENCE_AFFECTED];
    const size_t count = gsn_sequence_affected(a->t->n, place, at);

    for (int i = 0; i < 2; i++)
        gsn_sequence_lay_again(a->t, place[i]);
    for (size_t i = 0; i < count; i++)
        gsn_sequence_lay_again(a->t, at[i]);
}

/* Between the planes around a swap and their scratch. */
static void copy_around(struct gsn_sequence_search *a, const struct gsn_sequence_swap *swap,
                        int back)
{
    struct gsn_sequence_tissue *t = a->t;
    const size_t cells = t->columns * t->rows;
    size_t at[GSN_SEQUENCE_AFFECTED];
    const size_t count = gsn_sequence_affected(t->n, swap->place, at);

    for (size_t i = 0; i < count; i++) {
        float *value = t->value + t->place[at[i]] * cells, *kept_value = a->kept_value + i * cells;
        unsigned char *known = t->known + t->place[at[i]] * cells,
                      *kept_known = a->kept_known + i * cells;
        double *motion = t->motion[t->place[at[i]]], *kept_motion = a->kept_motion[i];

        memcpy(back ? value : kept_value, back ? kept_value : value, cells * sizeof *value);
        memcpy(back ? known : kept_known, back ? kept_known : known, cells);
        memcpy(back ? motion : kept_motion, back ? kept_motion : motion, sizeof *t->motion);
    }
}

void gsn_sequence_keep(struct gsn_sequence_search *a, const struct gsn_sequence_swap *swap)
{
    copy_around(a, swap, 0);
}

void gsn_sequence_put_back(struct gsn_sequence_search *a, const struct gsn_sequence_swap *swap)
{
    copy_around(a, swap, 1);
}

void gsn_sequence_exchange(struct gsn_sequence_search *a, const struct gsn_sequence_swap *swap)
{
    gsn_sequence_trade(a, swap);
    gsn_sequence_lay_around(a, swap->place);
    gsn_sequence_compare_near(a, swap->place);
}

struct gsn_sequence_change gsn_sequence_change_both_ways(struct gsn_sequence_search *a,
                                                         const struct gsn_sequence_swap *swap)
{
    const size_t i = swap->place[0], j = swap->place[1];
    struct gsn_sequence_change change = gsn_sequence_change_between(a->t, i, j);

    gsn_sequence_keep(a, swap);
    gsn_sequence_trade(a, swap);
    gsn_sequence_lay_again(a->t, i);
    gsn_sequence_lay_again(a->t, j);
    change.shown -= gsn_sequence_change_between(a->t, i, j).shown;
    change.shown /= 2;
    gsn_sequence_trade(a, swap);
    gsn_sequence_put_back(a, swap);
    return change;
}
