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
    GSN_CLASSES = 3,
    /* Each class has 3 means and 6 covariances; its share is known but for the last one's. */
    GSN_CLASS_UNKNOWNS = GSN_CLASSES * 9 + GSN_CLASSES - 1,
    GSN_SCORE_UNKNOWNS = GSN_DYE_TURNS + GSN_CLASS_UNKNOWNS,
};

struct gsn_class {
    double share, mean[3];
    double precision[3][3]; /* inverse of the covariance */
    double log_norm;
};

struct gsn_classes {
    size_t count;
    struct gsn_class class[GSN_CLASSES];
    double strays; /* share of the pixels that are none of theirs, as of the last refit */
};

/* Slopes of the log-likelihood by the turns, freed of what the classes could follow. */
struct gsn_scores {
    double total[GSN_DYE_TURNS];
    double information[GSN_DYE_TURNS][GSN_DYE_TURNS];
    double outer[GSN_SCORE_UNKNOWNS][GSN_SCORE_UNKNOWNS]; /* scratch */
};

/* count classes, at most GSN_CLASSES. */
void gsn_classes_start(struct gsn_classes *classes, size_t count,
                       const struct gsn_stain_sample *sample, const struct gsn_optics *optics);

size_t gsn_classes_unknowns(const struct gsn_classes *classes);

/* One round of expectation-maximisation. */
void gsn_classes_refit(struct gsn_classes *classes, const struct gsn_stain_sample *sample,
                       const struct gsn_optics *optics);

double gsn_classes_likelihood(const struct gsn_classes *classes,
                              const struct gsn_stain_sample *sample,
                              const struct gsn_optics *optics);

void gsn_classes_score(const struct gsn_classes *classes, const struct gsn_stain_sample *sample,
                       const struct gsn_optics *optics, struct gsn_scores *ret_scores);

/* How far the pixels are from any mixture of classes, in nats per pixel: the largest relative
 * entropy between the logarithms of the amounts, seen along one direction, and the classes there.
 * About 0 (0.002 in 4000 pixels) where they fit; pixels of layered tissue, scanned as JPEG, come to
 * 0.01 to 0.07. */
double gsn_classes_misfit(const struct gsn_classes *classes, const struct gsn_stain_sample *sample,
                          const struct gsn_optics *optics);

#ifdef __cplusplus
}
#endif

#endif
