/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/device/blob.h"

#include <stdlib.h>
#include <string.h>

#include "tests/device/wire.h"

enum { MOST_UNITS = 254 };

uint8_t *blob_extend(struct blob *blob, size_t size)
{
    if (blob->size + size > blob->room) {
        const size_t room = 2 * (blob->size + size) + 64;
        uint8_t *const bytes = realloc(blob->bytes, room);

        if (!bytes)
            abort();
        blob->bytes = bytes;
        blob->room = room;
    }
    memset(blob->bytes + blob->size, 0, size);
    blob->size += size;
    return blob->bytes + blob->size - size;
}

void blob_u8(struct blob *blob, uint32_t value)
{
    *blob_extend(blob, 1) = (uint8_t)value;
}

void blob_u16(struct blob *blob, uint32_t value)
{
    wire_put16(blob_extend(blob, 2), value);
}

void blob_u32(struct blob *blob, uint32_t value)
{
    wire_put32(blob_extend(blob, 4), value);
}

void blob_u64(struct blob *blob, uint64_t value)
{
    blob_u32(blob, (uint32_t)value);
    blob_u32(blob, (uint32_t)(value >> 32));
}

/* The next code point of well-formed UTF-8. */
static uint32_t decode(const uint8_t **at)
{
    uint32_t point = *(*at)++;
    const int more = point >= 0xf0 ? 3 : point >= 0xe0 ? 2 : point >= 0xc0 ? 1 : 0;

    if (more)
        point &= 0x3fu >> more;
    for (int i = 0; i < more && (**at & 0xc0) == 0x80; i++)
        point = point << 6 | (*(*at)++ & 0x3fu);
    return point;
}

void blob_string(struct blob *blob, const char *text)
{
    const uint8_t *at = (const uint8_t *)text;
    const size_t start = blob->size;
    size_t units = 0;

    blob_u8(blob, 0);
    while (*at && units < MOST_UNITS - 1) {
        const uint32_t point = decode(&at);

        if (point >= 0x10000) {
            blob_u16(blob, 0xd800 + ((point - 0x10000) >> 10));
            units++;
        }
        blob_u16(blob, point >= 0x10000 ? 0xdc00 + (point & 0x3ff) : point);
        units++;
    }
    if (units == 0)
        return;
    blob_u16(blob, 0);
    blob->bytes[start] = (uint8_t)(units + 1);
}

void blob_array16(struct blob *blob, const uint16_t *values, size_t count)
{
    blob_u32(blob, (uint32_t)count);
    for (size_t i = 0; i < count; i++)
        blob_u16(blob, values[i]);
}
