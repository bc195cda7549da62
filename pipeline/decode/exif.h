/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The few EXIF fields that change what a scan means: which side is up, how far apart pixels are,
 * and which colours its numbers name. Internal to decoding. */
#ifndef GSN_DECODE_EXIF_H
#define GSN_DECODE_EXIF_H

#include <stddef.h>
#include <stdint.h>

struct gsn_exif {
    unsigned orientation;          /* 1..8; 1 when not stated */
    double per_unit_x, per_unit_y; /* pixels per unit_um; 0: not stated */
    double unit_um;
    int is_srgb; /* ColorSpace 1 */
};

/* Reads the TIFF-shaped EXIF block (behind JPEG's "Exif\0\0", or a PNG eXIf chunk).
 *
 * Every offset is checked against size. Returns whether the block could be read; ret_exif then
 * holds what it states and otherwise the values of a file that states nothing. */
int gsn_exif_read(const uint8_t *bytes, size_t size, struct gsn_exif *ret_exif);

#endif
