/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Regions, surfaces, meshes and samples that several test programs of the model share. They fail
 * the running test when they cannot be made. */
#ifndef GSN_TESTS_MODEL_DOMAIN_SHAPES_H
#define GSN_TESTS_MODEL_DOMAIN_SHAPES_H

#include "pipeline/core/grid.h"
#include "pipeline/model/domain.h"
#include "pipeline/model/fit.h"
#include "pipeline/model/tetgen_wire.h"

/* gives: a region whose first voxel's corner is 0; rule says which voxels are inside. */
struct gsn_mask *shape_mask(size_t nx, size_t ny, size_t nz, double step_x, double step_y,
                            double step_z, int (*rule)(size_t x, size_t y, size_t z));
int shape_everywhere(size_t x, size_t y, size_t z);

/* gives: the surfaces of two tetrahedra that pass through each other. */
struct gsn_surface *shape_crossing(void);
/* gives: the cube [0, edge]^3 of six squares. */
struct gsn_surface *shape_cube(double edge);

/* The true mesher with these sizes. */
struct gsn_domain_options shape_options(double cell_um, double max_tet_um3);
/* gives: the mesh of a region. */
struct gsn_tets *shape_mesh(const struct gsn_mask *region, double cell_um, double max_tet_um3);
/* gives: the space over the mesh of the region [0, 80]^3 um. Cells of 40 um make that the domain
 * [-40, 120]^3. */
struct gsn_dms *shape_space(unsigned degree, double cloud, double max_tet_um3);

/* Samples that own their arrays. */
struct shape_samples {
    struct gsn_samples samples;
    double (*at)[3];
    float *value;
};
/* gives: n^3 samples of f at the cell centres of [low, high]^3 um. */
struct shape_samples shape_grid(double low, double high, size_t n, double (*f)(const double u[3]));
void shape_samples_done(struct shape_samples *samples);

/* Numbers from 0 to 1, ends excluded, and standard normal ones, the same ones for the same state. */
double shape_uniform(uint64_t *state);
double shape_normal(uint64_t *state);

#endif
