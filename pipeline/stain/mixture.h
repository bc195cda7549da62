/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Classes of tissue: how much of each dye a pixel holds, as a mixture of normals in the logarithms
 * of the three amounts, and how likely that makes the pixels for given stain vectors. */
#ifndef GSN_STAIN_MIXTURE_H
#define GSN_STAIN_MIXTURE_H

#include "pipeline/stain/stain_sample.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Classes of tissue: how much of each dye a pixel holds, as a mixture of normals in the logarithms
 * of the three amounts, and how likely that makes the pixels for given dye vectors. */

enum {
    GSN_MIXTURE_CLASSES = 3,
    /* Each class has 3 means and 6 covariances; its share is known but for the last one's. */
    GSN_MIXTURE_UNKNOWNS = GSN_MIXTURE_CLASSES * 9 + GSN_MIXTURE_CLASSES - 1,
    GSN_SCORE_UNKNOWNS = GSN_DYE_ROTATIONS + GSN_MIXTURE_UNKNOWNS,
};

struct gsn_mixture_class {
    double share, mean[3];
    double precision[3][3]; /* inverse of the covariance */
    double log_norm;
};

struct gsn_mixture {
    size_t count;
    struct gsn_mixture_class class[GSN_MIXTURE_CLASSES];
    double strays; /* share of the pixels that are none of theirs, as of the last refit */
};

/* Slopes of the log-likelihood by the turns, freed of what the classes could follow. */
struct gsn_mixture_scores {
    double total[GSN_DYE_ROTATIONS];
    double information[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS];
    double outer[GSN_SCORE_UNKNOWNS][GSN_SCORE_UNKNOWNS]; /* scratch */
};

/* count classes, at most GSN_MIXTURE_CLASSES. */
void gsn_mixture_start(struct gsn_mixture *classes, size_t count,
                       const struct gsn_stain_sample *sample,
                       const struct gsn_dyes_inverse *optics);

size_t gsn_mixture_unknowns(const struct gsn_mixture *classes);

/* One round of expectation-maximisation. */
void gsn_mixture_refit(struct gsn_mixture *classes, const struct gsn_stain_sample *sample,
                       const struct gsn_dyes_inverse *optics);

double gsn_mixture_likelihood(const struct gsn_mixture *classes,
                              const struct gsn_stain_sample *sample,
                              const struct gsn_dyes_inverse *optics);

void gsn_mixture_score(const struct gsn_mixture *classes, const struct gsn_stain_sample *sample,
                       const struct gsn_dyes_inverse *optics,
                       struct gsn_mixture_scores *ret_scores);

/* How far the pixels are from any mixture of classes, in nats per pixel: the largest relative
 * entropy between the logarithms of the amounts, seen along one direction, and the classes there.
 * About 0 (0.002 in 4000 pixels) where they fit; pixels of layered tissue, scanned as JPEG, come to
 * 0.01 to 0.07. */
double gsn_mixture_misfit(const struct gsn_mixture *classes, const struct gsn_stain_sample *sample,
                          const struct gsn_dyes_inverse *optics);

#ifdef __cplusplus
}
#endif

#endif
