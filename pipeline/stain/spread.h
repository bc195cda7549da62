/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How far a density and a loss could be off, given how well the dye vectors and the white are
 * known.
 *
 * A vector that is off by a degree lets yellow or dark dye leak into red, by an amount that depends
 * on the tissue; so the slopes are taken on the tissue itself. Two pictures that were stained
 * together share the vectors, and most of the leak cancels in their ratio; stained apart they do
 * not. The whites are measured in each scan and never shared. */
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
    double sampling; /* standard error as if pixels were drawn one by one; sections and animals
                        vary besides */
    size_t pixels;
};

/* mask: 8-bit grey, 0 leaves a pixel out; NULL takes all. Pixels that are not finite are left out.
 * Fails with GSN_E_STAIN when no pixel is left or the dyes cannot be told apart, GSN_E_INPUT when
 * sizes differ. */
int gsn_red_mean(struct gsn_plane *const od[3], const struct gsn_image *mask,
                 const struct gsn_dyes *dyes, struct gsn_red_mean *ret_mean, struct gsn_error *err);

/* One side of a comparison. Borrows its parts. */
struct gsn_red_side {
    const struct gsn_red_mean *red;
    const struct gsn_dyes_fit *fit; /* of the dyes that red was unmixed with */
    double white_od;                /* standard error of the white, per channel */
    double gain;                    /* what the internal reference says red is to be divided by */
    double gain_error;              /* relative standard error of that; 0 with gain 1: none used */
};

/* Standard deviations of the loss, in percent, by their cause; the interval is theirs together. */
struct gsn_red_loss {
    double percent, lower, upper; /* 95 % */
    double by_vectors, by_whites, by_sampling, by_gain;
};

/* Loss of treated against control. same_batch: both fits are the same one, with the same error.
 * Fails with GSN_E_STAIN when the control holds no red. */
int gsn_red_loss(const struct gsn_red_side *control, const struct gsn_red_side *treated,
                 int same_batch, struct gsn_red_loss *ret_loss, struct gsn_error *err);

/* 95 % interval of one density: half its width. */
double gsn_red_half_width(const struct gsn_red_side *side);

#ifdef __cplusplus
}
#endif
#endif
