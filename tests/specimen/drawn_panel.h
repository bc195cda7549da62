/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Small panels with a known truth: stained sections on glass with three burnt marks, coloured by
 * the built-in dye vectors (PHANTOM.md, sections 2 and 3, without texture or noise).
 *
 * The block frame is that of a job that states drawn_marks_um: micrometres, x right and y down. The
 * density is that of the section times 1 + DRAWN_SLOPE x, so a mean over a region that is symmetric
 * in x is the section's density, and one beside it tells left from right. */
#ifndef GSN_TESTS_SPECIMEN_DRAWN_PANEL_H
#define GSN_TESTS_SPECIMEN_DRAWN_PANEL_H

#include "pipeline/core/geom.h"
#include "pipeline/core/image.h"

#include <stdint.h>

enum { DRAWN_ROWS = 2, DRAWN_COLUMNS = 2, DRAWN_SLOTS = DRAWN_ROWS * DRAWN_COLUMNS };

#define DRAWN_SLOPE 2e-4
#define DRAWN_WIDTH_UM 1000.0 /* half axes of the tissue, an ellipse about the origin */
#define DRAWN_HEIGHT_UM 800.0

extern const struct gsn_point drawn_marks_um[3];
#define DRAWN_MARKS_JSON "[[-717.5, -350], [595, -525], [-525, 455]]"

struct drawn_section {
    int missing;               /* glass */
    unsigned no_marks;         /* bit m: mark m was not burnt */
    int flipped;               /* mounted face down */
    int lopsided;              /* the tissue ends at x = 200 and y = 100 um in its last quarter */
    unsigned grain;            /* not 0: structures that all sections share, and a grain by this
                                  number; the density's mean is no longer exact */
    double turn_deg;           /* of the mounting */
    struct gsn_point shift_um; /* of the mounting, on the panel */
    double density;            /* at x = 0 */
};

struct drawn_panel {
    double px_um;
    int srgb;     /* codes by the sRGB curve instead of in proportion to light */
    int mirrored; /* as it was fed: left to right, ... */
    int quarters; /* ... then turned clockwise; places and sections are those of the upright one */
    struct drawn_section section[DRAWN_SLOTS]; /* row by row */
};

/* Panel number (1-based) of a block whose sections all have this density: each mounted a little
 * askew in its own way. */
struct drawn_panel drawn_panel_of(unsigned number, double px_um, double density);

/* Where a point of the block's section lies on the panel, in pixels with centres at +0.5. */
struct gsn_point drawn_panel_place(const struct drawn_panel *panel, unsigned slot,
                                   struct gsn_point um);

/* gives: the picture mirrored left to right or not, then turned clockwise by quarters. Fails the
 * test when memory runs out. */
struct gsn_image *drawn_turned(const struct gsn_image *image, int mirrored, int quarters);

/* gives: the picture; its PNG. Fail the test when memory runs out. */
struct gsn_image *drawn_panel_image(const struct drawn_panel *panel);
uint8_t *drawn_panel_png(const struct drawn_panel *panel, size_t *ret_size);

#endif
