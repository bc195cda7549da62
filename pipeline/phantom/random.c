/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Random numbers: xoshiro256** (D. Blackman, S. Vigna, "Scrambled linear pseudorandom number
 * generators", 2018), each stream's state made from its name by splitmix64 (G. L. Steele, D. Lea,
 * C. H. Flood, "Fast splittable pseudorandom number generators", 2014); normals by Box and Muller,
 * small counts by Knuth's product of uniforms, whole numbers by multiplication, whose relative bias
 * is below count / 2^32. Nothing fails. */
#include "pipeline/phantom/random.h"

#include <math.h>

static uint64_t mix_bits(uint64_t *counter)
{
    uint64_t z = *counter += 0x9e3779b97f4a7c15u;

    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

static uint64_t rotate_bits(uint64_t x, int by)
{
    return (x << by) | (x >> (64 - by));
}

static uint64_t next_bits(struct gsn_phantom_random *random)
{
    uint64_t *s = random->state;
    const uint64_t result = rotate_bits(s[1] * 5, 7) * 9, shifted = s[1] << 17;

    s[2] ^= s[0];
    s[3] ^= s[1];
    s[1] ^= s[2];
    s[0] ^= s[3];
    s[2] ^= shifted;
    s[3] = rotate_bits(s[3], 45);
    return result;
}

struct gsn_phantom_random gsn_phantom_random_make(uint64_t seed, enum gsn_phantom_stream stream,
                                                  uint64_t major, uint64_t minor)
{
    const uint64_t name[4] = { seed, (uint64_t)stream, major, minor };
    struct gsn_phantom_random random;
    uint64_t counter = 0;

    /* Each part of the name is mixed before the next is added: neighbouring names are unrelated. */
    for (int i = 0; i < 4; i++) {
        counter += name[i];
        counter = mix_bits(&counter);
    }
    for (int i = 0; i < 4; i++)
        random.state[i] = mix_bits(&counter);
    return random;
}

double gsn_phantom_uniform(struct gsn_phantom_random *random)
{
    return (double)(next_bits(random) >> 11) * 0x1p-53;
}

uint32_t gsn_phantom_below(struct gsn_phantom_random *random, uint32_t count)
{
    return (uint32_t)(((next_bits(random) >> 32) * count) >> 32);
}

int gsn_phantom_poisson(struct gsn_phantom_random *random, double mean)
{
    const double end = exp(-mean);
    int count = 0;

    for (double product = gsn_phantom_uniform(random); product > end; count++)
        product *= gsn_phantom_uniform(random);
    return count;
}

void gsn_phantom_normals(struct gsn_phantom_random *random, double ret_pair[2])
{
    const double radius = sqrt(-2 * log(1 - gsn_phantom_uniform(random)));
    const double angle = 2 * M_PI * gsn_phantom_uniform(random);

    ret_pair[0] = radius * cos(angle);
    ret_pair[1] = radius * sin(angle);
}

double gsn_phantom_normal(struct gsn_phantom_random *random, double sd)
{
    double pair[2];

    gsn_phantom_normals(random, pair);
    return sd * pair[0];
}

void gsn_phantom_turn_vector(struct gsn_phantom_random *random, double angle, double vector[3])
{
    double across[3], along = 0, length = 0;

    for (int c = 0; c < 3; c++) {
        across[c] = gsn_phantom_normal(random, 1);
        along += across[c] * vector[c];
    }
    for (int c = 0; c < 3; c++) {
        across[c] -= along * vector[c];
        length += across[c] * across[c];
    }
    for (int c = 0; c < 3; c++)
        vector[c] = cos(angle) * vector[c] + sin(angle) * across[c] / sqrt(length);
}

double gsn_phantom_between(struct gsn_phantom_random *random, double low, double high)
{
    return low + (high - low) * gsn_phantom_uniform(random);
}
