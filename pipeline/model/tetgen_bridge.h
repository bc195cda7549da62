/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Tetrahedra inside a surface, by TetGen.
 *
 * TetGen 1.5 may leak, loop or crash on bad input, so only the mesher's process (gieson-mesh) and
 * the tests link this; everybody else calls domain.h. Micrometres. */
#ifndef GSN_MODEL_TETGEN_BRIDGE_H
#define GSN_MODEL_TETGEN_BRIDGE_H

#include "pipeline/model/tetgen_wire.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: a constrained Delaunay tetrahedralisation of the question's surface, or a refinement of
 * its mesh; unverified. The caller has checked the surface with gsn_surface_check().
 * Fails with GSN_E_MESH when TetGen gives up or returns nothing, GSN_E_INPUT on options out of
 * range, GSN_E_NOMEM. TetGen may write to stdout. */
int gsn_tetgen_mesh(const struct gsn_mesh_question *question, struct gsn_soup **ret_mesh,
                    struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
