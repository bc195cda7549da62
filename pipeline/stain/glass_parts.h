/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the files that look for glass share. For glass*.c alone. */
#ifndef GSN_STAIN_GLASS_PARTS_H
#define GSN_STAIN_GLASS_PARTS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_GLASS_TERMS = 6 };

struct gsn_glass_cell {
    double light[3]; /* mean of log10 */
    double rough;    /* deviation of one pixel in it */
    uint32_t top;    /* of the pixels read, those with a channel at the highest code */
    double weight;
};

struct gsn_glass_cells {
    size_t nx, ny, side;
    size_t apart, taps;     /* pixels read of a cell along each side, and how far from each other */
    uint32_t width, height; /* of the picture */
    struct gsn_glass_cell *cell;
    double *scratch; /* nx * ny */
};

struct gsn_glass_surface {
    double s[3][GSN_GLASS_TERMS];
    double reach;
};

/* Share of the cells that end on the surface, which begins near them and is fitted to them with a
 * reach that shrinks; their weights are left as they were last. */
double gsn_glass_grow(const struct gsn_glass_cells *all, struct gsn_glass_surface *surface);

#ifdef __cplusplus
}
#endif
#endif
