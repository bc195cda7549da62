/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/service/log.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "tests/check.h"

/* What stands on stderr after this name was logged. */
static void log_name(const char *name, char *said, size_t size)
{
    FILE *const file = tmpfile();
    const int was = dup(2);
    size_t got;

    (void)unsetenv("JOURNAL_STREAM");
    CHECK(file && was >= 0 && dup2(fileno(file), 2) == 2);
    gsn_log(LOG_INFO, NULL, "%s is here", name);
    (void)fflush(stderr);
    (void)dup2(was, 2);
    (void)close(was);
    rewind(file);
    got = fread(said, 1, size - 1, file);
    said[got] = '\0';
    (void)fclose(file);
}

TEST(a_name_is_shown_and_not_obeyed)
{
    char said[200];

    log_name("a\033]0;title\007 \r \n <0>b\177 \xc2\x9b"
             "2J",
             said, sizeof said);
    CHECK(strcmp(said, "a?]0;title? ? ? <0>b? ?"
                       "?2J is here\n") == 0);
}

TEST(what_people_write_stays_as_it_is)
{
    char said[200];

    log_name("M\xc3\xbcller \xe2\x80\x93 \xc2\xb5m.tif", said, sizeof said);
    CHECK(strcmp(said, "M\xc3\xbcller \xe2\x80\x93 \xc2\xb5m.tif is here\n") == 0);
}
