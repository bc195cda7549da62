/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* When has a panel come to rest under the camera? Decided from small pictures of brightness, one a
 * frame, and from nothing else: no clock, no memory beyond three of them.
 *
 * After a change it waits for frames in a row of which each differs from the one before by no more
 * than noise can, and the last from the first by no more than twice what neighbours differ: that
 * is, nothing moves, only noise is left, and the noise is measured in those very frames. Then one
 * frame is to be taken, and the next change awaited. A slow slide fails the second half: its ends
 * differ by many times what neighbours do.
 *
 * What lies there is not asked. An empty stage at rest is taken as a panel would be, for a faint
 * section and clean glass cannot be told apart from a distance; a person files it or does not.
 * Three pictures are known beforehand and not taken: the one taken last (a hand passed over it),
 * the blank glass a person has shown (gsn_rest_blank), both within the noise, and darkness: no cell
 * brighter than twice the noise, for a panel is seen by the light that goes through it. */
#ifndef GSN_ACQUIRE_REST_H
#define GSN_ACQUIRE_REST_H

#include "acquire/frame.h"

#include <stdbool.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_THUMBNAIL_COLUMNS = 32, GSN_THUMBNAIL_ROWS = 24, GSN_REST_MOST_FRAMES = 64 };

/* Mean brightness of the cells a frame is divided in, 0..255. */
struct gsn_thumbnail {
    float cell[GSN_THUMBNAIL_COLUMNS * GSN_THUMBNAIL_ROWS];
};

/* Of a frame whose payload is complete; 0 when there is none: a JPEG tells no brightness unless it
 * is decoded, or the payload is short. */
int gsn_thumbnail_make(const struct gsn_frame *frame, struct gsn_thumbnail *ret_thumbnail);

/* The largest difference of a cell. */
float gsn_thumbnail_difference(const struct gsn_thumbnail *a, const struct gsn_thumbnail *b);

enum gsn_rest_answer {
    GSN_REST_MOVING,  /* not still yet */
    GSN_REST_TAKE,    /* take this frame */
    GSN_REST_WAITING, /* taken, or known: waiting for a change */
};

struct gsn_rest {
    unsigned frames; /* in a row that must be still: 2..GSN_REST_MOST_FRAMES */
    float noise;     /* 0..255: neighbours that differ by more than this are never at rest */
    struct gsn_thumbnail previous, first, taken, blank; /* first of the frames in a row */
    float between[GSN_REST_MOST_FRAMES];                /* differences of those neighbours */
    unsigned run;                                       /* of those frames; 0: none was seen */
    bool has_taken, has_blank, is_waiting;
};

struct gsn_rest gsn_rest_begin(unsigned frames, float noise);

/* Looks at the next frame. */
enum gsn_rest_answer gsn_rest_look(struct gsn_rest *rest, const struct gsn_thumbnail *now);

/* This is the blank glass. */
void gsn_rest_blank(struct gsn_rest *rest, const struct gsn_thumbnail *blank);

#ifdef __cplusplus
}
#endif
#endif
