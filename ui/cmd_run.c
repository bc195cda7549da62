/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verbs that have waiting work done: run, retry.
 *
 * `run` starts gieson-work until the queue is empty and draws one line of progress from the rows.
 */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sysexits.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/process.h"
#include "storage/audit.h"
#include "storage/catalog.h"
#include "storage/queue.h"
#include "storage/result.h"
#include "ui/snapshot.h"
#include "ui/text.h"
#include "ui/ui.h"

enum {
    LOOK_EVERY_MS = 100,
    LONGEST_PAUSE_MS = 1600, /* between two looks for a job while others are at what is left */
    MOST_THREADS = 64,
    FRUITLESS_STARTS = 8, /* workers that ended without touching the queue: something is broken */
};

/* run, retry */

/* "decoding 3/5, 12 s left" */
static char *how_far(const struct gsn_job_row *job)
{
    const char *unit = job->eta_s < 90 ? "s" : "min";
    const double left = job->eta_s < 90 ? job->eta_s : job->eta_s / 60;

    if (!job->stage[0])
        return gsn_strdup("starting");
    if (isnan(left))
        return gsn_format("%s %lld/%lld", job->stage, (long long)job->done, (long long)job->total);
    return gsn_format("%s %lld/%lld, %.0f %s left", job->stage, (long long)job->done,
                      (long long)job->total, left, unit);
}

/* The line within so many columns. Of a panel's job the specimen's name goes first, then the end of
 * the panel's; how far it is stays readable. gives. */
static char *progress_line(const struct gsn_job_row *job, size_t finished, size_t count,
                           int columns)
{
    gsn_auto_mem(char) far = how_far(job);
    gsn_auto_mem(char) head = gsn_format("[%zu/%zu] ", finished, count);
    gsn_auto_mem(char) who =
        gsn_format("%s%s%s", job->specimen, job->panel[0] ? " " : "", job->panel);
    gsn_auto_mem(char) line = NULL;
    int room;

    if (!far || !head || !who)
        return NULL;
    room = columns - gsn_text_columns(head) - gsn_text_columns(far) - 2;
    if (gsn_text_columns(who) > room) {
        const char *one = job->panel[0] ? job->panel : job->specimen;
        const int length = gsn_text_columns(one);

        gsn_free(who);
        who = room > 0 ? gsn_text_cell(one, length < room ? length : room) : gsn_strdup("");
        if (!who)
            return NULL;
    }
    line = gsn_format("%s%s%s%s", head, who, who[0] ? ": " : "", far);
    return line ? gsn_text_cell(line, columns) : NULL;
}

/* One line that is written over; the rows are what others read. The cursor stays at its start, so
 * that what a worker has to say is not appended to it. */
static void draw_progress(const struct gsn_ui *ui, struct gsn_store *store)
{
    gsn_auto(gsn_job_rows) jobs = NULL;
    struct gsn_error quiet = { 0 };
    size_t finished = 0;

    if (!ui->err_tty || gsn_queue_list(store, &jobs, &quiet) < 0)
        return;
    for (size_t i = 0; i < jobs->count; i++)
        finished += strcmp(jobs->at[i].state, "done") == 0;
    for (size_t i = 0; i < jobs->count; i++) {
        gsn_auto_mem(char) line = NULL;

        if (strcmp(jobs->at[i].state, "running") != 0)
            continue;
        line =
            progress_line(&jobs->at[i], finished, jobs->count, gsn_ui_columns(STDERR_FILENO) - 1);
        if (line)
            (void)fprintf(stderr, "\r%s\r", line);
        (void)fflush(stderr);
        return;
    }
}

static void wipe_line(const struct gsn_ui *ui)
{
    if (ui->err_tty)
        (void)fputs("\r\033[K", stderr);
}

static int wait_and_draw(const struct gsn_ui *ui, struct gsn_store *store, pid_t child)
{
    for (;;) {
        const int status = gsn_process_wait(child, 0);

        if (status >= 0)
            return status;
        draw_progress(ui, store);
        gsn_ui_pause_ms(LOOK_EVERY_MS);
    }
}

static int64_t count_attempts(struct gsn_store *store)
{
    gsn_auto(gsn_job_rows) jobs = NULL;
    struct gsn_error quiet = { 0 };
    int64_t sum = 0;

    if (gsn_queue_list(store, &jobs, &quiet) < 0)
        return 0;
    for (size_t i = 0; i < jobs->count; i++)
        sum += jobs->at[i].claim;
    return sum;
}

/* Whether what is left runs already, at other workers. */
static int is_all_taken(struct gsn_store *store)
{
    struct gsn_job_counts counts = { 0 };
    struct gsn_error quiet = { 0 };

    return gsn_queue_counts(store, &counts, &quiet) >= 0 && counts.waiting == 0;
}

int gsn_ui_work_queue(const struct gsn_ui *ui, struct gsn_store *store, const char *const args[],
                      int shared)
{
    int fruitless = 0;
    long pause_ms = LOOK_EVERY_MS;

    while (fruitless < FRUITLESS_STARTS) {
        const int64_t before = count_attempts(store);
        const pid_t child = gsn_ui_start(ui, "gieson-work", 1, args);
        int status;

        if (child < 0)
            return EX_OSERR;
        status = wait_and_draw(ui, store, child);
        wipe_line(ui);
        if (status == EX_NOINPUT || (shared && status == EX_TEMPFAIL && is_all_taken(store)))
            return EX_OK;
        if (status == EX_TEMPFAIL) {
            gsn_ui_pause_ms(pause_ms); /* another worker has it */
            pause_ms = pause_ms < LONGEST_PAUSE_MS ? 2 * pause_ms : pause_ms;
            continue;
        }
        pause_ms = LOOK_EVERY_MS;
        if (count_attempts(store) != before)
            fruitless = 0;
        else if (status == EX_USAGE || status == EX_IOERR || status == EX_NOPERM)
            return status; /* it has said why, and would say it again */
        else
            fruitless++;
    }
    return gsn_ui_fail(ui, EX_UNAVAILABLE,
                       "workers end without taking a job: look at the lines above");
}

void gsn_ui_print_end(const struct gsn_ui *ui, const struct gsn_snapshot_row *row)
{
    gsn_auto_mem(char) loss = gsn_look_loss(row->loss_percent, row->loss_lower, row->loss_upper);
    gsn_auto_mem(char) line =
        gsn_format("%s: %s%s%s%s%s", row->name, row->state, loss && loss[0] ? ", loss " : "",
                   loss ? loss : "", row->detail ? ": " : "", row->detail ? row->detail : "");

    gsn_ui_wrap(ui, 0, line ? line : row->name);
}

static int report_end(const struct gsn_ui *ui, struct gsn_store *store)
{
    gsn_auto(gsn_snapshot) snapshot = NULL;
    struct gsn_error err = { 0 };
    const int r = gsn_snapshot_take(store, &snapshot, &err);
    size_t failed = 0, withheld = 0;

    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    for (size_t i = 0; i < snapshot->count; i++) {
        const struct gsn_snapshot_row *row = &snapshot->at[i];

        failed += strcmp(row->state, "failed") == 0;
        withheld += strcmp(row->state, "withheld") == 0;
        if (ui->json)
            continue;
        gsn_ui_print_end(ui, row);
    }
    if (ui->json)
        gsn_ui_print_json(
            ui, json_pack("{s:I, s:I, s:I, s:I, s:I}", "done", (json_int_t)snapshot->jobs.done,
                          "failed", (json_int_t)snapshot->jobs.failed, "waiting",
                          (json_int_t)snapshot->jobs.waiting, "specimens",
                          (json_int_t)snapshot->count, "withheld", (json_int_t)withheld));
    return failed || (withheld && withheld == snapshot->count) ? EX_DATAERR : EX_OK;
}

int gsn_ui_threads(const struct gsn_ui *ui, const char *takes, int argc, char **argv,
                   const char *ret_args[4])
{
    int n = 0;

    for (int i = 1; i < argc; i++) {
        int64_t threads;

        if (strcmp(argv[i], "--threads") != 0 || n > 0)
            return gsn_ui_usage(ui, "%s takes only %s, not \"%s\"", argv[0], takes, argv[i]);
        if (i + 1 == argc || !gsn_ui_whole(argv[i + 1], 0, MOST_THREADS, &threads))
            return gsn_ui_usage(ui, "--threads must be a whole number from 0 to %d, not \"%s\"",
                                (int)MOST_THREADS, i + 1 == argc ? "" : argv[i + 1]);
        ret_args[n++] = argv[i++];
        ret_args[n++] = argv[i];
    }
    ret_args[n] = "work";
    return EX_OK;
}

int gsn_cmd_run(const struct gsn_ui *ui, int argc, char **argv)
{
    static const char *const index[] = { "index", "--quiet", NULL };
    const char *args[4] = { 0 };
    gsn_auto(gsn_store) store = NULL;
    struct gsn_ui quiet = *ui;
    int status = gsn_ui_threads(ui, "--threads N", argc, argv, args);

    if (status != EX_OK)
        return status;
    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    quiet.json = 0;
    status = gsn_ui_work_queue(&quiet, store, args, 0);
    if (status == EX_OK)
        status = gsn_ui_call(&quiet, "gieson-work", 1, index);
    return status == EX_OK ? report_end(ui, store) : status;
}

int gsn_cmd_retry(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_specimen_row) specimen = NULL;
    struct gsn_error err = { 0 };
    int status = EX_OK, r = GSN_OK;
    size_t count = 0;

    if (argc > 2)
        return gsn_ui_usage(ui, "retry takes one specimen or none");
    store = gsn_ui_store(ui, GSN_STORE_WRITE, &status);
    if (!store)
        return status;
    if (argc == 2)
        r = gsn_specimen_get(store, argv[1], &specimen, &err);
    if (r >= 0)
        r = gsn_queue_retry(store, specimen ? specimen->id : 0, &count, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    if (ui->json)
        gsn_ui_print_json(ui, json_pack("{s:I}", "waiting_again", (json_int_t)count));
    else
        gsn_ui_say(ui, "%zu job%s again; `gieson run` does them", count,
                   count == 1 ? " waits" : "s wait");
    return EX_OK;
}
