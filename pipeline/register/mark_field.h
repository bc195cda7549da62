/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Dark round spots on a reduced picture: where it is worth looking for marks.
 *
 * Cells of some 25 um carry the optical density of the red channel. Differences of blurs (B3
 * splines, a factor of about two apart) answer to discs of about their size; whoever answers most
 * strongly around is a spot. Places are right to about half a cell, radii to a third: a fit
 * (mark_fit.h) goes back to the pixels. Lengths are panel pixels, centres at +0.5. */
#ifndef GSN_REGISTER_MARK_FIELD_H
#define GSN_REGISTER_MARK_FIELD_H

#include "pipeline/core/error.h"
#include "pipeline/core/image.h"
#include "pipeline/register/markers.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_mark_field {
    size_t width, height; /* cells */
    double cell_px;
    struct gsn_point origin_px; /* corner of the first cell */
    float *od;                  /* width x height; must be finite */
};

/* Radius of an ordinary laser burn, um. */
extern const double gsn_mark_radius_least_um, gsn_mark_radius_most_um;
/* Optical density below which nothing is called a spot. */
extern const double gsn_mark_contrast_least;

/* Pixels along the side of a cell, 1 or more. */
size_t gsn_mark_field_step(double px_um);

/* The strongest spots, strongest first, with place, radius, contrast and score; their covariance is
 * that of a cell. borrows: field. ret_spots has room for most of them; ret_count may be 0. Fails
 * with GSN_E_NOMEM. */
int gsn_mark_field_spots(const struct gsn_mark_field *field, double px_um, size_t most,
                         struct gsn_mark *ret_spots, size_t *ret_count, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
