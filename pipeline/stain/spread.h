/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How far a density could be off, given how well the dye vectors and the white are known.
 *
 * A vector that is off by a degree lets yellow or dark dye leak into red, by an amount that depends
 * on the tissue; so the slopes are taken on the tissue itself. Pictures that were stained together
 * share the vectors, and most of the leak cancels in the ratio of their densities. */
#ifndef GSN_STAIN_SPREAD_H
#define GSN_STAIN_SPREAD_H

#include "pipeline/stain/dyes.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The mean density of a piece of tissue, and what moves it. */
struct gsn_red_mean {
    double mean;                   /* collagen-equivalent density, 1 = full */
    double by_turn[GSN_DYE_TURNS]; /* per radian */
    double by_white[3];            /* per unit of optical density that the white is off */
};

/* mask: 8-bit grey, 0 leaves a pixel out; NULL takes all. Pixels that are not finite are left out.
 * Fails with GSN_E_STAIN when no pixel is left or the dyes cannot be told apart, GSN_E_INPUT when
 * sizes differ. */
int gsn_red_mean(struct gsn_plane *const od[3], const struct gsn_image *mask,
                 const struct gsn_dyes *dyes, struct gsn_red_mean *ret_mean, struct gsn_error *err);

/* Relative standard error of the mean. fit: of the dyes that it was unmixed with. white_od:
 * standard error of the white, per channel. */
double gsn_red_error(const struct gsn_red_mean *red, const struct gsn_dyes_fit *fit,
                     double white_od);

#ifdef __cplusplus
}
#endif
#endif
