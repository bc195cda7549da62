/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A spline as a file that ParaView and VTK (9.0 or later) read: an unstructured grid with one
 * Bezier tetrahedron of the spline's degree (cell type 78) per tetrahedron of the mesh.
 *
 * What is written is p_I, the polynomial the spline is on the core of tetrahedron I, in Bernstein
 * form over the whole of I:
 *
 *     p_I(lambda) = sum over |beta| = n of b_beta (n! / beta!) lambda^beta.
 *
 * For collapsed clouds (all knots of a vertex at the vertex) that is the spline itself, everywhere;
 * so it is where the spline is one polynomial. With open clouds the file is exact in the cores and
 * is the polynomial of each tetrahedron, not the spline, in the skins around the faces; how far the
 * two are apart there is what gsn_spline_residual() bounds.
 *
 * Every cell has points of its own, so that jumps of p_I across faces are kept; the geometry is
 * straight and in micrometres. The point data "s" are the b_beta at the Bezier points, as IEEE
 * doubles: nothing is rounded. */
#ifndef GSN_MODEL_VTU_H
#define GSN_MODEL_VTU_H

#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Writes the file so that a power cut leaves the old one or the new one. borrows: everything.
 * Fails with GSN_E_IO naming the path, GSN_E_NOMEM; the old file is then untouched. */
int gsn_vtu_write(const struct gsn_spline *spline, const char *path, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
