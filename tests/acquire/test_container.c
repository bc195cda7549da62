/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/container.h"

#include <dirent.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"
#include "tests/check.h"
#include "tests/storage/scratch.h"

/* A file put together byte by byte. */
struct draft {
    uint8_t at[4096];
    size_t size;
};

static void put(struct draft *draft, const void *bytes, size_t size)
{
    CHECK(draft->size + size <= sizeof draft->at);
    memcpy(draft->at + draft->size, bytes, size);
    draft->size += size;
}

static void put_number(struct draft *draft, bool little, uint64_t value, unsigned size)
{
    for (unsigned i = 0; i < size; i++) {
        const unsigned shift = 8 * (little ? i : size - 1 - i);

        put(draft, &(uint8_t){ (uint8_t)(value >> shift) }, 1);
    }
}

static void put_chunk(struct draft *draft, const char *type, size_t length)
{
    static const uint8_t zeros[1024];

    put_number(draft, false, length, 4);
    put(draft, type, 4);
    put(draft, zeros, length + 4);
}

static struct draft png(void)
{
    struct draft draft = { .size = 0 };

    put(&draft, "\x89PNG\r\n\x1a\n", 8);
    put_chunk(&draft, "IHDR", 13);
    put_chunk(&draft, "IDAT", 700);
    put_chunk(&draft, "IEND", 0);
    return draft;
}

/* With a thumbnail inside its EXIF, fill bytes, a restart marker and stuffed bytes in the scan. */
static struct draft jpeg(void)
{
    static const char scan[] = "\x12\xff\x00\x34\xff\xd0\x56\xff\xff\x00 not yet \xff\x00";
    struct draft draft = { .size = 0 };

    put(&draft, "\xff\xd8\xff\xe1\x00\x14", 6);
    put(&draft, "Exif\0\0\xff\xd8\xff\xda\x00\x02 \xff\xd9 .", 18);
    put(&draft, "\xff\xff\xff\xdb\x00\x05qqq", 9);
    put(&draft, "\xff\xda\x00\x04hh", 6);
    put(&draft, scan, sizeof scan - 1);
    put(&draft, "\xff\xc4\x00\x03t\xff\xda\x00\x02more\xff\xd9", 15);
    return draft;
}

static void put_entry(struct draft *draft, bool little, bool big, unsigned tag, unsigned type,
                      uint64_t count, uint64_t value)
{
    put_number(draft, little, tag, 2);
    put_number(draft, little, type, 2);
    put_number(draft, little, count, big ? 8 : 4);
    put_number(draft, little, value, big ? 8 : 4);
}

/* Header, two strips of 50 bytes, their offsets and lengths, the directory, one tile in a child
 * directory at the very end. */
static struct draft tiff(bool little, bool big)
{
    enum { LONG = 4, LONG8 = 16, STRIP = 50 };
    const unsigned word = big ? 8 : 4, header = big ? 16 : 8, type = big ? LONG8 : LONG;
    const unsigned counts = big ? 8 : 2, entry = big ? 20 : 12;
    const uint64_t arrays = header + 2 * STRIP, first = arrays + 4 * word;
    const uint64_t child = first + counts + 3 * entry + word;
    const uint64_t tile = child + counts + 2 * entry + word;
    static const uint8_t pixels[2 * STRIP];
    struct draft draft = { .size = 0 };

    put(&draft, little ? "II" : "MM", 2);
    put_number(&draft, little, big ? 43 : 42, 2);
    if (big) {
        put_number(&draft, little, 8, 2);
        put_number(&draft, little, 0, 2);
    }
    put_number(&draft, little, first, word);
    put(&draft, pixels, 2 * STRIP);
    put_number(&draft, little, header, word);
    put_number(&draft, little, header + STRIP, word);
    put_number(&draft, little, STRIP, word);
    put_number(&draft, little, STRIP, word);
    put_number(&draft, little, 3, counts);
    put_entry(&draft, little, big, 273, type, 2, arrays);
    put_entry(&draft, little, big, 279, type, 2, arrays + 2 * word);
    put_entry(&draft, little, big, 330, type, 1, child);
    put_number(&draft, little, 0, word);
    put_number(&draft, little, 2, counts);
    put_entry(&draft, little, big, 324, type, 1, tile);
    put_entry(&draft, little, big, 325, type, 1, STRIP);
    put_number(&draft, little, 0, word);
    put(&draft, pixels, STRIP);
    return draft;
}

enum { DRAFTS = 6 };

static struct draft draft_of(int which)
{
    switch (which) {
    case 0:
        return png();
    case 1:
        return jpeg();
    default:
        return tiff(which & 1, which >= 4);
    }
}

static enum gsn_container_kind kind_of(int which)
{
    return which == 0 ? GSN_CONTAINER_PNG : which == 1 ? GSN_CONTAINER_JPEG : GSN_CONTAINER_TIFF;
}

TEST(a_whole_container_is_complete)
{
    for (int i = 0; i < DRAFTS; i++) {
        const struct draft draft = draft_of(i);
        const struct gsn_container got = gsn_container_check(draft.at, draft.size);

        if (!got.complete)
            fail_msg("draft %d: %s", i, got.reason);
        CHECK(got.kind == kind_of(i) && got.reason[0] == '\0');
    }
}

TEST(a_container_cut_anywhere_is_not_complete_and_says_why)
{
    for (int i = 0; i < DRAFTS; i++) {
        const struct draft draft = draft_of(i);

        for (size_t size = 0; size < draft.size; size++) {
            const struct gsn_container got = gsn_container_check(draft.at, size);

            if (got.complete)
                fail_msg("draft %d of %zu bytes passes at %zu", i, draft.size, size);
            CHECK(got.reason[0] != '\0');
        }
    }
}

TEST(what_follows_a_whole_container_does_not_matter)
{
    for (int i = 0; i < DRAFTS; i++) {
        struct draft draft = draft_of(i);

        put(&draft, "camera makers append things", 27);
        CHECK(gsn_container_check(draft.at, draft.size).complete == 1);
    }
}

TEST(the_file_is_judged_as_its_bytes_are)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_error err = { 0 };

    for (int i = 0; i < DRAFTS; i++) {
        const struct draft draft = draft_of(i);

        for (size_t size = draft.size; size + 3 > draft.size; size--) {
            const char *const path = gsn_scratch_path(&scratch, "file");
            struct gsn_container got;
            int fd = -1;

            CHECK_OK(gsn_file_write(path, draft.at, size, &err), err);
            CHECK_OK(gsn_file_open(path, &fd, &err), err);
            CHECK_OK(gsn_container_check_fd(fd, &got, &err), err);
            CHECK(close(fd) == 0);
            CHECK(got.kind == kind_of(i) && got.complete == (size == draft.size));
        }
    }
}

TEST(a_scan_longer_than_the_window_is_walked_to_its_end)
{
    enum { LONG = 200000 };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto_mem(uint8_t) scan = gsn_alloc_array(LONG, 1);
    const char *const path = gsn_scratch_path(&scratch, "file");
    struct gsn_error err = { 0 };
    struct gsn_container got;
    int fd = -1;

    /* Stuffed bytes everywhere, so that some lie across the edge of every window. */
    for (size_t i = 0; i < LONG; i++)
        scan[i] = i % 2 ? 0x00 : 0xff;
    gsn_scratch_append(path, "\xff\xd8\xff\xda\x00\x03s", 7);
    gsn_scratch_append(path, scan, LONG);
    CHECK_OK(gsn_file_open(path, &fd, &err), err);
    CHECK_OK(gsn_container_check_fd(fd, &got, &err), err);
    CHECK(got.complete == 0);
    gsn_scratch_append(path, "\xff\xd9", 2);
    CHECK_OK(gsn_container_check_fd(fd, &got, &err), err);
    CHECK(got.complete == 1);
    CHECK(close(fd) == 0);
}

TEST(other_bytes_are_unknown)
{
    static const char *const others[] = { "", "G", "GIF89a", "RIFF....WEBP", "II", "P5 3 3 255 " };

    for (size_t i = 0; i < sizeof others / sizeof others[0]; i++) {
        const struct gsn_container got = gsn_container_check(others[i], strlen(others[i]));

        CHECK(got.kind == GSN_CONTAINER_UNKNOWN && got.complete == 0 && got.reason[0] != '\0');
    }
}

/* As libtiff leaves it between TIFFWriteCheckpointDirectory() and the last strip. */
TEST(a_tiff_whose_directory_came_before_its_strips_is_awaited)
{
    enum { SECOND_OFFSET = 112, SECOND_LENGTH = 120 };
    struct draft draft = tiff(true, false);
    struct gsn_container got = gsn_container_check(draft.at, draft.size);

    CHECK(got.complete == 1);
    memset(draft.at + SECOND_LENGTH, 0, 4);
    got = gsn_container_check(draft.at, draft.size);
    CHECK(got.complete == 0 && strstr(got.reason, "a TIFF strip at byte 58 is not written yet"));
    draft = tiff(true, false);
    memset(draft.at + SECOND_OFFSET, 0, 4);
    CHECK(gsn_container_check(draft.at, draft.size).complete == 0);
}

/* A scanner that makes the file as long as it will be, and then writes from its beginning: all that
 * is not there yet reads as zeros. 18 of 18 such halves counted as whole. */
TEST(a_tiff_made_to_its_length_and_filled_later_is_awaited_to_the_end_of_its_directories)
{
    for (int which = 2; which < DRAFTS; which++) {
        const struct draft whole = draft_of(which);

        for (size_t written = 4; written < whole.size; written++) {
            struct draft half = whole;

            memset(half.at + written, 0, half.size - written);
            /* Strips are zeros, and directories end with some, in this drawing. */
            if (memcmp(half.at, whole.at, whole.size) == 0)
                continue;
            const struct gsn_container got = gsn_container_check(half.at, half.size);

            if (got.complete || !got.reason[0])
                fail_msg("draft %d with %zu of %zu bytes written counts as whole", which, written,
                         whole.size);
        }
    }
}

TEST(a_loop_of_directories_ends)
{
    struct draft draft = { .size = 0 };

    put(&draft, "II*\0", 4);
    put_number(&draft, true, 8, 4);
    put_number(&draft, true, 1, 2);
    put_entry(&draft, true, false, 330, 4, 1, 8); /* its own child */
    put_number(&draft, true, 8, 4);               /* and its own successor */
    CHECK(gsn_container_check(draft.at, draft.size).complete == 1);
}

TEST(sizes_that_overflow_are_outside_the_file)
{
    static const uint64_t counts[] = { UINT64_MAX, UINT64_MAX / 8, UINT64_MAX / 8 + 1,
                                       (uint64_t)1 << 61 };

    for (size_t i = 0; i < sizeof counts / sizeof counts[0]; i++) {
        struct draft draft = { .size = 0 };

        put(&draft, "II+\0\x08\0\0\0", 8);
        put_number(&draft, true, 16, 8);
        put_number(&draft, true, 1, 8);
        put_entry(&draft, true, true, 270, 16, counts[i], 16);
        put_number(&draft, true, 0, 8);
        CHECK(gsn_container_check(draft.at, draft.size).complete == 0);
        draft.size = 16;
        put_number(&draft, true, counts[i], 8);
        CHECK(gsn_container_check(draft.at, draft.size).complete == 0);
    }
}

TEST(hostile_bytes_are_only_ever_judged)
{
    unsigned seed = 20260;
    unsigned complete = 0;

    for (int round = 0; round < 60000; round++) {
        const struct draft draft = draft_of(round % DRAFTS);
        size_t size = draft.size;
        gsn_auto_mem(uint8_t) copy = NULL;

        seed = seed * 1664525u + 1013904223u;
        if (seed >> 31)
            size = (seed >> 8) % (draft.size + 1);
        /* Of its exact size, so that ASan sees the first byte beyond. */
        copy = gsn_memdup(draft.at, size);
        CHECK(copy != NULL);
        for (unsigned flips = (seed >> 4) % 5; flips > 0 && size > 0; flips--) {
            seed = seed * 1664525u + 1013904223u;
            copy[(seed >> 8) % size] = (uint8_t)(seed >> 3);
        }
        complete += gsn_container_check(copy, size).complete ? 1 : 0;
    }
    CHECK(complete > 0 && complete < 60000);
}

/* What the libraries' own collections of test pictures hold. Truncated means what its name says;
 * the rest is whole, as far as a container can tell. */
TEST(real_pictures_are_whole_unless_they_are_cut)
{
    static const struct {
        const char *name;
        int complete;
    } known[] = {
        { "hopper.jpg", 1 },
        { "hopper_orientation_6.jpg", 1 },
        { "pil_sample_cmyk.jpg", 1 },
        { "invalid-exif.jpg", 1 },
        { "truncated_jpeg.jpg", 0 },
        { "truncated_image.png", 0 },
        { "broken.png", 0 },
        { "tiff_16bit_RGB_target.png", 1 },
        { "hopper.tif", 1 },
        { "hopper_bigtiff.tif", 1 },
        { "multipage.tiff", 1 },
        { "multipage_single_frame_loop.tiff", 1 },
        { "quad-tile.jpg.tiff", 1 },
        { "rgb-3c-16b.tiff", 1 },
        { "minisblack-1c-16b.tiff", 1 },
        { "tiff_tiled_planar_raw.tif", 1 },
        { "tiff_strip_planar_lzw.tiff", 1 },
        { "tiff_with_subifd_chain.tif", 1 },
        { "old-style-jpeg-compression.tif", 1 },
        { "test_ifd_loop_to_self.tif", 1 },
        { "seek_too_large.tif", 0 },
    };

    if (access(GSN_SHARED "/data/images", R_OK) < 0) {
        gsn_check_skip("%s is not there", GSN_SHARED "/data/images");
    }
    for (size_t i = 0; i < sizeof known / sizeof known[0]; i++) {
        gsn_auto_mem(uint8_t) bytes = NULL;
        struct gsn_error err = { 0 };
        char path[4096];
        size_t size = 0;

        (void)snprintf(path, sizeof path, "%s/data/images/%s", GSN_SHARED, known[i].name);
        CHECK_OK(gsn_file_read(path, 1 << 24, &bytes, &size, &err), err);
        const struct gsn_container got = gsn_container_check(bytes, size);

        if (got.complete != known[i].complete)
            fail_msg("%s: complete %d, reason \"%s\"", known[i].name, got.complete, got.reason);
    }
}

TEST(a_pam_is_complete_when_its_last_sample_is_there)
{
    static const char head[] = "P7\n# device: WIDTH 9\nWIDTH 3\nHEIGHT 2\nDEPTH 2\nMAXVAL 1023\n"
                               "TUPLTYPE X\nENDHDR\n";
    static const char huge[] = "P7\nWIDTH 4294967295\nHEIGHT 4294967295\nDEPTH 4294967295\n"
                               "MAXVAL 65535\nENDHDR\nxxxxxxxx";
    struct gsn_container got;
    struct draft draft = { .size = 0 };

    put(&draft, head, sizeof head - 1);
    for (size_t i = 0; i < 3 * 2 * 2 * 2; i++)
        put(&draft, "\n", 1);
    for (size_t cut = 3; cut < draft.size; cut++) {
        got = gsn_container_check(draft.at, cut);
        CHECK(got.kind == GSN_CONTAINER_PAM && !got.complete && got.reason[0]);
    }
    got = gsn_container_check(draft.at, draft.size);
    CHECK(got.kind == GSN_CONTAINER_PAM && got.complete && !got.reason[0]);
    got = gsn_container_check(huge, sizeof huge - 1);
    CHECK(got.kind == GSN_CONTAINER_PAM && !got.complete);
    got = gsn_container_check("P7\nWIDTH 1\nENDHDR\n", 18);
    CHECK(strcmp(got.reason, "the PAM's header has no HEIGHT") == 0);
}
