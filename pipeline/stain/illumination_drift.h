/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How steady the light was while one panel was scanned.
 *
 * A scan is taken row by row, so a lamp that flickers or is still warming up leaves bands on the
 * blank glass that no smooth surface follows. What is left of the glass after its own surface was
 * taken out is what every density on the panel is wrong by. Lengths are optical densities. */
#ifndef GSN_STAIN_ILLUMINATION_DRIFT_H
#define GSN_STAIN_ILLUMINATION_DRIFT_H

#include "pipeline/stain/optical_density.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_illumination {
    double residual; /* root mean square of the glass about its surface; NaN: too little glass */
    double rows;     /* how far the brightest band of rows is from the darkest; NaN: not told */
    double columns;  /* the same across, for scanners that move that way */
};

/* od: R, G and B of the panel, as gsn_od_thin() gives them. box: the part of the picture to
 * look at, where no label and no frame is; it lies in the picture. borrows: both. */
struct gsn_illumination gsn_illumination_drift(struct gsn_plane *const od[3],
                                               const struct gsn_pixel_box *box);

#ifdef __cplusplus
}
#endif

#endif
