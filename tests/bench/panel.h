/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The panel that decoding, splitting and registering are timed on: 8000 x 6000 pixels of 5 um, four
 * by three sections of 6 mm with three marks each, turned by any angle, some face down; glass with
 * vignetting and noise, dust. A quick run makes it smaller. */
#ifndef GSN_TESTS_BENCH_PANEL_H
#define GSN_TESTS_BENCH_PANEL_H

#include "pipeline/core/geom.h"
#include "pipeline/core/image.h"

enum { BENCH_ROWS = 3, BENCH_COLUMNS = 4, BENCH_SECTIONS = BENCH_ROWS * BENCH_COLUMNS };

struct bench_panel {
    struct gsn_image *image;
    double px_um;
    uint32_t side;                            /* of a section's square, pixels */
    struct gsn_point triangle_um[3];          /* marks around the section's centre */
    struct gsn_point mark[BENCH_SECTIONS][3]; /* where they are, pixel centres at +0.5 */
};

struct bench_panel bench_panel_draw(void);
void bench_panel_done(struct bench_panel *panel);

enum bench_format {
    BENCH_TIFF_STRIPS,
    BENCH_TIFF_TILES,
    BENCH_TIFF_UNEVEN,
    BENCH_TIFF_WIDE,
    BENCH_TIFF_LZW,
    BENCH_TIFF_LZW_TILES,
    BENCH_TIFF_ZIP,
    BENCH_TIFF_JPEG,
    BENCH_JPEG,
    BENCH_PNG,
    BENCH_FORMATS
};
const char *bench_format_name(enum bench_format format);
unsigned bench_format_bits(enum bench_format format);

/* Writes the picture, by the libraries themselves. Returns whether it is there. */
int bench_format_write(enum bench_format format, const struct gsn_image *image, const char *path);
/* Decodes the file with the bare library into bytes that are as many as the file's picture has,
 * upright RGB. Returns whether it went well. */
int bench_format_read(enum bench_format format, const char *path, uint8_t *bytes);

#endif
