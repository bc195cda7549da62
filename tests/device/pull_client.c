/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Takes from a device what a source finds, for tests where no bench is at hand:
 *
 *     pull_client ADDRESS DIRECTORY COUNT SECONDS
 *
 * Writes each item into DIRECTORY under its name, until there are COUNT of them (exit 0) or SECONDS
 * have passed (exit 1). A device that goes is waited for. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "pipeline/core/file.h"
#include "tests/device/pull.h"

enum { LOOK_MS = 500, AWAY_MS = 300 };

static int64_t now_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static int save(const struct pull *pull, size_t from, const char *directory, struct gsn_error *err)
{
    char path[500];
    int r = GSN_OK;

    for (size_t i = from; r >= 0 && i < pull->count; i++) {
        (void)snprintf(path, sizeof path, "%.300s/%s", directory, pull->at[i].name);
        r = gsn_file_write(path, pull->at[i].bytes, pull->at[i].size, err);
        (void)printf("%s, %zu bytes\n", pull->at[i].name, pull->at[i].size);
    }
    return r;
}

/* Looks once, opening the source where that has to be done; what went wrong is printed. */
static void turn(const char *address, const char *directory, struct gsn_source **source,
                 struct pull *pull)
{
    static const struct gsn_source_options options = { .settle_ms = LOOK_MS };
    const size_t before = pull->count;
    struct gsn_error err = { 0 };
    int r = *source ? GSN_OK : gsn_source_open(address, &options, source, &err);

    if (r >= 0) {
        pull->now_ms = now_ms() - 1000; /* a look moves it on by a second */
        r = pull_look(pull, *source, &err);
    }
    if (r < 0)
        (void)printf("%s: %s\n", gsn_code_name(r), err.text);
    if (save(pull, before, directory, &err) < 0)
        (void)printf("%s\n", err.text);
    if (r >= 0)
        r = gsn_source_wait(*source, LOOK_MS, -1, &err);
    if (r < 0) {
        const struct timespec while_away = { .tv_nsec = AWAY_MS * 1000000L };

        (void)nanosleep(&while_away, NULL);
    }
    (void)fflush(stdout);
}

int main(int argc, char **argv)
{
    struct gsn_source *source = NULL;
    struct pull pull = { 0 };
    size_t count;
    int64_t end;

    if (argc != 5)
        return 64;
    count = strtoul(argv[3], NULL, 10);
    end = now_ms() + strtol(argv[4], NULL, 10) * 1000;
    while (pull.count < count && now_ms() < end)
        turn(argv[1], argv[2], &source, &pull);
    gsn_source_free(source);
    count -= pull.count < count ? pull.count : count;
    pull_free(&pull);
    return count > 0;
}
