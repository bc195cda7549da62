/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where marks are looked for: the optical density (log10) of a panel's red channel, read where it
 * is asked for.
 *
 * Spots are told from a few pixels of each cell of 25 um, and only around a spot are all of them
 * read, so that most of a panel never becomes density. Lengths are panel pixels, centres at +0.5.
 */
#ifndef GSN_REGISTER_MARK_DENSITY_H
#define GSN_REGISTER_MARK_DENSITY_H

#include "pipeline/core/error.h"
#include "pipeline/core/image.h"
#include "pipeline/register/mark_field.h"
#include "pipeline/register/markers.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Averages some pixels of each step x step to a cell of the field, whose first begins at the slot's
 * corner; masked pixels take no part. Fails with GSN_E_NOMEM. */
int gsn_mark_density_reduce(const struct gsn_mark_density *density, const struct gsn_slot *slot,
                            size_t step, struct gsn_mark_field *field, struct gsn_error *err);

/* The same with holes filled that a dark rim encloses (mark_fill.h): all pixels are read, and rims
 * are kept closed where they are as narrow as a third of a cell. */
int gsn_mark_density_reduce_filled(const struct gsn_mark_density *density,
                                   const struct gsn_slot *slot, size_t step,
                                   struct gsn_mark_field *field, struct gsn_error *err);

/* gsn_mark_fit() with the pixels of the slot around start; holes: filled first. */
int gsn_mark_density_fit(const struct gsn_mark_density *density, const struct gsn_slot *slot,
                         struct gsn_point start, double radius_px, int holes,
                         struct gsn_mark *ret_mark, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
