/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The scale of the densities: how the panels of a specimen were brought to one, what other
 * specimens can be compared by, and what the stain leaves open. */
#ifndef GSN_SPECIMEN_NORMALISATION_H
#define GSN_SPECIMEN_NORMALISATION_H

#include "pipeline/specimen/density_stack.h"
#include "pipeline/stain/error_propagation.h"
#include "pipeline/stain/hue_distribution.h"
#include "pipeline/stain/normalisation.h"

/* Tissue that nobody treated, found by its density. */
enum gsn_control_tissue {
    GSN_CONTROL_DENSE,
    GSN_CONTROL_LOOSE,
    GSN_CONTROL_DENTINE,
    GSN_CONTROL_KINDS
};

/* What of the panels was compared, and with which tissue other specimens can be. */
struct gsn_normalisation {
    int done;                      /* whether the panels could be compared with each other */
    struct gsn_gain_fit fit;       /* of the steps between them */
    size_t panels;                 /* that were compared */
    double share[GSN_GAIN_PANELS]; /* of the region's voxels with data, by place; they sum to 1 */
    struct gsn_control_tissues
        tissues; /* by enum gsn_control_tissue, on the panels' common scale */
    double yellow[GSN_CONTROL_TISSUES];   /* of them in the region's planes, OD; NaN: not seen */
    struct gsn_vector_error_left vectors; /* what the dye vectors leave open beside those tissues */
    struct gsn_vector_scatter turns; /* where the vectors were taken as exact: what they turn by
                                         from panel to panel; vectors is then per rad^2 of it */
    char why[480];                   /* why not done, or empty */
};

/* How one panel's densities were changed. */
struct gsn_panel_scale {
    struct gsn_stain_gain gain;   /* what they were divided by */
    int levelled;                 /* whether it was compared with the panels beside it */
    size_t place;                 /* then, along the block among those that were; 0-based */
    struct gsn_gain_offset level; /* they were: minus offset, divided by gain */
};

struct gsn_scale {
    size_t panel_count;
    struct gsn_panel_scale *panel; /* owned; as the densities have them */
    int by_standards; /* whether densities are on the scale of the calibration panels' standards */
    char not_comparable[240]; /* why the stain could not be normalised though asked, or empty */
    struct gsn_normalisation levelling;
    double red_error;     /* relative standard error of a mean density on the panels' own scale: by
                             vectors, white, gains and the steps between panels */
    double step_error;    /* of it, what the steps between panels leave open */
    double common_error;  /* relative: what that scale itself may be off by against another
                             specimen's where no reference tissue tells; 0: one panel, or a tissue
                             was stated */
    double stain_scatter; /* relative standard deviation of the panels' strength, where no reference
                             tissue was stated; 0: one panel, or one was */
    struct gsn_cloud *cloud; /* owned; the colours of its tissue on the panels' common scale; NULL
                                as the coarse grid is */
    double region_od[3];     /* mean R, G and B of the region's tissue on it; NaN: none is seen */
    double free_od[3];  /* of the stated tissue without collagen; NaN: none is stated, or seen */
    double free_panels; /* that it lies in, counted by its cells; 0: in none */
};

/* Brings the densities to one scale, in place: by standards, by a stated reference tissue, or by
 * tissue outside of the region. Fills what is there zeroed. That it cannot be done is a state, with
 * a sentence. region: known by now, or NULL. Fails with GSN_E_NOMEM. */
int gsn_scale_normalise(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                        const struct gsn_poses *poses, struct gsn_densities *densities,
                        struct gsn_scale *scale, struct gsn_error *err);
/* Then, the region being known: the standard error of a mean density by the stain, what unequal
 * panels add to it, and the region's shares of the levelled panels. */
void gsn_scale_sum_errors(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                          const struct gsn_poses *poses, const struct gsn_densities *densities,
                          struct gsn_scale *scale);
/* Finds tissue that other specimens have too, off the region (control_tissue.c). Comes when the
 * region and its shares of the panels are known. Fails with GSN_E_NOMEM, GSN_E_STAIN. */
int gsn_scale_find_tissues(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                           const struct gsn_poses *poses, const struct gsn_densities *densities,
                           struct gsn_scale *scale, struct gsn_error *err);
/* The colours of all tissue, panel by panel, and the region's mean colour. Fails with
 * GSN_E_NOMEM. */
int gsn_scale_count_colours(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                            const struct gsn_poses *poses, const struct gsn_densities *densities,
                            struct gsn_scale *scale, struct gsn_error *err);
void gsn_scale_done(struct gsn_scale *scale);

#endif
