/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verb `night`: every specimen that changed since its last report is computed, and the morning
 * finds what came of it.
 *
 * Steps. 1. What changed is asked for, and the queue is worked until it is empty. 2. The store
 * before is held against the store after: a line for each specimen that was computed. 3. The pages
 * of all studies and of the store are made again; $GIESON_PUBLISH names a folder that gets a copy.
 * 4. STORE/night.txt, one paragraph: how many, what is withheld or failed and why, and what a person
 * does next. It is what gieson-notify@.service hands on. It says no loss: a study may be blind.
 *
 * Failure: 65 where a specimen that was computed has no result, the pages being made all the same;
 * any other status is that of the step that failed, and the paragraph says that it did. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sysexits.h>
#include <time.h>

#include "pipeline/core/file.h"
#include "storage/advice.h"
#include "ui/snapshot.h"
#include "ui/text.h"
#include "ui/ui.h"

enum { MOST_NAMED = 10 };

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

static const struct gsn_snapshot_row *find_row(const struct gsn_snapshot *snapshot, int64_t id)
{
    for (size_t i = 0; i < snapshot->count; i++)
        if (snapshot->at[i].id == id)
            return &snapshot->at[i];
    return NULL;
}

/* By us or by somebody else at the same time: it had work to do, or has another run than before. */
static int was_worked(const struct gsn_snapshot_row *before, const struct gsn_snapshot_row *after)
{
    return !before || before->run != after->run || strcmp(before->state, "waiting") == 0 ||
           strcmp(before->state, "working") == 0;
}

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

static void compare_rows(const struct gsn_ui *ui, const struct gsn_snapshot *before,
                         const struct gsn_snapshot *after, struct night *night)
{
    for (size_t i = 0; i < after->count; i++) {
        const struct gsn_snapshot_row *row = &after->at[i];
        const int failed = strcmp(row->state, "failed") == 0;
        const int withheld = strcmp(row->state, "withheld") == 0;

        if (!was_worked(find_row(before, row->id), row)) {
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

/* before: as it was when all that changed had been asked for. */
static int work_night(const struct gsn_ui *ui, struct gsn_store *store, const char *const args[],
                      struct night *night)
{
    gsn_auto(gsn_snapshot) before = NULL;
    gsn_auto(gsn_snapshot) after = NULL;
    struct gsn_ui quiet = *ui;
    struct gsn_error err = { 0 };
    int status, r = gsn_snapshot_take(store, &before, &err);

    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    quiet.json = 0;
    status = gsn_ui_work_queue(&quiet, store, args);
    if (status != EX_OK)
        return status;
    r = gsn_snapshot_take(store, &after, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    compare_rows(ui, before, after, night);
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

/* gives: the paragraph. status: how the night ended. */
static char *write_words(const struct gsn_store *store, const struct night *night,
                         const char *publish, int status)
{
    const time_t now = time(NULL);
    struct tm local = { 0 };
    char day[32];
    gsn_auto_mem(char) withheld = count_words(night->withheld, "withheld");
    gsn_auto_mem(char) failed = count_words(night->failed, "failed");
    gsn_auto_mem(char) earlier =
        count_words(night->failed_before, "failed earlier and not tried again");
    gsn_auto_mem(char) person = person_words(night);
    gsn_auto_mem(char) more =
        night->named_count > MOST_NAMED
            ? gsn_format("\nand %zu more", night->named_count - MOST_NAMED)
            : gsn_strdup("");

    (void)localtime_r(&now, &local);
    (void)strftime(day, sizeof day, "%Y-%m-%d %H:%M", &local);
    if (!withheld || !failed || !earlier || !person || !more)
        return NULL;
    return gsn_format(
        "gieson, %s: %s%zu specimen%s computed, %zu reported%s%s%s.%s All of it: %s/index.html%s%s\n",
        day,
        status == EX_OK || status == EX_DATAERR ? "" : "the night could not be done to its end, "
                                                       "`journalctl -u gieson-night` says why. ",
        night->worked, plural(night->worked), night->reported, withheld, failed, earlier, person,
        publish ? publish : gsn_store_dir(store), night->named ? night->named : "", more);
}

static int leave_words(const struct gsn_ui *ui, struct gsn_store *store, const struct night *night,
                       const char *publish, int status)
{
    gsn_auto_mem(char) words = write_words(store, night, publish, status);
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

int gsn_cmd_night(const struct gsn_ui *ui, int argc, char **argv)
{
    static const char *const ask[] = { "changed", NULL };
    const char *const said = getenv("GIESON_PUBLISH");
    const char *const publish = said && *said ? said : NULL;
    const char *args[4] = { 0 };
    gsn_auto(gsn_store) store = NULL;
    struct gsn_ui quiet = *ui;
    __attribute__((cleanup(night_done))) struct night night = { 0 };
    int status = gsn_ui_threads(ui, argv[0], argc, argv, args), made;

    if (status != EX_OK)
        return status;
    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    quiet.json = 0;
    status = gsn_ui_call(&quiet, "gieson-work", 1, ask);
    if (status == EX_OK) {
        night.rows = ui->json ? json_array() : NULL;
        status = work_night(ui, store, args, &night);
    }
    if (status == EX_OK || status == EX_DATAERR) {
        made = make_pages(&quiet, publish);
        status = made == EX_OK ? status : made;
    }
    made = leave_words(ui, store, &night, publish, status);
    return status == EX_OK ? made : status;
}
