/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Discrete Fourier transforms of planes. */
#ifndef GSN_IMAGING_FOURIER_H
#define GSN_IMAGING_FOURIER_H

#include "pipeline/core/error.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Transforms width * height complex numbers in place, rows from top to bottom, a real part before
 * its imaginary one. back: the inverse, not divided by the number of them. */
int gsn_fourier(float *numbers, uint32_t width, uint32_t height, int back, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
