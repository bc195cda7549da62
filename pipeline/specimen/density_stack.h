/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The density stack: what the opened panels show of the sections that have poses. All later stages
 * read it; normalisation alone changes the densities themselves, in place, to one scale. */
#ifndef GSN_SPECIMEN_DENSITY_STACK_H
#define GSN_SPECIMEN_DENSITY_STACK_H

#include "pipeline/core/colour_grid.h"
#include "pipeline/register/order/sequence.h"
#include "pipeline/specimen/analysis.h"
#include "pipeline/specimen/coarse_grid.h"
#include "pipeline/specimen/poses.h"
#include "pipeline/stain/artefact/detection.h"
#include "pipeline/stain/artefact/dust.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/illumination_drift.h"
#include "pipeline/stain/staining_uniformity.h"

/* A section as its panel shows it; by the index of its pose. */
struct gsn_section_density {
    enum gsn_section_state state;   /* of its pose, or held for what its picture is like */
    struct gsn_section_flags flags; /* of its pose, and more */
    double clipped; /* share of its tissue with a sample at either end of the codes; masked */
    struct gsn_artefact_figures masked;           /* what of it is not measured, and why */
    double region_masked, region_by[GSN_DEFECTS]; /* shares of its part of the region, 0..1 */
    struct gsn_stain_amounts tone;                /* its dyes; no pixels: not looked at */
    double thickness; /* against the panel's other sections; 1: as they are, or not told */
    struct gsn_png_picture thumbnail;                         /* png owned; size 0: none */
    struct gsn_png_picture candidate_picture[GSN_CANDIDATES]; /* likewise */
    struct gsn_png_picture aligned;                           /* as its pose lays it; likewise */
    struct gsn_png_picture glass;      /* the same with all that the scanner saw; likewise */
    struct gsn_png_picture masked_map; /* grey: 1 + the first reason why it is not measured there */
    unsigned compared_with; /* serial number of the section outlined in them, from 1; 0: none */
};

struct gsn_stack_panel {
    const struct gsn_specimen_panel *given; /* borrowed from the specimen */
    int opened;
    int lossy; /* whether its picture went through JPEG */
    struct gsn_flat_field glass;
    struct gsn_specimen_stain stain;
    struct gsn_calibrated calibrated; /* by its calibration panel, where one is stated */
    double strength;  /* density of its strongest stained tissue; NaN: not known, 0: not opened */
    double red_error; /* relative standard error of its red by vectors and white; 0: the
                         vectors were taken as exact */
    unsigned cell_px; /* side of the cells in which lamp, tones and dust were looked for */
    struct gsn_illumination lamp;  /* how steady its light was */
    struct gsn_stain_amounts tone; /* of all its sections */
    struct gsn_dust_turn turn;     /* as in its scan */
    char note[400];
};

struct gsn_densities {
    size_t section_count;
    struct gsn_section_density *section; /* owned; as the poses have them */
    struct gsn_section_marks *marks;     /* owned; of each section, with those found by tissue */
    struct gsn_point aligned_corner;     /* of their aligned pictures, um in the block */
    double aligned_um_per_px;            /* 0: there are none */
    double glass_um_per_px, masked_um_per_px; /* of the same square */
    size_t panel_count;
    struct gsn_stack_panel *panel;  /* owned; as in the specimen */
    struct gsn_grid *grid;          /* owned; NULL without region or solution */
    struct gsn_colour_grid *colour; /* owned; what the grid's sections look like; NULL as grid is */
    struct gsn_mask *tissue;        /* owned; the reference tissue, NULL when the job states none */
    struct gsn_grid *tissue_grid;   /* owned; its density as stained */
    struct gsn_coarse_grid *coarse; /* owned; NULL where there is no grid */
    struct gsn_dust *dust;          /* owned; what is dark on each panel */
    size_t spot_count;              /* of the scanner's dust */
    struct gsn_artefact_disc *spot; /* owned; pixels as the scanner gave them */
    unsigned spot_panels;           /* that were compared for it */
    struct gsn_sequence *sequence;  /* owned; what is odd in the order of the sections; NULL: not
                                       looked at, as nothing was measured */
    char misordered[400]; /* why the order that the job states is not the sections', or empty */
};

/* Opens every panel and resamples its sections into lattice, which is that of the region or of the
 * whole block; NULL: there is none, and only pictures are made. region: known by now, or NULL.
 * Fills what is there zeroed. Fails with GSN_E_NOMEM, GSN_E_IO, GSN_E_INPUT (a reference tissue
 * that misses the block), and as its panels are read and unmixed. */
int gsn_densities_stack(const struct gsn_specimen *specimen,
                        const struct gsn_specimen_options *options,
                        const struct gsn_lattice *lattice, const struct gsn_mask *region,
                        const struct gsn_poses *poses, struct gsn_calibrations *calibrations,
                        struct gsn_densities *densities, struct gsn_error *err);
void gsn_densities_done(struct gsn_densities *densities);

/* Finds the band that the job states, in densities on one scale, and cuts grid and colour down to
 * what lies around it. gives: ret_region. Not finding it is a state: ret_why says so, and the grid
 * is dropped. */
int gsn_densities_find_band(const struct gsn_specimen *specimen,
                            const struct gsn_specimen_options *options,
                            const struct gsn_poses *poses, struct gsn_densities *densities,
                            struct gsn_mask **ret_region, char ret_why[480], struct gsn_error *err);

/* Cuts the colours down to what is left of the grid. Fails with GSN_E_NOMEM. */
int gsn_densities_crop_colour(struct gsn_densities *densities, struct gsn_error *err);

/* The index of the panel that the used section in this plane was taken from; -1 when there is none.
 */
int gsn_panel_of_plane(const struct gsn_poses *poses, const struct gsn_densities *densities,
                       const struct gsn_lattice *at, size_t z, double interval_um);

/* What the samples of an opened panel mean as light. */
struct gsn_stack_light_table {
    uint16_t *of_sample; /* owned, as is the next: stack_colour.h */
    uint8_t *code;
};

/* gives: the tables. Fails with GSN_E_NOMEM. */
int gsn_stack_light_table(enum gsn_light light, unsigned bits,
                          struct gsn_stack_light_table *ret_light, struct gsn_error *err);
void gsn_stack_light_table_done(struct gsn_stack_light_table *light);

#endif
