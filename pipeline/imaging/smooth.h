/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Smoothing of float planes by separable kernels. width and height are 1 or more; no value may be
 * NaN. */
#ifndef GSN_IMAGING_SMOOTH_H
#define GSN_IMAGING_SMOOTH_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* By (1 2 1) / 4 along both axes, so many times, in place: a variance of times / 2 pixels. Beyond
 * the border lies the pixel at it. */
void gsn_smooth_binomial(float *plane, size_t width, size_t height, int times);

/* By a Gaussian of this standard deviation in pixels, up to GSN_SMOOTH_WIDEST, cut off at three of
 * them, in place. What lies beyond the border counts as 0. scratch: as large as the plane. */
#define GSN_SMOOTH_WIDEST 10
void gsn_smooth_gaussian(float *plane, size_t width, size_t height, double sigma, float *scratch);

#ifdef __cplusplus
}
#endif
#endif
