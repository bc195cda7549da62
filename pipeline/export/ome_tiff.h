/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A colour stack as OME-TIFF, which Bio-Formats (ImageJ, Fiji, QuPath, napari, OMERO) opens: a page
 * a plane, sRGB of 8 bits, sizes and places in micrometres of the block frame. 0 0 0: no data. */
#ifndef GSN_EXPORT_OME_TIFF_H
#define GSN_EXPORT_OME_TIFF_H

#include "pipeline/core/colour_grid.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: the bytes; losslessly compressed (deflate), in BigTIFF from 4 GB on, the same bytes for
 * the same stack and version of libtiff. name: of the image; what is not printable ASCII becomes
 * '?'. borrows: stack. Fails with GSN_E_NOMEM, GSN_E_IO when libtiff does. */
int gsn_ome_tiff_write(const struct gsn_colour_grid *stack, const char *name, uint8_t **ret_bytes,
                       size_t *ret_size, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
