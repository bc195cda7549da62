/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/bench/panel_theme.h"

#include "pipeline/core/file.h"

#include "tests/bench/bench.h"

#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

int bench_theme_begin(struct bench_theme *theme, const char *measure, const char *unit)
{
    char side[16];
    char *argv[] = { (char[]){ GSN_DEBIAN_PYTHON }, (char[]){ GSN_BENCH_OPENCV }, side, NULL };

    *theme = (struct bench_theme){ .folder = "/tmp/gieson-bench.XXXXXX" };
    if (!mkdtemp(theme->folder)) {
        bench_skip(measure, unit, NULL, "no folder could be made in /tmp");
        return 0;
    }
    theme->panel = bench_panel_draw();
    (void)snprintf(side, sizeof side, "%u", theme->panel.side);
    theme->has_peer = bench_peer_start(&theme->peer, argv);
    return 1;
}

void bench_theme_end(struct bench_theme *theme)
{
    bench_peer_end(&theme->peer);
    bench_panel_done(&theme->panel);
    (void)unlink(theme->path);
    (void)rmdir(theme->folder);
}

void bench_theme_write(struct bench_theme *theme, enum bench_format format)
{
    const char *suffix = format == BENCH_JPEG ? "jpg" : format == BENCH_PNG ? "png" : "tif";

    (void)snprintf(theme->path, sizeof theme->path, "%s/panel.%s", theme->folder, suffix);
    if (!bench_format_write(format, theme->panel.image, theme->path)) {
        fprintf(stderr, "gieson-bench: %s cannot be written\n", theme->path);
        exit(gsn_code_exit(GSN_E_IO));
    }
}

double bench_theme_ask(struct bench_theme *theme, const char *verb, double *ret_number)
{
    char order[128];
    double seconds;

    (void)snprintf(order, sizeof order, "%s %s", verb, theme->path);
    seconds = theme->has_peer ? bench_peer_ask(&theme->peer, order, ret_number) : -1;
    theme->has_peer = seconds >= 0;
    return seconds >= 0 ? seconds : NAN;
}

void bench_theme_say(struct bench_theme *theme, const char *measure, double value, const char *unit,
                     const char *against, double ratio, json_t *details)
{
    if (theme->has_peer) {
        bench_say(measure, value, unit, against, ratio, details);
        return;
    }
    (void)json_object_set_new(
        details, "skipped", json_string("python3-opencv is not installed for " GSN_DEBIAN_PYTHON));
    bench_say(measure, value, unit, against, NAN, details);
}

struct bench_file bench_file_map(const char *path)
{
    struct bench_file file = { .at = MAP_FAILED };
    struct gsn_error err = { 0 };
    struct stat status = { .st_size = 0 };
    int fd;

    bench_need(gsn_file_open(path, &fd, &err), &err, "panel");
    if (fstat(fd, &status) == 0) {
        file.size = (size_t)status.st_size;
        file.at = mmap(NULL, file.size, PROT_READ, MAP_PRIVATE, fd, 0);
    }
    (void)close(fd);
    if (file.at == MAP_FAILED) {
        fprintf(stderr, "gieson-bench: %s cannot be mapped\n", path);
        exit(gsn_code_exit(GSN_E_IO));
    }
    return file;
}
