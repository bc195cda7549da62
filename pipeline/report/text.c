/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A growing text, and what is written into it: UTF-8 (RFC 3629) decoded strictly, so that overlong
 * forms, surrogates and stray bytes become U+FFFD; HTML's five special characters escaped; base64
 * (RFC 4648, section 4); numbers as people read them.
 *
 * Failure: sticky; after the first nothing is added. Cost: linear; room doubles. */
#include "pipeline/report/text.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "pipeline/core/mem.h"

static const char unknown[] = "\xEF\xBF\xBD"; /* U+FFFD */
static const char dash[] = "\xE2\x80\x93";
static const char minus[] = "\xE2\x88\x92";
static const char narrow_space[] = "\xE2\x80\xAF";

void gsn_report_text_done(struct gsn_report_text *text)
{
    gsn_free(text->bytes);
    *text = (struct gsn_report_text){ .bytes = NULL };
}

void gsn_report_text_give(struct gsn_report_text *text, char **ret_bytes, size_t *ret_size)
{
    *ret_bytes = text->bytes;
    *ret_size = text->size;
    *text = (struct gsn_report_text){ .bytes = NULL };
}

/* Makes room for so many more bytes and the zero behind them. */
static int reserve_room(struct gsn_report_text *text, size_t more)
{
    size_t room = text->room ? text->room : 256;
    char *bytes;

    if (text->failed)
        return 0;
    if (more >= SIZE_MAX / 4 - text->size) {
        text->failed = 1;
        return 0;
    }
    while (room < text->size + more + 1)
        room *= 2;
    if (room == text->room)
        return 1;
    bytes = gsn_realloc_array(text->bytes, room, 1);
    if (!bytes) {
        text->failed = 1;
        return 0;
    }
    text->bytes = bytes;
    text->room = room;
    return 1;
}

void gsn_report_text_bytes(struct gsn_report_text *text, const void *bytes, size_t size)
{
    if (!reserve_room(text, size))
        return;
    if (size)
        memcpy(text->bytes + text->size, bytes, size);
    text->size += size;
    text->bytes[text->size] = '\0';
}

void gsn_report_text_raw(struct gsn_report_text *text, const char *markup)
{
    gsn_report_text_bytes(text, markup, strlen(markup));
}

void gsn_report_text_print(struct gsn_report_text *text, const char *format, ...)
{
    va_list args, again;
    int length;

    va_start(args, format);
    va_copy(again, args);
    length = vsnprintf(NULL, 0, format, args);
    if (length >= 0 && reserve_room(text, (size_t)length)) {
        (void)vsnprintf(text->bytes + text->size, (size_t)length + 1, format, again);
        text->size += (size_t)length;
    }
    va_end(again);
    va_end(args);
}

/* How many bytes a character takes that begins with this one; 0: none does. */
static size_t utf8_length(unsigned char first)
{
    return first < 0x80    ? 1
           : first < 0xC2  ? 0
           : first < 0xE0  ? 2
           : first < 0xF0  ? 3
           : first <= 0xF4 ? 4
                           : 0;
}

uint32_t gsn_utf8_next(const char *said, size_t *ret_length)
{
    static const uint32_t least[5] = { 0, 0, 0x80, 0x800, 0x10000 };
    static const unsigned char lead[5] = { 0, 0x7F, 0x1F, 0x0F, 0x07 };
    const unsigned char *bytes = (const unsigned char *)said;
    const size_t length = utf8_length(bytes[0]);
    uint32_t point;

    *ret_length = 1;
    if (length == 0)
        return 0xFFFD;
    point = bytes[0] & lead[length];
    for (size_t i = 1; i < length; i++) {
        if ((bytes[i] & 0xC0) != 0x80) /* also stops at the terminating zero */
            return 0xFFFD;
        point = point << 6 | (bytes[i] & 0x3F);
    }
    /* Overlong forms, surrogates and what lies beyond Unicode. */
    if (point < least[length] || (point >= 0xD800 && point < 0xE000) || point > 0x10FFFF)
        return 0xFFFD;
    *ret_length = length;
    return point;
}

/* Controls, and marks that would let a file name turn the text around it. */
static int is_hidden(uint32_t point)
{
    return (point < 0x20 && point != '\t' && point != '\n') || (point >= 0x7F && point < 0xA0) ||
           point == 0x200E || point == 0x200F || (point >= 0x202A && point <= 0x202E) ||
           (point >= 0x2066 && point <= 0x2069) || point == 0xFFFE || point == 0xFFFF;
}

static void escape_point(struct gsn_report_text *text, uint32_t point, const char *bytes,
                         size_t length)
{
    switch (point) {
    case '&':
        gsn_report_text_raw(text, "&amp;");
        break;
    case '<':
        gsn_report_text_raw(text, "&lt;");
        break;
    case '>':
        gsn_report_text_raw(text, "&gt;");
        break;
    case '"':
        gsn_report_text_raw(text, "&quot;");
        break;
    case '\'':
        gsn_report_text_raw(text, "&#39;");
        break;
    default:
        if (point == 0xFFFD || is_hidden(point))
            gsn_report_text_raw(text, unknown);
        else
            gsn_report_text_bytes(text, bytes, length);
    }
}

void gsn_report_text_escape_short(struct gsn_report_text *text, const char *said, size_t most)
{
    size_t length, count = 0;

    for (; said && *said; said += length) {
        const uint32_t point = gsn_utf8_next(said, &length);

        if (count++ == most) {
            gsn_report_text_raw(text, "\xE2\x80\xA6"); /* an ellipsis */
            return;
        }
        escape_point(text, point, said, length);
    }
}

void gsn_report_text_escape(struct gsn_report_text *text, const char *said)
{
    gsn_report_text_escape_short(text, said, SIZE_MAX);
}

void gsn_report_text_utf8(struct gsn_report_text *text, const char *said)
{
    size_t length;

    gsn_report_text_raw(text, ""); /* so that even nothing is a text */
    for (; said && *said; said += length) {
        if (gsn_utf8_next(said, &length) == 0xFFFD)
            gsn_report_text_raw(text, unknown);
        else
            gsn_report_text_bytes(text, said, length);
    }
}

void gsn_report_text_field(struct gsn_report_text *text, const char *said)
{
    size_t length;

    gsn_report_text_raw(text, "\"");
    if (*said && strchr("=+-@\t\r", *said))
        gsn_report_text_raw(text, "'");
    for (; *said; said += length) {
        if (gsn_utf8_next(said, &length) == 0xFFFD)
            gsn_report_text_raw(text, "\xEF\xBF\xBD");
        else if (*said == '"')
            gsn_report_text_raw(text, "\"\"");
        else
            gsn_report_text_bytes(text, said, length);
    }
    gsn_report_text_raw(text, "\"");
}

void gsn_report_text_base64(struct gsn_report_text *text, const void *bytes, size_t size)
{
    static const char digit[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const unsigned char *from = bytes;
    char *to;

    if (size > SIZE_MAX / 2 || !reserve_room(text, (size + 2) / 3 * 4)) {
        text->failed = 1;
        return;
    }
    to = text->bytes + text->size;
    for (size_t i = 0; i < size; i += 3) {
        const unsigned a = from[i], b = i + 1 < size ? from[i + 1] : 0,
                       c = i + 2 < size ? from[i + 2] : 0;

        *to++ = digit[a >> 2];
        *to++ = digit[(a & 3) << 4 | b >> 4];
        *to++ = i + 1 < size ? digit[(b & 15) << 2 | c >> 6] : '=';
        *to++ = i + 2 < size ? digit[c & 63] : '=';
    }
    *to = '\0';
    text->size = (size_t)(to - text->bytes);
}

/* Writes digits with groups of three before the point. */
static void write_grouped(struct gsn_report_text *text, const char *digits)
{
    size_t whole = 0;

    if (*digits == '-') {
        gsn_report_text_raw(text, minus);
        digits++;
    }
    while (digits[whole] >= '0' && digits[whole] <= '9')
        whole++;
    for (size_t i = 0; i < whole; i++) {
        if (i > 0 && (whole - i) % 3 == 0 && whole > 4)
            gsn_report_text_raw(text, narrow_space);
        gsn_report_text_bytes(text, &digits[i], 1);
    }
    gsn_report_text_raw(text, digits + whole);
}

static int is_zero(const char *digits)
{
    return digits[strspn(digits, "-0.")] == '\0';
}

void gsn_report_text_number(struct gsn_report_text *text, double value, int decimals)
{
    char digits[400]; /* DBL_MAX has 309 digits before its point */

    if (!isfinite(value)) {
        gsn_report_text_raw(text, dash);
        return;
    }
    (void)snprintf(digits, sizeof digits, "%.*f", decimals, value);
    write_grouped(text, is_zero(digits) && digits[0] == '-' ? digits + 1 : digits);
}

/* "1.500e-06" as 1.5 x 10^-6 with raised digits. */
static void write_scientific(struct gsn_report_text *text, double value, int digits)
{
    static const char *const raised[10] = { "\xE2\x81\xB0", "\xC2\xB9",     "\xC2\xB2",
                                            "\xC2\xB3",     "\xE2\x81\xB4", "\xE2\x81\xB5",
                                            "\xE2\x81\xB6", "\xE2\x81\xB7", "\xE2\x81\xB8",
                                            "\xE2\x81\xB9" };
    char written[40], *exponent, *end;

    (void)snprintf(written, sizeof written, "%.*e", digits - 1, value);
    exponent = strchr(written, 'e');
    *exponent++ = '\0';
    for (end = exponent - 1; digits > 1 && end[-1] == '0'; end--)
        end[-1] = '\0';
    if (end[-1] == '.')
        end[-1] = '\0';
    write_grouped(text, written);
    gsn_report_text_raw(text, " \xC3\x97 10");
    if (*exponent++ == '-')
        gsn_report_text_raw(text, "\xE2\x81\xBB");
    for (exponent += exponent[0] == '0'; *exponent; exponent++)
        gsn_report_text_raw(text, raised[*exponent - '0']);
}

void gsn_report_text_digits(struct gsn_report_text *text, double value, int digits)
{
    int exponent;

    if (!isfinite(value) || value == 0) {
        gsn_report_text_number(text, value, 0);
        return;
    }
    exponent = (int)floor(log10(fabs(value)));
    if (exponent >= 9 || exponent < -3)
        write_scientific(text, value, digits);
    else
        gsn_report_text_number(text, value, digits - 1 - exponent > 0 ? digits - 1 - exponent : 0);
}

void gsn_report_text_plain(struct gsn_report_text *text, double value)
{
    enum { DIGITS = 9 };
    char written[40];

    if (!isfinite(value) || value == 0) {
        gsn_report_text_number(text, value, 0);
    } else if (fabs(value) >= 1e9 || fabs(value) < 1e-4) {
        write_scientific(text, value, DIGITS);
    } else {
        (void)snprintf(written, sizeof written, "%.*g", DIGITS, value);
        write_grouped(text, written);
    }
}

void gsn_report_text_count(struct gsn_report_text *text, size_t count)
{
    char digits[24];

    (void)snprintf(digits, sizeof digits, "%zu", count);
    write_grouped(text, digits);
}
