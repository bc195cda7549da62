/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Photographs as JPEG, for reports: the same image gives the same bytes. */
#ifndef GSN_DECODE_JPEG_WRITE_H
#define GSN_DECODE_JPEG_WRITE_H

#include "pipeline/core/error.h"
#include "pipeline/core/image.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Encodes an 8-bit RGB image with this quality, 1 to 100; colours at half the resolution.
 *
 * Fails with GSN_E_UNSUPPORTED (16 bit or grey), GSN_E_INPUT (no pixels, or more than 65500 along a
 * side) or GSN_E_NOMEM. borrows: image. gives: ret_bytes. */
int gsn_jpeg_encode(const struct gsn_image *image, int quality, uint8_t **ret_bytes,
                    size_t *ret_size, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
