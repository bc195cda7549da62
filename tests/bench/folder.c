/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/bench/folder.h"

#include <ftw.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

void need(int holds, const char *what)
{
    if (!holds) {
        perror(what);
        exit(gsn_code_exit(GSN_E_IO));
    }
}

static int remove_one(const char *path, const struct stat *st, int what, struct FTW *walk)
{
    (void)st;
    (void)what;
    (void)walk;
    return remove(path);
}

struct folder folder_new(void)
{
    struct folder folder = { "gieson-bench-XXXXXX" };

    need(mkdtemp(folder.path) != NULL, folder.path);
    return folder;
}

void folder_done(struct folder *folder)
{
    need(nftw(folder->path, remove_one, 32, FTW_DEPTH | FTW_PHYS) == 0, folder->path);
}

double seconds(clockid_t clock)
{
    struct timespec now;

    need(clock_gettime(clock, &now) == 0, "clock");
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

double mean(const double *at, size_t count)
{
    double sum = 0;

    for (size_t i = 0; i < count; i++)
        sum += at[i];
    return sum / (double)count;
}

double median(double *at, size_t count)
{
    qsort(at, count, sizeof *at, by_value);
    return at[count / 2];
}
