/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Decoding in a process of its own.
 *
 * A picture file comes from outside and its decoders are old and large, so they run where they can
 * do no harm: in gieson-decode, which has entered the sandbox (pipeline/core/sandbox.h) before it
 * looks at the first byte. It maps the file itself and decodes to where the samples stay, in memory
 * that both processes have mapped; nothing that it says is believed unchecked. It stays for the
 * next file of the job. */
#ifndef GSN_DECODE_APART_H
#define GSN_DECODE_APART_H

#include "pipeline/decode/decode.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The decoders of one job, started when they are needed. Several threads may ask at once. */
struct gsn_decoder;

/* program: path of gieson-decode. Starts nothing yet. gives: ret_decoder; it must outlive the
 * pictures that come from it. Fails with GSN_E_NOMEM. */
int gsn_decoder_new(const char *program, struct gsn_decoder **ret_decoder, struct gsn_error *err);
/* Ends the decoders that wait and gives their memory back: for a job whose pictures are all read.
 */
void gsn_decoder_rest(struct gsn_decoder *decoder);
void gsn_decoder_free(struct gsn_decoder *decoder);
GSN_DEFINE_AUTO(gsn_decoder);

/* As gsn_decode(), of the whole file behind the descriptor fd, by decoder; NULL decodes in this
 * process, which is for bytes that are trusted.
 *
 * A decoder that crashes, hangs, eats memory or does what no decoder needs costs this file alone:
 * GSN_E_INPUT or GSN_E_LIMIT, with a sentence that says which. GSN_E_PROCESS when it could not be
 * asked at all (not installed, no sandbox, killed from outside): the file is not to blame.
 * borrows: fd, of a file that nobody writes to meanwhile. */
int gsn_decode_apart(struct gsn_decoder *decoder, int fd, const struct gsn_decode_limits *limits,
                     struct gsn_picture **ret_picture, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
