/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/container.h"

#include <errno.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "acquire/container_walk.h"

const uint8_t *gsn_walk_view(struct gsn_walk *walk, uint64_t offset, size_t size)
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

size_t gsn_walk_run(const struct gsn_walk *walk, uint64_t offset)
{
    const uint64_t left = offset < walk->size ? walk->size - offset : 0;
    uint64_t most = GSN_WALK_WINDOW;

    if (!walk->bytes && offset >= walk->at && offset < walk->at + walk->filled)
        most = walk->at + walk->filled - offset;
    return (size_t)(left < most ? left : most);
}

struct gsn_container gsn_walk_missing(enum gsn_container_kind kind, const char *format, ...)
{
    struct gsn_container answer = { .kind = kind };
    va_list args;

    va_start(args, format);
    (void)vsnprintf(answer.reason, sizeof answer.reason, format, args);
    va_end(args);
    return answer;
}

static const uint8_t png_signature[8] = { 0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n' };

/* PNG, clause 5.3: length, type, data, CRC. */
static struct gsn_container walk_png(struct gsn_walk *walk)
{
    enum { AROUND = 12 };
    uint64_t at = sizeof png_signature;

    for (;;) {
        const uint8_t *const head = gsn_walk_view(walk, at, 8);
        uint64_t length;

        if (!head)
            return gsn_walk_missing(GSN_CONTAINER_PNG, "the file ends before the PNG's IEND");
        length =
            (uint64_t)head[0] << 24 | (uint64_t)head[1] << 16 | (uint64_t)head[2] << 8 | head[3];
        if (walk->size - at < length + AROUND)
            return gsn_walk_missing(GSN_CONTAINER_PNG,
                                    "the file ends inside a PNG chunk at byte %llu",
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
static uint64_t skip_scan(struct gsn_walk *walk, uint64_t at)
{
    for (;;) {
        const size_t run = gsn_walk_run(walk, at);
        const uint8_t *const bytes = run ? gsn_walk_view(walk, at, run) : NULL;
        const uint8_t *const found = bytes ? memchr(bytes, 0xff, run) : NULL;
        const uint8_t *next;

        if (!bytes)
            return walk->size;
        if (!found) {
            at += run;
            continue;
        }
        at += (uint64_t)(found - bytes);
        next = gsn_walk_view(walk, at, 2);
        if (!next)
            return walk->size;
        /* ITU T.81: 0xff00 is a data byte, restart markers belong to the scan, 0xff may repeat. */
        if (next[1] != 0 && next[1] != 0xff && !(next[1] >= JPEG_RST0 && next[1] <= JPEG_RST7))
            return at;
        at += next[1] == 0xff ? 1 : 2;
    }
}

/* Segments are passed by their lengths, so a thumbnail's EOI inside one is not seen. */
static struct gsn_container walk_jpeg(struct gsn_walk *walk)
{
    uint64_t at = 2;

    for (;;) {
        const uint8_t *const head = gsn_walk_view(walk, at, 2);
        const uint8_t *length;

        if (!head)
            return gsn_walk_missing(GSN_CONTAINER_JPEG, "the file ends before the JPEG's EOI");
        if (head[0] != 0xff)
            return gsn_walk_missing(GSN_CONTAINER_JPEG, "no JPEG marker at byte %llu",
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

        length = gsn_walk_view(walk, at + 2, 2);
        if (!length)
            return gsn_walk_missing(GSN_CONTAINER_JPEG, "the file ends before the JPEG's EOI");
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
static bool fits(const uint64_t value[PAM_KEYS], uint64_t room)
{
    const uint64_t pixel = value[PAM_DEPTH] * (value[PAM_MAXVAL] > 255 ? 2 : 1);

    return value[PAM_WIDTH] <= room / pixel && value[PAM_HEIGHT] <= room / pixel / value[PAM_WIDTH];
}

/* netpbm's pam(5): lines of text to ENDHDR, then the samples, one or two bytes each. */
static struct gsn_container walk_pam(struct gsn_walk *walk)
{
    static const char *const keys[PAM_KEYS] = { "WIDTH", "HEIGHT", "DEPTH", "MAXVAL" };
    uint64_t value[PAM_KEYS] = { 0 };
    uint64_t at = 3;

    for (;;) {
        const size_t run = (size_t)(walk->size - at < 1024 ? walk->size - at : 1024);
        const uint8_t *const bytes = run ? gsn_walk_view(walk, at, run) : NULL;
        const uint8_t *const end = bytes ? memchr(bytes, '\n', run) : NULL;
        char line[1024];

        if (!end)
            return gsn_walk_missing(GSN_CONTAINER_PAM, "the file ends inside the PAM's header");
        (void)snprintf(line, sizeof line, "%.*s", (int)(end - bytes), (const char *)bytes);
        at += (uint64_t)(end - bytes) + 1;
        if (strcmp(line, "ENDHDR") == 0)
            break;
        for (size_t i = 0; i < PAM_KEYS; i++)
            value[i] = value[i] ? value[i] : number_behind(line, keys[i]);
    }
    for (size_t i = 0; i < PAM_KEYS; i++) {
        if (!value[i])
            return gsn_walk_missing(GSN_CONTAINER_PAM, "the PAM's header has no %s", keys[i]);
    }
    if (!fits(value, walk->size - at))
        return gsn_walk_missing(GSN_CONTAINER_PAM, "the file ends before the PAM's last row");
    return (struct gsn_container){ .kind = GSN_CONTAINER_PAM, .complete = 1 };
}

static struct gsn_container judge(struct gsn_walk *walk)
{
    const uint8_t *head;

    if (walk->size == 0)
        return gsn_walk_missing(GSN_CONTAINER_UNKNOWN, "the file is empty");
    head = gsn_walk_view(walk, 0, sizeof png_signature);
    if (head && memcmp(head, png_signature, sizeof png_signature) == 0)
        return walk_png(walk);
    head = gsn_walk_view(walk, 0, 4);
    if (head && (memcmp(head, "II*\0", 4) == 0 || memcmp(head, "MM\0*", 4) == 0 ||
                 memcmp(head, "II+\0", 4) == 0 || memcmp(head, "MM\0+", 4) == 0))
        return gsn_walk_tiff(walk);
    head = gsn_walk_view(walk, 0, 3);
    if (head && head[0] == 0xff && head[1] == JPEG_SOI && head[2] == 0xff)
        return walk_jpeg(walk);
    if (head && memcmp(head, "P7\n", 3) == 0)
        return walk_pam(walk);
    return gsn_walk_missing(GSN_CONTAINER_UNKNOWN, "its bytes are no PNG, JPEG, TIFF or PAM");
}

struct gsn_container gsn_container_check(const void *bytes, size_t size)
{
    struct gsn_walk walk = { .bytes = bytes, .size = size, .fd = -1 };

    return judge(&walk);
}

int gsn_container_check_fd(int fd, struct gsn_container *ret_container, struct gsn_error *err)
{
    struct gsn_walk walk = { .fd = fd };
    struct gsn_container answer;
    struct stat st;

    if (fstat(fd, &st) < 0)
        return gsn_fail(err, GSN_E_IO, "fstat: %s", strerror(errno));
    walk.size = st.st_size > 0 ? (uint64_t)st.st_size : 0;
    answer = judge(&walk);
    if (walk.failure)
        return gsn_fail(err, GSN_E_IO, "reading: %s", strerror(walk.failure));
    *ret_container = answer;
    return GSN_OK;
}

const char *gsn_container_kind_name(enum gsn_container_kind kind)
{
    static const char *const names[] = { "unknown", "PNG", "JPEG", "TIFF", "PAM" };

    return names[kind];
}
