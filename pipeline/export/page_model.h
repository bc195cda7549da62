/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A model small enough to travel in a page, for the viewer that the report carries
 * (pipeline/report/viewer.js reads it, and both state the format).
 *
 * zlib around, little-endian: GSN_PAGE_HEAD doubles, then columns. A column is a byte W, then
 * W planes of one byte an item: the lowest bytes of all items, the next ones, ... Items are
 * differences to the item before, 2 d for d >= 0 and -2 d - 1 below. With V vertices, E edges
 * and C cells the columns are
 *
 *     V   x, y, z            origin + step * item, um
 *     C   corner 0, 1, 2, 3  of 0..V-1
 *     V   s at the vertices  low + step * item
 *     E   s amid the edges   the same; edges in the order in which cells have them first, of each
 *                            cell (0,1) (0,2) (0,3) (1,2) (1,3) (2,3)
 *     C   number             of the tetrahedron in the model
 *     C   density            times 10^digits, to the nearest; and the same of
 *     C   lower, upper       certified bounds of s in the cell, rounded outward
 *     C   residual           rms of its samples
 *     C   below, above       s lies between l - below and l + above, l being linear between s at
 *                            the corners as given here; rounded outward
 *     C   samples
 *     C   share              of its volume in the region, times 1000
 *     C   volume             um^3 times 10^(digits of volumes)
 *     V   inward             distance from the border of the region in um, positive inside, at the
 *                            vertices
 *     E                      the same amid the edges
 *     V   red at the vertices, where there are colours: codes of sRGB, 0..255
 *     E   red amid the edges; then green and blue likewise
 *
 * What the model does not have is -2^31. Cells that hold no tissue of the region are left out. */
#ifndef GSN_EXPORT_PAGE_MODEL_H
#define GSN_EXPORT_PAGE_MODEL_H

#include "pipeline/model/model_file.h"

#ifdef __cplusplus
extern "C" {
#endif

/* V, E, C, origin x y z, step x y z, low and step of s, digits, digits of volumes, the two ends of
 * the colour scale, channels of colour (0 or 3). */
enum { GSN_PAGE_HEAD = 16 };

/* A page may weigh 3 MB: pictures take 2, and base64 a quarter of the rest. */
enum { GSN_PAGE_BYTES = 600000 };

struct gsn_page_options {
    const struct gsn_mask *region; /* NULL: all of the domain is inside */
    double low, high;              /* ends of the colour scale */
    const struct gsn_spline *const
        *colour; /* red, green, blue as light on the same space, or NULL */
    size_t most_bytes;
};

struct gsn_page_model {
    uint8_t *bytes; /* owned */
    size_t size;
    size_t cells;    /* that are in it */
    size_t of;       /* that the model has with tissue of the region */
    double apart_um; /* 0: all are; else corners nearer than this were drawn together, cells that
                        lost their volume by it are left out, and the others fill the room */
};

/* gives: the model; with no cells where none has tissue. borrows: everything. Fails with
 * GSN_E_LIMIT when it cannot be made so small, GSN_E_NOMEM. The same bytes for any number of
 * threads. */
int gsn_page_model_new(const struct gsn_spline *spline, const struct gsn_model_cells *cells,
                       const struct gsn_page_options *options, unsigned threads,
                       struct gsn_page_model **ret_model, struct gsn_error *err);
void gsn_page_model_free(struct gsn_page_model *model);
GSN_DEFINE_AUTO(gsn_page_model);

#ifdef __cplusplus
}
#endif
#endif
