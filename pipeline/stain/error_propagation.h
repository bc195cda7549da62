/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How far a density, and a loss, could be off, given how well the stain vectors and the white are
 * known.
 *
 * A vector that is off by a degree lets yellow or dark dye leak into red, by an amount that depends
 * on the tissue; so the slopes are taken on the tissue itself. Pictures that were stained together
 * share the vectors, and most of the leak cancels in the ratio of their densities. */
#ifndef GSN_STAIN_ERROR_PROPAGATION_H
#define GSN_STAIN_ERROR_PROPAGATION_H

#include "pipeline/stain/stain_vectors.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ---- a mean density ---------------------------------------------------------------------- */

/* How far a density could be off, given how well the dye vectors and the white are known.
 *
 * A vector that is off by a degree lets yellow or dark dye leak into red, by an amount that depends
 * on the tissue; so the slopes are taken on the tissue itself. Pictures that were stained together
 * share the vectors, and most of the leak cancels in the ratio of their densities. */

/* The mean density of a piece of tissue, and what moves it. */
struct gsn_collagen_mean {
    double mean;                   /* collagen-equivalent density, 1 = full */
    double by_turn[GSN_DYE_ROTATIONS]; /* per radian */
    double by_white[3];            /* per unit of optical density that the white is off */
};

/* mask: 8-bit grey, 0 leaves a pixel out; NULL takes all. Pixels that are not finite are left out.
 * Fails with GSN_E_STAIN when no pixel is left or the dyes cannot be told apart, GSN_E_INPUT when
 * sizes differ. */
int gsn_collagen_mean(struct gsn_plane *const od[3], const struct gsn_image *mask,
                      const struct gsn_dyes *dyes, struct gsn_collagen_mean *ret_mean,
                      struct gsn_error *err);

/* Relative standard error of the mean. fit: of the dyes that it was unmixed with. white_od:
 * standard error of the white, per channel. */
double gsn_collagen_mean_error(const struct gsn_collagen_mean *red, const struct gsn_dyes_fit *fit,
                               double white_od);

/* ---- what an error of the vectors leaves in a loss --------------------------------------- */

/* The stain of both specimens was compared by tissue that nobody treated. A vector that is off
 * multiplies red and adds to it, and that the control tissues show as well: the line through them
 * takes it out (normalisation.h). Two things stay. What is added to both sides alike cancels in
 * their difference and not in their ratio; and tissue that holds more of another dye than control
 * tissue of its density does, as inflamed bone holds nuclei, lies off the line. */

/* What an error of the dye vectors leaves in a loss once the stain of both specimens was compared
 * by tissue that nobody treated.
 *
 * A vector that is off multiplies red and adds to it, and that the untreated tissues show as well:
 * the line through them takes it out (stain/normalisation.h). Two things stay. What is added to
 * both sides alike cancels in their difference and not in their ratio; and tissue that holds more
 * of another dye than untreated tissue of its density does, as inflamed bone holds nuclei, lies off
 * the line.
 */

/* A tissue's mean density, and how it moves as the vectors turn. Begins as zeros. */
struct gsn_vector_error {
    double red;
    double by_turn[GSN_DYE_ROTATIONS]; /* per radian */
    double weight;                 /* of all that was added */
};

/* Adds tissue of these mean densities, seen with these vectors.
 * Fails with GSN_E_STAIN when the vectors lie in one plane. */
int gsn_vector_error_add(struct gsn_vector_error *tissue, const struct gsn_dyes *dyes,
                         const double od[3], double weight, struct gsn_error *err);

/* Variances, relative to the density of the region. */
struct gsn_vector_error_left {
    int known;
    double off;  /* by what the region is off the line through the untreated tissues */
    double zero; /* by where that line puts density 0 */
    double both; /* covariance of the two */
};

/* What is left in a region's density. Not known where fewer than two tissues have weight, the
 * region has none, or the tissues are of one density. */
struct gsn_vector_error_left
gsn_vector_error_left_of(const struct gsn_vector_error *tissue, size_t count,
                         const struct gsn_vector_error *region,
                         const double covariance[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS]);

/* What vectors turn by from panel to panel. */
struct gsn_vector_scatter {
    double variance; /* of one turn, rad^2 */
    double freedom;  /* degrees of, that it is known by; 0: not known */
};

/* The scatter that makes density 0 scatter by this variance from panel to panel. Not known where
 * the tissues tell no line. */
struct gsn_vector_scatter gsn_vector_scatter_of(const struct gsn_vector_error *tissue, size_t count,
                                                double zero_variance, double freedom);

/* Of two specimens' panels together. */
struct gsn_vector_scatter gsn_vector_scatter_pool(const struct gsn_vector_scatter *a,
                                                  const struct gsn_vector_scatter *b);

/* Standard deviation of one turn, rad, wide enough that 1.96 of it hold 95 % though it is known
 * from few panels (the standard deviation of Student's distribution); 0: not known. */
double gsn_vector_scatter_deviation(const struct gsn_vector_scatter *scatter);

/* Relative standard error of the region's density over the baseline's, when it is this. */
double gsn_vector_error_of_loss(const struct gsn_vector_error_left *left, double ratio);

#ifdef __cplusplus
}
#endif

#endif
