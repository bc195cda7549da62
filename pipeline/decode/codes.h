/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The codes printed on a picture: Data Matrix by libdmtx, QR and bar codes by ZBar. Both parse
 * whatever pixels a stranger sends, so they run where decoders run (apart.h). Internal to decoding;
 * callers see struct gsn_printed in decode.h.
 *
 * They are given a grey picture of the brightest channel of each pixel: print is dark in all three,
 * stained tissue never is in red, so sections all but vanish from it. */
#ifndef GSN_DECODE_CODES_H
#define GSN_DECODE_CODES_H

#include "pipeline/decode/decode.h"

/* Keeps a text as data: at most GSN_CODE_BYTES - 1 bytes, what does not print becomes '?'. Returns
 * the new code, or NULL when there is no room. */
struct gsn_printed *gsn_codes_add(struct gsn_picture *picture, const char *kind, const void *text,
                                  size_t size);

/* All of the above on the decoded picture. Fails with GSN_E_NOMEM. */
int gsn_codes_read(struct gsn_picture *picture, struct gsn_error *err);

#endif
