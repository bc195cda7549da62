/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Decoding in a process of its own.
 *
 * A picture file comes from outside and its decoders are old and large, so they run where they can
 * do no harm: in gieson-decode, which has entered the sandbox (pipeline/core/sandbox.h) before it
 * looks at the first byte. File and samples stand in memory that both processes have mapped; the
 * samples are decoded to where they stay, and nothing that the child says is believed unchecked. */
#ifndef GSN_DECODE_APART_H
#define GSN_DECODE_APART_H

#include "pipeline/decode/decode.h"

#ifdef __cplusplus
extern "C" {
#endif

/* As gsn_decode(), by the program decoder (path of gieson-decode); NULL decodes in this process,
 * which is for bytes that are trusted.
 *
 * A decoder that crashes, hangs, eats memory or does what no decoder needs costs this file alone:
 * GSN_E_INPUT or GSN_E_LIMIT, with a sentence that says which. GSN_E_PROCESS when it could not be
 * asked at all (not installed, no sandbox, killed from outside): the file is not to blame. */
int gsn_decode_apart(const char *decoder, const void *bytes, size_t size,
                     const struct gsn_decode_limits *limits, struct gsn_picture **ret_picture,
                     struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
