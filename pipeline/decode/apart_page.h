/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the worker and gieson-decode say to each other. They share memory: one page of question and
 * answer, and behind it room for the samples. The decoder's stdin is a socket; over it comes that
 * memory first, then file after file, a descriptor in each message, and the decoder sends a byte
 * back when a file's answer stands on the page. Both programs are of one build. Internal to
 * decoding. */
#ifndef GSN_DECODE_APART_PAGE_H
#define GSN_DECODE_APART_PAGE_H

#include "pipeline/decode/decode.h"

#define GSN_DECODE_PAGE_MAGIC "gsndec6"

struct gsn_decode_page {
    char magic[8];
    /* asked */
    uint64_t most_pixels, most_bytes, file_size;
    uint32_t codes, light, slide, level;
    double target_um;
    /* answered */
    uint32_t answered;
    int32_t code;
    char text[480];
    uint32_t width, height, channels, bits, pages, transfer, lossy;
    double px_um_x, px_um_y;
    char kind[24], note[160], withheld[160], profile[96];
    uint32_t printed_count;
    struct gsn_printed printed[GSN_CODES];
};
enum { GSN_DECODE_PAGE_BYTES = 4096 };

/* The decoder's: the next descriptor; -1 when the worker has no more, or is gone. */
int gsn_decode_receive(int socket);

/* The decoder's: maps the shared memory behind the descriptor.
 * Fails with GSN_E_INPUT when it is not what gsn_decode_apart() sends, or GSN_E_IO. */
int gsn_decode_page_map(int fd, struct gsn_decode_page **ret_page, struct gsn_error *err);

/* The bytes of the file that is asked about; NULL when they cannot be mapped. */
const uint8_t *gsn_decode_page_file(const struct gsn_decode_page *page, int fd);

/* Decodes and writes the answer, a refusal included. */
void gsn_decode_page_answer(struct gsn_decode_page *page, const uint8_t *file);

#endif
