/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Bytes in memory whose room doubles when it is full; the file is written at once by
 * gsn_file_write(). */
#include "pipeline/phantom/buffer.h"

#include "pipeline/core/file.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

enum { FIRST_ROOM = 4096 };

void gsn_phantom_buffer_done(struct gsn_phantom_buffer *buffer)
{
    gsn_free(buffer->bytes);
    *buffer = (struct gsn_phantom_buffer){ 0 };
}

static int make_room(struct gsn_phantom_buffer *buffer, size_t size)
{
    size_t room = buffer->room ? buffer->room : FIRST_ROOM;
    uint8_t *bytes;

    if (buffer->failed)
        return -1;
    while (room < size)
        room *= 2;
    if (room == buffer->room)
        return 0;
    bytes = gsn_realloc_array(buffer->bytes, room, 1);
    if (!bytes) {
        buffer->failed = 1;
        return -1;
    }
    buffer->bytes = bytes;
    buffer->room = room;
    return 0;
}

int gsn_phantom_buffer_put(struct gsn_phantom_buffer *buffer, size_t at, const void *bytes,
                           size_t size)
{
    if (make_room(buffer, at + size) < 0)
        return -1;
    if (at > buffer->size)
        memset(buffer->bytes + buffer->size, 0, at - buffer->size);
    if (size > 0)
        memcpy(buffer->bytes + at, bytes, size);
    if (at + size > buffer->size)
        buffer->size = at + size;
    return 0;
}

void gsn_phantom_buffer_print(struct gsn_phantom_buffer *buffer, const char *format, ...)
{
    va_list args, again;
    int length;

    va_start(args, format);
    va_copy(again, args);
    length = vsnprintf(NULL, 0, format, args);
    /* One byte more than kept: vsnprintf ends with a zero. */
    if (length >= 0 && make_room(buffer, buffer->size + (size_t)length + 1) == 0) {
        (void)vsnprintf((char *)buffer->bytes + buffer->size, (size_t)length + 1, format, again);
        buffer->size += (size_t)length;
    }
    va_end(again);
    va_end(args);
}

int gsn_phantom_buffer_write(const struct gsn_phantom_buffer *buffer, const char *folder,
                             const char *name, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", folder, name);

    if (!path || buffer->failed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", name);
    return gsn_file_write(path, buffer->bytes, buffer->size, err);
}
