/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* EXIF (CIPA DC-008, built as TIFF 6.0 is): byte order, the first directory and the Exif directory
 * that it names; of their entries orientation, resolution, its unit and ColorSpace are taken.
 *
 * Failure: a block that does not begin as TIFF does, or a directory that does not lie inside it:
 * nothing is taken then. A value of another type or outside the block is one that is not stated.
 * Cost: linear in the entries; no other directory is followed, so there is no cycle to run into. */
#include "pipeline/decode/exif.h"

enum { TAG_ORIENTATION = 0x112, TAG_X_RESOLUTION = 0x11a, TAG_Y_RESOLUTION = 0x11b };
enum { TAG_RESOLUTION_UNIT = 0x128, TAG_EXIF_IFD = 0x8769, TAG_COLOR_SPACE = 0xa001 };
enum { TYPE_SHORT = 3, TYPE_LONG = 4, TYPE_RATIONAL = 5 };

struct block {
    const uint8_t *bytes;
    size_t size;
    int big_endian;
};

/* One directory entry: 12 bytes of which the last four are the value or its offset. */
struct entry {
    unsigned tag, type;
    uint32_t count;
    size_t value_at;
};

static uint32_t get_number(const struct block *block, size_t at, unsigned bytes)
{
    uint32_t value = 0;

    for (unsigned i = 0; i < bytes; i++) {
        const size_t from = block->big_endian ? at + i : at + bytes - 1 - i;

        value = value << 8 | block->bytes[from];
    }
    return value;
}

static int lies_inside(const struct block *block, uint64_t at, uint64_t count)
{
    return at <= block->size && count <= block->size - at;
}

/* A single SHORT or LONG stored in the entry itself; 0 when it is something else. */
static uint32_t read_whole(const struct block *block, const struct entry *entry)
{
    if (entry->count != 1 || (entry->type != TYPE_SHORT && entry->type != TYPE_LONG))
        return 0;
    return get_number(block, entry->value_at, entry->type == TYPE_SHORT ? 2 : 4);
}

static double read_rational(const struct block *block, const struct entry *entry)
{
    const uint32_t at = get_number(block, entry->value_at, 4);
    uint32_t below;

    if (entry->count != 1 || entry->type != TYPE_RATIONAL || !lies_inside(block, at, 8))
        return 0;
    below = get_number(block, at + 4, 4);
    return below ? (double)get_number(block, at, 4) / below : 0;
}

static double unit_um(uint32_t unit)
{
    return unit == 2 ? 25400 : unit == 3 ? 10000 : 0;
}

/* Takes one entry; returns the offset of the Exif directory when the entry names it. */
static uint32_t take_entry(const struct block *block, const struct entry *entry,
                           struct gsn_exif *exif)
{
    const uint32_t value = read_whole(block, entry);

    if (entry->tag == TAG_ORIENTATION && value >= 1 && value <= 8)
        exif->orientation = value;
    else if (entry->tag == TAG_X_RESOLUTION)
        exif->per_unit_x = read_rational(block, entry);
    else if (entry->tag == TAG_Y_RESOLUTION)
        exif->per_unit_y = read_rational(block, entry);
    else if (entry->tag == TAG_RESOLUTION_UNIT)
        exif->unit_um = unit_um(value);
    else if (entry->tag == TAG_COLOR_SPACE)
        exif->is_srgb = value == 1;
    else if (entry->tag == TAG_EXIF_IFD)
        return value;
    return 0;
}

/* Returns 0 when the directory does not lie inside the block. */
static int read_directory(const struct block *block, uint32_t at, struct gsn_exif *exif,
                          uint32_t *ret_exif_at)
{
    uint32_t count;

    if (!lies_inside(block, at, 2))
        return 0;
    count = get_number(block, at, 2);
    if (!lies_inside(block, (uint64_t)at + 2, 12 * (uint64_t)count))
        return 0;
    for (uint32_t i = 0; i < count; i++) {
        const size_t entry_at = (size_t)at + 2 + 12 * (size_t)i;
        const struct entry entry = { .tag = get_number(block, entry_at, 2),
                                     .type = get_number(block, entry_at + 2, 2),
                                     .count = get_number(block, entry_at + 4, 4),
                                     .value_at = entry_at + 8 };
        const uint32_t exif_at = take_entry(block, &entry, exif);

        if (exif_at)
            *ret_exif_at = exif_at;
    }
    return 1;
}

int gsn_exif_read(const uint8_t *bytes, size_t size, struct gsn_exif *ret_exif)
{
    const struct gsn_exif nothing = { .orientation = 1, .unit_um = 25400 };
    struct block block = { .bytes = bytes, .size = size };
    struct gsn_exif exif = nothing;
    uint32_t exif_at = 0, ignored = 0;

    *ret_exif = nothing;
    if (size < 8 || bytes[0] != bytes[1] || (bytes[0] != 'I' && bytes[0] != 'M'))
        return 0;
    block.big_endian = bytes[0] == 'M';
    if (get_number(&block, 2, 2) != 42 ||
        !read_directory(&block, get_number(&block, 4, 4), &exif, &exif_at))
        return 0;
    if (exif_at && !read_directory(&block, exif_at, &exif, &ignored))
        return 0;
    *ret_exif = exif;
    return 1;
}
