/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Filters of planes and of bytes, differences, and a plane at half the resolution. */
#ifndef GSN_IMAGING_FILTER_H
#define GSN_IMAGING_FILTER_H

#include "pipeline/core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: the mean over (2 radius + 1)^2 pixels, fewer at the border. No value may be NaN. */
int gsn_box_mean(const struct gsn_plane *plane, uint32_t radius, struct gsn_plane **ret_mean,
                 struct gsn_error *err);

/* The sums over (2 radius + 1)^2 pixels of a plane of width * height, with nothing beyond the
 * border; to is another plane of that size. */
int gsn_box_sum(const float *from, uint32_t width, uint32_t height, uint32_t radius, float *to,
                struct gsn_error *err);

/* Differences of the neighbours on either side, right less left into dx and lower less upper into
 * dy, times scale; at the border the plane goes on as its edge. dx and dy are planes of that
 * size. */
int gsn_differences(const float *from, uint32_t width, uint32_t height, double scale, float *dx,
                    float *dy, struct gsn_error *err);

/* The median of 3 x 3 bytes (of a set: what most of them are); at the border the picture goes on as
 * its edge. In place. */
int gsn_median_3(uint8_t *bytes, uint32_t width, uint32_t height, struct gsn_error *err);

/* The means of two by two pixels, (width / 2) * (height / 2) of them, whose corners coincide; a
 * last odd row or column is left out. width and height are 2 or more. */
int gsn_halve(const float *from, uint32_t width, uint32_t height, float *to, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
