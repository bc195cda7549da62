/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/text.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* Room for size more characters and the zero behind them. */
static bool make_room(struct gsn_text *text, size_t size)
{
    const size_t room = 2 * (text->used + size + 1);
    char *at;

    if (!text->starved && text->room < text->used + size + 1) {
        at = gsn_realloc_array(text->at, room, 1);
        text->starved = !at;
        text->at = at ? at : text->at;
        text->room = at ? room : text->room;
    }
    return !text->starved;
}

void gsn_text_add(struct gsn_text *text, const char *format, ...)
{
    va_list args, again;
    int size;

    va_start(args, format);
    va_copy(again, args);
    size = vsnprintf(NULL, 0, format, args);
    if (size >= 0 && make_room(text, (size_t)size)) {
        (void)vsnprintf(text->at + text->used, (size_t)size + 1, format, again);
        text->used += (size_t)size;
    }
    va_end(again);
    va_end(args);
}

static char plain(char c)
{
    return c >= ' ' && c <= '~' ? c : '?';
}

void gsn_text_add_line(struct gsn_text *text, const char *key, const char *value)
{
    gsn_text_add(text, "# %s: ", key);
    for (size_t i = 0; value[i]; i++)
        gsn_text_add(text, "%c", plain(value[i]));
    gsn_text_add(text, "\n");
}

void gsn_text_add_json(struct gsn_text *text, const char *value)
{
    gsn_text_add(text, "\"");
    for (size_t i = 0; value[i]; i++) {
        const char c = plain(value[i]);

        gsn_text_add(text, c == '"' || c == '\\' ? "\\%c" : "%c", c);
    }
    gsn_text_add(text, "\"");
}
