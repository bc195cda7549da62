/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A session with a camera that exists (Canon PowerShot SX200, recorded by the makers of umockdev),
 * made a record of ours and played as a device. Its photos are known. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "acquire/source.h"
#include "pipeline/core/file.h"
#include "tests/check.h"
#include "tests/device/pull.h"
#include "tests/device/transcript.h"
#include "tests/device/umock.h"

enum { NUMBER = 11, LARGEST = 16 << 20, TAR_BLOCK = 512, SKIPPED = 77 };

static const char canon[] = "C767F1C714174C309255F70E4A7B2EE2";

static void play(const char *text, size_t size, struct pull *pull)
{
    const struct gsn_source_options options = { .settle_ms = 500 };
    struct transcript *const transcript = transcript_new(text, size);
    struct umock *const umock = umock_new();
    struct gsn_source *source = NULL;
    struct gsn_error err = { 0 };

    CHECK(transcript);
    umock_plug(umock, transcript_usb(transcript), NUMBER);
    CHECK_OK(gsn_source_open("ptp:04a9:31c0", &options, &source, &err), err);
    CHECK_OK(pull_until(pull, source, 2, &err), err);
    CHECK(strstr(gsn_source_device(source), canon));
    gsn_source_free(source);
    umock_free(umock);
    transcript_free(transcript);
}

static const char *shared(const char *name)
{
    static char path[400];
    const char *const given = getenv("GIESON_SHARED");

    (void)snprintf(path, sizeof path, "%s/data/device/%s", given ? given : GSN_SHARED, name);
    return path;
}

/* borrows: a member of a tar archive; NULL when it is not in it. */
static const uint8_t *find_in_tar(const uint8_t *tar, size_t size, const char *name,
                                  size_t *ret_size)
{
    for (size_t at = 0; at + TAR_BLOCK <= size && tar[at];) {
        const char *const path = (const char *)tar + at, *const slash = strrchr(path, '/');
        const size_t length = strtoul(path + 124, NULL, 8);

        if (strcmp(slash ? slash + 1 : path, name) == 0) {
            *ret_size = length;
            return tar + at + TAR_BLOCK;
        }
        at += TAR_BLOCK + (length + TAR_BLOCK - 1) / TAR_BLOCK * TAR_BLOCK;
    }
    return NULL;
}

/* gives: free(). NULL when the recording is not here. */
static char *convert_canon(size_t *ret_size)
{
    char command[1200], *text;
    FILE *pipe;

    if (access(shared("canon-powershot-sx200.ioctl"), R_OK) < 0)
        return NULL;
    (void)snprintf(command, sizeof command, "env -u LD_PRELOAD python3 '%s' 04a9 31c0 %s '%s'",
                   GSN_CONVERTER, canon, shared("canon-powershot-sx200.ioctl"));
    text = malloc(LARGEST);
    pipe = popen(command, "r");
    CHECK(text && pipe);
    *ret_size = fread(text, 1, LARGEST, pipe);
    CHECK(pclose(pipe) == 0);
    return text;
}

TEST(a_recorded_camera_yields_both_photos_bit_identical)
{
    static const char *const names[] = { "IMG_0001.JPG", "IMG_0002.JPG" };
    static const size_t sizes[] = { 68182, 89334 };
    gsn_auto_mem(uint8_t) tar = NULL;
    struct pull pull = { 0 };
    struct gsn_error err = { 0 };
    size_t size = 0, tar_size;
    char *const text = convert_canon(&size);

    if (!text) {
        print_message("the recording of a camera is not here: %s\n", shared(""));
        _exit(SKIPPED);
    }
    CHECK_OK(gsn_file_read(shared("test-photos.tar"), LARGEST, &tar, &tar_size, &err), err);
    play(text, size, &pull);
    for (size_t i = 0; i < 2; i++) {
        const struct pulled *const got = pull_find(&pull, names[i]);
        size_t truth_size = 0;
        const uint8_t *const truth = find_in_tar(tar, tar_size, names[i], &truth_size);

        CHECK(got && truth && got->size == sizes[i] && truth_size == sizes[i]);
        CHECK(memcmp(got->bytes, truth, sizes[i]) == 0);
    }
    pull_free(&pull);
    free(text);
}
