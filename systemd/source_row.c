/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/source_row.h"

#include <stdio.h>
#include <string.h>
#include <time.h>

#include "storage/bench.h"
#include "systemd/lifeline.h"

enum { EVERY_MS = 500, SHORT_COPY_MS = 300 };

static void put(struct gsn_source_row *row, const struct gsn_bench_source *source)
{
    struct gsn_error quiet = { 0 };

    row->written_ms = gsn_now_ms();
    if (gsn_bench_put(row->store, source, time(NULL), &quiet) < 0)
        return;
    (void)snprintf(row->state, sizeof row->state, "%s", source->state);
    (void)snprintf(row->message, sizeof row->message, "%s", source->message);
}

void gsn_source_row_say(struct gsn_source_row *row, const char *state, const char *message)
{
    const struct gsn_bench_source source = { .name = row->name,
                                             .address = row->address,
                                             .device = row->device,
                                             .state = state,
                                             .message = message,
                                             .item = "" };

    if (strcmp(row->state, state) == 0 && strcmp(row->message, message) == 0)
        return;
    put(row, &source);
}

void gsn_source_row_progress(struct gsn_source_row *row, const char *item, int64_t began_ms,
                             uint64_t done, uint64_t total)
{
    const struct gsn_bench_source source = { .name = row->name,
                                             .address = row->address,
                                             .device = row->device,
                                             .state = "receiving",
                                             .message = "",
                                             .item = item,
                                             .done = (int64_t)done,
                                             .total = (int64_t)total };
    const int64_t now = gsn_now_ms();

    if (now - began_ms >= SHORT_COPY_MS && now - row->written_ms >= EVERY_MS)
        put(row, &source);
}
