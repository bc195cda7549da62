/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verb `night`: every specimen that changed since its last report is computed, and the morning
 * finds what came of it.
 *
 * Steps. 1. What changed is asked for, and the queue is worked until it is empty. 2. What was to be
 * done then is held against the store after: a line for each specimen that was computed. 3. The
 * pages of all studies and of the store are made again; $GIESON_PUBLISH names a folder that gets a
 * copy.
 * 4. STORE/night.txt, one paragraph: how many, what is withheld or failed and why, and what a
 * person does next. It is what gieson-notify@.service hands on. It says no loss: a study may be
 * blind.
 *
 * With --slurm the first step ends when all is asked for, and Slurm starts the rest (slurm.c):
 * tasks that share the queue (`night --share`), and after them steps 1 to 4 once more, for what
 * they left
 * (`night --rest`). Both are told how it began, and refuse to run on another machine.
 *
 * Failure: 65 where a specimen that was computed has no result, the pages being made all the same;
 * any other status is that of the step that failed, and the paragraph says that it did. */

#include <stdio.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <sysexits.h>
#include <time.h>

#include "pipeline/core/file.h"
#include "storage/advice.h"
#include "storage/queue.h"
#include "ui/slurm.h"
#include "ui/snapshot.h"
#include "ui/text.h"
#include "ui/ui.h"

enum { MOST_NAMED = 10 };

/* How a night goes: here, or by Slurm, or as a part of one by Slurm. */
enum way { HERE, SLURM, SHARE, REST };

/* What came of it. */
struct night {
    size_t worked, reported, withheld, failed, failed_before;
    size_t panels, sections; /* that need a person */
    json_t *rows;            /* NULL without --json */
    char *named;             /* owned; a sentence for each that has no result, or NULL */
    size_t named_count;
};

static void night_done(struct night *night)
{
    json_decref(night->rows);
    gsn_free(night->named);
}

/* ---- how it began ---------------------------------------------------------------------------- */

/* gives: the machine, the last run and specimen, and the specimens that have work to do. NULL when
 * memory runs out. */
static json_t *note_beginning(const struct gsn_snapshot *snapshot)
{
    char boot[GSN_QUEUE_BOOT_SIZE];
    json_t *open = json_array();
    int64_t run = 0, specimen = 0;

    for (size_t i = 0; i < snapshot->count; i++) {
        const struct gsn_snapshot_row *row = &snapshot->at[i];

        run = row->run > run ? row->run : run;
        specimen = row->id > specimen ? row->id : specimen;
        if (strcmp(row->state, "waiting") == 0 || strcmp(row->state, "working") == 0)
            (void)json_array_append_new(open, json_integer(row->id));
    }
    gsn_queue_boot(boot);
    return json_pack("{s:s, s:I, s:I, s:o}", "boot", boot, "run", (json_int_t)run, "specimen",
                     (json_int_t)specimen, "open", open);
}

static size_t count_open(const json_t *began)
{
    return json_array_size(json_object_get(began, "open"));
}

/* gives: what note_beginning() noted, or NULL after a complaint: this is no such text, or it was
 * another machine. */
static json_t *read_beginning(const struct gsn_ui *ui, const char *text, int *ret_status)
{
    json_t *began = json_loads(text, JSON_REJECT_DUPLICATES, NULL);
    char boot[GSN_QUEUE_BOOT_SIZE];
    const char *was;
    json_int_t run, specimen;
    json_t *open;

    gsn_queue_boot(boot);
    if (!began || json_unpack(began, "{s:s, s:I, s:I, s:o!}", "boot", &was, "run", &run, "specimen",
                              &specimen, "open", &open) < 0)
        *ret_status = gsn_ui_usage(ui, "--share and --rest are for `gieson night --slurm`, which "
                                       "gives them what they need");
    else if (strcmp(was, boot) != 0)
        *ret_status = gsn_ui_fail(
            ui, EX_UNAVAILABLE,
            "this is another machine than the one that began the night, or it was started again "
            "since: a store is worked on by its own machine alone, so have Slurm choose that one "
            "(SBATCH_PARTITION=...); nothing is lost, `gieson night` goes on");
    else
        return began;
    json_decref(began);
    return NULL;
}

/* By us or by somebody else at the same time: it had work to do, or is new, or has a new run. */
static int was_worked(const json_t *began, const struct gsn_snapshot_row *row)
{
    const json_t *const open = json_object_get(began, "open");

    for (size_t i = 0; i < json_array_size(open); i++)
        if (json_integer_value(json_array_get(open, i)) == row->id)
            return 1;
    return row->id > json_integer_value(json_object_get(began, "specimen")) ||
           row->run > json_integer_value(json_object_get(began, "run"));
}

/* ---- what came of it ------------------------------------------------------------------------- */

static void tell_row(const struct gsn_ui *ui, struct night *night,
                     const struct gsn_snapshot_row *row)
{
    if (!night->rows) {
        gsn_ui_print_end(ui, row);
        return;
    }
    (void)json_array_append_new(
        night->rows,
        json_pack("{s:o, s:s, s:o, s:o, s:o, s:o, s:o}", "specimen", gsn_text_json(row->name),
                  "state", row->state, "detail", gsn_text_json(row->detail ? row->detail : ""),
                  "loss_percent", gsn_ui_number(row->loss_percent), "loss_lower",
                  gsn_ui_number(row->loss_lower), "loss_upper", gsn_ui_number(row->loss_upper),
                  "report", row->report ? gsn_text_json(row->report) : json_null()));
}

/* Adds a sentence about a specimen without a result; beyond some only their number is said. */
static void name_row(struct night *night, const struct gsn_snapshot_row *row)
{
    char *longer;

    if (night->named_count++ >= MOST_NAMED)
        return;
    longer = gsn_format("%s\n%s: %s%s%s%s%s%s", night->named ? night->named : "", row->name,
                        row->state, row->detail ? ": " : "", row->detail ? row->detail : "",
                        row->action ? "; next: `" : "", row->action ? row->action : "",
                        row->action ? "`" : "");
    if (!longer)
        return;
    gsn_free(night->named);
    night->named = longer;
}

static void compare_rows(const struct gsn_ui *ui, const json_t *began,
                         const struct gsn_snapshot *after, struct night *night)
{
    for (size_t i = 0; i < after->count; i++) {
        const struct gsn_snapshot_row *row = &after->at[i];
        const int failed = strcmp(row->state, "failed") == 0;
        const int withheld = strcmp(row->state, "withheld") == 0;

        if (!was_worked(began, row)) {
            night->failed_before += failed != 0;
            continue;
        }
        tell_row(ui, night, row);
        night->worked++;
        night->failed += failed != 0;
        night->withheld += withheld != 0;
        night->reported += !failed && !withheld;
        if (failed || withheld)
            name_row(night, row);
    }
    night->panels = after->panels->count;
    night->sections = after->doubts->count;
}

static int tell_end(const struct gsn_ui *ui, const struct night *night)
{
    if (ui->json)
        gsn_ui_print_json(ui, json_pack("{s:O, s:I, s:I, s:I}", "worked", night->rows, "failed",
                                        (json_int_t)night->failed, "failed_before",
                                        (json_int_t)night->failed_before, "withheld",
                                        (json_int_t)night->withheld));
    else if (night->worked == 0)
        (void)printf("nothing changed since the last reports\n");
    if (night->failed_before > 0)
        gsn_text_line(stderr,
                      "gieson: %zu specimen%s failed earlier: see `gieson status`; `gieson retry` "
                      "lets %s wait again",
                      night->failed_before, night->failed_before == 1 ? "" : "s",
                      night->failed_before == 1 ? "it" : "them");
    return night->failed + night->withheld > 0 ? EX_DATAERR : EX_OK;
}

static int work_night(const struct gsn_ui *ui, struct gsn_store *store, const char *const args[],
                      const json_t *began, struct night *night)
{
    gsn_auto(gsn_snapshot) after = NULL;
    struct gsn_ui quiet = *ui;
    struct gsn_error err = { 0 };
    int status, r;

    quiet.json = 0;
    status = gsn_ui_work_queue(&quiet, store, args, 0);
    if (status != EX_OK)
        return status;
    r = gsn_snapshot_take(store, &after, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    compare_rows(ui, began, after, night);
    return tell_end(ui, night);
}

/* ---- the paragraph --------------------------------------------------------------------------- */

static const char *plural(size_t count)
{
    return count == 1 ? "" : "s";
}

/* gives: ", 2 withheld" or nothing. */
static char *count_words(size_t count, const char *what)
{
    return count ? gsn_format(", %zu %s", count, what) : gsn_strdup("");
}

/* gives: what needs a person, or nothing. */
static char *person_words(const struct night *night)
{
    if (night->panels + night->sections == 0)
        return gsn_strdup("");
    return gsn_format(" %zu panel%s and %zu section%s of the store need a person: `gieson status`.",
                      night->panels, plural(night->panels), night->sections,
                      plural(night->sections));
}

/* gives: the paragraph. log: where it is said why the night could not be done, which is where
 * status says so. */
static char *write_words(const struct gsn_store *store, const struct night *night,
                         const char *publish, const char *log, int status)
{
    const time_t now = time(NULL);
    const int ended = status == EX_OK || status == EX_DATAERR;
    struct tm local = { 0 };
    char day[32];
    gsn_auto_mem(char) withheld = count_words(night->withheld, "withheld");
    gsn_auto_mem(char) failed = count_words(night->failed, "failed");
    gsn_auto_mem(char) earlier =
        count_words(night->failed_before, "failed earlier and not tried again");
    gsn_auto_mem(char) person = person_words(night);
    gsn_auto_mem(char) more = night->named_count > MOST_NAMED
                                  ? gsn_format("\nand %zu more", night->named_count - MOST_NAMED)
                                  : gsn_strdup("");

    (void)localtime_r(&now, &local);
    (void)strftime(day, sizeof day, "%Y-%m-%d %H:%M", &local);
    if (!withheld || !failed || !earlier || !person || !more)
        return NULL;
    return gsn_format("gieson, %s: %s%s%s%zu specimen%s computed, %zu reported%s%s%s.%s All of it: "
                      "%s/index.html%s%s\n",
                      day, ended ? "" : "the night could not be done to its end, ",
                      ended ? "" : log, ended ? "" : " says why. ", night->worked,
                      plural(night->worked), night->reported, withheld, failed, earlier, person,
                      publish ? publish : gsn_store_dir(store), night->named ? night->named : "",
                      more);
}

static int leave_words(const struct gsn_ui *ui, struct gsn_store *store, const struct night *night,
                       const char *publish, const char *log, int status)
{
    gsn_auto_mem(char) words = write_words(store, night, publish, log, status);
    gsn_auto_mem(char) advice = words ? gsn_advice(ui->store_dir, words) : NULL;
    gsn_auto_mem(char) path = gsn_format("%s/night.txt", gsn_store_dir(store));
    struct gsn_error err = { 0 };
    int r;

    if (!advice || !path)
        return gsn_ui_fail(ui, EX_OSERR, "out of memory");
    r = gsn_file_write(path, advice, strlen(advice), &err);
    return r < 0 ? gsn_ui_complain(ui, &err, r) : EX_OK;
}

/* The pages of the studies and of the store, and their copy. */
static int make_pages(const struct gsn_ui *quiet, const char *publish)
{
    static const char *const studies[] = { "study", "--quiet", NULL };
    const char *const index[] = { "index", "--quiet", publish ? "--publish" : NULL, publish, NULL };
    const int made = gsn_ui_call(quiet, "gieson-work", 1, studies);

    return made == EX_OK ? gsn_ui_call(quiet, "gieson-work", 1, index) : made;
}

/* ---- Slurm ----------------------------------------------------------------------------------- */

static int tell_jobs(const struct gsn_ui *ui, const struct gsn_slurm_jobs *jobs, size_t specimens)
{
    if (ui->json)
        gsn_ui_print_json(ui, json_pack("{s:s, s:I, s:s}", "share", jobs->share, "tasks",
                                        (json_int_t)jobs->tasks, "rest", jobs->rest));
    else
        gsn_ui_say(
            ui,
            "%zu specimen%s: job %s of Slurm (%zu task%s) computes, job %s makes the pages and "
            "night.txt after it; `squeue -j %s,%s` shows them, and night.log of the store has "
            "what they say",
            specimens, plural(specimens), jobs->share, jobs->tasks, plural(jobs->tasks), jobs->rest,
            jobs->share, jobs->rest);
    return EX_OK;
}

/* threads: NULL when nothing was said. */
static int submit_night(const struct gsn_ui *ui, const char *publish, const char *threads,
                        const json_t *began)
{
    char folder[PATH_MAX];
    char *const text = json_dumps(began, JSON_COMPACT);
    const struct gsn_slurm_night night = { folder, text, threads, count_open(began) };
    __attribute__((cleanup(gsn_slurm_jobs_done))) struct gsn_slurm_jobs jobs = { 0 };
    struct gsn_error err = { 0 };
    int r;

    if (publish && publish[0] != '/')
        r = gsn_fail(&err, GSN_E_INPUT,
                     "GIESON_PUBLISH is \"%s\": Slurm's jobs run in the store, so say it from / on",
                     publish);
    else if (!text || !realpath(ui->store_dir, folder))
        r = gsn_fail(&err, GSN_E_IO, "%s: its place cannot be told", ui->store_dir);
    else
        r = gsn_slurm_submit(&night, &jobs, &err);
    free(text); /* door */
    return r < 0 ? gsn_ui_complain(ui, &err, r) : tell_jobs(ui, &jobs, night.specimens);
}

/* ---- the verb -------------------------------------------------------------------------------- */

/* Takes --slurm, --share and --rest out of the arguments. ret_began: the text behind the latter
 * two. */
static enum way take_way(int *argc, char **argv, const char **ret_began)
{
    enum way way = HERE;
    int kept = 1;

    for (int i = 1; i < *argc; i++) {
        const int is_share = strcmp(argv[i], "--share") == 0;

        if (strcmp(argv[i], "--slurm") == 0) {
            way = SLURM;
        } else if ((is_share || strcmp(argv[i], "--rest") == 0) && i + 1 < *argc) {
            way = is_share ? SHARE : REST;
            *ret_began = argv[++i];
        } else {
            argv[kept++] = argv[i];
        }
    }
    *argc = kept;
    return way;
}

/* gives: how it begins now that all that changed is asked for, or NULL after a complaint. */
static json_t *begin_night(const struct gsn_ui *ui, struct gsn_store *store, int *ret_status)
{
    static const char *const ask[] = { "changed", NULL };
    gsn_auto(gsn_snapshot) snapshot = NULL;
    struct gsn_error err = { 0 };
    json_t *began;
    int r;

    *ret_status = gsn_ui_call(ui, "gieson-work", 1, ask);
    if (*ret_status != EX_OK)
        return NULL;
    r = gsn_snapshot_take(store, &snapshot, &err);
    if (r < 0) {
        *ret_status = gsn_ui_complain(ui, &err, r);
        return NULL;
    }
    began = note_beginning(snapshot);
    if (!began)
        *ret_status = gsn_ui_fail(ui, EX_OSERR, "out of memory");
    return began;
}

/* Works, makes the pages and leaves the paragraph. began: NULL where status says why there is none.
 */
static int finish_night(const struct gsn_ui *ui, struct gsn_store *store, const char *const args[],
                        const json_t *began, const char *publish, const char *log, int status)
{
    __attribute__((cleanup(night_done))) struct night night = { 0 };
    struct gsn_ui quiet = *ui;
    int made;

    quiet.json = 0;
    if (began) {
        night.rows = ui->json ? json_array() : NULL;
        status = work_night(ui, store, args, began, &night);
    }
    if (status == EX_OK || status == EX_DATAERR) {
        made = make_pages(&quiet, publish);
        status = made == EX_OK ? status : made;
    }
    made = leave_words(ui, store, &night, publish, log, status);
    return status == EX_OK ? made : status;
}

int gsn_cmd_night(const struct gsn_ui *ui, int argc, char **argv)
{
    const char *const said = getenv("GIESON_PUBLISH");
    const char *const publish = said && *said ? said : NULL;
    const char *args[4] = { 0 }, *text = NULL;
    const enum way way = take_way(&argc, argv, &text);
    gsn_auto(gsn_store) store = NULL;
    struct gsn_ui quiet = *ui;
    json_t *began;
    int status = gsn_ui_threads(ui, "--threads N and --slurm", argc, argv, args);

    if (status != EX_OK)
        return status;
    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    quiet.json = 0;
    began = way == SHARE || way == REST ? read_beginning(ui, text, &status)
                                        : begin_night(&quiet, store, &status);
    if (!began && way != HERE)
        return status;
    if (way == SHARE)
        status = gsn_ui_work_queue(&quiet, store, args, 1);
    else if (way == SLURM && count_open(began) > 0)
        status = submit_night(ui, publish, argc > 1 ? args[1] : NULL, began);
    else
        status = finish_night(
            ui, store, args, began, publish,
            way == REST ? "night.log of the store" : "`journalctl -u gieson-night`", status);
    json_decref(began);
    return status;
}
