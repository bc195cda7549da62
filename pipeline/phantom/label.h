/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The writing on a panel's label: 5 x 7 letters on cells of 48 um. */
#ifndef GSN_PHANTOM_LABEL_H
#define GSN_PHANTOM_LABEL_H

#ifdef __cplusplus
extern "C" {
#endif

/* Whether the point, in um right of and below the upper left corner of the writing, is on a stroke
 * of text. It knows what the names of specimens and panels need: C D G N P S T U V, 0 to 5, 8 and
 * the dash; anything else is blank. */
int gsn_phantom_label_has(const char *text, double x_um, double y_um);

#ifdef __cplusplus
}
#endif
#endif
