/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The writing on a panel's label: 5 x 7 letters on cells of 48 um, and a Data Matrix. */
#ifndef GSN_PHANTOM_LABEL_H
#define GSN_PHANTOM_LABEL_H

#include "pipeline/core/error.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Whether the point, in um right of and below the upper left corner of the writing, is on a stroke
 * of text. It knows what the names of specimens and panels need: C D G N P S T U V, 0 to 5, 8 and
 * the dash; anything else is blank. */
int gsn_phantom_label_has(const char *text, double x_um, double y_um);

/* The Data Matrix (ISO/IEC 16022, ECC 200) on a panel's label: its modules, without the quiet
 * zone. */

/* Modules on a side: the smallest square that holds the name of a panel, 11 of its 12 code words.
 */
enum { GSN_PHANTOM_MATRIX_SIDE = 16 };

struct gsn_phantom_matrix {
    uint8_t dark[GSN_PHANTOM_MATRIX_SIDE][GSN_PHANTOM_MATRIX_SIDE]; /* 0 or 1; the top row first */
};

/* Encodes ASCII text; two digits side by side share a code word. Fails with GSN_E_LIMIT when the
 * text is empty or needs more than 12 code words, with GSN_E_NOMEM. borrows: text. */
int gsn_phantom_matrix_make(const char *text, struct gsn_phantom_matrix *ret_matrix,
                            struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
