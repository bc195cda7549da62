/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The pixels that speak for the dyes, as the parts of this folder share them. */
#ifndef GSN_STAIN_SAMPLE_H
#define GSN_STAIN_SAMPLE_H

#include "pipeline/stain/dyes.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_SAMPLE_LEAST = 1000 };

struct gsn_stain_pixel {
    float od[3];
    float noise[3]; /* deviation of od */
};

struct gsn_stain_sample {
    struct gsn_stain_pixel *pixel; /* owned */
    size_t count;
};

#ifdef __cplusplus
}
#endif
#endif
