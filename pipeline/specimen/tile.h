/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One picture of stained tissue, without sections or depth: its collagen map, and how well the map
 * agrees with one that somebody else made. */
#ifndef GSN_SPECIMEN_TILE_H
#define GSN_SPECIMEN_TILE_H

#include "pipeline/specimen/scan.h"
#include "pipeline/specimen/section_pictures.h"
#include "pipeline/specimen/specimen.h"
#include "pipeline/stain/collagen_density.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/stain_vectors.h"

/* The mean density. Nobody measured this slide's light or its dyes, so each figure comes with what
 * it would be if that were otherwise. */

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

struct gsn_tile {
    struct gsn_flat_field glass;
    struct gsn_dyes_fit fit;
    double px_um; /* 0: nobody states it */
    int light_assumed, by_palest;
    struct gsn_palest palest; /* where by_palest */
    char note[400];
    struct gsn_collagen collagen; /* the map, pixel by pixel */
    struct gsn_tile_density density;
    int compared;
    struct gsn_overlap overlap;
    size_t picture_count;
    struct gsn_png_picture picture[4]; /* png owned */
};

/* gives. Fails as gsn_scan_open(), gsn_scan_dyes() and gsn_collagen_map() do; with GSN_E_INPUT when
 * the reference is of another size. */
int gsn_tile_process(const struct gsn_specimen *specimen,
                     const struct gsn_specimen_options *options, struct gsn_tile **ret_tile,
                     struct gsn_error *err);
void gsn_tile_free(struct gsn_tile *tile);
GSN_DEFINE_AUTO(gsn_tile);

#endif
