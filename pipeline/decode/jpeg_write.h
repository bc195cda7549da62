/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Photographs as JPEG: the same image gives the same bytes. */
#ifndef GSN_DECODE_JPEG_WRITE_H
#define GSN_DECODE_JPEG_WRITE_H

#include "pipeline/core/error.h"
#include "pipeline/core/image.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_jpeg_style {
    int quality;     /* 1 to 100 */
    int smallest;    /* tables of its own: a smaller file, for memory as large as the picture */
    double px_um;    /* of the pixels, for the resolution tag; 0: not stated */
    int orientation; /* EXIF's; 0 or 1: not stated */
};

/* Encodes an 8-bit RGB image as it is stored; colours at half the resolution.
 *
 * Fails with GSN_E_UNSUPPORTED (16 bit or grey), GSN_E_INPUT (no pixels, or more than 65500 along a
 * side) or GSN_E_NOMEM. borrows: image, style. gives: ret_bytes. */
int gsn_jpeg_encode(const struct gsn_image *image, const struct gsn_jpeg_style *style,
                    uint8_t **ret_bytes, size_t *ret_size, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
