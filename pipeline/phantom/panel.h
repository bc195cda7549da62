/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A panel as the scanner delivers it: twelve stained sections on glass, and a label. */
#ifndef GSN_PHANTOM_PANEL_H
#define GSN_PHANTOM_PANEL_H

#include "pipeline/core/image.h"
#include "pipeline/phantom/section.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Draws the panel of a file, RGB of the file's bits, upright; the codes of 16 bits are 257 times
 * those of 8. gives: ret_image; ret_extent is by slot, as many as a panel has. The pixels do not
 * depend on the number of threads. Fails with GSN_E_NOMEM. borrows: plan, file. */
int gsn_phantom_panel_draw(const struct gsn_phantom_plan *plan, const struct gsn_phantom_file *file,
                           unsigned threads, struct gsn_image **ret_image,
                           struct gsn_phantom_extent *ret_extent, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
