/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* gieson-decode: one picture file, decoded where it can do no harm. Its stdin is memory shared with
 * gieson-work (pipeline/decode/apart_page.h), its answer goes there too.
 *
 * Exit status: 0 answered, a refusal included; 1 it was asked wrongly; 2 there is no sandbox.
 * Anything but 0 comes with one line on stderr. */
#include "pipeline/core/sandbox.h"
#include "pipeline/decode/apart_page.h"

#include <stdio.h>
#include <time.h>
#include <unistd.h>

enum { EXIT_ANSWERED, EXIT_QUESTION, EXIT_SANDBOX };

static int complain(const struct gsn_error *err, int status)
{
    (void)fprintf(stderr, "%s\n", err->text);
    return status;
}

static int work(void)
{
    struct gsn_decode_page *page;
    struct gsn_error err = { 0 };

    if (gsn_decode_page_map(0, &page, &err) < 0)
        return complain(&err, EXIT_QUESTION);
    tzset(); /* a profile is dated, and the C library would look for the time zone behind the door
              */
    if (gsn_sandbox_enter(2, &err) < 0)
        return complain(&err, EXIT_SANDBOX);
    gsn_decode_page_answer(page);
    return EXIT_ANSWERED;
}

int main(void)
{
    _exit(work());
}
