/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The appearance of blobs: whether one is a mark, or a blob that lies there by chance.
 *
 * By appearance a blob is told by how strong and how large it is: beside the section's other blobs
 * as long as nothing is learnt, beside the stack's marks afterwards. By place: given two marks, the
 * third is where the triangle puts it, as far as sections stretch and tear; a blob that is no mark
 * lies anywhere. How often a mark looks so unlike the typical one, and how often anything else
 * looks as like it, is counted on the sections whose marks are clear. The likelihood ratio is that
 * of the two, with how often a mark is seen at all. */
#ifndef GSN_REGISTER_FIDUCIAL_APPEARANCE_H
#define GSN_REGISTER_FIDUCIAL_APPEARANCE_H

#include "pipeline/register/fiducial/fiducial.h"

#ifdef __cplusplus
extern "C" {
#endif

/* -2 ln of the likelihood that a blob's looks give: burns of one stack are about as strong and as
 * large as each other. The caller guarantees that the prior is learnt. */
double gsn_appearance_distance(const struct gsn_fiducial *mark, double px_um,
                               const struct gsn_triangle_prior *prior);

/* The same for what the fit leaves unexplained of the picture: dirt that touches the mark. */
double gsn_appearance_residual(const struct gsn_fiducial *mark);

/* How many times more often a mark looks like this blob than blobs that are none do, these per
 * um^2: the odds of its looks, in um^2. The caller guarantees that the prior is learnt. */
double gsn_appearance_ratio(const struct gsn_fiducial *mark, double px_um,
                            const struct gsn_triangle_prior *prior);

/* Burns that are seen where one belongs. */
#define GSN_FIDUCIAL_SEEN 0.95

/* What clear sections show, by classes of unlikeness: each reaches twice as far as the one before,
 * the first to 1, the last to anything. */
struct gsn_appearance_counts {
    double marks;
    double
        alike[GSN_APPEARANCE_CLASSES]; /* marks that are at least as unlike as the class begins */
    double
        seen[GSN_APPEARANCE_CLASSES]; /* blobs that are none, at most as unlike as the class ends */
    double area_um2;                  /* where they were counted: as far as the marks lie */
    double sections;
};

/* Adds one section, its marks and its other blobs. borrows: everything. */
void gsn_appearance_count(const struct gsn_fiducial_candidates *section,
                          const struct gsn_fiducial marks[GSN_FIDUCIALS],
                          const struct gsn_triangle_prior *prior,
                          struct gsn_appearance_counts *counts);

/* Fills alike and chance of the prior, with 0 where nothing was counted. */
void gsn_appearance_learn(const struct gsn_appearance_counts *counts,
                          struct gsn_triangle_prior *prior);

/* How far sections of this stack move a mark, one standard deviation per axis. */
struct gsn_displacement {
    double ordinary_um, loose_um, torn_um;
    double ordinary, loose, torn; /* shares of the sections; together 1 */
};

/* Odds for a blob that lies away_um from where two marks apart_um from each other put the third,
 * whose place is across_um from their middle. */
double gsn_third_mark_ratio(const struct gsn_fiducial *blob, double px_um,
                            const struct gsn_triangle_prior *prior,
                            const struct gsn_displacement *moves, double away_um, double apart_um,
                            double across_um);

/* The same for one that lies away_um from where something else than marks lays the mark, with this
 * error per axis. */
double gsn_placed_mark_ratio(const struct gsn_fiducial *blob, double px_um,
                             const struct gsn_triangle_prior *prior,
                             const struct gsn_displacement *moves, double away_um, double error_um);

/* Of a blob that is less alike (-2 ln of its likelihood), looks say nothing more. */
#define GSN_APPEARANCE_DISTANCE_MAX 8.0

/* Whether a blob is of a strength and size that a mark may have. */
int gsn_appearance_acceptable(const struct gsn_fiducial_candidates *section, size_t i,
                              const struct gsn_triangle_prior *prior);

/* -2 ln of the likelihood of these blobs' looks, no blob counting for more than most. candidate:
 * indices, or -1 where a mark is not there. */
double gsn_appearance_sum(const struct gsn_fiducial_candidates *section,
                          const struct gsn_triangle_prior *prior,
                          const int candidate[GSN_FIDUCIALS], double most);

/* Whether all of them look as the stack's marks do. */
int gsn_appearance_alike(const struct gsn_fiducial_candidates *section,
                         const struct gsn_triangle_prior *prior,
                         const int candidate[GSN_FIDUCIALS]);

#ifdef __cplusplus
}
#endif
#endif
