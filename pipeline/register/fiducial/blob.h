/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Blobs, dark and round, on a reduced picture: where it is worth looking for marks.
 *
 * Cells of some 25 um carry the optical density of the red channel. Differences of blurs (B3
 * splines, a factor of about two apart) answer to discs of about their size; whoever answers most
 * strongly around is a blob. Places are right to about half a cell, radii to a third: a fit
 * (localise.h) goes back to the pixels. Lengths are panel pixels, centres at +0.5. */
#ifndef GSN_REGISTER_FIDUCIAL_BLOB_H
#define GSN_REGISTER_FIDUCIAL_BLOB_H

#include "pipeline/core/error.h"
#include "pipeline/core/image.h"
#include "pipeline/register/fiducial/fiducial.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_blob_field {
    size_t width, height; /* cells */
    double cell_px;
    struct gsn_point origin_px; /* corner of the first cell */
    float *od;                  /* width x height; must be finite */
};

/* Radius of an ordinary laser burn, um. */
extern const double gsn_burn_radius_min_um, gsn_burn_radius_max_um;
/* Optical density below which nothing is called a blob. */
extern const double gsn_blob_contrast_min;

/* Pixels along the side of a cell, 1 or more. */
size_t gsn_blob_cell_px(double px_um);

/* The strongest blobs, strongest first, with place, radius, contrast and score; their covariance is
 * that of a cell. borrows: field. ret_blobs has room for most of them; ret_count may be 0. Fails
 * with GSN_E_NOMEM. */
int gsn_blobs_find(const struct gsn_blob_field *field, double px_um, size_t most,
                   struct gsn_fiducial *ret_blobs, size_t *ret_count, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
