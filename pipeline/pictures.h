/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The pictures of a report: three orthogonal cuts through data and model, one analytic X-ray, one
 * isosurface; and the small pictures of the contact sheet. */
#ifndef GSN_PIPELINE_PICTURES_H
#define GSN_PIPELINE_PICTURES_H

#include "pipeline/account.h"
#include "pipeline/core/image.h"
#include "pipeline/register/fiducial/fiducial.h"

#include "pipeline/stain/flat_field.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Appends the pictures to the account. Fails as the renderers do. */
int gsn_pictures_make(const struct gsn_grid *grid, const struct gsn_mask *region,
                      const struct gsn_protocol *protocol,
                      const struct gsn_account_options *options, struct gsn_account *account,
                      struct gsn_error *err);

/* gives: a PNG of at most longest_px of this box of a scan (RGB), with the marks ringed. light:
 * what its samples mean. The box lies inside the image. Fails with GSN_E_NOMEM. */
int gsn_thumbnail(const struct gsn_image *image, enum gsn_light light, int x, int y, int width,
                  int height, const struct gsn_mark mark[GSN_MARKS], unsigned longest_px,
                  struct gsn_account_picture *ret_picture, struct gsn_error *err);

/* A box of a scan and how it lies in the block; the box lies inside the image. */
struct gsn_laid_box {
    struct gsn_affine panel_to_block_um;
    int x, y, width, height;
};

/* gives: what a scan (RGB) shows in its box as it lies in the block, on white: side_px square
 * pixels of um_per_px from the corner on. light: as above. Fails with GSN_E_NOMEM. */
int gsn_laid_picture(const struct gsn_image *image, enum gsn_light light,
                     const struct gsn_laid_box *box, struct gsn_point corner, double um_per_px,
                     unsigned side_px, struct gsn_image **ret_picture, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
