/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Drawn specimens assembled, and their planes held against what was drawn. */
#ifndef GSN_TESTS_SPECIMEN_DRAWN_ASSEMBLY_H
#define GSN_TESTS_SPECIMEN_DRAWN_ASSEMBLY_H

#include "pipeline/specimen/reconstruction.h"
#include "tests/specimen/drawn_specimen.h"

#define DRAWN_DENSITY 0.8

extern const struct gsn_specimen_options DRAWN_OPTIONS; /* one thread */

/* Three panels of twelve sections with DRAWN_DENSITY. */
void drawn_three_panels(struct drawn_panel panels[3]);

/* give: what is assembled of them. Fail the test when it cannot be. */
struct gsn_reconstruction *drawn_assembly(const struct drawn_specimen *d);
struct gsn_reconstruction *drawn_assembly_from(const struct drawn_panel panels[3]);

/* The same for a sweep: the code. */
int drawn_assemble_once(const struct drawn_specimen *d, struct gsn_error *err);

/* Fail the test unless every voxel of the section's plane holds this density; unless none of them
 * holds any. */
void drawn_check_plane(const struct gsn_grid *grid, unsigned serial, double density);
void drawn_check_gap(const struct gsn_grid *grid, unsigned serial);

#endif
