/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The registered sections as a true-colour volume, beside the density of resample.h.
 *
 * Between pixels light is averaged, not codes: half of the light of black and white is the sRGB
 * code 188, and not 128. Weights are never negative, so no colour is made up beside an edge. */
#ifndef GSN_REGISTER_STACK_RESAMPLE_COLOUR_H
#define GSN_REGISTER_STACK_RESAMPLE_COLOUR_H

#include "pipeline/core/colour_grid.h"
#include "pipeline/core/image.h"
#include "pipeline/register/stack/resample.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Light in whole numbers: 0 to GSN_STACK_FULL_LIGHT. */
#define GSN_STACK_FULL_LIGHT (255 * 128)

/* What the samples of a picture mean. Both borrowed. */
struct gsn_stack_light {
    const uint16_t *of_sample; /* light of each of the 2^bits samples */
    const uint8_t *code;       /* sRGB code of light / 4, GSN_STACK_FULL_LIGHT / 4 + 1 of them; none
                                  is 0, which means "no data" */
};

/* Resamples a section of the picture into its planes of the grid; other planes, and voxels beside
 * the section, are left as they are. section->density is not looked at. borrows: all.
 *
 * Bilinear where a voxel is no larger than a pixel, else a tent as wide as two voxels. The result
 * does not depend on threads (0: all) nor on the processor. Fails, with the grid untouched, with
 * GSN_E_INPUT when the picture is grey, the box reaches outside of it or the affine map is
 * singular; GSN_E_NOMEM. */
int gsn_stack_resample_colour(const struct gsn_stack_section *section,
                              const struct gsn_image *image, const struct gsn_stack_light *light,
                              double interval_um, unsigned threads, struct gsn_colour_grid *grid,
                              struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
