/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Notes of a captured frame: after the line that names them, lines "# key: value", of which four
 * keys are taken and others passed over. In a JPEG the segments before the scan are walked by their
 * lengths to the first comment (ITU-T T.81, annex B). Failure: none; a length that does not fit
 * ends the walk, and what is not said stays empty. */
#include "pipeline/decode/frame_notes.h"

#include <stdio.h>
#include <string.h>

static const char first_line[] = "# gieson frame 1";

/* Copies what follows "# key: " when the line is that one. */
static void take_value(const char *line, size_t size, const char *key, char *ret_value, size_t room)
{
    const size_t length = strlen(key);

    if (size < length + 4 || memcmp(line, "# ", 2) != 0 || memcmp(line + 2, key, length) != 0 ||
        memcmp(line + 2 + length, ": ", 2) != 0)
        return;
    (void)snprintf(ret_value, room, "%.*s", (int)(size - length - 4), line + length + 4);
}

void gsn_frame_notes_line(struct gsn_frame_notes *notes, int *begun, const char *line, size_t size)
{
    if (size == sizeof first_line - 1 && memcmp(line, first_line, size) == 0)
        *begun = 1;
    if (!*begun)
        return;
    take_value(line, size, "matrix", notes->matrix, sizeof notes->matrix);
    take_value(line, size, "range", notes->range, sizeof notes->range);
    take_value(line, size, "transfer", notes->transfer, sizeof notes->transfer);
    take_value(line, size, "not to be measured", notes->withheld, sizeof notes->withheld);
}

static struct gsn_frame_notes read_lines(const char *text, size_t size)
{
    struct gsn_frame_notes notes = { 0 };
    int begun = 0;

    while (size > 0) {
        const char *const end = memchr(text, '\n', size);
        const size_t length = end ? (size_t)(end - text) : size;

        gsn_frame_notes_line(&notes, &begun, text, length);
        text += end ? length + 1 : length;
        size -= end ? length + 1 : length;
    }
    return notes;
}

struct gsn_frame_notes gsn_frame_notes_of_jpeg(struct gsn_bytes file)
{
    enum { COM = 0xfe, SOS = 0xda };
    size_t at = 2;

    while (at + 4 <= file.size && file.at[at] == 0xff && file.at[at + 1] != SOS) {
        const size_t length = (size_t)file.at[at + 2] << 8 | file.at[at + 3];

        if (length < 2 || length > file.size - at - 2)
            break;
        if (file.at[at + 1] == COM)
            return read_lines((const char *)file.at + at + 4, length - 2);
        at += 2 + length;
    }
    return (struct gsn_frame_notes){ .matrix = "" };
}

void gsn_frame_notes_apply(const struct gsn_frame_notes *notes, struct gsn_picture *picture)
{
    if (picture->transfer == GSN_TRANSFER_UNKNOWN && strcmp(notes->transfer, "sRGB") == 0)
        picture->transfer = GSN_TRANSFER_SRGB;
    if (picture->transfer == GSN_TRANSFER_UNKNOWN && strcmp(notes->transfer, "linear") == 0)
        picture->transfer = GSN_TRANSFER_LINEAR;
    (void)snprintf(picture->withheld, sizeof picture->withheld, "%s", notes->withheld);
}
