/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The last two steps of every picture: its label is written, and the lamp is switched on. */
#ifndef GSN_PHANTOM_EXPOSE_H
#define GSN_PHANTOM_EXPOSE_H

#include "pipeline/core/image.h"
#include "pipeline/phantom/plan.h"

#ifdef __cplusplus
extern "C" {
#endif

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
