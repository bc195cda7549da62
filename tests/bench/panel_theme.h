/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the themes on a panel share: the panel as a file, and the peer, opencv_probe.py, that is
 * asked to do the same with it. Everything is one thread's CPU time. */
#ifndef GSN_TESTS_BENCH_PANEL_THEME_H
#define GSN_TESTS_BENCH_PANEL_THEME_H

#include "tests/bench/panel.h"
#include "tests/bench/peer.h"

#include <jansson.h>
#include <stddef.h>

struct bench_theme {
    struct bench_panel panel;
    struct bench_peer peer;
    int has_peer;
    char folder[64], path[96];
};

/* Draws the panel and starts the peer. Returns 0, and says that the measure is skipped, where there
 * is no room for the file. */
int bench_theme_begin(struct bench_theme *theme, const char *measure, const char *unit);
void bench_theme_end(struct bench_theme *theme);
/* Writes the panel to path, for the orders that follow. */
void bench_theme_write(struct bench_theme *theme, enum bench_format format);
/* The peer's seconds for an order, or NAN where it is not there; number as in peer.h. */
double bench_theme_ask(struct bench_theme *theme, const char *verb, double *ret_number);
/* bench_say, and that the comparison is skipped where the peer is not there. takes: details. */
void bench_theme_say(struct bench_theme *theme, const char *measure, double value, const char *unit,
                     const char *against, double ratio, json_t *details);

/* The bytes of a file, as they lie in the page cache. */
struct bench_file {
    void *at;
    size_t size;
};
struct bench_file bench_file_map(const char *path);

#endif
