/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Any bytes as a picture's container: judged within their bounds, with a reason exactly when they
 * are not whole, and alike in memory and through a descriptor, whose window moves. */
#include "acquire/container.h"

#include <string.h>
#include <unistd.h>

#include "tests/fuzz/hold.h"
#include "tests/memory_file.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    const struct gsn_container got = gsn_container_check(bytes, size);
    struct gsn_container again = { .complete = 7 };
    struct gsn_error err = { 0 };
    int fd = -1;

    HOLD(!got.complete == (got.reason[0] != '\0'));
    HOLD(memchr(got.reason, '\0', sizeof got.reason));
    HOLD(got.kind <= GSN_CONTAINER_PAM);
    if (gsn_memory_file(bytes, size, &fd, &err) < 0)
        return 0;
    HOLD(gsn_container_check_fd(fd, &again, &err) == GSN_OK);
    HOLD(again.kind == got.kind && again.complete == got.complete &&
         strcmp(again.reason, got.reason) == 0);
    (void)close(fd);
    return 0;
}
