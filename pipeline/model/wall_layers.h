/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where the walls of a density are, as points for a mesh that follows them.
 *
 * A wall is where the density falls from one plateau to another within few voxels: the surface of
 * tissue, a canal, a marrow space. Level, blur and noise are estimated from the voxels. Points are
 * laid on level sets of one signed distance from that surface: such layers are nested, and where
 * two walls touch they merge by themselves. Around them lie the points of the region's own rim.
 * Micrometres throughout. */
#ifndef GSN_MODEL_WALL_LAYERS_H
#define GSN_MODEL_WALL_LAYERS_H

#include "pipeline/core/grid.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_wall_options {
    double edge_um;     /* aimed at between neighbouring points of a layer; 0: 4.5 voxels */
    double rim_um;      /* and of the region's rim; 0: 5 voxels */
    size_t most_points; /* of all layers: a longer edge keeps to it, about; 0: any number */
};

struct gsn_wall_layers {
    double low, high; /* the plateaus, in the unit of the density */
    double noise;     /* standard deviation of a voxel beside its neighbouring planes */
    double blur_um;   /* of the walls: of the Gaussian that made them of steps */
    double edge_um;   /* of the layers' triangles, as aimed at */
    size_t walls;     /* points on the layers of walls, which stand first; 0: none are sharp */
    size_t rims;      /* points around the region */
    double (*at)[3];  /* walls + rims */
    size_t facets;    /* triangles of the layers */
    uint32_t (*facet)[3];
};

/* gives. NaN is no data. A voxel of the region is one whose centre lies in the mask.
 * Fails with GSN_E_INPUT when no voxel of the region has data, GSN_E_NOMEM. */
int gsn_wall_layers_find(const struct gsn_grid *grid, const struct gsn_mask *region,
                         const struct gsn_wall_options *options,
                         struct gsn_wall_layers **ret_layers, struct gsn_error *err);
void gsn_wall_layers_free(struct gsn_wall_layers *layers);
GSN_DEFINE_AUTO(gsn_wall_layers);

#ifdef __cplusplus
}
#endif
#endif
