/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The search for a sample's dye vectors, as the parts of this folder share it. */
#ifndef GSN_STAIN_DYES_PARTS_H
#define GSN_STAIN_DYES_PARTS_H

#include "pipeline/stain/classes.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_dyes_search {
    const struct gsn_stain_sample *sample;
    const struct gsn_dyes *dyes; /* the prior's */
    double precision[GSN_DYE_TURNS];
    double turn[GSN_DYE_TURNS];
    struct gsn_classes classes;
    double weight; /* of each pixel */
    double best;   /* the objective here */
};

/* The vectors at these turns, their inverse, and how they move with each turn. Returns 0 when they
 * lie nearly in one plane. */
int gsn_dyes_look_through(const struct gsn_dyes *dyes, const double turn[GSN_DYE_TURNS],
                          struct gsn_optics *ret_optics);

/* What each pixel of a sample is worth whose best classes at any turns are those of the search. */
double gsn_dyes_weight(const struct gsn_dyes_search *search);

/* Of the turns found, rad^2; never wider than the prior. scores: scratch. */
void gsn_dyes_covariance(const struct gsn_dyes_search *search, struct gsn_scores *scores,
                         double ret_covariance[GSN_DYE_TURNS][GSN_DYE_TURNS]);

#ifdef __cplusplus
}
#endif
#endif
