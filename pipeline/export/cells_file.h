/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The tetrahedra of a model, one by one, as files: VTU (VTK's XML, Bezier tetrahedra, for programs
 * that do not read .vtkhdf) and a table of micro-units, CSV. Lengths are micrometres. */
#ifndef GSN_EXPORT_CELLS_FILE_H
#define GSN_EXPORT_CELLS_FILE_H

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

#ifdef __cplusplus
}
#endif
#endif
