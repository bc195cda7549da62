/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A spline on a regular grid, by objects: every tetrahedron writes its polynomial into the voxels
 * whose centres it holds, then every face adds its seam (face_correction.h) to the voxels near it.
 * No point is ever searched for. */
#ifndef GSN_MODEL_RESAMPLE_H
#define GSN_MODEL_RESAMPLE_H

#include "pipeline/core/grid.h"
#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

/* s at the voxel centres of a lattice, in its order; NaN, "no data", outside the mesh. Which
 * centres are inside is decided exactly, as by gsn_dms_locate(). The same bits for any number of
 * threads (0: as many as the process may use) and any instruction set.
 * Fails with GSN_E_INPUT on a lattice without voxels, with numbers that are not finite or steps
 * that are not positive, and with GSN_E_NOMEM; ret_value is then untouched. */
int gsn_spline_resample(const struct gsn_spline *spline, const struct gsn_lattice *at,
                        unsigned threads, double *ret_value, struct gsn_error *err);

/* gives: the same as a grid of floats. */
int gsn_spline_grid(const struct gsn_spline *spline, const struct gsn_lattice *at, unsigned threads,
                    struct gsn_grid **ret_grid, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
