/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Stain unmixing (colour deconvolution): three dyes out of one optical density. Prepared once for
 * many pixels, or plane by plane. */
#ifndef GSN_STAIN_UNMIXING_H
#define GSN_STAIN_UNMIXING_H

#include "pipeline/stain/stain_vectors.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Three dyes out of one density, prepared once for many pixels. */

struct gsn_unmixer {
    double dye[3][3];
    double inverse[8][3]
                  [3]; /* of the Gram matrix of each subset; rows and columns of the others 0 */
};

/* Fails with GSN_E_STAIN as gsn_unmix() does. */
int gsn_unmixer_init(struct gsn_unmixer *mix, const struct gsn_dyes *dyes, struct gsn_error *err);

/* Amounts of red, yellow and dark as lengths in optical density, none below 0. */
void gsn_unmixer_apply(const struct gsn_unmixer *mix, const double od[3], double ret_amount[3]);

/* The length of what no such amounts explain. */
double gsn_unmixer_left(const struct gsn_unmixer *mix, const double od[3]);

/* gives: the amounts of the three dyes that explain the densities best in least squares, none
 * below 0. Red is divided by full_red_od: it is the collagen-equivalent density, 1 = full; yellow
 * and dark are lengths in optical density. ret_yellow and ret_dark may be NULL.
 * Fails with GSN_E_STAIN when two dyes are too alike (or a vector is not of length 1),
 * GSN_E_INPUT when the planes differ in size, GSN_E_NOMEM. */
int gsn_unmix(struct gsn_plane *const od[3], const struct gsn_dyes *dyes, unsigned threads,
              struct gsn_plane **ret_red, struct gsn_plane **ret_yellow,
              struct gsn_plane **ret_dark, struct gsn_error *err);

/* gsn_unmix() for one pixel: amounts of red, yellow and dark as lengths in optical density. */
int gsn_unmix_one(const double od[3], const struct gsn_dyes *dyes, double ret_amount[3],
                  struct gsn_error *err);

#ifdef __cplusplus
}
#endif

#endif
