/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a captured frame says of itself, in lines "# key: value" that begin with "# gieson frame 1":
 * at the top of a PAM, or in the first comment segment of a JPEG. Internal to decoding. */
#ifndef GSN_DECODE_FRAME_NOTES_H
#define GSN_DECODE_FRAME_NOTES_H

#include "pipeline/decode/raster.h"

/* Empty texts: not said. */
struct gsn_frame_notes {
    char matrix[16], range[16], transfer[16];
    char withheld[160]; /* why colours must not be measured; cut when longer */
};

/* Takes one line of a header, without its newline. begun: whether the first line was seen; lines
 * before it are anybody's comments and mean nothing. */
void gsn_frame_notes_line(struct gsn_frame_notes *notes, int *begun, const char *line, size_t size);

/* Those of a JPEG, empty when it has none. Every length is checked against the file's. */
struct gsn_frame_notes gsn_frame_notes_of_jpeg(struct gsn_bytes file);

/* Transfer curve, where the file's own header said none, and why the picture is withheld. */
void gsn_frame_notes_apply(const struct gsn_frame_notes *notes, struct gsn_picture *picture);

#endif
