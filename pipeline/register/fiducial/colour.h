/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The marks of a section that is a picture of its own, from all its channels.
 *
 * Only some of the rows are read to find the blobs, and only a window around each is kept, so that
 * the picture itself may go. A blob is measured when it matters. For that the channels are mixed
 * into one: the mixture in which the mark differs most from the tissue around it, measured in how
 * much that tissue differs from place to place (Fisher's discriminant). Char is neutral and dyes
 * are not, so what the dyes do under the edge of the mark all but cancels. Lengths as in
 * fiducial.h.
 */
#ifndef GSN_REGISTER_FIDUCIAL_COLOUR_H
#define GSN_REGISTER_FIDUCIAL_COLOUR_H

#include "pipeline/core/error.h"
#include "pipeline/core/image.h"
#include "pipeline/core/mem.h"
#include "pipeline/register/fiducial/fiducial.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_colour_candidates {
    struct gsn_fiducial_candidates candidates; /* coarse as long as they are not measured */
    int measured[GSN_FIDUCIAL_CANDIDATES];
    struct gsn_image *window[GSN_FIDUCIAL_CANDIDATES];
    int x[GSN_FIDUCIAL_CANDIDATES],
        y[GSN_FIDUCIAL_CANDIDATES]; /* place of the window's first pixel */
};

/* borrows: picture, codes of transmitted light (whatever the curve). gives: ret_spots. Finding
 * nothing is no error. Fails with GSN_E_INPUT when px_um is not positive or too coarse for a mark;
 * GSN_E_NOMEM. */
int gsn_colour_candidates_find(const struct gsn_image *picture, double px_um,
                               struct gsn_colour_candidates **ret_spots, struct gsn_error *err);
void gsn_colour_candidates_free(struct gsn_colour_candidates *spots);
GSN_DEFINE_AUTO(gsn_colour_candidates);

/* Looks for another kind of burn than the ordinary, of gsn_burns: in the red channel alone,
 * and every blob is measured. borrows: picture. tissue_px: centre of the tissue. Fails as
 * gsn_fiducials_detect(). */
int gsn_colour_candidates_find_burns(const struct gsn_image *picture, double px_um,
                                     struct gsn_point tissue_px, unsigned burn,
                                     struct gsn_fiducial_candidates *ret_candidates,
                                     struct gsn_error *err);

/* Replaces candidate i by what the fit says; one that is no disc keeps its place and loses its
 * score. Does nothing for one that is measured already. The caller guarantees i < count. Fails with
 * GSN_E_NOMEM. */
int gsn_colour_candidates_localise(struct gsn_colour_candidates *spots, size_t i,
                                   struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
