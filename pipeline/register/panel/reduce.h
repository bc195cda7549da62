/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A panel made small: what is needed to tell sections from glass, and no more.
 *
 * A panel of 48 million pixels holds twelve things of a few millimetres. Cells of about 50 um show
 * their outlines; each is the mean of a few of its pixels, so that most rows of the scan are never
 * read. */
#ifndef GSN_REGISTER_PANEL_REDUCE_H
#define GSN_REGISTER_PANEL_REDUCE_H

#include "pipeline/core/error.h"
#include "pipeline/core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Panel pixels along the side of one cell, 1 or more. px_um > 0. */
unsigned gsn_panel_step(double px_um);

/* gives: one pixel for each whole cell of step x step pixels, always 16 bits a sample: the mean of
 * at most nine pixels spread over the cell, codes as they are stored. Pixels of 8 bits are
 * stretched to 16. Fails with GSN_E_INPUT when not one cell fits, GSN_E_NOMEM. */
int gsn_panel_reduce(const struct gsn_image *image, unsigned step, struct gsn_image **ret_small,
                     struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
