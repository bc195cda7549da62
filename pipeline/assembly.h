/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From the panels of one specimen to one stack in the block frame: poses of all sections solved
 * together, colour turned into density panel by panel, 24 um planes with gaps kept as gaps. */
#ifndef GSN_PIPELINE_ASSEMBLY_H
#define GSN_PIPELINE_ASSEMBLY_H

#include "pipeline/calibration_panel.h"
#include "pipeline/columns.h"
#include "pipeline/core/colour_grid.h"
#include "pipeline/pictures.h"
#include "pipeline/register/order/sequence.h"
#include "pipeline/register/pose/strain.h"
#include "pipeline/register/tissue/pose_check.h"
#include "pipeline/specimen.h"
#include "pipeline/stain/artefact/dust.h"
#include "pipeline/stain/error_propagation.h"
#include "pipeline/stain/hue_distribution.h"
#include "pipeline/stain/illumination_drift.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/staining_uniformity.h"

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_assembly_state {
    GSN_SECTION_USED,
    GSN_SECTION_DOUBTFUL, /* used, on two marks: a person should look */
    GSN_SECTION_HELD,     /* not used: its place is not known well enough */
    GSN_SECTION_MISSING,  /* expected, but not there or on a refused panel */
    GSN_SECTION_EMPTY,
};

/* Where its neighbours' tissue lays a section, perhaps too roughly for a pose. */
struct gsn_tissue_place {
    int known;
    struct gsn_affine panel_to_block_um;
    double error_um; /* predicted, root mean square over its tissue */
};

/* The stack where the job lays it by tissue alone. */
struct gsn_by_tissue {
    int done;
    size_t frame; /* the section whose panel's picture, pixels times their size, is the block */
    struct gsn_tissue_summary summary; /* lengths um */
};

/* One slot, found or not. */
struct gsn_assembly_section {
    unsigned panel; /* 1-based */
    struct gsn_panel_section seen;
    int posed;
    struct gsn_pose pose;
    enum gsn_assembly_state state;
    struct gsn_tissue_finding finding; /* whether its neighbours' tissue bears out its marks */
    struct gsn_tissue_place place;     /* of one that its marks do not lay */
    double clipped;  /* share of its tissue with a sample at either end of the codes; masked */
    char flags[160]; /* words with one space between */
    struct gsn_artefact_figures masked;           /* what of it is not measured, and why */
    double region_masked, region_by[GSN_DEFECTS]; /* shares of its part of the region, 0..1 */
    struct gsn_stain_amounts tone;                /* its dyes; no pixels: not looked at */
    double thickness; /* against the panel's other sections; 1: as they are, or not told */
    struct gsn_account_picture thumbnail;                         /* png owned; size 0: none */
    struct gsn_candidates candidates;                             /* as the stack lays them */
    struct gsn_account_picture candidate_picture[GSN_CANDIDATES]; /* likewise */
    unsigned compared_with; /* serial number of the section outlined in them, from 1; 0: none */
};

struct gsn_assembly_panel {
    const struct gsn_specimen_panel *given; /* borrowed from the specimen */
    int opened;
    int lossy; /* whether its picture is a JPEG */
    struct gsn_flat_field glass;
    struct gsn_specimen_stain stain;
    struct gsn_calibrated calibrated; /* by its calibration panel, where one is stated */
    struct gsn_stain_gain gain;       /* what its densities were divided by */
    int levelled;                     /* whether it was compared with the panels beside it */
    size_t place;                     /* then, along the block among those that were; 0-based */
    struct gsn_gain_offset level;     /* its densities were: minus offset, divided by gain */
    double strength;  /* density of its strongest stained tissue; NaN: not known, 0: not opened */
    double red_error; /* relative standard error of its red by vectors and white; 0: the
                         vectors were taken as exact */
    unsigned cell_px; /* side of the cells in which lamp, tones and dust were looked for */
    struct gsn_illumination lamp;  /* how steady its light was */
    struct gsn_stain_amounts tone; /* of all its sections */
    struct gsn_dust_turn turn; /* as in its scan */
    char note[400];
};

/* Tissue that nobody treated, found by its density. */
enum gsn_untreated {
    GSN_UNTREATED_DENSE,
    GSN_UNTREATED_LOOSE,
    GSN_UNTREATED_DENTINE,
    GSN_UNTREATED_KINDS
};

/* What of the panels was compared, and with which tissue other specimens can be. */
struct gsn_levelling {
    int done;                       /* whether the panels could be compared with each other */
    struct gsn_gain_fit fit;        /* of the steps between them */
    size_t panels;                  /* that were compared */
    double share[GSN_GAIN_PANELS];  /* of the region's voxels with data, by place; they sum to 1 */
    struct gsn_control_tissues tissues;   /* by enum gsn_untreated, on the panels' common scale */
    double yellow[GSN_CONTROL_TISSUES];   /* of them in the region's planes, OD; NaN: not seen */
    struct gsn_vector_error_left vectors; /* what the dye vectors leave open beside those tissues */
    struct gsn_vector_scatter turns;  /* where the vectors were taken as exact: what they turn by
                                         from panel to panel; vectors is then per rad^2 of it */
    char why[480];                    /* why not done, or empty */
};

/* What became of the sections that were to be laid by their tissue. */
struct gsn_refinement {
    int done;
    size_t sections, compared; /* that have a pose, and whose tissue told something of it */
    double radius_um;          /* of the disc that was compared */
    double moved_um;           /* root mean square over the region and all sections */
    double area_mean, area_sd; /* of what the tissue added to the sections' area, shares of it */
    double factor[2];          /* errors against the stated: of the marks, of the comparisons */
    char why[240];             /* why not done, or empty */
};

struct gsn_assembly {
    size_t section_count;
    struct gsn_assembly_section *section; /* owned; by serial, then panel and slot */
    size_t panel_count;
    struct gsn_assembly_panel *panel;           /* owned; as in the specimen */
    struct gsn_calibration_panel **calibration; /* owned; one for each that the job states, NULL as
                                                   long as no panel needed it */
    size_t calibration_count;
    int by_standards; /* whether densities are on the scale of the calibration panels' standards */
    int solved;       /* whether there is a block frame: of the stack's triangle, or by tissue */
    struct gsn_pose_summary summary; /* of the marks; 0 where none was asked for */
    struct gsn_by_tissue by_tissue;
    struct gsn_strain_common panel_stretch; /* what the scan did to all sections alike */
    enum gsn_strain_mode strain_mode;       /* the protocol's */
    struct gsn_refinement refinement;       /* where that is GSN_STRAIN_TISSUE */
    char unsolved[600];                     /* why not, or empty */
    char no_region[480];                    /* why the stated band could not be found, or empty */
    struct gsn_mask *region;        /* owned; NULL when the job states none or it was not found */
    struct gsn_grid *grid;          /* owned; NULL without region or solution */
    struct gsn_colour_grid *colour; /* owned; what the grid's sections look like; NULL as grid is */
    struct gsn_mask *tissue;        /* owned; the reference tissue, NULL when the job states none */
    struct gsn_grid *tissue_grid;   /* owned; its density as stained */
    struct gsn_dust *dust;          /* owned; what is dark on each panel */
    size_t spot_count;              /* of the scanner's dust */
    struct gsn_artefact_disc *spot; /* owned; pixels as the scanner gave them */
    unsigned spot_panels;           /* that were compared for it */
    struct gsn_columns *columns;    /* owned; NULL where there is no grid */
    struct gsn_levelling levelling;
    struct gsn_cloud *cloud; /* owned; the colours of its tissue on the panels' common scale; NULL
                                as columns are */
    double region_od[3];     /* mean R, G and B of the region's tissue on it; NaN: none is seen */
    double free_od[3]; /* of the stated tissue without collagen; NaN: none is stated, or seen */
    double red_error;  /* relative standard error of a mean density on the panels' own scale: by
                          vectors, white, gains and the steps between panels */
    double step_error; /* of it, what the steps between panels leave open */
    double
        common_error; /* relative: what that scale itself may be off by against another specimen's
                         where no reference tissue tells; 0: one panel, or a tissue was stated */
    double stain_scatter; /* relative standard deviation of the panels' strength, where no reference
                             tissue was stated; 0: one panel, or one was */
    struct gsn_sequence *sequence; /* owned; what is odd in the order of the sections; NULL: not
                                      looked at, as nothing was measured */
    char misordered[400];     /* why the order that the job states is not the sections', or empty */
    char not_comparable[240]; /* why the stain could not be normalised though asked, or empty */
};

/* gives. Sections and panels that cannot be used are states, not failures.
 * Fails with GSN_E_NOMEM, GSN_E_IO, GSN_E_INPUT (a region that misses the stack). */
int gsn_assembly_make(const struct gsn_specimen *specimen,
                      const struct gsn_specimen_options *options,
                      struct gsn_assembly **ret_assembly, struct gsn_error *err);
void gsn_assembly_free(struct gsn_assembly *assembly);
GSN_DEFINE_AUTO(gsn_assembly);

/* "used", "doubtful", "held", "missing", "empty". */
const char *gsn_assembly_state_name(enum gsn_assembly_state state);

#ifdef __cplusplus
}
#endif
#endif
