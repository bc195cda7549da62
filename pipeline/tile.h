/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One picture of stained tissue, without sections or depth: its collagen map, and how well the map
 * agrees with one that somebody else made. */
#ifndef GSN_PIPELINE_TILE_H
#define GSN_PIPELINE_TILE_H

#include "pipeline/pictures.h"
#include "pipeline/scan.h"
#include "pipeline/specimen.h"
#include "pipeline/stain/collagen_density.h"
#include "pipeline/tile_density.h"

#ifdef __cplusplus
extern "C" {
#endif

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
    struct gsn_account_picture picture[4]; /* png owned */
};

/* gives. Fails as gsn_scan_open(), gsn_scan_dyes() and gsn_collagen_map() do; with GSN_E_INPUT when
 * the reference is of another size. */
int gsn_tile_work(const struct gsn_specimen *specimen, const struct gsn_specimen_options *options,
                  struct gsn_tile **ret_tile, struct gsn_error *err);
void gsn_tile_free(struct gsn_tile *tile);
GSN_DEFINE_AUTO(gsn_tile);

#ifdef __cplusplus
}
#endif
#endif
