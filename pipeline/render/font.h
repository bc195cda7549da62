/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The face that pictures are lettered in: 5x7 dots, 2 rows below the line, on a cell of 6x10. */
#ifndef GSN_RENDER_FONT_H
#define GSN_RENDER_FONT_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_FONT_WIDTH = 5, GSN_FONT_ROWS = 9 };

/* Rows from top to bottom; bit 4 is the leftmost dot. */
struct gsn_font_bits {
    uint8_t row[GSN_FONT_ROWS];
};

/* Takes the next character off UTF-8 text; returns 0 at its end. What the face does not have is an
 * empty square. */
int gsn_font_next(const char **text, struct gsn_font_bits *ret_bits);

#ifdef __cplusplus
}
#endif
#endif
