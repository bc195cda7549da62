/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/status_text.h"

#include <stdio.h>
#include <string.h>

#include "storage/bench.h"
#include "storage/queue.h"

struct line {
    size_t length, size;
    char *text;
};

/* "3 jobs waiting", then ", 1 running": the thing is named once. */
static void add(struct line *line, const char *thing, size_t count, const char *what, int *is_named)
{
    int put;

    if (count == 0)
        return;
    if (*is_named)
        put =
            snprintf(line->text + line->length, line->size - line->length, ", %zu %s", count, what);
    else
        put = snprintf(line->text + line->length, line->size - line->length, "%s%zu %s%s %s",
                       line->length ? "; " : "", count, thing, count == 1 ? "" : "s", what);
    *is_named = 1;
    if (put > 0 && (size_t)put < line->size - line->length)
        line->length += (size_t)put;
}

static int add_sources(struct gsn_store *store, struct line *line, struct gsn_error *err)
{
    static const char *const states[] = { "ready", "receiving", "paused", "away", "failed" };
    gsn_auto(gsn_bench_sources) rows = NULL;
    int r = gsn_bench_list(store, &rows, err), is_named = 0;

    for (size_t s = 0; r >= 0 && s < sizeof states / sizeof states[0]; s++) {
        size_t count = 0;

        for (size_t i = 0; i < rows->count; i++)
            count += strcmp(rows->at[i].state, states[s]) == 0;
        add(line, "source", count, states[s], &is_named);
    }
    if (r >= 0 && !is_named)
        line->length = (size_t)snprintf(line->text, line->size, "no sources");
    return r;
}

static int add_jobs(struct gsn_store *store, struct line *line, struct gsn_error *err)
{
    struct gsn_job_counts counts = { 0 };
    const int r = gsn_queue_counts(store, &counts, err);
    int is_named = 0;

    if (r < 0)
        return r;
    add(line, "job", (size_t)counts.waiting, "waiting", &is_named);
    add(line, "job", (size_t)counts.running, "running", &is_named);
    add(line, "job", (size_t)counts.failed, "failed", &is_named);
    if (!is_named)
        (void)snprintf(line->text + line->length, line->size - line->length, "%sno jobs waiting",
                       line->length ? "; " : "");
    return GSN_OK;
}

int gsn_status_text(struct gsn_store *store, unsigned parts, char *ret_text, size_t size,
                    struct gsn_error *err)
{
    char text[256] = "";
    struct line line = { .size = sizeof text, .text = text };
    int r = GSN_OK;

    if (parts & GSN_STATUS_INTAKE)
        r = add_sources(store, &line, err);
    if (r >= 0 && (parts & GSN_STATUS_QUEUE))
        r = add_jobs(store, &line, err);
    if (r >= 0)
        (void)snprintf(ret_text, size, "%s", text);
    return r;
}
