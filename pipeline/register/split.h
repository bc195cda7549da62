/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The connected pieces of a mask, with what is thin told from what is wide. Units are mask cells. */
#ifndef GSN_REGISTER_SPLIT_H
#define GSN_REGISTER_SPLIT_H

#include "pipeline/imaging/components.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Closes gaps of up to two cells, then separates what touches in none of the 8 directions.
 *
 * mask holds width * height bytes, rows from top to bottom, 0 outside and 1 inside. thread: what
 * is at most so many cells wide joins nothing: where a hair or the edge of a coverslip runs from
 * one thing to the next, it is left out between them; a thing that is that thin all over is a piece
 * of its own and marked so. 0 keeps everything together.
 * gives: pieces, in the order in which their first cells come, and for each whether no place of it
 * is wider than a thread (ret_thin; NULL where nobody asks). Fails with GSN_E_NOMEM. */
int gsn_split_pieces(const uint8_t *mask, uint32_t width, uint32_t height, unsigned thread,
                     struct gsn_components **ret_pieces, uint8_t **ret_thin,
                     struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
