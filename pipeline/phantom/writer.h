/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Panels as files: PNG, LZW TIFF and JPEG with the pixel size in their resolution tags. */
#ifndef GSN_PHANTOM_WRITER_H
#define GSN_PHANTOM_WRITER_H

#include "pipeline/core/image.h"
#include "pipeline/phantom/buffer.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Encode an RGB image, of 8 bits (the TIFF also of 16), into an empty buffer. Fail with GSN_E_NOMEM
 * or GSN_E_UNSUPPORTED. */
int gsn_phantom_png(const struct gsn_image *image, double px_um,
                    struct gsn_phantom_buffer *ret_file, struct gsn_error *err);
int gsn_phantom_tiff(const struct gsn_image *image, double px_um,
                     struct gsn_phantom_buffer *ret_file, struct gsn_error *err);

/* Quality 1..100, colours at half resolution in both directions (4:2:0). orientation is EXIF's; at
 * 1 nothing is said about it. The image is what is stored, turned already. */
int gsn_phantom_jpeg(const struct gsn_image *image, double px_um, int quality, int orientation,
                     struct gsn_phantom_buffer *ret_file, struct gsn_error *err);

/* gives: the image after one passage through such a file. */
int gsn_phantom_jpeg_lossy(const struct gsn_image *image, int quality, struct gsn_image **ret_image,
                           struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
