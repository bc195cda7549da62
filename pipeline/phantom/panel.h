/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A panel as the scanner delivers it: stained sections on glass, and a label. */
#ifndef GSN_PHANTOM_PANEL_H
#define GSN_PHANTOM_PANEL_H

#include "pipeline/core/image.h"
#include "pipeline/phantom/plan.h"
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

/* The last two steps of every picture: its label is written, and the lamp is switched on. */

/* The optical density of a panel: R, G, B per pixel, row by row. */
struct gsn_phantom_glass {
    uint32_t width, height;
    double px_um;
    float *od;
};

/* Writes the specimen's name, the panel's ("P03") and both as a Data Matrix, unless the variant has
 * no labels. */
int gsn_phantom_label_write(const struct gsn_phantom_plan *plan, const char *panel,
                            const struct gsn_phantom_glass *glass, struct gsn_error *err);

/* gives: RGB of 8 or 16 bits, in the light and on this white; borrows: white. noise names the
 * stream of its noise. The pixels do not depend on the number of threads. Fails with GSN_E_NOMEM.
 */
int gsn_phantom_expose(const struct gsn_phantom_plan *plan, const struct gsn_phantom_glass *glass,
                       const double white[3], int noise, uint32_t bits, unsigned threads,
                       struct gsn_image **ret_image, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
