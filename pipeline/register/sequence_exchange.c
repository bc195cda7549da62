/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_search.h"

#include <string.h>

enum { NEAR = GSN_SEQUENCE_NEAR };

static void trade(struct gsn_sequence_search *a, const struct gsn_sequence_swap *swap)
{
    size_t *place = a->t->place;
    const size_t plane = place[swap->place[0]];

    place[swap->place[0]] = place[swap->place[1]];
    place[swap->place[1]] = plane;
}

void gsn_sequence_exchange(struct gsn_sequence_search *a, const struct gsn_sequence_swap *swap)
{
    trade(a, swap);
    for (int i = 0; i < 2; i++)
        gsn_sequence_lay_again(a->t, swap->place[i]);
    gsn_sequence_compare_near(a, swap->place);
}

void gsn_sequence_keep(struct gsn_sequence_search *a, const struct gsn_sequence_swap *swap)
{
    const struct gsn_sequence_tissue *t = a->t;
    const size_t cells = t->columns * t->rows;

    memcpy(a->kept, a->near, t->n * NEAR * sizeof *a->near);
    for (int i = 0; i < 2; i++) {
        const size_t plane = t->place[swap->place[i]];

        memcpy(a->kept_value + (size_t)i * cells, t->value + plane * cells, cells * sizeof(float));
        memcpy(a->kept_known + (size_t)i * cells, t->known + plane * cells, cells);
        memcpy(a->kept_motion[i], t->motion[plane], sizeof a->kept_motion[i]);
    }
}

void gsn_sequence_put_back(struct gsn_sequence_search *a, const struct gsn_sequence_swap *swap)
{
    struct gsn_sequence_tissue *t = a->t;
    const size_t cells = t->columns * t->rows;

    trade(a, swap);
    memcpy(a->near, a->kept, t->n * NEAR * sizeof *a->near);
    for (int i = 0; i < 2; i++) {
        const size_t plane = t->place[swap->place[i]];

        memcpy(t->value + plane * cells, a->kept_value + (size_t)i * cells, cells * sizeof(float));
        memcpy(t->known + plane * cells, a->kept_known + (size_t)i * cells, cells);
        memcpy(t->motion[plane], a->kept_motion[i], sizeof a->kept_motion[i]);
    }
}

struct gsn_sequence_change gsn_sequence_change_both_ways(struct gsn_sequence_search *a,
                                                         const struct gsn_sequence_swap *swap)
{
    const size_t i = swap->place[0], j = swap->place[1];
    struct gsn_sequence_change change = gsn_sequence_change_between(a->t, i, j);

    gsn_sequence_keep(a, swap);
    trade(a, swap);
    gsn_sequence_lay_again(a->t, i);
    gsn_sequence_lay_again(a->t, j);
    change.shown -= gsn_sequence_change_between(a->t, i, j).shown;
    change.shown /= 2;
    gsn_sequence_put_back(a, swap);
    return change;
}
