/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which of several orders of the sections their tissue speaks for.
 *
 * Tissue changes little from one section to the next, so through the right order the way is short
 * (seriation; Robinson 1951): the sum of what neighbours differ by. An order that is stated
 * wrongly, a snake called rows or panels that were turned, has many long steps, and the right one
 * shows them gone. */
#ifndef GSN_REGISTER_ORDER_SERIATION_H
#define GSN_REGISTER_ORDER_SERIATION_H

#include "pipeline/register/order/sequence.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_seriation;

/* The way through the sections is shorter by this many standard errors, or the order stands as it
 * is stated. Errors have long tails, so no probability is claimed: on eleven phantoms of levels L1
 * and L2 and on the Visible Human's axial cuts no other order came nearer to the true one than
 * 2.4 below it, and of these eleven a snake that was called rows showed on ten by 7.7 to 26 (on one
 * with half of its sections missing by 3.9). */
extern const double gsn_seriation_shorter;

/* gives: planes in the order that is stated. Fails with GSN_E_NOMEM. */
int gsn_seriation_new(const struct gsn_sequence_plane *planes, size_t count, size_t columns,
                      size_t rows, struct gsn_seriation **ret_path, struct gsn_error *err);
void gsn_seriation_free(struct gsn_seriation *path);
GSN_DEFINE_AUTO(gsn_seriation);

/* 1 - correlation of two planes' densities; 0: alike. */
double gsn_seriation_distance(const struct gsn_seriation *path, size_t i, size_t j);

/* By how many standard errors the way through the planes in another order is shorter than as they
 * are given; negative: it is longer. order: count numbers of planes, each once; 0 where they go the
 * same way, or where planes are too few to tell what a step's error is. */
double gsn_seriation_gain(struct gsn_seriation *path, const size_t *order);

/* The same of two planes that take each other's places: by how many standard errors each is nearer
 * than the other to those around the other's place, twice the lesser of both. Neighbours alone must
 * show it, and neighbours with those two places away: the smaller of the two counts. 0 for the last
 * two at either end, of which nothing tells which is the last. */
double gsn_seriation_exchange_gain(const struct gsn_seriation *path, size_t i, size_t j);

/* From now on these two planes lie in each other's places. */
void gsn_seriation_exchange(struct gsn_seriation *path, size_t i, size_t j);

#ifdef __cplusplus
}
#endif
#endif
