/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include <string.h>

static size_t place_of(const struct gsn_sequence_plane *planes, unsigned serial)
{
    size_t k = 0;

    while (planes[k].serial != serial)
        k++;
    return k;
}

static size_t apart(size_t one, size_t other)
{
    return one > other ? one - other : other - one;
}

static int is_either(const struct gsn_sequence_finding *f, unsigned serial)
{
    return f->a == serial || f->b == serial;
}

static int touches(const struct gsn_sequence_finding *swap,
                   const struct gsn_sequence_finding *twins)
{
    return is_either(swap, twins->a) || is_either(swap, twins->b);
}

void gsn_sequence_leave_out(const struct gsn_sequence_plane *planes,
                            const struct gsn_sequence *found, int second, char *ret_out, size_t n)
{
    memset(ret_out, 0, n);
    for (size_t k = 0; k < found->count; k++)
        if (found->finding[k].kind == GSN_SEQUENCE_DUPLICATE)
            ret_out[place_of(planes, second ? found->finding[k].b : found->finding[k].a)] = 1;
}

int gsn_sequence_is_settled(const struct gsn_sequence_plane *planes,
                            const struct gsn_sequence *found)
{
    for (size_t k = 0; k < found->count; k++) {
        const struct gsn_sequence_finding *twins = &found->finding[k];

        if (twins->kind != GSN_SEQUENCE_DUPLICATE)
            continue;
        if (place_of(planes, twins->b) != place_of(planes, twins->a) + 1)
            return 0;
        for (size_t i = 0; i < found->count; i++)
            if (found->finding[i].kind == GSN_SEQUENCE_SWAP && touches(&found->finding[i], twins))
                return 0;
    }
    return 1;
}

static const struct gsn_sequence_finding *same_in(const struct gsn_sequence *s,
                                                  const struct gsn_sequence_finding *swap)
{
    for (size_t k = 0; k < s->count; k++)
        if (s->finding[k].kind == GSN_SEQUENCE_SWAP && s->finding[k].a == swap->a &&
            s->finding[k].b == swap->b)
            return &s->finding[k];
    return NULL;
}

/* Where a section lies once a swap is undone. */
static size_t undone(const struct gsn_sequence_plane *planes,
                     const struct gsn_sequence_finding *swap, unsigned serial)
{
    if (swap->a == serial)
        return place_of(planes, swap->b);
    return place_of(planes, swap->b == serial ? swap->a : serial);
}

/* 1 where a swap brings two mounts side by side, -1 where it moves one from or past the other, 0
 * where it moves neither. */
static int brings_together(const struct gsn_sequence_plane *planes,
                           const struct gsn_sequence *duplicates,
                           const struct gsn_sequence_finding *swap)
{
    int moved = 0;

    for (size_t k = 0; k < duplicates->count; k++) {
        const struct gsn_sequence_finding *twins = &duplicates->finding[k];

        if (twins->kind != GSN_SEQUENCE_DUPLICATE || !touches(swap, twins))
            continue;
        if (apart(undone(planes, swap, twins->a), undone(planes, swap, twins->b)) != 1)
            return -1;
        moved = 1;
    }
    return moved;
}

/* Whether another swap of one of its sections brings mounts together with more evidence. */
static int is_beaten(const struct gsn_sequence_plane *planes, const struct gsn_sequence *found,
                     const struct gsn_sequence *other, const struct gsn_sequence_finding *swap)
{
    for (size_t k = 0; k < other->count; k++) {
        const struct gsn_sequence_finding *f = &other->finding[k];

        if (f->kind == GSN_SEQUENCE_SWAP && brings_together(planes, found, f) > 0 &&
            (is_either(swap, f->a) || is_either(swap, f->b)) && f->evidence > swap->evidence)
            return 1;
    }
    return 0;
}

static int stands(const struct gsn_sequence_plane *planes, const struct gsn_sequence *found,
                  const struct gsn_sequence *other, const struct gsn_sequence_finding *swap)
{
    const int together = brings_together(planes, found, swap);

    if (same_in(other, swap))
        return together >= 0;
    return together > 0 && !is_beaten(planes, found, other, swap);
}

void gsn_sequence_agree(const struct gsn_sequence_plane *planes, const struct gsn_sequence *other,
                        struct gsn_sequence *found, char *room)
{
    const size_t own = found->count;
    size_t count = 0;

    for (size_t k = 0; k < own; k++)
        room[k] = found->finding[k].kind != GSN_SEQUENCE_SWAP ||
                  stands(planes, found, other, &found->finding[k]);
    for (size_t k = 0; k < other->count; k++)
        room[own + k] = other->finding[k].kind == GSN_SEQUENCE_SWAP &&
                        !same_in(found, &other->finding[k]) &&
                        stands(planes, found, found, &other->finding[k]);
    for (size_t k = 0; k < own; k++)
        if (room[k])
            found->finding[count++] = found->finding[k];
    for (size_t k = 0; k < other->count; k++)
        if (room[own + k])
            found->finding[count++] = other->finding[k];
    found->count = count;
}
