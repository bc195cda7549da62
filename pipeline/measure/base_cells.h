/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Density cell by cell on a mesh that all specimens of one block frame share, and from two of them
 * where the collagen was lost.
 *
 * The base mesh: cubes of GSN_BASE_EDGE_UM from the origin of the block frame, each divided into
 * six tetrahedra about its diagonal (Freudenthal 1942, Kuhn 1960); neighbours share whole faces. It
 * follows no specimen's tissue, so a cell is the same piece of the block in each of them. */
#ifndef GSN_MEASURE_BASE_CELLS_H
#define GSN_MEASURE_BASE_CELLS_H

#include "pipeline/core/grid.h"
#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_BASE_EDGE_UM = 200, GSN_BASE_TETS = 6 };

/* Which cell: the cube's number along x, y and z, and which of its tetrahedra, 0..5. */
struct gsn_base_address {
    int32_t cube[3];
    uint8_t tet;
};

/* The cell that holds a point, um; one on a face belongs to one of the two, always the same. */
struct gsn_base_address gsn_base_find(struct gsn_vec3 point_um);

/* Corners of a cell, um. */
void gsn_base_corners(struct gsn_base_address address, double ret_corner[4][3]);

/* Below 0, 0 or above 0: the order of cells, by z, y and x of the cube, then by tetrahedron. */
int gsn_base_compare(struct gsn_base_address a, struct gsn_base_address b);

struct gsn_base_cell {
    struct gsn_base_address address;
    double mean;       /* of the spline over the region's voxels whose centres lie in the cell */
    double volume_um3; /* of those voxels */
    double planes;     /* of constant z that they lie in, those that hold few counting less */
};

struct gsn_base_cells {
    size_t count;
    struct gsn_base_cell *cell; /* those with voxels of the region, in order of address */
};
void gsn_base_cells_free(struct gsn_base_cells *cells);
GSN_DEFINE_AUTO(gsn_base_cells);

/* gives. The sum of mean times volume over all cells is that over the region. borrows: spline,
 * region. threads 0: all; the same bytes on any number. Fails with GSN_E_INPUT when the region is
 * empty or a voxel's centre lies outside the spline's mesh, with GSN_E_LIMIT when it spans more
 * than 2^24 cells, and with GSN_E_NOMEM. */
int gsn_base_cells_new(const struct gsn_spline *spline, const struct gsn_mask *region,
                       unsigned threads, struct gsn_base_cells **ret_cells, struct gsn_error *err);

/* Standard error of the mean density of one plane (section) within one cube's column of the region,
 * by what each section errs by itself there: cutting, registration, its own stain, noise. What a
 * plane's mean is off the middle of its two neighbours has 3/2 of its variance (Gasser, Sroka and
 * Jennen-Steinmetz 1986). NaN without three planes in a row in any column. Fails with GSN_E_NOMEM.
 * borrows: grid, region, which may have different lattices. */
int gsn_base_plane_error(const struct gsn_grid *grid, const struct gsn_mask *region,
                         double *ret_error, struct gsn_error *err);

/* A specimen as the loss asks for it. */
struct gsn_base_side {
    const struct gsn_base_cells *cells;
    double plane_error; /* gsn_base_plane_error(); NaN: not known */
};

/* How densities are compared: a control's are brought to the treated specimen's stain as gain *
 * density + offset, and zero is what no collagen reads as there (measure/loss.h). */
struct gsn_loss_scale {
    double gain, offset, zero;
};

/* One cell of both. */
struct gsn_loss_cell {
    struct gsn_base_address address;
    double volume_um3;             /* that the smaller of the two regions has of it */
    double control, control_error; /* mean, as brought over; standard error, NaN */
    double treated, treated_error;
    double percent, error; /* of the control's collagen lost; standard error by sections, NaN: not
                              known */
};

struct gsn_loss_map {
    size_t count;
    struct gsn_loss_cell *cell; /* in order of address */
    double shared;              /* of the treated region's volume, that lies in these cells, 0..1 */
    /* Over the cells by their volume, per cent: a twentieth lost less than low, a twentieth more
     * than high. */
    double low, median, high;
    double noise; /* root of the mean squared error of a cell, by sections; NaN: not known */
};
void gsn_loss_map_free(struct gsn_loss_map *map);
GSN_DEFINE_AUTO(gsn_loss_map);

/* gives: the loss in each cell that both have. Several controls are averaged, cell by cell, over
 * those that have the cell. borrows: all. Fails with GSN_E_WITHHELD when the regions have no cell
 * in common, or when a control's density is nowhere told from none; and with GSN_E_NOMEM. */
int gsn_loss_map_new(const struct gsn_base_side *control, size_t controls,
                     const struct gsn_base_side *treated, const struct gsn_loss_scale *scale,
                     struct gsn_loss_map **ret_map, struct gsn_error *err);

/* The loss in the cell that holds this point; NaN: none is known. */
double gsn_loss_map_at(const struct gsn_loss_map *map, struct gsn_vec3 point_um);

#ifdef __cplusplus
}
#endif
#endif
