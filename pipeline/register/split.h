/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The connected pieces of a mask, by OpenCV (split_opencv.cpp). Units are mask cells. */
#ifndef GSN_REGISTER_SPLIT_H
#define GSN_REGISTER_SPLIT_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_component {
    int x, y, width, height; /* box */
    size_t area;             /* cells */
    double cx, cy;           /* centre of area, cell centres at +0.5 */
};

struct gsn_components {
    size_t count;
    struct gsn_component *piece;
    int32_t *label; /* width * height: 0 outside, else 1 + the index of the piece */
};

void gsn_components_free(struct gsn_components *pieces);
GSN_DEFINE_AUTO(gsn_components);

/* Closes gaps of up to 2 close_cells, then separates what touches in none of the 8 directions.
 *
 * mask holds width * height bytes, rows from top to bottom, 0 outside; it is changed to the closed
 * mask. gives: pieces, in the order in which their first cells come. Fails with GSN_E_NOMEM. */
int gsn_split_pieces(uint8_t *mask, int width, int height, int close_cells,
                     struct gsn_components **ret_pieces, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
