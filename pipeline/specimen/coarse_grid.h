/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The whole block in coarse cells, while its panels pass: what is needed to compare panel with
 * panel, and specimen with specimen, by tissue outside of the region of interest. */
#ifndef GSN_SPECIMEN_COARSE_GRID_H
#define GSN_SPECIMEN_COARSE_GRID_H

#include "pipeline/core/grid.h"
#include "pipeline/register/stack/resample.h"
#include "pipeline/stain/optical_density.h"

/* Cells of this size are a quarter of the thinnest ligament; the root is looked for in such. */
#define GSN_COARSE_UM 32.0

/* A lesion does not end where the region does: nothing nearer to it is compared. */
#define GSN_SURROUNDINGS_UM 300.0

struct gsn_coarse_grid {
    struct gsn_grid *density; /* mean over the cell's tissue; NaN: not seen, or glass in it */
    struct gsn_grid *tissue;  /* share of the cell's seen pixels that is tissue; NaN: not seen */
    struct gsn_grid *od[3];   /* R, G and B as scanned: means where density has one */
};

/* gives: nothing seen. Fails with GSN_E_NOMEM. */
int gsn_coarse_grid_new(const struct gsn_lattice *at, struct gsn_coarse_grid **ret_columns,
                        struct gsn_error *err);
void gsn_coarse_grid_free(struct gsn_coarse_grid *columns);
GSN_DEFINE_AUTO(gsn_coarse_grid);

/* Adds a section; a plane that was filled before is filled anew. Its density holds every apart-th
 * row of its box; absorber: of its panel, tells tissue from glass. Sections of different planes may
 * be added side by side. Fails with GSN_E_NOMEM. borrows: all. */
int gsn_coarse_grid_add(struct gsn_coarse_grid *columns, const struct gsn_stack_section *section,
                        unsigned apart, const struct gsn_od_reader *absorber, double interval_um,
                        struct gsn_error *err);

/* gives: per cell of one plane how far it is, in um, from the nearest that a region lies above or
 * below; infinity where the region is empty. at is the columns' lattice, of one plane. Fails with
 * GSN_E_NOMEM. */
int gsn_coarse_grid_away(const struct gsn_mask *region, const struct gsn_lattice *at,
                         struct gsn_grid **ret_um, struct gsn_error *err);

/* gives: per cell of one plane whether a region lies above or below it, or within margin_um.
 * at is the columns' lattice, of one plane. Fails with GSN_E_NOMEM. */
int gsn_coarse_grid_footprint(const struct gsn_mask *region, const struct gsn_lattice *at,
                              double margin_um, struct gsn_mask **ret_footprint,
                              struct gsn_error *err);

#endif
