/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the codecs share: the bytes of a file, and a canvas that turns stored pixels upright while
 * they arrive, so that no second copy of a large picture is ever needed. Internal to decoding. */
#ifndef GSN_DECODE_RASTER_H
#define GSN_DECODE_RASTER_H

#include "pipeline/decode/decode.h"

#include <stddef.h>

struct gsn_bytes {
    const uint8_t *at;
    size_t size;
};

/* Working memory a codec may use beside the decoded samples. */
#define GSN_DECODE_WORK_BYTES ((uint64_t)128 << 20)
/* The longest row, or the largest tile, that is decoded in one piece. */
#define GSN_DECODE_PIECE_BYTES ((uint64_t)64 << 20)

/* A picture as its header describes it, before it is turned upright. */
struct gsn_raster_layout {
    uint32_t width, height, channels, bits;
    unsigned orientation; /* 1..8 as in EXIF and TIFF */
};

/* Pixel (x, y) as stored is at origin + x * step_x + y * step_y of the upright image. */
struct gsn_raster {
    struct gsn_image *image; /* borrowed from the picture */
    ptrdiff_t origin, step_x, step_y;
    uint64_t *transparent; /* borrowed from the picture: how many pixels are */
};

/* A run of pixels of one stored row: x, x + step, ... Samples are native; stride counts the samples
 * from one pixel of the source to the next; channels of them are taken, put from channel on. */
struct gsn_run {
    uint32_t x, y, step, count;
    uint32_t channel, channels, stride;
    int alpha; /* the sample behind the channels is one */
};

/* Checks the limits, then allocates picture->image; turns px_um and notes the orientation.
 *
 * limits has no member 0. Fails with GSN_E_INPUT (no pixels), GSN_E_LIMIT or GSN_E_NOMEM. */
int gsn_raster_open(struct gsn_raster *canvas, const struct gsn_raster_layout *layout,
                    const struct gsn_decode_limits *limits, struct gsn_picture *picture,
                    struct gsn_error *err);

/* As gsn_decode(), with the samples at place, the start of a page with room for limits->most_bytes,
 * whatever they hold; NULL allocates them. borrows: place, as long as the picture lives. */
int gsn_decode_into(const void *bytes, size_t size, const struct gsn_decode_limits *limits,
                    void *place, struct gsn_picture **ret_picture, struct gsn_error *err);

/* The limits with their defaults put in; limits may be NULL. */
struct gsn_decode_limits gsn_decode_defaults(const struct gsn_decode_limits *limits);

/* The caller guarantees that the run lies inside the stored picture. */
void gsn_raster_put(const struct gsn_raster *canvas, const struct gsn_run *run,
                    const void *samples);
/* The same for so many stored rows from run->y on, each row_bytes after the other in samples. */
void gsn_raster_put_rows(const struct gsn_raster *canvas, const struct gsn_run *run, uint32_t rows,
                         size_t row_bytes, const void *samples);

/* Where stored row y goes when its pixels, all channels of them, come to lie side by side as they
 * are stored; rows then follow each other. NULL when they have to be turned. */
void *gsn_raster_row(const struct gsn_raster *canvas, uint32_t y);

/* Adds a remark to picture->note; what does not fit is left out whole. */
void gsn_picture_remark(struct gsn_picture *picture, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* Sets both pitches from pixels per unit of unit_um; values that make no sense state nothing. */
void gsn_picture_pitch(struct gsn_picture *picture, double per_unit_x, double per_unit_y,
                       double unit_um);

/* One codec each: fill a picture that holds nothing yet. limits has no member 0. */
int gsn_jpeg_decode(struct gsn_bytes file, const struct gsn_decode_limits *limits,
                    struct gsn_picture *picture, struct gsn_error *err);
int gsn_png_decode(struct gsn_bytes file, const struct gsn_decode_limits *limits,
                   struct gsn_picture *picture, struct gsn_error *err);
int gsn_pam_decode(struct gsn_bytes file, const struct gsn_decode_limits *limits,
                   struct gsn_picture *picture, struct gsn_error *err);
int gsn_tiff_decode(struct gsn_bytes file, const struct gsn_decode_limits *limits,
                    struct gsn_picture *picture, struct gsn_error *err);

#endif
