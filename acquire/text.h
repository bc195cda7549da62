/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Text that grows: headers of frames, and what a device stated, as JSON. Private to this folder. */
#ifndef GSN_ACQUIRE_TEXT_H
#define GSN_ACQUIRE_TEXT_H

#include "pipeline/core/mem.h"

#include <stdbool.h>

struct gsn_text {
    char *at; /* NULL before the first piece; owned */
    size_t used, room;
    bool starved; /* memory ran out: what follows is not added */
};

void gsn_text_add(struct gsn_text *text, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* One line of what a device said: control characters and bytes that are no ASCII become '?'. */
void gsn_text_add_line(struct gsn_text *text, const char *key, const char *value);

/* A JSON string with its quotes. Bytes that are no ASCII become '?'. */
void gsn_text_add_json(struct gsn_text *text, const char *value);

#endif
