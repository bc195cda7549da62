/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Numbers at random that are the same on every machine (splitmix64). */
#ifndef GSN_TESTS_DRAW_H
#define GSN_TESTS_DRAW_H

#include <stdint.h>

/* Evenly in [0, 1). */
static inline double draw(uint64_t *state)
{
    uint64_t z = *state += 0x9e3779b97f4a7c15U;

    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9U;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebU;
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

#endif
