/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What it costs to log the slices that were found on a panel: ours are the rows of twelve sections
 * and of their 36 marks with covariances, in place of what was known of the panel before, in one
 * commit. */
#include "tests/bench/folder.h"
#include "tests/bench/log_peer.h"

#include <math.h>
#include <stdio.h>

#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/store.h"

enum { WARM = 400, PANELS = 400, QUICK = 4, ON_A_PANEL = 12, BY_SPECIMEN = 20 };
enum { OURS, PANEL, SLICE, LOGS };

struct slices {
    struct gsn_store *store;
    struct log_peer panel, slice; /* twelve rows a commit, and one */
    int64_t specimen;
    size_t warm, count;
    double wall[LOGS][PANELS], cpu[LOGS];
};

static int64_t put_panel(struct slices *slices, size_t number)
{
    struct gsn_specimen_row specimen = { .study = "study",
                                         .group = "group",
                                         .animal = "animal",
                                         .week = 1,
                                         .kind = "sections",
                                         .baseline = "",
                                         .job_json = "{}",
                                         .job_sha256 = "" };
    struct gsn_panel_row panel = { .number = (int64_t)(number % BY_SPECIMEN + 1),
                                   .file_name = "P.jpg",
                                   .size = 12345678,
                                   .state = "waiting",
                                   .code = "",
                                   .message = "",
                                   .px_um = NAN };
    char name[20], digest[65];
    struct gsn_error err = { 0 };
    int64_t id = 0;
    int again = 0;

    (void)snprintf(name, sizeof name, "S%zu", number / BY_SPECIMEN + 1);
    (void)snprintf(digest, sizeof digest, "%064zx", number);
    specimen.name = name;
    panel.sha256 = digest;
    if (number % BY_SPECIMEN == 0)
        bench_need(gsn_specimen_put(slices->store, &specimen, GSN_SPECIMEN_REFUSE, "bench", 1,
                                    &slices->specimen, &err),
                   &err, "specimen");
    panel.specimen_id = slices->specimen;
    bench_need(gsn_panel_put(slices->store, &panel, &id, &again, &err), &err, "panel");
    return id;
}

static struct gsn_section_row section(size_t number, size_t slot)
{
    const double at = (double)(number * ON_A_PANEL + slot);
    struct gsn_section_row row = { .slot = (int64_t)slot + 1,
                                   .serial =
                                       (int64_t)(number % BY_SPECIMEN * ON_A_PANEL + slot + 1),
                                   .state = "found",
                                   .flags = "",
                                   .bbox_x = at,
                                   .bbox_y = at,
                                   .bbox_w = 800,
                                   .bbox_h = 700,
                                   .area_px = 400000 + at };

    for (size_t m = 0; m < GSN_ROW_MARKS; m++)
        row.marker[m] = (struct gsn_fiducial_row){ .found = 1,
                                                   .x_px = at * .25 + (double)m,
                                                   .y_px = at * .125,
                                                   .radius_px = 9.5,
                                                   .cov_xx = .01,
                                                   .cov_xy = .001,
                                                   .cov_yy = .02,
                                                   .score = .9 };
    return row;
}

static void log_ours(struct slices *slices, int64_t panel, size_t number)
{
    struct gsn_section_row rows[ON_A_PANEL];
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < ON_A_PANEL; i++)
        rows[i] = section(number, i);
    bench_need(gsn_section_replace(slices->store, panel, rows, ON_A_PANEL, &err), &err, "sections");
}

static void time_log(struct slices *slices, int which, int64_t panel, size_t number)
{
    const double cpu = seconds(CLOCK_PROCESS_CPUTIME_ID), start = seconds(CLOCK_MONOTONIC);

    if (which == OURS)
        log_ours(slices, panel, number);
    else if (which == PANEL)
        log_peer_slices(&slices->panel, number * ON_A_PANEL, ON_A_PANEL);
    else
        for (size_t i = 0; i < ON_A_PANEL; i++)
            log_peer_slices(&slices->slice, number * ON_A_PANEL + i, 1);
    if (number < slices->warm)
        return;
    slices->wall[which][number - slices->warm] = seconds(CLOCK_MONOTONIC) - start;
    slices->cpu[which] += seconds(CLOCK_PROCESS_CPUTIME_ID) - cpu;
}

static void say(struct slices *slices, int against, const char *name)
{
    const double ours = mean(slices->wall[OURS], slices->count);
    const double peer = mean(slices->wall[against], slices->count);
    const double ms = 1e3 / ON_A_PANEL;

    bench_say("slice_log", ours * ms, "ms/slice", name, peer / ours,
              json_pack("{s:f, s:f, s:f, s:f, s:I}", "ratio_of_medians",
                        median(slices->wall[against], slices->count) /
                            median(slices->wall[OURS], slices->count),
                        "peer_ms", peer * ms, "cpu_ms",
                        slices->cpu[OURS] * ms / (double)slices->count, "peer_cpu_ms",
                        slices->cpu[against] * ms / (double)slices->count, "slices",
                        (json_int_t)(slices->count * ON_A_PANEL)));
}

void bench_log_slices(void)
{
    struct folder folder = folder_new();
    struct slices *const slices = bench_alloc(1, sizeof *slices);
    struct gsn_error err = { 0 };
    char dir[100];

    (void)snprintf(dir, sizeof dir, "%s/store", folder.path);
    bench_need(gsn_store_open(dir, GSN_STORE_CREATE, &slices->store, &err), &err, "store");
    slices->panel = log_peer_open(folder.path, "panel.db");
    slices->slice = log_peer_open(folder.path, "slice.db");
    slices->warm = bench_quick ? QUICK : WARM;
    slices->count = bench_quick ? QUICK : PANELS;
    for (size_t i = 0; i < slices->warm + slices->count; i++) {
        const int64_t panel = put_panel(slices, i);

        /* In turns, so that all meet the same disk. */
        for (size_t turn = 0; turn < LOGS; turn++)
            time_log(slices, (int)((i + turn) % LOGS), panel, i);
    }
    say(slices, SLICE, "one INSERT of a slice's row a commit");
    say(slices, PANEL, "12 INSERTs of a slice's row a commit");
    log_peer_close(&slices->panel);
    log_peer_close(&slices->slice);
    gsn_store_free(slices->store);
    gsn_free(slices);
    folder_done(&folder);
}
