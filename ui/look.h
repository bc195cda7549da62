/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How a state looks: a symbol beside its word, so that neither a colour nor a symbol alone carries
 * the meaning; and how long ago something was, in a word. */
#ifndef GSN_UI_LOOK_H
#define GSN_UI_LOOK_H

#include "pipeline/core/mem.h"

#include <stdint.h>

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
