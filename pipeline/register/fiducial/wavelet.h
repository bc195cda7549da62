/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The a-trous wavelet transform of a picture with the B3-spline kernel 1 4 6 4 1: smoothed
 * pictures, each about twice as blurred as the one before, and the details between two of them.
 *
 * Rows are worked out as they are asked for, from the first to the last, and only those that others
 * need are kept: whole planes would cost more in memory touched for the first time than in
 * arithmetic. Edges repeat. */
#ifndef GSN_REGISTER_FIDUCIAL_WAVELET_H
#define GSN_REGISTER_FIDUCIAL_WAVELET_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_WAVELET_LEVELS = 4, GSN_WAVELET_SCALES = GSN_WAVELET_LEVELS - 1 };
/* Rows of a detail that are at hand; a power of two. */
enum { GSN_WAVELET_ROWS = 4 };
/* By which the levels blur, pixels squared. */
extern const double gsn_wavelet_variance[GSN_WAVELET_LEVELS];

struct gsn_wavelet {
    const float *value; /* the picture */
    size_t width, height;
    size_t scales;                     /* details, one less than levels */
    size_t kept;                       /* rows of a level that are at hand: a power of two */
    size_t done[GSN_WAVELET_LEVELS];   /* rows of each level so far */
    float *level[GSN_WAVELET_LEVELS];  /* kept rows */
    float *detail[GSN_WAVELET_SCALES]; /* level k less level k + 1 */
    float *margin;                     /* a row, and what repeats on either side */
    float *buffer;                     /* all of the above */
};

/* borrows: value, width x height finite numbers, as long as the transform is used. The caller
 * guarantees width, height > 0 and 1 to GSN_WAVELET_SCALES scales. Fails with GSN_E_NOMEM. */
int gsn_wavelet_init(struct gsn_wavelet *wavelet, const float *value, size_t width, size_t height,
                     size_t scales, struct gsn_error *err);
void gsn_wavelet_done(struct gsn_wavelet *wavelet);

/* Makes rows y - 1, y and y + 1 available, of what there are; y never falls. */
void gsn_wavelet_advance(struct gsn_wavelet *wavelet, size_t y);

static inline const float *gsn_wavelet_level(const struct gsn_wavelet *wavelet, size_t level,
                                             size_t y)
{
    return wavelet->level[level] + (y & (wavelet->kept - 1)) * wavelet->width;
}

static inline const float *gsn_wavelet_detail(const struct gsn_wavelet *wavelet, size_t scale,
                                              size_t y)
{
    return wavelet->detail[scale] + (y & (GSN_WAVELET_ROWS - 1)) * wavelet->width;
}

#ifdef __cplusplus
}
#endif
#endif
