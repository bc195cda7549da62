/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The mean density of one picture of tissue, and how well it is known.
 *
 * Nobody measured this slide's light or its dyes, so each figure comes with what it would be if
 * that were otherwise. */
#ifndef GSN_PIPELINE_TILE_DENSITY_H
#define GSN_PIPELINE_TILE_DENSITY_H

#include "pipeline/stain/stain_vectors.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How bright the empty slide is, where too little of it shows to be measured as glass is: by the
 * palest parts of the picture. */
struct gsn_palest {
    struct gsn_flat_field glass;  /* even; its fraction is 0 */
    struct gsn_flat_field darker; /* the same by four times as much of the picture */
    double share;            /* of the picture that was taken */
    double clipped;          /* share of its samples at the highest code */
};

/* Fails with GSN_E_STAIN when the picture is black, GSN_E_INPUT when it is grey or has less than
 * one cell of 8 x 8 pixels, GSN_E_NOMEM. */
int gsn_palest_find(const struct gsn_image *image, enum gsn_light light,
                    struct gsn_palest *ret_palest, struct gsn_error *err);

struct gsn_tile_density {
    double mean;         /* collagen-equivalent density over the tissue */
    double yellow, dark; /* mean optical densities of the other dyes there */
    double red;          /* and of the red one */
    double red_share;    /* red of all three; how strong the stain is drops out of it */
    double by_white;     /* standard errors of the mean: by the white, */
    double by_detail;    /* by what is finer than a cell, as JPEG takes it away, */
    double by_vectors;   /* by the dye vectors */
    double error;        /* all three */
};

/* fit: the vectors and how well they are known. darker: NULL where the glass was measured or
 * stated. Fails with GSN_E_STAIN when there is no tissue or the dyes are too alike, GSN_E_INPUT on
 * a picture of less than one cell, GSN_E_NOMEM. */
int gsn_tile_density(const struct gsn_image *image, const struct gsn_flat_field *glass,
                     const struct gsn_flat_field *darker, const struct gsn_dyes_fit *fit,
                     struct gsn_tile_density *ret_density, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
