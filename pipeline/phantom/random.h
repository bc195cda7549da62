/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Reproducible random numbers: xoshiro256** (Blackman and Vigna, 2018), seeded by splitmix64.
 *
 * Every section, panel and row has a stream of its own, named by the numbers it belongs to, so what
 * is drawn does not depend on the order or the number of threads. */
#ifndef GSN_PHANTOM_RANDOM_H
#define GSN_PHANTOM_RANDOM_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What a stream is for; part of its name. */
enum gsn_phantom_stream {
    GSN_PHANTOM_STREAM_POSE,
    GSN_PHANTOM_STREAM_RED_TEXTURE,
    GSN_PHANTOM_STREAM_YELLOW_TEXTURE,
    GSN_PHANTOM_STREAM_NUCLEI,
    GSN_PHANTOM_STREAM_NOISE,
    GSN_PHANTOM_STREAM_WARP,
    GSN_PHANTOM_STREAM_MARKS,
    GSN_PHANTOM_STREAM_DECOYS,
    GSN_PHANTOM_STREAM_BATCH,
    GSN_PHANTOM_STREAM_DEFECTS,
    GSN_PHANTOM_STREAM_DELIVERY,
    GSN_PHANTOM_STREAM_BATH
};

struct gsn_phantom_random {
    uint64_t state[4];
};

/* major and minor tell the section, or the panel and row. */
struct gsn_phantom_random gsn_phantom_random_make(uint64_t seed, enum gsn_phantom_stream stream,
                                                  uint64_t major, uint64_t minor);

/* [0, 1) with 53 bits. */
double gsn_phantom_uniform(struct gsn_phantom_random *random);

/* 0..count-1; the caller guarantees 0 < count < 2^32. */
uint32_t gsn_phantom_below(struct gsn_phantom_random *random, uint32_t count);

/* Knuth's product of uniforms; for means of a few. */
int gsn_phantom_poisson(struct gsn_phantom_random *random, double mean);

/* Two independent standard normals (Box and Muller). */
void gsn_phantom_normals(struct gsn_phantom_random *random, double ret_pair[2]);

/* Normal with this deviation and mean 0. */
double gsn_phantom_normal(struct gsn_phantom_random *random, double sd);

/* Turns a unit vector by an angle towards a random direction across it. */
void gsn_phantom_turn_vector(struct gsn_phantom_random *random, double angle, double vector[3]);

/* Uniform in low..high. */
double gsn_phantom_between(struct gsn_phantom_random *random, double low, double high);

#ifdef __cplusplus
}
#endif
#endif
