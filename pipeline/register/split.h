/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The connected pieces of a mask. Units are mask cells. */
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
    int thin;                /* no place of it is wider than a thread */
};

/* Cells [x0, x1) of row y, all of one piece. */
struct gsn_piece_run {
    int y, x0, x1;
    int piece; /* its index */
};

struct gsn_components {
    size_t count;
    struct gsn_component *piece;
    size_t run_count;
    struct gsn_piece_run *run; /* from top to bottom, from left to right */
};

void gsn_components_free(struct gsn_components *pieces);
GSN_DEFINE_AUTO(gsn_components);

/* Closes gaps of up to two cells, then separates what touches in none of the 8 directions.
 *
 * mask holds width * height bytes, rows from top to bottom, 0 outside and 1 inside. thread: what
 * is at most so many cells wide joins nothing: where a hair or the edge of a coverslip runs from
 * one thing to the next, it is left out between them; a thing that is that thin all over is a piece
 * of its own and marked so. 0 keeps everything together.
 * gives: pieces, in the order in which their first cells come. Fails with GSN_E_NOMEM. */
int gsn_split_pieces(const uint8_t *mask, int width, int height, unsigned thread,
                     struct gsn_components **ret_pieces, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
