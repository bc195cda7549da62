/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/text.h"
#include "ui/ui.h"

#include "pipeline/core/file.h"
#include "storage/audit.h"
#include "storage/catalog.h"
#include "storage/result.h"

#include <stdio.h>
#include <sysexits.h>

enum { MOST_REPORT_BYTES = 1 << 28 };

/* gives: the latest run of a specimen that left a report. */
static int find(struct gsn_store *store, const char *name, struct gsn_run_row **ret_run,
                struct gsn_error *err)
{
    gsn_auto(gsn_specimen_row) specimen = NULL;
    gsn_auto(gsn_run_rows) runs = NULL;
    int64_t latest = 0;
    int r = gsn_specimen_get(store, name, &specimen, err);

    if (r >= 0)
        r = gsn_run_list(store, specimen->id, &runs, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < runs->count; i++)
        if (runs->at[i].json_path[0])
            latest = runs->at[i].id;
    if (!latest)
        return gsn_fail(err, GSN_E_NOTFOUND, "%s has no report yet: `gieson run` works the queue",
                        name);
    return gsn_run_get(store, latest, ret_run, err);
}

/* A report that is not what the run wrote is not handed out, whichever half of it was asked for. */
static int check_files(struct gsn_store *store, const struct gsn_run_row *run,
                       struct gsn_error *err)
{
    struct gsn_error why = { 0 };
    int r = gsn_audit_file(store, run->json_path, run->json_sha256, &why);

    if (r >= 0)
        r = gsn_audit_file(store, run->report_path, run->report_sha256, &why);
    if (r >= 0)
        return r;
    return gsn_fail(err, r, "%s; it is not shown. `gieson verify %lld` says what else changed",
                    why.text, (long long)run->id);
}

static int print_file(const char *path, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size;
    const int r = gsn_file_read(path, MOST_REPORT_BYTES, &bytes, &size, err);

    if (r >= 0)
        (void)fwrite(bytes, 1, size, stdout);
    return r;
}

int gsn_cmd_report(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_run_row) run = NULL;
    gsn_auto_mem(char) json = NULL;
    struct gsn_error err = { 0 };
    int status = EX_OK, r;

    if (argc != 2)
        return gsn_ui_usage(ui, "report of which specimen? Say `gieson report SPECIMEN`");
    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    r = find(store, argv[1], &run, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    json = gsn_format("%s/%s", gsn_store_dir(store), run->json_path);
    if (!json)
        return gsn_ui_fail(ui, EX_OSERR, "out of memory");
    r = check_files(store, run, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    if (ui->json) {
        r = print_file(json, &err);
        return r < 0 ? gsn_ui_complain(ui, &err, r) : EX_OK;
    }
    gsn_text_line(stdout, "run %lld, %s%s%s", (long long)run->id, run->state,
                  run->message[0] ? ": " : "", run->message);
    (void)printf("%s/%s\n%s\n", gsn_store_dir(store), run->report_path, json);
    return EX_OK;
}
