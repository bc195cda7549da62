/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the search for swaps shares: every near change, how far planes fit elsewhere, and two planes
 * in each other's places for a while. */
#ifndef GSN_REGISTER_SEQUENCE_SEARCH_H
#define GSN_REGISTER_SEQUENCE_SEARCH_H

#include "pipeline/register/sequence_parts.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Places whose surroundings a swap of two changes, at most. */
enum { GSN_SEQUENCE_AFFECTED = 2 * (GSN_SEQUENCE_AROUND + 1) };
/* Tissue so many sections apart still changes one way: what lies between two says so, too. */
enum { GSN_SEQUENCE_ONE_WAY = 12 };
/* Of so many cells one tells how planes fit. */
enum { GSN_SEQUENCE_EVERY = 3 };

struct gsn_sequence_search {
    struct gsn_sequence_tissue *t;
    struct gsn_sequence_change *near; /* n * NEAR: to the places 1 to NEAR further on */
    float *kept_value;                /* of GSN_SEQUENCE_AFFECTED planes: scratch */
    unsigned char *kept_known;        /* as many: scratch */
    double kept_motion[GSN_SEQUENCE_AFFECTED][GSN_SEQUENCE_MOTION];
    float *sample;                   /* n samples: scratch */
    double *fit;                     /* n * n: how ill the plane at one place fits at another */
    double *apart;                   /* n * n: of i < j, between what the two places foretell */
    double least[GSN_SEQUENCE_NEAR]; /* how much swaps 1 to NEAR apart must show */
    double gain;                     /* how much of what is foretold a change shows */
    char *used;                      /* n: in a proposal already, or left out */
    int exchanged;                   /* whether a swap was found */
    char *suspect;                   /* n: of those that fit worst where they lie */
};

struct gsn_sequence_swap {
    size_t place[2];
    struct gsn_sequence_change change; /* laid both ways */
    double turned; /* how far all changes that it turns over run against what is foretold */
    double fit;    /* how much better the planes around would fit, in standard errors */
    double convincing;
};

size_t gsn_sequence_apart(size_t one, size_t other);
/* Compares anew the near changes that two places have a say in; NULL: all. */
void gsn_sequence_compare_near(struct gsn_sequence_search *search, const size_t place[2]);
/* How many of a plane's cells tell how it fits elsewhere. */
size_t gsn_sequence_sample(const struct gsn_sequence_tissue *tissue);
/* How every plane fits at every place, and which are suspect. */
void gsn_sequence_compare_far(struct gsn_sequence_search *search);
/* How the planes at two places stand between them, roughly: 1 where they lie in order, -1 where
 * each lies at the other's, 0 where one alone is out of place. */
double gsn_sequence_standing(const struct gsn_sequence_search *search, size_t i, size_t j);

/* Adds to a sample of cells how ill the plane at a place fits there. */
void gsn_sequence_add_misfit(struct gsn_sequence_search *search, size_t place, float *sum);

/* The places whose surroundings a swap of two changes, themselves among them; how many. */
size_t gsn_sequence_affected(size_t n, const size_t place[2], size_t ret_at[GSN_SEQUENCE_AFFECTED]);
/* The planes there as they are, and back; the same planes must lie there. */
void gsn_sequence_keep(struct gsn_sequence_search *search, const struct gsn_sequence_swap *swap);
void gsn_sequence_put_back(struct gsn_sequence_search *search,
                           const struct gsn_sequence_swap *swap);
/* Two planes take each other's places; as they were laid. */
void gsn_sequence_trade(struct gsn_sequence_search *search, const struct gsn_sequence_swap *swap);
/* Lays the planes at two places anew, and all whose surroundings they are. */
void gsn_sequence_lay_around(struct gsn_sequence_search *search, const size_t place[2]);
/* For good: the two trade places, what is around is laid anew, and what is near compared. */
void gsn_sequence_exchange(struct gsn_sequence_search *search,
                           const struct gsn_sequence_swap *swap);
/* What speaks for a swap: how far the changes run that it turns over, and how much better all
 * planes around would fit. Everything around is laid anew as it is and as it would be, as a plane
 * out of place has misled those that were laid onto it. */
void gsn_sequence_weigh(struct gsn_sequence_search *search, struct gsn_sequence_swap *swap);
/* What two places show, each plane laid where it is and where the other is: a plane follows those
 * that it is laid onto, wherever it lies, and one from far away fits nowhere before it is laid
 * again. */
struct gsn_sequence_change gsn_sequence_change_both_ways(struct gsn_sequence_search *search,
                                                         const struct gsn_sequence_swap *swap);

#ifdef __cplusplus
}
#endif
#endif
