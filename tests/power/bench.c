/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/power/bench.h"

#include <errno.h>
#include <ftw.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"

void power_give_up(const char *what)
{
    fprintf(stderr, "%s: %s\n", what, strerror(errno));
    exit(70);
}

static int remove_one(const char *path, const struct stat *st, int what, struct FTW *walk)
{
    (void)st;
    (void)what;
    (void)walk;
    return remove(path);
}

void power_remove_tree(const char *path)
{
    if (nftw(path, remove_one, 32, FTW_DEPTH | FTW_PHYS) < 0 && errno != ENOENT)
        power_give_up(path);
}

static uint32_t next_random(uint32_t *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return *seed >> 8;
}

/* A JPEG of comments: whole, and of any length. */
static void write_picture(const char *folder, unsigned number, size_t size)
{
    gsn_auto_mem(uint8_t) bytes = gsn_alloc(size + 70000);
    gsn_auto_mem(char) path = gsn_format("%s/S1-P%02u.jpg", folder, number);
    struct gsn_error err = { 0 };
    uint32_t seed = number;
    size_t at = 2;

    if (!bytes || !path)
        power_give_up("memory");
    memcpy(bytes, "\xff\xd8", 2);
    while (at < size) {
        const size_t length = size - at < 60000 ? size - at + 2 : 60000;

        memcpy(bytes + at, "\xff\xfe", 2);
        bytes[at + 2] = (uint8_t)(length >> 8);
        bytes[at + 3] = (uint8_t)length;
        for (size_t i = 4; i < length + 2; i++)
            bytes[at + i] = (uint8_t)next_random(&seed);
        at += length + 2;
    }
    memcpy(bytes + at, "\xff\xd9", 2);
    if (gsn_file_write(path, bytes, at + 2, &err) < 0)
        power_give_up(err.text);
}

struct power_bench power_bench_new(unsigned pictures)
{
    const char *const tmp = getenv("TMPDIR");
    struct power_bench bench;

    (void)snprintf(bench.dir, sizeof bench.dir, "%.150s/gieson-power-XXXXXX",
                   access("/dev/shm", W_OK) == 0 ? "/dev/shm" : (tmp ? tmp : "/tmp"));
    if (!mkdtemp(bench.dir))
        power_give_up(bench.dir);
    (void)snprintf(bench.root, sizeof bench.root, "%s/root", bench.dir);
    (void)snprintf(bench.store, sizeof bench.store, "%s/store", bench.root);
    (void)snprintf(bench.folder, sizeof bench.folder, "%s/folder", bench.dir);
    (void)snprintf(bench.address, sizeof bench.address, "replay:%s", bench.folder);
    if (mkdir(bench.root, 0755) < 0 || mkdir(bench.folder, 0755) < 0)
        power_give_up(bench.dir);
    for (unsigned i = 1; i <= pictures; i++)
        write_picture(bench.folder, i, i % 8 == 5 ? 600000 : 300 + 777 * i);
    return bench;
}

void power_bench_done(const struct power_bench *bench)
{
    power_remove_tree(bench->dir);
}
