/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Volumes out of files: MetaImage (.mhd, .mha), NRRD (.nrrd, .nhdr) and INRIMAGE-4 (.inr).
 *
 * Three axes, one number a voxel, axes parallel to those of the block frame. Spacings and origin
 * are taken as micrometres, as written; the origin is the centre of the first voxel. A header that
 * contradicts its data is refused: no voxel is ever made up or left over. */
#ifndef GSN_DECODE_VOLUME_H
#define GSN_DECODE_VOLUME_H

#include "pipeline/core/error.h"
#include "pipeline/core/grid.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Reads a volume as floats; NaN stays ("no data"), infinity is refused.
 *
 * The voxel data may stand in the file itself or in one file beside it. limit_bytes bounds each
 * file read and the voxels in memory (stored or as floats, whichever is more); 0 stands for
 * 512 MiB. Fails with GSN_E_NOTFOUND, GSN_E_IO, GSN_E_INPUT, GSN_E_UNSUPPORTED, GSN_E_LIMIT or
 * GSN_E_NOMEM. gives: ret_grid. */
int gsn_volume_read_grid(const char *path, size_t limit_bytes, struct gsn_grid **ret_grid,
                         struct gsn_error *err);

/* The same for a region: a voxel other than 0 is inside (1), NaN is refused. gives: ret_mask. */
int gsn_volume_read_mask(const char *path, size_t limit_bytes, struct gsn_mask **ret_mask,
                         struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
