/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One captured frame, as the file that is kept of it.
 *
 * A PAM (netpbm's P7): the payload as the camera delivered it, without the padding at the ends of
 * rows; 16-bit samples with the high byte first, as PAM demands. TUPLTYPE names the layout. RGB and
 * GRAYSCALE are netpbm's own; ours are
 *   YUYV, UYVY    DEPTH 2: a pixel has its Y and, in turn, the U or V it shares with a neighbour
 *   NV12          DEPTH 1, and HEIGHT is one and a half times that of the picture: rows of Y, then
 *                 half as many of U and V in turn
 *   BGR           DEPTH 3, blue first
 *   BAYER_RGGB    (BGGR, GBRG, GRBG) DEPTH 1: the sensor's samples, the first row's letters first;
 *                 MAXVAL 255, 1023, 4095 or 65535
 * Comments at the top, "# key: value", say what the bytes mean and which camera gave them, with
 * which controls as read back; they begin with "# gieson frame 1". No time is among them: the same
 * frame is the same file.
 *
 * A frame that is a JPEG stays one. The same lines stand in a comment segment behind its SOI, and
 * the standard Huffman tables (ITU T.81, annex K.3) are put in where the stream has none, as the
 * streams of many UVC cameras; a line says so. */
#ifndef GSN_ACQUIRE_FRAME_H
#define GSN_ACQUIRE_FRAME_H

#include "acquire/source.h"
#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* How cameras lay out pixels, and what becomes of each layout in a PAM file. A new format is one
 * row of the table. */

enum gsn_packing {
    GSN_PACKING_BYTES, /* kept byte for byte */
    GSN_PACKING_WORDS, /* 16 bit, low byte first; PAM wants the high byte first, so they change
                          places and nothing else */
    GSN_PACKING_CSI10, /* MIPI CSI-2: four samples in five bytes, the last with the low bits */
    GSN_PACKING_CSI12, /* two samples in three bytes; both are taken apart into 16-bit samples */
    GSN_PACKING_NV12,  /* a plane of Y, then one of half the rows with U and V in turn */
    GSN_PACKING_JPEG,  /* a picture file already */
};

struct gsn_pixel_format {
    char fourcc[5];        /* V4L2's code; trailing blanks belong to it */
    const char *libcamera; /* libcamera's name */
    enum gsn_packing packing;
    unsigned depth;           /* samples to a pixel in the file */
    unsigned bits;            /* of a sample: MAXVAL is 2^bits - 1 */
    const char *tupltype;     /* RGB and GRAYSCALE are PAM's, the others ours */
    unsigned luma, luma_step; /* for GSN_PACKING_BYTES: the byte that stands for the brightness of
                                 the first pixel, and from one pixel's to the next's */
};

/* borrows: a row of the table, valid for ever; NULL when there is none. By a code as a person
 * writes it ("YUYV", "Y16"), blanks at its end left away or not. */
const struct gsn_pixel_format *gsn_pixel_format_named(const char *fourcc);

/* V4L2's number of the code. */
uint32_t gsn_pixel_format_code(const struct gsn_pixel_format *format);

/* The codes of the table, for sentences: "YUYV, UYVY, ...". */
const char *gsn_pixel_format_list(void);

/* Y, U and V: needs a matrix and a range to become RGB. */
int gsn_pixel_format_is_yuv(const struct gsn_pixel_format *format);

/* Samples as the sensor gave them, before any white balance. */
int gsn_pixel_format_is_raw(const struct gsn_pixel_format *format);

/* Bytes of one row without padding (of the Y plane for NV12; 0 for JPEG). */
uint64_t gsn_pixel_format_row(const struct gsn_pixel_format *format, uint32_t width);

/* Text that grows: headers of frames, what a device stated, as JSON. */

struct gsn_text {
    char *at; /* NULL before the first piece; owned */
    size_t used, room;
    bool starved; /* memory ran out: what follows is not added */
};

void gsn_text_add(struct gsn_text *text, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

struct gsn_frame_control {
    const char *name;   /* "exposure", "gain", "white balance", ... */
    const char *unit;   /* as the camera's interface counts it; empty for a mere number */
    int64_t value;      /* read back */
    int is_known;       /* 0: the camera has no such control, or does not tell its value */
    const char *unlock; /* why it may change by itself, without full stop; NULL: it is locked */
};

struct gsn_frame {
    const struct gsn_pixel_format *format;
    uint32_t width, height;
    uint32_t stride;        /* bytes from one row to the next; of both planes for NV12 */
    const char *device;     /* the camera's name and serial */
    const char *interface;  /* "V4L2", "libcamera" */
    const char *colorspace; /* as the interface calls it */
    const char *matrix;     /* of YUV: "BT.601", "BT.709", "BT.2020"; else NULL */
    const char *range;      /* of YUV: "full" or "limited"; else NULL */
    const char *transfer;   /* "sRGB", "linear"; NULL: not stated, or a curve that is neither */
    enum gsn_source_subject subject;
    size_t control_count;
    const struct gsn_frame_control *control;
    const char *withheld; /* why colours of this frame must not be measured; NULL: they may */
    const uint8_t *bytes;
    size_t size;
};

/* "panel", "blank" or "dark". */
const char *gsn_frame_subject(enum gsn_source_subject subject);

/* gives: the file.
 *
 * Fails with GSN_E_INPUT when the payload is short, has a sample above what its bits can hold, or
 * is a JPEG without its end or one that is no baseline picture of the stated size; the sentence
 * says which. GSN_E_NOMEM. */
int gsn_frame_encode(const struct gsn_frame *frame, uint8_t **ret_bytes, size_t *ret_size,
                     struct gsn_error *err);

/* gives: the same facts as a JSON object, with how many frames the camera had flagged as damaged
 * since the one before, and the frame's thumbnail as text (acquire/scene_stability.h; NULL: none).
 */
int gsn_frame_facts(const struct gsn_frame *frame, unsigned damaged, const char *thumbnail,
                    char **ret_json, struct gsn_error *err);

/* "panel.pam", "blank.jpg": without a number, for a name's number is that of its panel. */
const char *gsn_frame_name(const struct gsn_frame *frame);

#ifdef __cplusplus
}
#endif
#endif
