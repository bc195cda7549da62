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
 * Some pictures are known beforehand and not taken: the panel taken last (a hand passed over it),
 * and what a person has shown as blank glass or as dark, all within the noise (gsn_stability_know);
 * and darkness: no cell brighter than twice the noise, for a panel is seen by the light that goes
 * through it. */
#ifndef GSN_ACQUIRE_SCENE_STABILITY_H
#define GSN_ACQUIRE_SCENE_STABILITY_H

#include "acquire/frame.h"

#include <stdbool.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_THUMBNAIL_COLUMNS = 32, GSN_THUMBNAIL_ROWS = 24, GSN_STABILITY_MAX_FRAMES = 64 };

/* Mean brightness of the cells a frame is divided in, 0..255. */
struct gsn_thumbnail {
    float cell[GSN_THUMBNAIL_COLUMNS * GSN_THUMBNAIL_ROWS];
};

/* Of a frame whose payload is complete; 0 when there is none: a JPEG tells no brightness unless it
 * is decoded, or the payload is short. */
int gsn_thumbnail_make(const struct gsn_frame *frame, struct gsn_thumbnail *ret_thumbnail);

/* The largest difference of a cell. */
float gsn_thumbnail_difference(const struct gsn_thumbnail *a, const struct gsn_thumbnail *b);

/* A thumbnail as text: each cell in two letters of the base64 alphabet, in sixteenths of a step of
 * brightness, so that it may stand in a JSON string. Reading costs no more than 1/32. */
enum { GSN_THUMBNAIL_TEXT = 2 * GSN_THUMBNAIL_COLUMNS * GSN_THUMBNAIL_ROWS };

void gsn_thumbnail_write(const struct gsn_thumbnail *thumbnail,
                         char ret_text[GSN_THUMBNAIL_TEXT + 1]);

/* The thumbnail among the facts of a frame (gsn_frame_facts); 0 when facts are NULL, hold none, or
 * were not written by these rules. facts may be any text. */
int gsn_thumbnail_read(const char *facts, struct gsn_thumbnail *ret_thumbnail);

enum gsn_stability_answer {
    GSN_STABILITY_MOVING,  /* not still yet */
    GSN_STABILITY_TAKE,    /* take this frame */
    GSN_STABILITY_WAITING, /* taken, or known: waiting for a change */
};

struct gsn_stability {
    unsigned frames; /* in a row that must be still: 2..GSN_STABILITY_MAX_FRAMES */
    float noise;     /* 0..255: neighbours that differ by more than this are never at rest */
    struct gsn_thumbnail previous, first;    /* first of the frames in a row */
    float between[GSN_STABILITY_MAX_FRAMES]; /* differences of those neighbours */
    unsigned run;                            /* of those frames; 0: none was seen */
    struct gsn_thumbnail known[GSN_SUBJECTS];
    bool is_known[GSN_SUBJECTS], is_waiting;
};

struct gsn_stability gsn_stability_begin(unsigned frames, float noise);

/* Looks at the next frame. */
enum gsn_stability_answer gsn_stability_update(struct gsn_stability *rest,
                                               const struct gsn_thumbnail *now);

/* This is the picture of that subject which was taken last, by rest, on request or by an earlier
 * process. It takes the place of the one before. */
void gsn_stability_know(struct gsn_stability *rest, enum gsn_source_subject subject,
                        const struct gsn_thumbnail *thumbnail);

#ifdef __cplusplus
}
#endif
#endif
