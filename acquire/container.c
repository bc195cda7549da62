/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether a picture file is all there: the container is walked, never the picture.
 *
 * Steps. The first bytes say which walk.
 *  - PNG (clause 5.3): chunk by chunk to IEND.
 *  - JPEG (ITU T.81): segment by segment, through each scan to its next marker, to EOI.
 *  - TIFF 6.0, section 2, and BigTIFF by its published layout: a chain of directories, each a list
 * of entries (tag, type, count, value or offset). Complete means: every directory, every value
 * stored outside its entry and every strip, tile or old-style JPEG stream lies inside the file, and
 * none of those places is still zero.
 *  - PAM (netpbm's pam(5)): the header's product of sizes.
 * The file is seen through a window of 32 KiB, read with pread().
 *
 * How it fails: bad content is an answer with a reason; only a read error is a failure. Input is
 * hostile: each offset is compared in 64 bits without wrapping, a directory met twice ends its
 * chain, and the elements of a TIFF are counted, so the work is bounded. */
#include "acquire/container.h"

#include <errno.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { WINDOW = 32768 };

/* A file seen through a small window. */
struct walk {
    const uint8_t *bytes; /* the whole content; NULL: read from fd through the window */
    uint64_t size;
    int fd;
    int failure; /* errno of a pread() that failed; 0: none */
    uint64_t at; /* offset of the window */
    size_t filled;
    uint8_t window[WINDOW];
};

/* The window. */

/* size bytes (at most WINDOW) from offset, valid until the next call; NULL when they are
 * not all inside the file. */
static const uint8_t *view_bytes(struct walk *walk, uint64_t offset, size_t size)
{
    if (walk->bytes)
        return offset <= walk->size && size <= walk->size - offset ? walk->bytes + offset : NULL;
    if (size > sizeof walk->window || offset > walk->size || size > walk->size - offset)
        return NULL;
    if (offset < walk->at || offset + size > walk->at + walk->filled) {
        walk->at = offset;
        walk->filled = 0;
        while (walk->filled < size) {
            const ssize_t got =
                pread(walk->fd, walk->window + walk->filled, sizeof walk->window - walk->filled,
                      (off_t)(offset + walk->filled));

            if (got < 0 && errno == EINTR)
                continue;
            if (got <= 0) {
                walk->failure = got < 0 ? errno : 0;
                return NULL;
            }
            walk->filled += (size_t)got;
        }
    }
    return walk->window + (offset - walk->at);
}

/* How many bytes from offset a view can cheaply hold; 0 at the end of the file. */
static size_t count_cheap(const struct walk *walk, uint64_t offset)
{
    const uint64_t left = offset < walk->size ? walk->size - offset : 0;
    uint64_t most = WINDOW;

    if (!walk->bytes && offset >= walk->at && offset < walk->at + walk->filled)
        most = walk->at + walk->filled - offset;
    return (size_t)(left < most ? left : most);
}

/* An answer "not complete" with its reason. */
static struct gsn_container fail_missing(enum gsn_container_kind kind, const char *format, ...)
{
    struct gsn_container answer = { .kind = kind };
    va_list args;

    va_start(args, format);
    (void)vsnprintf(answer.reason, sizeof answer.reason, format, args);
    va_end(args);
    return answer;
}

/* PNG, JPEG and PAM. */

static const uint8_t png_signature[8] = { 0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n' };

/* PNG, clause 5.3: length, type, data, CRC. */
static struct gsn_container walk_png(struct walk *walk)
{
    enum { AROUND = 12 };
    uint64_t at = sizeof png_signature;

    for (;;) {
        const uint8_t *const head = view_bytes(walk, at, 8);
        uint64_t length;

        if (!head)
            return fail_missing(GSN_CONTAINER_PNG, "the file ends before the PNG's IEND");
        length =
            (uint64_t)head[0] << 24 | (uint64_t)head[1] << 16 | (uint64_t)head[2] << 8 | head[3];
        if (walk->size - at < length + AROUND)
            return fail_missing(GSN_CONTAINER_PNG, "the file ends inside a PNG chunk at byte %llu",
                                (unsigned long long)at);
        if (memcmp(head + 4, "IEND", 4) == 0)
            return (struct gsn_container){ .kind = GSN_CONTAINER_PNG, .complete = 1 };
        at += length + AROUND;
    }
}

enum jpeg_marker {
    JPEG_TEM = 0x01,
    JPEG_RST0 = 0xd0,
    JPEG_RST7 = 0xd7,
    JPEG_SOI = 0xd8,
    JPEG_EOI = 0xd9,
    JPEG_SOS = 0xda,
};

/* The offset of the next 0xff of this scan that begins a marker; the size of the file if none. */
static uint64_t skip_scan(struct walk *walk, uint64_t at)
{
    for (;;) {
        const size_t run = count_cheap(walk, at);
        const uint8_t *const bytes = run ? view_bytes(walk, at, run) : NULL;
        const uint8_t *const found = bytes ? memchr(bytes, 0xff, run) : NULL;
        const uint8_t *next;

        if (!bytes)
            return walk->size;
        if (!found) {
            at += run;
            continue;
        }
        at += (uint64_t)(found - bytes);
        next = view_bytes(walk, at, 2);
        if (!next)
            return walk->size;
        /* ITU T.81: 0xff00 is a data byte, restart markers belong to the scan, 0xff may repeat. */
        if (next[1] != 0 && next[1] != 0xff && !(next[1] >= JPEG_RST0 && next[1] <= JPEG_RST7))
            return at;
        at += next[1] == 0xff ? 1 : 2;
    }
}

/* Segments are passed by their lengths, so a thumbnail's EOI inside one is not seen. */
static struct gsn_container walk_jpeg(struct walk *walk)
{
    uint64_t at = 2;

    for (;;) {
        const uint8_t *const head = view_bytes(walk, at, 2);
        const uint8_t *length;

        if (!head)
            return fail_missing(GSN_CONTAINER_JPEG, "the file ends before the JPEG's EOI");
        if (head[0] != 0xff)
            return fail_missing(GSN_CONTAINER_JPEG, "no JPEG marker at byte %llu",
                                (unsigned long long)at);
        if (head[1] == JPEG_EOI)
            return (struct gsn_container){ .kind = GSN_CONTAINER_JPEG, .complete = 1 };
        if (head[1] == 0xff) {
            at++;
            continue;
        }
        if (head[1] == JPEG_TEM || (head[1] >= JPEG_RST0 && head[1] <= JPEG_SOI)) {
            at += 2;
            continue;
        }

        const bool scan = head[1] == JPEG_SOS;

        length = view_bytes(walk, at + 2, 2);
        if (!length)
            return fail_missing(GSN_CONTAINER_JPEG, "the file ends before the JPEG's EOI");
        at += 2 + ((uint64_t)length[0] << 8 | length[1]);
        if (scan)
            at = skip_scan(walk, at);
    }
}

/* The number behind a key at the beginning of a line; 0 when it is another line or no number. */
static uint64_t number_behind(const char *line, const char *key)
{
    const size_t length = strlen(key);
    uint64_t value = 0;

    if (strncmp(line, key, length) != 0)
        return 0;
    line += length + strspn(line + length, " \t");
    for (; *line >= '0' && *line <= '9' && value < (uint64_t)1 << 32; line++)
        value = value * 10 + (uint64_t)(*line - '0');
    return *line == '\0' && value <= UINT32_MAX ? value : 0;
}

enum pam_key { PAM_WIDTH, PAM_HEIGHT, PAM_DEPTH, PAM_MAXVAL, PAM_KEYS };

/* All factors are below 2^32 and the last two below 2^17: held against the size one by one. */
static bool is_size_inside(const uint64_t value[PAM_KEYS], uint64_t room)
{
    const uint64_t pixel = value[PAM_DEPTH] * (value[PAM_MAXVAL] > 255 ? 2 : 1);

    return value[PAM_WIDTH] <= room / pixel && value[PAM_HEIGHT] <= room / pixel / value[PAM_WIDTH];
}

/* netpbm's pam(5): lines of text to ENDHDR, then the samples, one or two bytes each. */
static struct gsn_container walk_pam(struct walk *walk)
{
    static const char *const keys[PAM_KEYS] = { "WIDTH", "HEIGHT", "DEPTH", "MAXVAL" };
    uint64_t value[PAM_KEYS] = { 0 };
    uint64_t at = 3;

    for (;;) {
        const size_t run = (size_t)(walk->size - at < 1024 ? walk->size - at : 1024);
        const uint8_t *const bytes = run ? view_bytes(walk, at, run) : NULL;
        const uint8_t *const end = bytes ? memchr(bytes, '\n', run) : NULL;
        char line[1024];

        if (!end)
            return fail_missing(GSN_CONTAINER_PAM, "the file ends inside the PAM's header");
        (void)snprintf(line, sizeof line, "%.*s", (int)(end - bytes), (const char *)bytes);
        at += (uint64_t)(end - bytes) + 1;
        if (strcmp(line, "ENDHDR") == 0)
            break;
        for (size_t i = 0; i < PAM_KEYS; i++)
            value[i] = value[i] ? value[i] : number_behind(line, keys[i]);
    }
    for (size_t i = 0; i < PAM_KEYS; i++) {
        if (!value[i])
            return fail_missing(GSN_CONTAINER_PAM, "the PAM's header has no %s", keys[i]);
    }
    if (!is_size_inside(value, walk->size - at))
        return fail_missing(GSN_CONTAINER_PAM, "the file ends before the PAM's last row");
    return (struct gsn_container){ .kind = GSN_CONTAINER_PAM, .complete = 1 };
}

/* TIFF and BigTIFF. */

enum {
    STRIP_OFFSETS = 273,
    STRIP_BYTE_COUNTS = 279,
    TILE_OFFSETS = 324,
    TILE_BYTE_COUNTS = 325,
    SUB_IFDS = 330,
    JPEG_OFFSET = 513,
    JPEG_LENGTH = 514,
};

enum { TEXT = 2, OPAQUE = 7 };
/* types */

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
    struct walk *walk;
    bool little, big;
    size_t pending, directories; /* next to look at; known so far */
    uint64_t directory[MOST_DIRECTORIES];
    uint64_t elements;
    struct gsn_container answer;
};

static uint64_t get_number(const struct tiff *tiff, const uint8_t *bytes, unsigned size)
{
    uint64_t value = 0;

    for (unsigned i = 0; i < size; i++)
        value = value << 8 | bytes[tiff->little ? size - 1 - i : i];
    return value;
}

static bool give_up(struct tiff *tiff, const char *what, uint64_t at)
{
    tiff->answer = fail_missing(GSN_CONTAINER_TIFF, "%s at byte %llu is not all in the file", what,
                                (unsigned long long)at);
    return false;
}

/* Who makes the file as long as it will be, or writes the directory first, has zeros where
 * something is to come. */
static bool is_awaited(struct tiff *tiff, const char *what, uint64_t at)
{
    tiff->answer = fail_missing(GSN_CONTAINER_TIFF, "%s at byte %llu is not written yet", what,
                                (unsigned long long)at);
    return false;
}

static bool read_number(struct tiff *tiff, uint64_t at, unsigned size, const char *what,
                        uint64_t *ret_value)
{
    const uint8_t *const bytes = view_bytes(tiff->walk, at, size);

    if (!bytes)
        return give_up(tiff, what, at);
    *ret_value = get_number(tiff, bytes, size);
    return true;
}

/* A directory met twice ends there: loops are the decoder's to refuse. */
static void add_directory(struct tiff *tiff, uint64_t at)
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
    const uint8_t *const bytes = view_bytes(tiff->walk, at, tiff->big ? 20 : 12);
    uint64_t size;

    if (!bytes)
        return give_up(tiff, "a TIFF directory", at);
    entry->tag = (unsigned)get_number(tiff, bytes, 2);
    entry->type = (unsigned)get_number(tiff, bytes + 2, 2);
    entry->count = get_number(tiff, bytes + 4, inline_size);
    /* Empty texts are seen, numbers without a number are not. */
    if (entry->type == 0 || (entry->count == 0 && entry->type != TEXT && entry->type != OPAQUE))
        return is_awaited(tiff, "a TIFF entry", at);
    entry->at = at + 4 + inline_size;
    size = type_size(entry->type);
    if (size == 0 || entry->count <= inline_size / size)
        return true;
    entry->at = get_number(tiff, bytes + 4 + inline_size, inline_size);
    if (entry->at == 0)
        return is_awaited(tiff, "a TIFF value", at);
    /* count * size in 64 bits: compared by division, so that it cannot wrap. */
    if (entry->count > tiff->walk->size / size || !is_inside(tiff, entry->at, entry->count * size))
        return give_up(tiff, "a TIFF value", entry->at);
    return true;
}

static bool read_element(struct tiff *tiff, const struct entry *entry, uint64_t index,
                         uint64_t *ret_value)
{
    const unsigned size = type_size(entry->type);

    return read_number(tiff, entry->at + index * size, size, "a TIFF value", ret_value);
}

static uint64_t smaller_of(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* Fills to[0..count-1] with the elements from first on; those that are not there are 0. */
static bool read_elements(struct tiff *tiff, const struct entry *entry, uint64_t first,
                          uint64_t count, uint64_t *to)
{
    for (uint64_t i = 0; i < count; i++) {
        to[i] = 0;
        if (first + i < entry->count && !read_element(tiff, entry, first + i, &to[i]))
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
    tiff->elements += smaller_of(offsets->count, MOST_ELEMENTS);
    if (tiff->elements > MOST_ELEMENTS)
        return give_up(tiff, "a TIFF with too many pieces", offsets->at);
    for (uint64_t first = 0; first < offsets->count; first += TURN) {
        const uint64_t count = smaller_of(TURN, offsets->count - first);

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

static bool add_children(struct tiff *tiff, const struct entry *children)
{
    uint64_t at = 0;

    for (uint64_t i = 0; i < children->count && tiff->directories < MOST_DIRECTORIES; i++) {
        if (!type_size(children->type) || !read_element(tiff, children, i, &at))
            return tiff->answer.reason[0] == '\0';
        if (at == 0)
            return is_awaited(tiff, "a TIFF directory", at);
        add_directory(tiff, at);
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
    add_directory(tiff, next);
    return check_pieces(tiff, &places.strip, &places.strip_length, "a TIFF strip") &&
           check_pieces(tiff, &places.tile, &places.tile_length, "a TIFF tile") &&
           check_pieces(tiff, &places.jpeg, &places.jpeg_length, "a JPEG stream") &&
           add_children(tiff, &places.children);
}

/* The file's first four bytes are those of a TIFF or BigTIFF. */
static struct gsn_container walk_tiff(struct walk *walk)
{
    const uint8_t *const head = view_bytes(walk, 0, 4);
    struct tiff tiff = { .walk = walk, .answer = { .kind = GSN_CONTAINER_TIFF } };
    uint64_t first = 0;

    tiff.little = head[0] == 'I';
    tiff.big = (tiff.little ? head[2] : head[3]) == '+';
    if (!read_number(&tiff, tiff.big ? 8 : 4, tiff.big ? 8 : 4, "the TIFF header", &first))
        return tiff.answer;
    if (first == 0)
        return fail_missing(GSN_CONTAINER_TIFF, "the TIFF has no directory yet");
    add_directory(&tiff, first);
    while (tiff.pending < tiff.directories) {
        if (!walk_directory(&tiff, tiff.directory[tiff.pending++]))
            return tiff.answer;
    }
    tiff.answer.complete = 1;
    return tiff.answer;
}

/* The answer. */

static struct gsn_container judge_container(struct walk *walk)
{
    const uint8_t *head;

    if (walk->size == 0)
        return fail_missing(GSN_CONTAINER_UNKNOWN, "the file is empty");
    head = view_bytes(walk, 0, sizeof png_signature);
    if (head && memcmp(head, png_signature, sizeof png_signature) == 0)
        return walk_png(walk);
    head = view_bytes(walk, 0, 4);
    if (head && (memcmp(head, "II*\0", 4) == 0 || memcmp(head, "MM\0*", 4) == 0 ||
                 memcmp(head, "II+\0", 4) == 0 || memcmp(head, "MM\0+", 4) == 0))
        return walk_tiff(walk);
    head = view_bytes(walk, 0, 3);
    if (head && head[0] == 0xff && head[1] == JPEG_SOI && head[2] == 0xff)
        return walk_jpeg(walk);
    if (head && memcmp(head, "P7\n", 3) == 0)
        return walk_pam(walk);
    return fail_missing(GSN_CONTAINER_UNKNOWN, "its bytes are no PNG, JPEG, TIFF or PAM");
}

struct gsn_container gsn_container_check(const void *bytes, size_t size)
{
    struct walk walk = { .bytes = bytes, .size = size, .fd = -1 };

    return judge_container(&walk);
}

int gsn_container_check_fd(int fd, struct gsn_container *ret_container, struct gsn_error *err)
{
    struct walk walk = { .fd = fd };
    struct gsn_container answer;
    struct stat st;

    if (fstat(fd, &st) < 0)
        return gsn_fail(err, GSN_E_IO, "fstat: %s", strerror(errno));
    walk.size = st.st_size > 0 ? (uint64_t)st.st_size : 0;
    answer = judge_container(&walk);
    if (walk.failure)
        return gsn_fail(err, GSN_E_IO, "reading: %s", strerror(walk.failure));
    *ret_container = answer;
    return GSN_OK;
}
