/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Words that others chose (names, file names, messages) on a terminal and in JSON; and how a state
 * looks.
 *
 * A text is any bytes. It is walked glyph by glyph (mbrtowc, wcwidth) and measured in columns; what
 * cannot be printed, escape sequences and changes of direction above all, appears as "?". In JSON a
 * byte that is no UTF-8 becomes U+FFFD. A state has a symbol and a word beside its colour, so that
 * neither alone carries the meaning. */
#include "ui/text.h"

#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <string.h>
#include <wchar.h>

struct glyph {
    size_t bytes; /* 0 at the end of the text */
    int columns;
    int printable, utf8;
};

/* Glyphs and columns. */

/* Characters that turn the direction of what follows on a terminal that knows them: no part of a
 * text that stands in columns. */
static int turns_text(wchar_t character)
{
    return (character >= 0x202a && character <= 0x202e) ||
           (character >= 0x2066 && character <= 0x2069) || character == 0x200e ||
           character == 0x200f;
}

static struct glyph glyph_at(const char *text)
{
    const size_t room = strnlen(text, MB_LEN_MAX);
    mbstate_t state = { 0 };
    wchar_t character;
    const size_t bytes = room ? mbrtowc(&character, text, room, &state) : 0;
    int columns;

    if (room == 0)
        return (struct glyph){ 0 };
    if (bytes > room)
        return (struct glyph){ .bytes = 1, .columns = 1 };
    columns = turns_text(character) ? -1 : wcwidth(character);
    return (struct glyph){
        .bytes = bytes, .columns = columns < 0 ? 1 : columns, .printable = columns >= 0, .utf8 = 1
    };
}

static void put_glyph(FILE *to, const char *text, struct glyph glyph)
{
    if (glyph.printable)
        (void)fwrite(text, 1, glyph.bytes, to);
    else
        (void)fputc('?', to);
}

int gsn_text_columns(const char *text)
{
    int columns = 0;

    for (struct glyph g = glyph_at(text); g.bytes > 0; g = glyph_at(text)) {
        columns += g.columns;
        text += g.bytes;
    }
    return columns;
}

char *gsn_text_cell(const char *text, int columns)
{
    const int room = gsn_text_columns(text) <= columns ? columns : columns - 1;
    char *cell = gsn_alloc_array(strlen(text) + (size_t)columns + 2, 1);
    size_t used = 0;
    int filled = 0;

    if (!cell)
        return NULL;
    for (struct glyph g = glyph_at(text); g.bytes > 0 && filled + g.columns <= room;
         g = glyph_at(text)) {
        if (g.printable)
            memcpy(cell + used, text, g.bytes);
        else
            cell[used] = '?';
        used += g.printable ? g.bytes : 1;
        filled += g.columns;
        text += g.bytes;
    }
    if (room < columns) {
        cell[used++] = '~';
        filled++;
    }
    for (; filled < columns; filled++)
        cell[used++] = ' ';
    return cell;
}

void gsn_text_ascii(char *text)
{
    char *to = text;

    for (struct glyph g = glyph_at(text); g.bytes > 0; g = glyph_at(text)) {
        if (g.bytes == 1 && g.printable)
            *to++ = *text;
        else
            for (int i = 0; i < g.columns; i++)
                *to++ = '?';
        text += g.bytes;
    }
    *to = '\0';
}

void gsn_text_line(FILE *to, const char *format, ...)
{
    gsn_auto_mem(char) line = NULL;
    va_list args, again;
    int length;

    va_start(args, format);
    va_copy(again, args);
    length = vsnprintf(NULL, 0, format, args);
    line = length < 0 ? NULL : gsn_alloc_array((size_t)length + 1, 1);
    if (line)
        (void)vsnprintf(line, (size_t)length + 1, format, again);
    va_end(again);
    va_end(args);
    gsn_text_wrap(to, 0, INT_MAX, line ? line : "out of memory");
}

size_t gsn_text_fit(const char *text, int columns)
{
    size_t at = 0, blank = 0;
    int filled = 0;

    for (struct glyph g = glyph_at(text); g.bytes > 0; g = glyph_at(text + at)) {
        if (at > 0 && filled > columns - g.columns)
            return blank > 0 ? blank : at;
        filled += g.columns;
        at += g.bytes;
        if (text[at] == ' ')
            blank = at;
    }
    return at;
}

void gsn_text_wrap(FILE *to, int indent, int width, const char *text)
{
    do {
        const size_t line = gsn_text_fit(text, width - indent);

        (void)fprintf(to, "%*s", indent, "");
        for (size_t at = 0; at < line; at += glyph_at(text + at).bytes)
            put_glyph(to, text + at, glyph_at(text + at));
        (void)fputc('\n', to);
        text += line;
        while (line > 0 && *text == ' ')
            text++;
    } while (*text);
}

json_t *gsn_text_json(const char *text)
{
    static const char stranger[] = "\xef\xbf\xbd"; /* U+FFFD */
    gsn_auto_mem(char) clean = gsn_alloc_array(strlen(text) + 1, sizeof stranger);
    json_t *plain = json_string(text);
    size_t used = 0;

    if (plain || !clean)
        return plain;
    for (struct glyph g = glyph_at(text); g.bytes > 0; g = glyph_at(text)) {
        json_t *alone = g.utf8 ? json_stringn(text, g.bytes) : NULL;

        if (alone)
            memcpy(clean + used, text, g.bytes);
        else
            memcpy(clean + used, stranger, strlen(stranger));
        used += alone ? g.bytes : strlen(stranger);
        text += g.bytes;
        json_decref(alone);
    }
    return json_string(clean);
}

static const struct gsn_look looks[] = {
    { "waiting", ".", GSN_HUE_PLAIN },  { "working", ">", GSN_HUE_BUSY },
    { "reported", "+", GSN_HUE_GOOD },  { "withheld", "!", GSN_HUE_CARE },
    { "failed", "x", GSN_HUE_BAD },     { "refused", "x", GSN_HUE_BAD },
    { "held", "!", GSN_HUE_CARE },      { "unfiled", "?", GSN_HUE_CARE },
    { "trouble", "!", GSN_HUE_CARE },   { "away", "-", GSN_HUE_CARE },
    { "ready", "+", GSN_HUE_GOOD },     { "receiving", ">", GSN_HUE_BUSY },
    { "paused", "=", GSN_HUE_CARE },    { "off", "-", GSN_HUE_PLAIN },
    { "needs-eye", "?", GSN_HUE_CARE },
};

/* How a state looks. */

const struct gsn_look *gsn_look_of(const char *state)
{
    for (size_t i = 0; i < sizeof looks / sizeof looks[0]; i++)
        if (strcmp(looks[i].state, state) == 0)
            return &looks[i];
    return &looks[0];
}

const char *gsn_hue_ansi(enum gsn_hue hue)
{
    static const char *const codes[] = { "", "\033[36m", "\033[32m", "\033[33m", "\033[31m" };

    return codes[hue];
}

char *gsn_look_age(int64_t now, int64_t then)
{
    const long long minutes = then ? (now - then) / 60 : 0;

    if (then == 0)
        return gsn_strdup("");
    if (minutes < 1)
        return gsn_strdup("now");
    if (minutes < 60)
        return gsn_format("%lld min", minutes);
    if (minutes < 48 * 60)
        return gsn_format("%lld h", minutes / 60);
    return gsn_format("%lld d", minutes / (24 * 60));
}

char *gsn_look_progress(const char *stage, int64_t done, int64_t total, double left_s)
{
    const double percent = total > 0 ? 100 * (double)done / (double)total : NAN;
    const char *unit = left_s < 90 ? "s" : left_s < 90 * 60 ? "min" : "h";
    const double left = left_s < 90 ? left_s : left_s < 90 * 60 ? left_s / 60 : left_s / 3600;

    if (!stage[0])
        return gsn_strdup("starting");
    if (isnan(percent))
        return gsn_strdup(stage);
    if (isnan(left_s))
        return gsn_format("%s %.0f %%", stage, percent);
    return gsn_format("%s %.0f %%, %.0f %s left", stage, percent, left, unit);
}

char *gsn_look_loss(double percent, double lower, double upper)
{
    if (isnan(percent))
        return gsn_strdup("");
    if (isnan(lower) || isnan(upper))
        return gsn_format("%.2f %%", percent);
    return gsn_format("%.2f %% (%.2f to %.2f)", percent, lower, upper);
}

char *gsn_look_bytes(int64_t bytes)
{
    static const char *const units[] = { "kB", "MB", "GB", "TB" };
    double size = (double)bytes / 1000;
    size_t unit = 0;

    for (; size >= 999.95 && unit + 1 < sizeof units / sizeof units[0]; unit++)
        size /= 1000;
    return gsn_format("%.1f %s", size, units[unit]);
}
