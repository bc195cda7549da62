/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The referee: gphoto2, as the distribution ships it, reads the model. What it cannot read is no
 * scanner, however well our own initiator gets on with it. */
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "tests/check.h"
#include "tests/device/ptp_model.h"
#include "tests/device/umock.h"
#include "tests/storage/scratch.h"

enum { NUMBER = 7, MISSING = 127, SKIPPED = 77, LARGEST = 3 << 20, KEPT = 3 };

/* Runs gphoto2 in the scratch directory; its words go to the file named said there. */
static int gphoto2(const struct gsn_scratch *scratch, const char *option, const char *value)
{
    const char *const said = gsn_scratch_path(scratch, "said");
    const pid_t child = fork();
    int status = 0;

    if (child == 0) {
        const int fd = open(said, O_WRONLY | O_CREAT | O_TRUNC, 0600);

        /* The sanitizer's runtime is for us alone. */
        if (fd < 0 || dup2(fd, 1) < 0 || dup2(fd, 2) < 0 || chdir(scratch->dir) < 0 ||
            setenv("LD_PRELOAD", "libumockdev-preload.so.0", 1) < 0 ||
            setenv("HOME", scratch->dir, 1) < 0 || setenv("LC_ALL", "C", 1) < 0)
            _exit(1);
        (void)execlp("gphoto2", "gphoto2", option, value, (char *)NULL);
        _exit(errno == ENOENT ? MISSING : 1);
    }
    CHECK(waitpid(child, &status, 0) == child && WIFEXITED(status));
    if (WEXITSTATUS(status) == MISSING) {
        print_message("gphoto2 is not installed: the model was not refereed\n");
        _exit(SKIPPED);
    }
    return WEXITSTATUS(status);
}

static void says(const struct gsn_scratch *scratch, const char *words)
{
    gsn_auto_mem(uint8_t) text = NULL;
    struct gsn_error err = { 0 };
    size_t size;

    CHECK_OK(gsn_file_read(gsn_scratch_path(scratch, "said"), 1 << 20, &text, &size, &err), err);
    if (!strstr((const char *)text, words))
        fail_msg("gphoto2 did not say \"%s\" but:\n%s", words, (const char *)text);
}

static void is_equal(const struct gsn_scratch *scratch, const char *name, const uint8_t *bytes,
                     size_t size)
{
    gsn_auto_mem(uint8_t) copy = NULL;
    struct gsn_error err = { 0 };
    size_t got;

    CHECK_OK(gsn_file_read(gsn_scratch_path(scratch, name), LARGEST, &copy, &got, &err), err);
    CHECK(got == size && memcmp(copy, bytes, size) == 0);
}

TEST(gphoto2_lists_and_pulls_byte_equal)
{
    /* One that fills its packet with the header; one that fills two; one that is long. */
    static const size_t size[KEPT] = { 512 - 12, 1024 - 12, LARGEST };
    static const char *const name[KEPT] = { "one.tif", "two.tif", "long.tif" };
    scratch_auto scratch = gsn_scratch_new();
    struct umock *const umock = umock_new();
    struct ptp_model *const model = ptp_model_new("SN0001", NULL);
    uint8_t *const bytes = malloc(LARGEST + KEPT);

    for (size_t i = 0; i < LARGEST + KEPT; i++)
        bytes[i] = (uint8_t)(i * 13 + i / 509);
    for (size_t i = 0; i < KEPT; i++)
        (void)ptp_model_add(model,
                            &(struct ptp_object){ .name = name[i],
                                                  .date = "20260101T120000",
                                                  .format = PTP_TIFF,
                                                  .size = size[i],
                                                  .bytes = bytes + i },
                            0);
    umock_plug(umock, ptp_model_usb(model), NUMBER);

    CHECK(gphoto2(&scratch, "--auto-detect", NULL) == 0);
    says(&scratch, "USB PTP Class Camera");
    CHECK(gphoto2(&scratch, "--list-files", NULL) == 0);
    for (size_t i = 0; i < KEPT; i++)
        says(&scratch, name[i]);
    CHECK(gphoto2(&scratch, "--get-all-files", NULL) == 0);
    for (size_t i = 0; i < KEPT; i++)
        is_equal(&scratch, name[i], bytes + i, size[i]);
    umock_free(umock);
    ptp_model_free(model);
    free(bytes);
}
