/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A surface as a file: STL, which slicers and CAD open, PLY, which keeps vertices and normals, and
 * glTF, which viewers and browsers show. Coordinates are micrometres of the block frame. */
#ifndef GSN_EXPORT_SURFACE_FILE_H
#define GSN_EXPORT_SURFACE_FILE_H

#include "pipeline/render/isosurface.h"

#ifdef __cplusplus
extern "C" {
#endif

/* give: the bytes. STL: binary, three corners a triangle in single precision, its normal by the
 * right hand. PLY 1.0: binary, little-endian, coordinates in double precision. GLB: glTF 2.0 in one
 * file, single precision from the middle of the surface, where a node puts it, scaled to metres.
 * Fail with GSN_E_NOMEM, and with GSN_E_LIMIT when there are more than 2^31 - 1 triangles. */
int gsn_stl_write(const struct gsn_trimesh *surface, uint8_t **ret_bytes, size_t *ret_size,
                  struct gsn_error *err);
int gsn_ply_write(const struct gsn_trimesh *surface, uint8_t **ret_bytes, size_t *ret_size,
                  struct gsn_error *err);
int gsn_glb_write(const struct gsn_trimesh *surface, uint8_t **ret_bytes, size_t *ret_size,
                  struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
