/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The text headers of volume files (volume_formats.c): one description for the three formats, and
 * the few ways of taking a text apart that others use too. Internal to decoding. */
#ifndef GSN_DECODE_VOLUME_INTERNAL_H
#define GSN_DECODE_VOLUME_INTERNAL_H

#include "pipeline/core/error.h"
#include "pipeline/core/grid.h"

#include <stddef.h>

enum gsn_voxel {
    GSN_VOXEL_NONE,
    GSN_VOXEL_U8,
    GSN_VOXEL_S8,
    GSN_VOXEL_U16,
    GSN_VOXEL_S16,
    GSN_VOXEL_U32,
    GSN_VOXEL_S32,
    GSN_VOXEL_F32,
    GSN_VOXEL_F64,
};

struct gsn_volume_header {
    struct gsn_lattice at; /* in the header's own unit */
    double unit_um;        /* which is so many micrometres; 0: it does not say */
    enum gsn_voxel voxel;
    int big_endian, compressed; /* compressed: one zlib or gzip stream */
    char data_file[256];        /* beside the header; empty: the data are in the header's file */
    size_t data_at;             /* first byte of the data, when from_end is 0 */
    int from_end;               /* the data are the last bytes of their file */
};

/* A stretch of header text, not terminated. */
struct gsn_words {
    const char *at;
    size_t size;
};

/* Cuts the next line off rest, without its end; returns whether there was one. */
int gsn_words_line(struct gsn_words *rest, struct gsn_words *ret_line);
/* "key<mark>value", both trimmed; returns whether the mark is there. */
int gsn_words_split(struct gsn_words line, const char *mark, struct gsn_words *ret_key,
                    struct gsn_words *ret_value);
/* Equal but for upper and lower case. */
int gsn_words_are(struct gsn_words words, const char *text);
/* Exactly count decimal numbers, apart by blanks, commas or brackets; returns whether it was so. */
int gsn_words_numbers(struct gsn_words words, double *ret_numbers, size_t count);

/* One format each: fills the header from the text of its file. What the file leaves open and
 * nobody may guess (sizes, type, spacing, byte order) is refused by name. */
int gsn_mhd_parse(struct gsn_words file, struct gsn_volume_header *header, struct gsn_error *err);
int gsn_nrrd_parse(struct gsn_words file, struct gsn_volume_header *header, struct gsn_error *err);
int gsn_inr_parse(struct gsn_words file, struct gsn_volume_header *header, struct gsn_error *err);

#endif
