/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether a mesh fills what it should: nothing that TetGen says is believed unseen. */
#ifndef GSN_MODEL_DOMAIN_VERIFY_H
#define GSN_MODEL_DOMAIN_VERIFY_H

#include "pipeline/model/domain_cells.h"
#include "pipeline/model/tets.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The mesh fills exactly the cells: volume and boundary area agree to 1e-9, every boundary face
 * lies between a filled and an empty cell, every voxel centre of the region is inside.
 * Fails with GSN_E_MESH saying what does not hold, GSN_E_NOMEM. */
int gsn_domain_verify_cells(const struct gsn_tets *mesh, const struct gsn_cells *cells,
                            const struct gsn_mask *region, struct gsn_error *err);

/* Volume and boundary area agree to 1e-9. Fails with GSN_E_MESH. */
int gsn_domain_verify_same(const struct gsn_tets *mesh, const struct gsn_tets *before,
                           struct gsn_error *err);

/* um^3, um^2. */
double gsn_domain_volume(const struct gsn_tets *mesh);
double gsn_domain_area(const struct gsn_tets *mesh);

#ifdef __cplusplus
}
#endif
#endif
