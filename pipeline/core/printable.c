/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One pass over UTF-8 (RFC 3629) that puts "?" for the control characters C0, DEL and C1, for bytes
 * that a terminal takes for C1, and for Unicode's marks of direction; the text never grows. */
#include "pipeline/core/printable.h"

#include <stddef.h>

/* How many bytes from here on are one character that does not belong on a terminal; 0: it does. */
static size_t bad_at(const unsigned char *at)
{
    if ((at[0] < 0x20 && at[0] != '\n') || at[0] == 0x7f)
        return 1;
    if (at[0] == 0xc2 && at[1] >= 0x80 && at[1] <= 0x9f) /* U+0080 to U+009F */
        return 2;
    if (at[0] >= 0x80 && at[0] <= 0x9f) /* the same, as a stray byte */
        return 1;
    if (at[0] == 0xe2 && at[1] == 0x80 &&
        (at[2] == 0x8e || at[2] == 0x8f || (at[2] >= 0xaa && at[2] <= 0xae)))
        return 3; /* U+200E, U+200F, U+202A to U+202E */
    if (at[0] == 0xe2 && at[1] == 0x81 && at[2] >= 0xa6 && at[2] <= 0xa9)
        return 3; /* U+2066 to U+2069 */
    return 0;
}

/* Bytes of a whole UTF-8 character, so that its later ones are not taken for stray ones. */
static size_t length_at(const unsigned char *at)
{
    const size_t length = at[0] >= 0xf0 ? 4 : at[0] >= 0xe0 ? 3 : at[0] >= 0xc2 ? 2 : 1;

    for (size_t i = 1; i < length; i++)
        if ((at[i] & 0xc0) != 0x80)
            return 1;
    return length;
}

void gsn_printable(char *text)
{
    const unsigned char *from = (const unsigned char *)text;
    char *to = text;

    while (*from) {
        const size_t bad = bad_at(from), length = bad ? bad : length_at(from);

        if (bad)
            *to++ = '?';
        for (size_t i = 0; !bad && i < length; i++)
            *to++ = (char)from[i];
        from += length;
    }
    *to = '\0';
}
