/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The nightly run: every specimen that changed since its last report is processed to its next one,
 * and the pages of all studies and of the store are made again. $GIESON_PUBLISH names a folder that
 * gets a copy of them. */
#include "ui/snapshot.h"
#include "ui/text.h"
#include "ui/ui.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sysexits.h>

/* What came of it. */
struct night {
    size_t worked, failed, failed_before;
    json_t *rows; /* NULL without --json */
};

static const struct gsn_snapshot_row *same_row(const struct gsn_snapshot *snapshot, int64_t id)
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

static void compare(const struct gsn_ui *ui, const struct gsn_snapshot *before,
                    const struct gsn_snapshot *after, struct night *night)
{
    for (size_t i = 0; i < after->count; i++) {
        const struct gsn_snapshot_row *row = &after->at[i];
        const int failed = strcmp(row->state, "failed") == 0;

        if (was_worked(same_row(before, row->id), row)) {
            tell_row(ui, night, row);
            night->worked++;
            night->failed += failed != 0;
        } else {
            night->failed_before += failed != 0;
        }
    }
}

static int tell_end(const struct gsn_ui *ui, const struct night *night)
{
    if (ui->json)
        gsn_ui_print_json(ui, json_pack("{s:O, s:I, s:I}", "worked", night->rows, "failed",
                                        (json_int_t)night->failed, "failed_before",
                                        (json_int_t)night->failed_before));
    else if (night->worked == 0)
        (void)printf("nothing changed since the last reports\n");
    if (night->failed_before > 0)
        gsn_text_line(stderr,
                      "gieson: %zu specimen%s failed earlier: see `gieson status`; `gieson retry` "
                      "lets %s wait again",
                      night->failed_before, night->failed_before == 1 ? "" : "s",
                      night->failed_before == 1 ? "it" : "them");
    return night->failed > 0 ? EX_DATAERR : EX_OK;
}

/* before: as it was when all that changed had been asked for. */
static int work(const struct gsn_ui *ui, struct gsn_store *store, const char *const args[],
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
    compare(ui, before, after, night);
    return tell_end(ui, night);
}

int gsn_cmd_night(const struct gsn_ui *ui, int argc, char **argv)
{
    static const char *const ask[] = { "changed", NULL };
    static const char *const studies[] = { "study", "--quiet", NULL };
    const char *const publish = getenv("GIESON_PUBLISH");
    const char *const index[] = { "index", "--quiet", publish && *publish ? "--publish" : NULL,
                                  publish, NULL };
    const char *args[4] = { 0 };
    gsn_auto(gsn_store) store = NULL;
    struct gsn_ui quiet = *ui;
    struct night night = { 0 };
    int status = gsn_ui_threads(ui, "{v}", argc, argv, args);

    if (status != EX_OK)
        return status;
    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    quiet.json = 0;
    status = gsn_ui_call(&quiet, "gieson-work", 1, ask);
    if (status != EX_OK)
        return status;
    night.rows = ui->json ? json_array() : NULL;
    status = work(ui, store, args, &night);
    json_decref(night.rows);
    if (status == EX_OK || status == EX_DATAERR) {
        int made = gsn_ui_call(&quiet, "gieson-work", 1, studies);

        if (made == EX_OK)
            made = gsn_ui_call(&quiet, "gieson-work", 1, index);
        status = status == EX_OK ? made : status;
    }
    return status;
}
