/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A density on a regular grid as a file that ITK, 3D Slicer, ImageJ and VTK open: NRRD, NIfTI-1.
 *
 * One float a voxel, NaN where there is no data; lengths are micrometres of the block frame, the
 * origin is the centre of the first voxel. NIfTI's axes have names (right, anterior, superior);
 * here they are x, y and z of the block and nothing more. */
#ifndef GSN_EXPORT_VOLUME_FILE_H
#define GSN_EXPORT_VOLUME_FILE_H

#include "pipeline/core/grid.h"

#ifdef __cplusplus
extern "C" {
#endif

/* give: the bytes. gzip: whether the file is compressed as a whole (.nii.gz); the same grid gives
 * the same bytes. Fail with GSN_E_NOMEM; NIfTI also with GSN_E_LIMIT when there are more than 32767
 * voxels along an axis. */
int gsn_nrrd_write(const struct gsn_grid *grid, uint8_t **ret_bytes, size_t *ret_size,
                   struct gsn_error *err);
int gsn_nifti_write(const struct gsn_grid *grid, int gzip, uint8_t **ret_bytes, size_t *ret_size,
                    struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
