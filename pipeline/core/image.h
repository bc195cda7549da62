/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures in memory: integer samples as scanned, and float planes for arithmetic.
 *
 * Rows run from top to bottom, channels are interleaved, nothing is padded. */
#ifndef GSN_CORE_IMAGE_H
#define GSN_CORE_IMAGE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* channels is 1 (grey) or 3 (RGB); bits is 8 (samples are uint8_t) or 16 (uint16_t, native). */
struct gsn_image {
    uint32_t width, height, channels, bits;
    void *samples;
};

struct gsn_plane {
    uint32_t width, height;
    float *value;
};

/* gives: zeroed. Fails with GSN_E_NOMEM. The caller guarantees the legal channels and bits. */
int gsn_image_new(uint32_t width, uint32_t height, uint32_t channels, uint32_t bits,
                  struct gsn_image **ret_image, struct gsn_error *err);
void gsn_image_free(struct gsn_image *image);
GSN_DEFINE_AUTO(gsn_image);

/* One sample as an integer, 0..255 or 0..65535. */
unsigned gsn_image_at(const struct gsn_image *image, uint32_t x, uint32_t y, uint32_t channel);
size_t gsn_image_bytes(const struct gsn_image *image);

/* gives: zeroed. Fails with GSN_E_NOMEM. */
int gsn_plane_new(uint32_t width, uint32_t height, struct gsn_plane **ret_plane,
                  struct gsn_error *err);
void gsn_plane_free(struct gsn_plane *plane);
GSN_DEFINE_AUTO(gsn_plane);

#ifdef __cplusplus
}
#endif
#endif
