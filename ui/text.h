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
#include <stdint.h>
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

/* How a state looks: a symbol beside its word, so that neither a colour nor a symbol alone carries
 * the meaning; and how long ago something was, in a word. */

/* What a colour stands for. */
enum gsn_hue { GSN_HUE_PLAIN, GSN_HUE_BUSY, GSN_HUE_GOOD, GSN_HUE_CARE, GSN_HUE_BAD };

struct gsn_look {
    const char *state;
    const char *symbol; /* one character of ASCII */
    enum gsn_hue hue;
};

/* Of a word for a state; one that is not known looks like "waiting". */
const struct gsn_look *gsn_look_of(const char *state);

/* The sequence that switches a terminal to it; empty for GSN_HUE_PLAIN. */
const char *gsn_hue_ansi(enum gsn_hue hue);

/* gives: "now", "7 min", "3 h", "12 d"; empty when then is 0. NULL when memory runs out. */
char *gsn_look_age(int64_t now, int64_t then);

/* gives: "decode 40 %, 12 s left", as much of it as is known. NULL when memory runs out. */
char *gsn_look_progress(const char *stage, int64_t done, int64_t total, double left_s);

/* gives: "36.42 % (33.10 to 39.74)", without what is not known. NULL when memory runs out. */
char *gsn_look_loss(double percent, double lower, double upper);

/* gives: "28.0 MB". NULL when memory runs out. */
char *gsn_look_bytes(int64_t bytes);

#endif
