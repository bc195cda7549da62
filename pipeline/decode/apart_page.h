/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The memory that the worker and gieson-decode share: one page of question and answer, the bytes of
 * the file, and room for the samples. Both programs are of one build. Internal to decoding. */
#ifndef GSN_DECODE_APART_PAGE_H
#define GSN_DECODE_APART_PAGE_H

#include "pipeline/decode/decode.h"

#define GSN_DECODE_PAGE_MAGIC "gsndec4"

struct gsn_decode_page {
    char magic[8];
    /* asked; places are from the start of the memory, on page borders */
    uint64_t most_pixels, most_bytes;
    uint64_t file_at, file_size;
    uint64_t samples_at, whole_size;
    uint32_t codes, light, slide, level;
    double target_um;
    /* answered */
    uint32_t answered;
    int32_t code;
    char text[480];
    uint32_t width, height, channels, bits, pages, transfer;
    double px_um_x, px_um_y;
    char kind[24], note[160], withheld[160], profile[96];
    uint32_t printed_count;
    struct gsn_printed printed[GSN_CODES];
};
enum { GSN_DECODE_PAGE_BYTES = 4096 };

/* The child's half: maps the shared memory behind the descriptor.
 * Fails with GSN_E_INPUT when it is not what gsn_decode_apart() sends, or GSN_E_IO. */
int gsn_decode_page_map(int fd, struct gsn_decode_page **ret_page, struct gsn_error *err);

/* Decodes and writes the answer, a refusal included. */
void gsn_decode_page_answer(struct gsn_decode_page *page);

#endif
