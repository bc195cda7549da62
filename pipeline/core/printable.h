/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Words that others chose (names, file names, what a file says) on a terminal, by the programs that
 * measure no columns. */
#ifndef GSN_CORE_PRINTABLE_H
#define GSN_CORE_PRINTABLE_H

#ifdef __cplusplus
extern "C" {
#endif

/* Puts "?" for what moves a terminal's cursor or turns its direction, in place: control bytes, the
 * second set of them (U+0080 to U+009F) and the marks of direction. A text of several lines keeps
 * its line breaks. borrows: text. */
void gsn_printable(char *text);

#ifdef __cplusplus
}
#endif
#endif
