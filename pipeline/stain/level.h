/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Panels of one block brought to one scale by tissue that the treatment did not reach.
 *
 * A bath that dyes stronger multiplies the density; a dye whose colour turned a little lets some of
 * the yellow dye count as red, and yellow is weakest where red is strongest, so that adds a
 * constant as well. What is measured on a panel is therefore
 *
 *     measured = gain * density + offset.
 *
 * Tissue goes on across the boundary of two panels: the sections on its either side show the same
 * cells of tissue, and the straight line between what they measure is the step of the stain. Within
 * a panel the same comparison tells how much tissue, pose and focus change by themselves over as
 * many sections; their mean is taken off as the tissue's own drift, their scatter is the error. */
#ifndef GSN_STAIN_LEVEL_H
#define GSN_STAIN_LEVEL_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* after = slope * before + offset. */
struct gsn_level_line {
    double slope, offset;
    double lag;   /* sections between the middles of the two sides */
    size_t cells; /* that it rests on */
};

/* The line through cells seen twice, both times with like noise (Deming's), robustly: cells off it
 * by more than four of their median deviation hardly count. lag of ret_line is not set.
 * Fails with GSN_E_STAIN when there are fewer than 100 cells or they are so alike that a line is
 * not told; GSN_E_NOMEM. No value may be NaN. */
int gsn_level_line(const double *before, const double *after, size_t count,
                   struct gsn_level_line *ret_line, struct gsn_error *err);

struct gsn_level {
    double gain, offset;
};

/* Panels of one block, at most. */
enum { GSN_LEVEL_PANELS = 64 };

/* How well the panels could be levelled. */
struct gsn_level_fit {
    double at[2];               /* the two densities between which tissue lies mostly */
    double drift[2];            /* what tissue itself changes by at those, per section */
    double covariance[3];       /* of one step at those: 00, 01, 11 */
    double drift_covariance[3]; /* of drift; what it is off by, all steps are off by */
    size_t steps;
    double lag[GSN_LEVEL_PANELS];        /* of each step, sections */
    double kept;                         /* share of the steps that is more than error, 0..1 */
    double gain_scatter, offset_scatter; /* standard deviations from panel to panel */
};

/* The levels of panels that follow each other, from the steps between them (one less than panels)
 * and from lines within them (four at least). The mean of the levels is gain 1, offset 0: what all
 * panels share is not told by steps. Steps are shrunk by the share of them that their own error
 * explains (their sum of squares in units of the error is compared with that of mere error), so
 * panels that are even stay as they are.
 * Fails with GSN_E_STAIN when there are too few lines, GSN_LEVEL_PANELS steps or a step turns the
 * order of densities round.
 */
int gsn_level_chain(const struct gsn_level_line *step, size_t steps,
                    const struct gsn_level_line *within, size_t lines, const double at[2],
                    struct gsn_level *ret_level, struct gsn_level_fit *ret_fit,
                    struct gsn_error *err);

/* Covariance of what the errors of the steps lift two sums over panels by: one weighs the panels by
 * a, the other by b, and they lie at these densities. Weights are fit->steps + 1 each; those of one
 * sum to 0, as all panels alike are nobody's step. */
double gsn_level_covariance(const struct gsn_level_fit *fit, const double *a, double density_a,
                            const double *b, double density_b);
/* Standard error of a mean density, at that density, over panels with these shares of the region
 * (they sum to 1), against the mean of all panels. */
double gsn_level_error(const struct gsn_level_fit *fit, const double *share, double density);

#ifdef __cplusplus
}
#endif
#endif
