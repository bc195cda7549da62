/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One section cut out of a panel, at the resolution at which defects are looked for.
 *
 * Cells are squares of whole pixels of about 20 um; around the section's box lies a rim of glass,
 * so that what is closed or grown finds room. Private to pipeline/stain. */
#ifndef GSN_STAIN_ARTEFACT_CELLS_H
#define GSN_STAIN_ARTEFACT_CELLS_H

#include "pipeline/stain/artefact/detection.h"
#include "pipeline/stain/optical_density.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_artefact_cells {
    uint32_t nx, ny, rim;                  /* rim: cells around the box */
    uint32_t side;                         /* pixels per cell, per axis */
    double um;                             /* of a cell */
    int x0, y0;                            /* the panel pixel of the first cell inside the rim */
    struct gsn_plane *od[3], *even[3];     /* even: smoothed over 3 x 3 cells */
    struct gsn_plane *red, *yellow, *dark; /* amounts as lengths in optical density */
    struct gsn_plane *total;               /* R + G + B of the even ones */
    struct gsn_plane *foreign; /* length of what no mixture of the dyes explains, even */
    float clear;               /* total below it is glass */
    float noise;               /* optical density, of one cell of one channel */
    uint8_t *tissue;           /* 0 or 1: not glass, and large enough */
    uint8_t *outline;          /* tissue with its holes and clefts filled */
    uint16_t *label;
    double clipped; /* share of the tissue's pixels */
};

/* gives. Fails as gsn_unmix() and with GSN_E_NOMEM. */
int gsn_artefact_cells_cut(const struct gsn_artefact_panel *panel,
                           const struct gsn_od_reader *absorber,
                           const struct gsn_artefact_section *section, double clear,
                           struct gsn_artefact_cells **ret_cells, struct gsn_error *err);

void gsn_artefact_cells_free(struct gsn_artefact_cells *cells);

GSN_DEFINE_AUTO(gsn_artefact_cells);

/* Length of density that nothing but ink has. */
#define GSN_DARKEST_OD 1.2

/* A stroke is broader than the char of a laser mark (75 um of radius, 10 % more at most, blurred).
 */
#define GSN_STROKE_HALF_UM 130.0

/* Before the detectors, over all sections of a panel: where a colour is the tissue's own by `own`,
 * the dyes as the panel's tissue shows them, `foreign` becomes what those leave unexplained. Only
 * halos may have labels. Fails as gsn_unmixer_init() and with GSN_E_NOMEM. */
int gsn_artefact_own_hues(struct gsn_artefact_cells *const *cells, size_t count,
                          const struct gsn_dyes *own, struct gsn_error *err);

/* Sets the bit where set is 1. */
void gsn_artefact_cells_mark(struct gsn_artefact_cells *cells, const uint8_t *set,
                             enum gsn_defect defect);

/* Gives the pieces of `weak` that hold a cell of `sure`, as far as um from one, in weak.
 * Fails with GSN_E_NOMEM. */
int gsn_artefact_cells_grow(const struct gsn_artefact_cells *cells, const uint8_t *sure,
                            uint8_t *weak, double um, struct gsn_error *err);

/* Leaves of the set what is broader than twice half_um, and what goes on from there for 3 half_um.
 * Fails with GSN_E_NOMEM. */
int gsn_artefact_cells_broad(const struct gsn_artefact_cells *cells, uint8_t *set, double half_um,
                             struct gsn_error *err);

/* The detectors, each of which sets its own bit; all fail with GSN_E_NOMEM only. */
int gsn_artefact_ink(struct gsn_artefact_cells *cells, struct gsn_error *err);

int gsn_artefact_voids(struct gsn_artefact_cells *cells, struct gsn_error *err);

int gsn_artefact_folds(struct gsn_artefact_cells *cells, struct gsn_error *err);

int gsn_artefact_bubbles(struct gsn_artefact_cells *cells, struct gsn_error *err);

int gsn_artefact_debris(struct gsn_artefact_cells *cells, struct gsn_error *err);

/* gives: how sharp the tissue is around each cell, NaN where that cannot be told, and the median of
 * it (NaN when there is none). Labels count as masked. */
int gsn_artefact_sharpness(const struct gsn_artefact_cells *cells, struct gsn_plane **ret_sharpness,
                           double *ret_median, struct gsn_error *err);

/* usual: the median over the sections that the section is compared with. */
int gsn_artefact_blur(struct gsn_artefact_cells *cells, const struct gsn_plane *sharpness,
                      double usual, struct gsn_error *err);

#ifdef __cplusplus
}
#endif

#endif
