/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Small pictures of sections for the report: thumbnails with their marks, and sections as each of
 * their candidate poses would have them. */
#ifndef GSN_SPECIMEN_SECTION_PICTURES_H
#define GSN_SPECIMEN_SECTION_PICTURES_H

#include "pipeline/core/image.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/specimen/analysis.h"
#include "pipeline/specimen/density_stack.h"
#include "pipeline/specimen/scan.h"
#include "pipeline/stain/flat_field.h"

/* gives: a picture of at most longest_px of this box of a scan (RGB), with the marks ringed, as
 * JPEG of this quality; 0: as PNG. light: what its samples mean. The box lies inside the image.
 * Fails with GSN_E_NOMEM. */
int gsn_thumbnail(const struct gsn_image *image, enum gsn_light light, int x, int y, int width,
                  int height, const struct gsn_fiducial mark[GSN_FIDUCIALS], unsigned longest_px,
                  int quality, struct gsn_png_picture *ret_picture, struct gsn_error *err);

/* A box of a scan and how it lies in the block; the box lies inside the image. */
struct gsn_placed_box {
    struct gsn_affine panel_to_block_um;
    int x, y, width, height;
};

/* A processor without fused multiply-adds finds poses that differ in their last digits, and a pixel
 * at the edge of another would be taken or not: what is drawn is settled to these. */
struct gsn_affine gsn_settled_pose(const struct gsn_affine *panel_to_block_um);

/* gives: what a scan (RGB) shows in its box as it lies in the block, on white: side_px square
 * pixels of um_per_px from the corner on. light: as above. Fails with GSN_E_NOMEM. */
int gsn_placed_picture(const struct gsn_image *image, enum gsn_light light,
                       const struct gsn_placed_box *box, struct gsn_point corner, double um_per_px,
                       unsigned side_px, struct gsn_image **ret_picture, struct gsn_error *err);

/* Whether it is certain enough where a section lies to hold others against it. */
int gsn_section_is_placed(const struct gsn_section *section);
/* The corner and side of a square around the middle of the placed sections, so many times as wide
 * as the typical one; side 0: none is placed. Fails with GSN_E_NOMEM. */
int gsn_placed_frame(const struct gsn_poses *poses, double room, struct gsn_point *ret_corner,
                     double *ret_side_um, struct gsn_error *err);

/* A candidate sheet: doubtful sections as each of their candidates would lay them, in the block
 * frame, with the outline of the nearest section whose place is known: small pictures to choose by.
 *
 * Panels are opened one after the other, so what each shows is gathered as it comes, and drawn at
 * the end. */

/* Opaque. */
struct gsn_candidate_sheet;

/* gives: an empty sheet; NULL when there is nothing to choose or no section to compare with. Fails
 * with GSN_E_NOMEM. */
int gsn_candidate_sheet_new(const struct gsn_poses *poses, struct gsn_candidate_sheet **ret_sheet,
                            struct gsn_error *err);
void gsn_candidate_sheet_free(struct gsn_candidate_sheet *sheet);
GSN_DEFINE_AUTO(gsn_candidate_sheet);

/* Takes what an opened panel of this number shows; sheet may be NULL. Fails with GSN_E_NOMEM. */
int gsn_candidate_sheet_look(struct gsn_candidate_sheet *sheet, const struct gsn_poses *poses,
                             const struct gsn_scan *scan, unsigned panel, struct gsn_error *err);

/* Draws the pictures into the reconstruction's sections; sheet may be NULL. Fails with GSN_E_NOMEM.
 */
int gsn_candidate_sheet_draw(struct gsn_candidate_sheet *sheet, const struct gsn_poses *poses,
                             struct gsn_densities *densities, struct gsn_error *err);

#endif
