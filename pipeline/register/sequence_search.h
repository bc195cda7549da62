/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the search for swaps shares: every near change, how far planes fit elsewhere, and two planes
 * in each other's places for a while. */
#ifndef GSN_REGISTER_SEQUENCE_SEARCH_H
#define GSN_REGISTER_SEQUENCE_SEARCH_H

#include "pipeline/register/sequence_parts.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_sequence_search {
    struct gsn_sequence_tissue *t;
    struct gsn_sequence_change *near; /* n * NEAR: to the places 1 to NEAR further on */
    struct gsn_sequence_change *kept; /* as many: scratch */
    float *kept_value;                /* of two planes: scratch */
    unsigned char *kept_known;        /* as many: scratch */
    double kept_motion[2][GSN_SEQUENCE_MOTION];
    float *foretold;                 /* n samples: of what each place foretells */
    double *fit;                     /* n * n: how ill the plane at one place fits at another */
    double *apart;                   /* n * n: of i < j, between what the two places foretell */
    double shown[GSN_SEQUENCE_NEAR]; /* share of swaps 1 to NEAR apart that would show */
    double gain;                     /* how much of what is foretold a change shows */
    char *used;                      /* n: in a proposal already */
    char *suspect;                   /* n: of those that fit worst where they lie */
};

struct gsn_sequence_swap {
    size_t place[2];
    struct gsn_sequence_change change;
    double convincing;
};

/* Compares anew the near changes that two places have a say in; NULL: all. */
void gsn_sequence_compare_near(struct gsn_sequence_search *search, const size_t place[2]);
/* How many of a plane's cells tell how it fits elsewhere. */
size_t gsn_sequence_sample(const struct gsn_sequence_tissue *tissue);
/* How every plane fits at every place, and which are suspect. */
void gsn_sequence_compare_far(struct gsn_sequence_search *search);
/* How the planes at two places stand between them, roughly: 1 where they lie in order, -1 where
 * each lies at the other's, 0 where one alone is out of place. */
double gsn_sequence_standing(const struct gsn_sequence_search *search, size_t i, size_t j);

/* The planes at two places as they are, to be put back after gsn_sequence_exchange(). */
void gsn_sequence_keep(struct gsn_sequence_search *search, const struct gsn_sequence_swap *swap);
/* Each plane was laid by those that it may not belong to, so it is laid again, and what is near
 * compared anew. */
void gsn_sequence_exchange(struct gsn_sequence_search *search,
                           const struct gsn_sequence_swap *swap);
void gsn_sequence_put_back(struct gsn_sequence_search *search,
                           const struct gsn_sequence_swap *swap);
/* What two far places show, each plane laid where it is and where the other is: a plane follows
 * those that it is laid onto, wherever it lies, and one from far away fits nowhere before it is
 * laid again. */
struct gsn_sequence_change gsn_sequence_change_both_ways(struct gsn_sequence_search *search,
                                                         const struct gsn_sequence_swap *swap);

#ifdef __cplusplus
}
#endif
#endif
