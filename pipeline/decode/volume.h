/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Volumes out of files: MetaImage (.mhd, .mha), NRRD (.nrrd, .nhdr) and INRIMAGE-4 (.inr).
 *
 * Three axes, one number a voxel, axes parallel to those of the block frame. Lengths
 * are micrometres: as the header says (NRRD's units may be micrometres or millimetres), else as the
 * caller does. The origin is the centre of the first voxel. A header that
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
 * unit_um: how many micrometres a length in the header is where it states no unit; > 0.
 * The voxel data may stand in the file itself or in one file beside it. limit_bytes bounds each
 * file read and the voxels in memory (stored or as floats, whichever is more); 0 stands for
 * 512 MiB. Fails with GSN_E_NOTFOUND, GSN_E_IO, GSN_E_INPUT, GSN_E_UNSUPPORTED, GSN_E_LIMIT or
 * GSN_E_NOMEM. gives: ret_grid. */
int gsn_volume_read_grid(const char *path, size_t limit_bytes, double unit_um,
                         struct gsn_grid **ret_grid, struct gsn_error *err);

/* The same for a region: a voxel other than 0 is inside (1), NaN is refused. gives: ret_mask. */
int gsn_volume_read_mask(const char *path, size_t limit_bytes, double unit_um,
                         struct gsn_mask **ret_mask, struct gsn_error *err);

/* Whether the text of a header states the unit of its lengths. */
int gsn_volume_states_unit(const char *header, size_t size);

#ifdef __cplusplus
}
#endif
#endif
