/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A section's bands, as the tissue files share them. Private to these files. */
#ifndef GSN_REGISTER_TISSUE_BANDS_H
#define GSN_REGISTER_TISSUE_BANDS_H

#include "pipeline/register/tissue.h"

#include <stddef.h>

enum { GSN_TISSUE_LEVELS = 8, GSN_TISSUE_COARSE = 48, GSN_TISSUE_GRID = 64 };

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

/* A motion between cells of the first level of two sections. */
struct gsn_tissue_fit {
    struct gsn_affine a_to_b;
    double information[3][3];
    double evidence, variance; /* of the evidence, by chance */
};

/* The likeliest starts of a search; most: room. Returns their number. Fails with GSN_E_NOMEM. */
int gsn_tissue_starts(const struct gsn_tissue *a, const struct gsn_tissue *b, size_t most,
                      struct gsn_affine *ret_start, size_t *ret_count, struct gsn_error *err);

#endif
