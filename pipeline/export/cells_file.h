/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The tetrahedra of a model, one by one, as files: VTU (VTK's XML, Bezier tetrahedra, for programs
 * that do not read .vtkhdf) and tables, CSV, of the micro-units and of the base mesh's cells.
 * Lengths are micrometres. */
#ifndef GSN_EXPORT_CELLS_FILE_H
#define GSN_EXPORT_CELLS_FILE_H

#include "pipeline/measure/base_cells.h"
#include "pipeline/model/model_file.h"

#ifdef __cplusplus
extern "C" {
#endif

/* give: the bytes. borrow: model. Fail with GSN_E_NOMEM.
 *
 * VTU: points, coefficients "s" and cell data as in model.vtkhdf (model_file.h), not rounded.
 *
 * CSV (RFC 4180): a row a tetrahedron: "cell" from 0, "x_um", "y_um", "z_um" of its centroid,
 * "volume_um3", "density" (mean over it; empty without tissue of the region or without samples),
 * "inside_share", "samples", "residual" (rms of its samples). Empty: not known. */
int gsn_vtu_write(const struct gsn_model *model, uint8_t **ret_bytes, size_t *ret_size,
                  struct gsn_error *err);
int gsn_units_csv_write(const struct gsn_model *model, uint8_t **ret_bytes, size_t *ret_size,
                        struct gsn_error *err);

/* gives: a row a cell of the base mesh that the region has voxels in, the same names of cells in
 * every specimen: "cube_x", "cube_y", "cube_z", "tet" (measure/base_cells.h), "x_um", "y_um",
 * "z_um" of its centroid, "volume_um3" of the region in it, "density", "density_error"; of a loss
 * "baseline_density" as it reads in this specimen's stain, "baseline_error", "loss_percent",
 * "loss_error". Errors are standard errors by sections. Empty: not known, or the loss has no such
 * cell. map: or NULL. borrows: all. Fails with GSN_E_NOMEM. */
int gsn_base_csv_write(const struct gsn_base_side *side, const struct gsn_loss_map *map,
                       uint8_t **ret_bytes, size_t *ret_size, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
