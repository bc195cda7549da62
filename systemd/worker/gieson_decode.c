/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* gieson-decode: picture files, decoded where they can do no harm. Its stdin is a socket of
 * gieson-work, over which it gets shared memory and then one file after the other
 * (pipeline/decode/apart_page.h); its answers go into that memory.
 *
 * Exit status: 0 there was nothing more to decode; 1 it was asked wrongly; 2 there is no sandbox.
 * Anything but 0 comes with one line on stderr. */
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/sandbox.h"
#include "pipeline/decode/apart_page.h"

enum { EXIT_ANSWERED, EXIT_QUESTION, EXIT_SANDBOX };

static int print_failure(const struct gsn_error *err, int status)
{
    (void)fprintf(stderr, "%s\n", err->text);
    return status;
}

static int answer_next(struct gsn_decode_page *page, int fd, struct gsn_error *err)
{
    const uint8_t *file = gsn_decode_page_file(page, fd);

    (void)close(fd);
    if (!file)
        return gsn_fail(err, GSN_E_IO, "the file cannot be mapped: %s", strerror(errno));
    gsn_decode_page_answer(page, file);
    if (page->file_size > 0)
        (void)munmap((void *)(uintptr_t)file, page->file_size);
    return write(0, "", 1) == 1 ? GSN_OK : gsn_fail(err, GSN_E_IO, "nobody hears the answer");
}

static int answer_files(void)
{
    struct gsn_decode_page *page;
    struct gsn_error err = { 0 };
    int fd = gsn_decode_receive(0);

    if (fd < 0) {
        (void)gsn_fail(&err, GSN_E_INPUT, "this program is asked by gieson-work, not by people");
        return print_failure(&err, EXIT_QUESTION);
    }
    if (gsn_decode_page_map(fd, &page, &err) < 0)
        return print_failure(&err, EXIT_QUESTION);
    (void)close(fd);
    tzset(); /* a profile is dated, and the C library would look for the time zone behind the door
              */
    if (gsn_sandbox_enter(2, 1, &err) < 0)
        return print_failure(&err, EXIT_SANDBOX);
    while ((fd = gsn_decode_receive(0)) >= 0)
        if (answer_next(page, fd, &err) < 0)
            return print_failure(&err, EXIT_QUESTION);
    return EXIT_ANSWERED;
}

int main(void)
{
    _exit(answer_files());
}
