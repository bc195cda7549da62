/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/lease.h"

#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"

/* A file of /proc, which has no size of its own, cut at size - 1 bytes; empty when unreadable. */
static void read_proc(const char *path, char *text, size_t size)
{
    ssize_t got = 0;
    int fd;

    if (gsn_file_open(path, &fd, NULL) >= 0) {
        got = read(fd, text, size - 1);
        (void)close(fd);
    }
    text[got > 0 ? got : 0] = '\0';
}

struct gsn_lease_home gsn_lease_home(void)
{
    struct gsn_lease_home home = { "", "" };
    const ssize_t length = readlink("/proc/self/ns/pid", home.processes, sizeof home.processes - 1);

    read_proc("/proc/sys/kernel/random/boot_id", home.boot, sizeof home.boot);
    home.boot[strcspn(home.boot, "\n")] = '\0';
    if (length <= 0)
        home.boot[0] = '\0';
    return home;
}

static int64_t parse_digits(const char *text)
{
    int64_t value = 0;

    for (; *text >= '0' && *text <= '9' && value < INT64_MAX / 10 - 1; text++)
        value = 10 * value + (*text - '0');
    return value;
}

/* proc(5): "pid (name) state ppid ...", the start time being field 22. The name may hold anything,
 * blanks and brackets too, so counting starts behind the last bracket. */
static int64_t parse_start(const char *stat)
{
    enum { STATE = 3, START = 22 };
    const char *at = strrchr(stat, ')');

    if (!at || at[1] != ' ' || at[2] == 'Z' || at[2] == 'X')
        return 0;
    for (int field = STATE - 1; at && field < START; field++)
        at = strchr(at + 1, ' ');
    return at ? parse_digits(at + 1) : 0;
}

int64_t gsn_lease_start(int64_t pid)
{
    char path[64], stat[1024];

    (void)snprintf(path, sizeof path, "/proc/%lld/stat", (long long)pid);
    read_proc(path, stat, sizeof stat);
    return parse_start(stat);
}

bool gsn_lease_is_of_other_start(const struct gsn_lease_home *here, const char *boot)
{
    return *here->boot && *boot && strcmp(here->boot, boot) != 0;
}

bool gsn_lease_is_dead(const struct gsn_lease_home *here, const char *boot, const char *processes,
                       int64_t pid, int64_t start)
{
    if (gsn_lease_is_of_other_start(here, boot))
        return true;
    if (!*here->boot || !*boot)
        return false;
    if (start == 0 || strcmp(here->processes, processes) != 0)
        return false;
    return gsn_lease_start(pid) != start;
}
