/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/container_walk.h"

#include <stdbool.h>

/* TIFF 6.0 section 2, BigTIFF by its published layout: a chain of directories, each a list of
 * entries (tag, type, count, value or offset). Complete means: every directory, every value stored
 * outside its entry and every strip, tile or old-style JPEG stream lies inside the file. */

enum {
    STRIP_OFFSETS = 273,
    STRIP_BYTE_COUNTS = 279,
    TILE_OFFSETS = 324,
    TILE_BYTE_COUNTS = 325,
    SUB_IFDS = 330,
    JPEG_OFFSET = 513,
    JPEG_LENGTH = 514,
};

enum { TEXT = 2, OPAQUE = 7 }; /* types */

enum {
    MOST_DIRECTORIES = 4096,
    MOST_ELEMENTS = 1 << 24, /* of offsets and lengths in all: bounds the time hostile files take */
};

struct entry {
    unsigned tag, type;
    uint64_t count;
    uint64_t at; /* where its values are */
};

struct tiff {
    struct gsn_walk *walk;
    bool little, big;
    size_t pending, directories; /* next to look at; known so far */
    uint64_t directory[MOST_DIRECTORIES];
    uint64_t elements;
    struct gsn_container answer;
};

static uint64_t number(const struct tiff *tiff, const uint8_t *bytes, unsigned size)
{
    uint64_t value = 0;

    for (unsigned i = 0; i < size; i++)
        value = value << 8 | bytes[tiff->little ? size - 1 - i : i];
    return value;
}

static bool give_up(struct tiff *tiff, const char *what, uint64_t at)
{
    tiff->answer = gsn_walk_missing(GSN_CONTAINER_TIFF, "%s at byte %llu is not all in the file",
                                    what, (unsigned long long)at);
    return false;
}

/* Who makes the file as long as it will be, or writes the directory first, has zeros where something
 * is to come. */
static bool is_awaited(struct tiff *tiff, const char *what, uint64_t at)
{
    tiff->answer = gsn_walk_missing(GSN_CONTAINER_TIFF, "%s at byte %llu is not written yet", what,
                                    (unsigned long long)at);
    return false;
}

static bool read_number(struct tiff *tiff, uint64_t at, unsigned size, const char *what,
                        uint64_t *ret_value)
{
    const uint8_t *const bytes = gsn_walk_view(tiff->walk, at, size);

    if (!bytes)
        return give_up(tiff, what, at);
    *ret_value = number(tiff, bytes, size);
    return true;
}

/* A directory met twice ends there: loops are the decoder's to refuse. */
static void remember(struct tiff *tiff, uint64_t at)
{
    for (size_t i = 0; i < tiff->directories; i++) {
        if (tiff->directory[i] == at)
            return;
    }
    if (at != 0 && tiff->directories < MOST_DIRECTORIES)
        tiff->directory[tiff->directories++] = at;
}

static unsigned type_size(unsigned type)
{
    static const uint8_t size[] = { 0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8 };

    return type < sizeof size ? size[type] : 0;
}

static bool is_inside(const struct tiff *tiff, uint64_t at, uint64_t size)
{
    return at <= tiff->walk->size && size <= tiff->walk->size - at;
}

static bool read_entry(struct tiff *tiff, uint64_t at, struct entry *entry)
{
    const unsigned inline_size = tiff->big ? 8 : 4;
    const uint8_t *const bytes = gsn_walk_view(tiff->walk, at, tiff->big ? 20 : 12);
    uint64_t size;

    if (!bytes)
        return give_up(tiff, "a TIFF directory", at);
    entry->tag = (unsigned)number(tiff, bytes, 2);
    entry->type = (unsigned)number(tiff, bytes + 2, 2);
    entry->count = number(tiff, bytes + 4, inline_size);
    /* Empty texts are seen, numbers without a number are not. */
    if (entry->type == 0 || (entry->count == 0 && entry->type != TEXT && entry->type != OPAQUE))
        return is_awaited(tiff, "a TIFF entry", at);
    entry->at = at + 4 + inline_size;
    size = type_size(entry->type);
    if (size == 0 || entry->count <= inline_size / size)
        return true;
    entry->at = number(tiff, bytes + 4 + inline_size, inline_size);
    if (entry->at == 0)
        return is_awaited(tiff, "a TIFF value", at);
    /* count * size in 64 bits: compared by division, so that it cannot wrap. */
    if (entry->count > tiff->walk->size / size || !is_inside(tiff, entry->at, entry->count * size))
        return give_up(tiff, "a TIFF value", entry->at);
    return true;
}

static bool element(struct tiff *tiff, const struct entry *entry, uint64_t index,
                    uint64_t *ret_value)
{
    const unsigned size = type_size(entry->type);

    return read_number(tiff, entry->at + index * size, size, "a TIFF value", ret_value);
}

static uint64_t least(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* Fills to[0..count-1] with the elements from first on; those that are not there are 0. */
static bool read_elements(struct tiff *tiff, const struct entry *entry, uint64_t first,
                          uint64_t count, uint64_t *to)
{
    for (uint64_t i = 0; i < count; i++) {
        to[i] = 0;
        if (first + i < entry->count && !element(tiff, entry, first + i, &to[i]))
            return false;
    }
    return true;
}

/* Without lengths only the starts can be looked at. Offsets and lengths lie apart in the file, so
 * they are read in turns of some hundred rather than one by one. */
static bool check_pieces(struct tiff *tiff, const struct entry *offsets,
                         const struct entry *lengths, const char *what)
{
    enum { TURN = 512 };
    uint64_t at[TURN], length[TURN];

    if (!type_size(offsets->type) || (lengths->count && !type_size(lengths->type)))
        return true;
    tiff->elements += least(offsets->count, MOST_ELEMENTS);
    if (tiff->elements > MOST_ELEMENTS)
        return give_up(tiff, "a TIFF with too many pieces", offsets->at);
    for (uint64_t first = 0; first < offsets->count; first += TURN) {
        const uint64_t count = least(TURN, offsets->count - first);

        if (!read_elements(tiff, offsets, first, count, at) ||
            !read_elements(tiff, lengths, first, count, length))
            return false;
        for (uint64_t i = 0; i < count; i++) {
            if (offsets->tag != JPEG_OFFSET &&
                (at[i] == 0 || (first + i < lengths->count && length[i] == 0)))
                return is_awaited(tiff, what, at[i]);
            if (!is_inside(tiff, at[i], length[i]))
                return give_up(tiff, what, at[i]);
        }
    }
    return true;
}

static bool remember_children(struct tiff *tiff, const struct entry *children)
{
    uint64_t at = 0;

    for (uint64_t i = 0; i < children->count && tiff->directories < MOST_DIRECTORIES; i++) {
        if (!type_size(children->type) || !element(tiff, children, i, &at))
            return tiff->answer.reason[0] == '\0';
        if (at == 0)
            return is_awaited(tiff, "a TIFF directory", at);
        remember(tiff, at);
    }
    return true;
}

/* The entries that say where the picture is. A count of 0: the entry is missing. */
struct places {
    struct entry strip, strip_length, tile, tile_length, jpeg, jpeg_length, children;
};

static void sort_entry(struct places *places, const struct entry *entry)
{
    switch (entry->tag) {
    case STRIP_OFFSETS:
        places->strip = *entry;
        break;
    case STRIP_BYTE_COUNTS:
        places->strip_length = *entry;
        break;
    case TILE_OFFSETS:
        places->tile = *entry;
        break;
    case TILE_BYTE_COUNTS:
        places->tile_length = *entry;
        break;
    case JPEG_OFFSET:
        places->jpeg = *entry;
        break;
    case JPEG_LENGTH:
        places->jpeg_length = *entry;
        break;
    case SUB_IFDS:
        places->children = *entry;
        break;
    default:
        break;
    }
}

static bool walk_directory(struct tiff *tiff, uint64_t at)
{
    const unsigned count_size = tiff->big ? 8 : 2, entry_size = tiff->big ? 20 : 12;
    struct places places = { 0 };
    struct entry entry;
    uint64_t count = 0, next = 0;

    if (!read_number(tiff, at, count_size, "a TIFF directory", &count))
        return false;
    /* TIFF 6.0 demands one entry at least. */
    if (count == 0)
        return is_awaited(tiff, "a TIFF directory", at);
    at += count_size;
    if (count > tiff->walk->size / entry_size || !is_inside(tiff, at, count * entry_size))
        return give_up(tiff, "a TIFF directory", at);
    for (uint64_t i = 0; i < count; i++, at += entry_size) {
        if (++tiff->elements > MOST_ELEMENTS)
            return give_up(tiff, "too large a TIFF directory", at);
        if (!read_entry(tiff, at, &entry))
            return false;
        sort_entry(&places, &entry);
    }
    if (!read_number(tiff, at, tiff->big ? 8 : 4, "the end of a TIFF directory", &next))
        return false;
    remember(tiff, next);
    return check_pieces(tiff, &places.strip, &places.strip_length, "a TIFF strip") &&
           check_pieces(tiff, &places.tile, &places.tile_length, "a TIFF tile") &&
           check_pieces(tiff, &places.jpeg, &places.jpeg_length, "a JPEG stream") &&
           remember_children(tiff, &places.children);
}

struct gsn_container gsn_walk_tiff(struct gsn_walk *walk)
{
    const uint8_t *const head = gsn_walk_view(walk, 0, 4);
    struct tiff tiff = { .walk = walk, .answer = { .kind = GSN_CONTAINER_TIFF } };
    uint64_t first = 0;

    tiff.little = head[0] == 'I';
    tiff.big = (tiff.little ? head[2] : head[3]) == '+';
    if (!read_number(&tiff, tiff.big ? 8 : 4, tiff.big ? 8 : 4, "the TIFF header", &first))
        return tiff.answer;
    if (first == 0)
        return gsn_walk_missing(GSN_CONTAINER_TIFF, "the TIFF has no directory yet");
    remember(&tiff, first);
    while (tiff.pending < tiff.directories) {
        if (!walk_directory(&tiff, tiff.directory[tiff.pending++]))
            return tiff.answer;
    }
    tiff.answer.complete = 1;
    return tiff.answer;
}
