/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the TIFF files share: the open file, what its tags state, and what libtiff said.
 * Internal to decoding. */
#ifndef GSN_DECODE_TIFF_INTERNAL_H
#define GSN_DECODE_TIFF_INTERNAL_H

#include "pipeline/decode/raster.h"

#include <tiffio.h>

struct gsn_tiff {
    TIFF *tiff;
    struct gsn_bytes file;
    size_t at; /* where libtiff's reading stands */

    uint32_t width, height;
    uint16_t bits, samples; /* as stored, per pixel with alpha */
    uint16_t photometric, planar, compression, orientation;
    uint16_t extra; /* samples beyond the colours */
    int alpha;      /* the first of them is declared to be one */
    const uint16_t *palette[3];
    double slide_um; /* size of the pixels of the level that was chosen; 0: no slide */

    int said_code;  /* of the first complaint worth a refusal, or GSN_OK */
    char said[160]; /* its text */
};

/* Decodes all strips or tiles of the open page onto the canvas. */
int gsn_tiff_read_pixels(struct gsn_tiff *t, const struct gsn_raster *canvas,
                         struct gsn_error *err);

#endif
