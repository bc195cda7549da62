/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Words that others chose (names, file names, messages) on a terminal and in JSON.
 *
 * Such a text is any bytes. On a terminal it is taken as UTF-8 and measured in columns, and what
 * cannot be printed, escape sequences above all, appears as "?". main() sets the character type to
 * UTF-8 for that, whatever the user's locale: the store holds UTF-8. */
#ifndef GSN_UI_TEXT_H
#define GSN_UI_TEXT_H

#include "pipeline/core/mem.h"

#include <jansson.h>
#include <stdio.h>

/* How wide the text is when printed. */
int gsn_text_columns(const char *text);

/* gives: the text in exactly so many columns, filled with blanks or cut, the last column then being
 * "~". NULL when memory runs out. */
char *gsn_text_cell(const char *text, int columns);

/* Bytes of the text that make a line of at most so many columns: up to the last blank that fits, or
 * as many characters as do, or one at least. */
size_t gsn_text_fit(const char *text, int columns);

/* Puts "?" for every column of what is not ASCII, in place, for a terminal that shows nothing else.
 */
void gsn_text_ascii(char *text);

/* Prints one line and its end; a line break inside counts as unprintable. */
void gsn_text_line(FILE *to, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Prints a text in lines of at most width columns, each set in by indent. */
void gsn_text_wrap(FILE *to, int indent, int width, const char *text);

/* gives: a JSON text, with U+FFFD for every byte that is no UTF-8. NULL when memory runs out. */
json_t *gsn_text_json(const char *text);

#endif
