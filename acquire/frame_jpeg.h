/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Frames of Motion JPEG: judged, and made picture files that stand alone. Private to this folder.
 */
#ifndef GSN_ACQUIRE_FRAME_JPEG_H
#define GSN_ACQUIRE_FRAME_JPEG_H

#include "acquire/frame.h"

#include <stdbool.h>

struct gsn_jpeg_stream {
    size_t end;      /* behind the EOI; what the camera sent after it is padding */
    bool has_tables; /* Huffman tables are among the segments */
};

/* Walks the segments. Fails with GSN_E_INPUT when the frame begins with no SOI, ends before its
 * EOI, or is of another size than the format says. */
int gsn_jpeg_stream_check(const struct gsn_frame *frame, struct gsn_jpeg_stream *ret_stream,
                          struct gsn_error *err);

/* gives: SOI, a comment segment with lines, the standard tables where they are missing, the rest.
 */
int gsn_jpeg_stream_keep(const struct gsn_frame *frame, const struct gsn_jpeg_stream *stream,
                         const char *lines, uint8_t **ret_bytes, size_t *ret_size,
                         struct gsn_error *err);

#endif
