/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How the panels of a specimen come in: as which files, in which order, and what is wrong with
 * them. */
#ifndef GSN_PHANTOM_DELIVERY_H
#define GSN_PHANTOM_DELIVERY_H

#include "pipeline/core/image.h"
#include "pipeline/phantom/buffer.h"
#include "pipeline/phantom/plan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Fills in the files of a plan. Up to L2, and at L3-whole, each panel comes once, in order. At L3
 * one panel does not come at all, one is cut short, one is stored turned, one is a TIFF of 16 bits
 * and one states a wrong resolution; the turned one is scanned a second time, upright, and comes
 * last; the order of the others is any. */
void gsn_phantom_delivery_draw(struct gsn_phantom_plan *plan);

/* gives: the name of file i; NULL when memory runs out. Where the order is any, it begins with the
 * place in the order of delivery. */
char *gsn_phantom_delivery_name(const struct gsn_phantom_plan *plan, int i);

/* What the file of this upright picture is made of. */
int gsn_phantom_delivery_encode(const struct gsn_phantom_plan *plan,
                                const struct gsn_phantom_file *file, const struct gsn_image *image,
                                struct gsn_phantom_buffer *ret_file, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
