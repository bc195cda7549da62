/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures of a region's data and model, and of where collagen was lost, as PNG with captions. */
#ifndef GSN_SPECIMEN_REGION_PICTURES_H
#define GSN_SPECIMEN_REGION_PICTURES_H

#include "pipeline/measure/base_cells.h"
#include "pipeline/specimen/analysis.h"
#include "pipeline/specimen/specimen.h"

/* Adds its pictures to the analysis, whose spline and bounds are there, and sets the ends of its
 * colour scale. grid: what the cuts show beside the model. Fails with GSN_E_NOMEM and as the parts
 * of render do. */
int gsn_region_pictures(const struct gsn_grid *grid, const struct gsn_mask *region,
                        const struct gsn_protocol *protocol,
                        const struct gsn_analysis_options *options, struct gsn_analysis *analysis,
                        struct gsn_error *err);

enum { GSN_LOSS_PICTURES = 2 };

/* What a picture of a loss shows. All borrowed. */
struct gsn_loss_scene {
    const struct gsn_analysis *analysis;
    const struct gsn_mask *region;
    const struct gsn_specimen_control *control; /* controls of them, each with a model */
    size_t controls;
    const struct gsn_loss_scale *scale;
    const struct gsn_loss_map *map;
};

/* give: across z and across y, the mean of the controls as it reads in this specimen's stain, this
 * specimen, and the loss cell by cell, side by side. ret_picture's bytes are owned by the caller.
 * threads 0: all. Fail as gsn_region_pictures() does. */
int gsn_loss_pictures(const struct gsn_loss_scene *scene, unsigned threads,
                      struct gsn_png_picture ret_picture[GSN_LOSS_PICTURES], struct gsn_error *err);

#endif
