/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures as PNG, for reports and for tests: the same image gives the same bytes. */
#ifndef GSN_DECODE_PNG_WRITE_H
#define GSN_DECODE_PNG_WRITE_H

#include "pipeline/core/error.h"
#include "pipeline/core/image.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Encodes an 8-bit grey or RGB image; no time, no text, fixed filter and level.
 *
 * Fails with GSN_E_UNSUPPORTED (16 bit), GSN_E_INPUT (no pixels) or GSN_E_NOMEM.
 * borrows: image. gives: ret_bytes. */
int gsn_png_encode(const struct gsn_image *image, uint8_t **ret_bytes, size_t *ret_size,
                   struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
