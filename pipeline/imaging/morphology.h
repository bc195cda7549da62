/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Sets of pixels grown, worn down and filled. A set is width * height bytes, 0 or 1, changed in
 * place; beyond its border lies nothing that grows into it or wears it down. */
#ifndef GSN_IMAGING_MORPHOLOGY_H
#define GSN_IMAGING_MORPHOLOGY_H

#include "pipeline/core/error.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What lies within `radius` pixels of the set, centre to centre; the radius need not be whole. */
int gsn_dilate(uint8_t *set, uint32_t width, uint32_t height, double radius, struct gsn_error *err);
/* What lies deeper than that in the set: the complement's dilation, taken away. */
int gsn_erode(uint8_t *set, uint32_t width, uint32_t height, double radius, struct gsn_error *err);

/* The largest, or the smallest, of the values within `radius` pixels of each; width x height
 * numbers, none of them NaN, changed in place. */
int gsn_dilate_values(float *value, uint32_t width, uint32_t height, double radius,
                      struct gsn_error *err);
int gsn_erode_values(float *value, uint32_t width, uint32_t height, double radius,
                     struct gsn_error *err);

/* Adds what no way over so many neighbours, 4 or 8, from beyond the border reaches. */
int gsn_fill_holes(uint8_t *set, uint32_t width, uint32_t height, int neighbours,
                   struct gsn_error *err);

/* How far each pixel's centre is from the outline of a set that is not empty, in pixels: above 0 in
 * it, below 0 outside. The outline is taken to lie half a pixel beyond the outermost centres;
 * beyond the border lies nothing of the set. to: width * height numbers. */
int gsn_signed_distance(const uint8_t *set, uint32_t width, uint32_t height, float *to,
                        struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
