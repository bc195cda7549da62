/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How cameras lay out pixels, and what becomes of each layout in a PAM file. A new format is one
 * row of the table. */
#ifndef GSN_ACQUIRE_PIXEL_FORMAT_H
#define GSN_ACQUIRE_PIXEL_FORMAT_H

#include "pipeline/core/error.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_packing {
    GSN_PACKING_BYTES, /* kept byte for byte */
    GSN_PACKING_WORDS, /* 16 bit, low byte first; PAM wants the high byte first, so they change
                          places and nothing else */
    GSN_PACKING_CSI10, /* MIPI CSI-2: four samples in five bytes, the last with the low bits */
    GSN_PACKING_CSI12, /* two samples in three bytes; both are taken apart into 16-bit samples */
    GSN_PACKING_NV12,  /* a plane of Y, then one of half the rows with U and V in turn */
    GSN_PACKING_JPEG,  /* a picture file already */
};

struct gsn_pixel_format {
    char fourcc[5];        /* V4L2's code; trailing blanks belong to it */
    const char *libcamera; /* libcamera's name */
    enum gsn_packing packing;
    unsigned depth;           /* samples to a pixel in the file */
    unsigned bits;            /* of a sample: MAXVAL is 2^bits - 1 */
    const char *tupltype;     /* RGB and GRAYSCALE are PAM's, the others ours */
    unsigned luma, luma_step; /* for GSN_PACKING_BYTES: the byte that stands for the brightness of
                                 the first pixel, and from one pixel's to the next's */
};

/* borrows: a row of the table, valid for ever; NULL when no row has that code or name. */
const struct gsn_pixel_format *gsn_pixel_format_v4l2(uint32_t fourcc);
const struct gsn_pixel_format *gsn_pixel_format_libcamera(const char *name);
/* By a code as a person writes it ("YUYV", "Y16"), blanks at its end left away or not. */
const struct gsn_pixel_format *gsn_pixel_format_named(const char *fourcc);

/* V4L2's number of the code. */
uint32_t gsn_pixel_format_code(const struct gsn_pixel_format *format);

/* The codes of the table, for sentences: "YUYV, UYVY, ...". */
const char *gsn_pixel_format_list(void);

/* Y, U and V: needs a matrix and a range to become RGB. */
int gsn_pixel_format_is_yuv(const struct gsn_pixel_format *format);
/* Samples as the sensor gave them, before any white balance. */
int gsn_pixel_format_is_raw(const struct gsn_pixel_format *format);

/* Bytes of one row without padding (of the Y plane for NV12; 0 for JPEG). */
uint64_t gsn_pixel_format_row(const struct gsn_pixel_format *format, uint32_t width);

#ifdef __cplusplus
}
#endif
#endif
