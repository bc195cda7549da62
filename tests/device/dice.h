/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Random numbers that are the same on every machine (SplitMix64). */
#ifndef GSN_TESTS_DEVICE_DICE_H
#define GSN_TESTS_DEVICE_DICE_H

#include <stdint.h>

struct dice {
    uint64_t state; /* the seed, at first */
};

static inline uint64_t roll(struct dice *dice)
{
    uint64_t z = dice->state += 0x9E3779B97F4A7C15u;

    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return z ^ z >> 31;
}

/* 0 .. limit - 1 */
static inline unsigned below(struct dice *dice, unsigned limit)
{
    return (unsigned)(roll(dice) % limit);
}

#endif
