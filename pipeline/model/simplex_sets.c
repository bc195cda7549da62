/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/simplex_sets.h"

#include <assert.h>
#include <string.h>

enum { MASKS = 1 << GSN_SIMPLEX_MAX_KNOTS, ABSENT = UINT16_MAX };

const uint8_t gsn_simplex_raised[10][4] = {
    { 0, 1, 2, 3 },    { 1, 4, 5, 6 },    { 2, 5, 7, 8 },    { 3, 6, 8, 9 },    { 4, 10, 11, 12 },
    { 5, 11, 13, 14 }, { 6, 12, 14, 15 }, { 7, 13, 16, 17 }, { 8, 14, 17, 18 }, { 9, 15, 18, 19 },
};

size_t gsn_simplex_count(unsigned degree)
{
    return (size_t)(degree + 1) * (degree + 2) * (degree + 3) / 6;
}

size_t gsn_simplex_place(const uint8_t beta[4])
{
    const size_t rest = (size_t)beta[1] + beta[2] + beta[3];
    const size_t last = (size_t)beta[2] + beta[3];

    return rest * (rest + 1) * (rest + 2) / 6 + last * (last + 1) / 2 + beta[3];
}

int gsn_simplex_next(uint8_t beta[4])
{
    const uint8_t tail = beta[3];
    int k = 2;

    while (k >= 0 && beta[k] == 0)
        k--;
    if (k < 0)
        return 0;
    beta[3] = 0;
    beta[k]--;
    beta[k + 1] = (uint8_t)(tail + 1);
    return 1;
}

static unsigned ones(unsigned mask)
{
    return (unsigned)__builtin_popcount(mask);
}

static unsigned knots_of(unsigned degree, const uint8_t beta[4])
{
    unsigned mask = 0;

    for (unsigned k = 0; k < 4; k++)
        mask |= ((2u << beta[k]) - 1) << (k * (degree + 1));
    return mask;
}

static unsigned corners_of(unsigned degree, const uint8_t beta[4])
{
    unsigned mask = 0;

    for (unsigned k = 0; k < 4; k++)
        mask |= 1u << (k * (degree + 1) + beta[k]);
    return mask;
}

static void describe(struct gsn_simplex_set *set, unsigned mask, unsigned degree)
{
    const unsigned cloud = (2u << degree) - 1;

    set->mask = (uint16_t)mask;
    set->size = 0;
    set->missing = 0;
    for (unsigned i = 0; i < GSN_SIMPLEX_MAX_KNOTS; i++) {
        if (!(mask >> i & 1))
            continue;
        set->cloud[set->size] = (uint8_t)(i / (degree + 1));
        set->member[set->size++] = (uint8_t)i;
    }
    for (unsigned k = 0; k < 4; k++) {
        if (!(mask >> (k * (degree + 1)) & cloud))
            set->missing |= (uint8_t)(1u << k);
    }
}

/* Appends a set unless it is there already. */
static uint16_t enter(struct gsn_simplex_sets *sets, uint16_t *place, unsigned mask)
{
    if (place[mask] == ABSENT) {
        assert(sets->count < GSN_SIMPLEX_MAX_SETS);
        place[mask] = (uint16_t)sets->count;
        describe(&sets->set[sets->count++], mask, sets->degree);
    }
    return place[mask];
}

/* The V_beta, then generation after generation their subsets with one knot less. */
static void descend(struct gsn_simplex_sets *sets, uint16_t *place)
{
    uint8_t beta[4] = { (uint8_t)sets->degree, 0, 0, 0 };

    do {
        const uint16_t function = enter(sets, place, knots_of(sets->degree, beta));

        memcpy(sets->beta[function], beta, sizeof beta);
    } while (gsn_simplex_next(beta));
    sets->functions = sets->count;

    sets->first[sets->degree + 4] = 0;
    for (unsigned size = sets->degree + 4; size > 3; size--) {
        const size_t end = sets->count;

        sets->first[size - 1] = end;
        for (size_t s = sets->first[size]; s < end; s++) {
            for (unsigned i = 0; i < size; i++)
                sets->set[s].without[i] =
                    enter(sets, place, sets->set[s].mask & ~(1u << sets->set[s].member[i]));
        }
    }
    sets->first[2] = sets->count;
    for (size_t f = 0; f < sets->functions; f++)
        sets->corners[f] = place[corners_of(sets->degree, sets->beta[f])];
}

/* Lists the subsets of four of every larger set; counts them only while quad is NULL. */
static size_t list_quads(struct gsn_simplex_sets *sets, const uint16_t *place)
{
    size_t count = 0;

    for (size_t s = 0; s < sets->first[4]; s++) {
        const struct gsn_simplex_set *set = &sets->set[s];

        sets->quads[s] = count;
        for (unsigned chosen = 0; chosen < 1u << set->size; chosen++) {
            unsigned mask = 0;

            if (ones(chosen) != 4)
                continue;
            for (unsigned i = 0; i < set->size; i++)
                mask |= (chosen >> i & 1) << set->member[i];
            if (sets->quad)
                sets->quad[count] = place[mask];
            count++;
        }
    }
    sets->quads[sets->first[4]] = count;
    return count;
}

int gsn_simplex_sets_new(unsigned degree, struct gsn_simplex_sets **ret_sets, struct gsn_error *err)
{
    gsn_auto(gsn_simplex_sets) sets = gsn_alloc_array(1, sizeof *sets);
    gsn_auto_mem(uint16_t) place = gsn_alloc_array(MASKS, sizeof *place);

    assert(degree >= 1 && degree <= GSN_SIMPLEX_MAX_DEGREE);

    if (sets)
        sets->set = gsn_alloc_array(GSN_SIMPLEX_MAX_SETS, sizeof *sets->set);
    if (!sets || !place || !sets->set)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the knot sets");
    for (size_t i = 0; i < MASKS; i++)
        place[i] = ABSENT;
    sets->degree = degree;
    descend(sets, place);

    sets->quads = gsn_alloc_array(sets->first[4] + 1, sizeof *sets->quads);
    if (sets->quads)
        sets->quad = gsn_alloc_array(list_quads(sets, place), sizeof *sets->quad);
    if (!sets->quads || !sets->quad)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the knot sets");
    (void)list_quads(sets, place);
    *ret_sets = gsn_steal(&sets);
    return GSN_OK;
}

void gsn_simplex_sets_free(struct gsn_simplex_sets *sets)
{
    if (!sets)
        return;
    gsn_free(sets->set);
    gsn_free(sets->quads);
    gsn_free(sets->quad);
    gsn_free(sets);
}
