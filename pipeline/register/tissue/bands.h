/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A section's bands, as pairwise.c uses them. Private to these two files. */
#ifndef GSN_REGISTER_TISSUE_BANDS_H
#define GSN_REGISTER_TISSUE_BANDS_H

#include "pipeline/register/tissue/pairwise.h"

#include <stddef.h>

enum { GSN_TISSUE_LEVELS = 8, GSN_TISSUE_COARSE = 48 };

/* A band: w * h cells of 2^level cells of the first, and its slopes by central differences. */
struct gsn_tissue_band {
    size_t w, h;
    float *value, *dx, *dy;
};

/* Positions are cells of the first level; a cell's middle is at +0.5. */
struct gsn_tissue {
    double cell;
    size_t levels;
    struct gsn_tissue_band band[GSN_TISSUE_LEVELS]; /* the finest first; owned */
    float *whole; /* w * h of the coarsest level, less its surroundings: for the search; owned */
    struct gsn_point centre;
    double radius;
};

#endif
