/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A run is verified in four steps, each of which can be read alone.
 *
 * 1. The database: its pages have the checksums they were written with, the audit log is whole and
 *    as long as others remember it, the rows of every run are those that were sealed (the
 * baseline's figures are among them).
 * 2. The files that people read: report.html, report.json and its outputs have the hashes of the
 * run.
 * 3. The originals: every panel is looked at again from its bytes (splitting, marks, orientation),
 * in a copy of the database that is thrown away, and what is found is compared with the rows. What
 *    comes out of the bytes goes into step 4, not what the rows said. A panel that is held or
 * refused is looked at as well; it stays what it is, for why it is held may depend on what else had
 * come.
 * 4. The specimen is worked again. report.json and report.html must come out byte for byte, and
 *    figures, poses and colours as the rows have them.
 *
 * Costs what the run cost, and the analysis of its panels. */
#include "systemd/worker/verify.h"

#include <errno.h>
#include <jansson.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/decode/apart.h"
#include "pipeline/specimen/process.h"
#include "storage/catalog.h"
#include "systemd/worker/job.h"
#include "systemd/worker/job_inputs.h"
#include "systemd/worker/panel_job.h"
#include "systemd/worker/specimen_job.h"

/* Counts on the way to who listens. */
struct listener {
    const struct gsn_verify *verify;
    size_t findings;
};

static void hear_finding(void *context, const char *what, const char *sentence)
{
    struct listener *const listener = context;

    listener->findings++;
    if (listener->verify->found)
        listener->verify->found(listener->verify->context, what, sentence);
}

/* ---- a copy to look at panels in ---------------------------------------------------------- */

/* A store whose database is a copy and whose objects are the original's. */
struct copy {
    char *dir;
    struct gsn_store *store;
};

static void remove_in(const struct copy *copy, const char *name)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", copy->dir, name);

    if (path)
        (void)unlink(path);
}

static void copy_done(struct copy *copy)
{
    static const char *const names[] = { "gieson.db",     "gieson.db-wal",
                                         "gieson.db-shm", "gieson.db-journal",
                                         "objects",       "audit.head",
                                         "reports" };

    gsn_store_free(copy->store);
    for (size_t i = 0; copy->dir && i < sizeof names / sizeof *names; i++)
        remove_in(copy, names[i]);
    if (copy->dir)
        (void)rmdir(copy->dir);
    gsn_free(copy->dir);
}
#define auto_copy __attribute__((cleanup(copy_done))) struct copy

static int link_folder(struct gsn_store *store, const struct copy *copy, const char *name,
                       struct gsn_error *err)
{
    gsn_auto_mem(char) from = gsn_format("%s/%s", gsn_store_dir(store), name);
    gsn_auto_mem(char) to = gsn_format("%s/%s", copy->dir, name);
    gsn_auto_mem(char) whole = from ? realpath(from, NULL) : NULL;

    if (!from || !to)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (!whole || symlink(whole, to) < 0)
        return gsn_fail(err, GSN_E_IO, "%s: %s", from, strerror(errno));
    return GSN_OK;
}

static int make_copy(struct gsn_store *store, struct copy *copy, struct gsn_error *err)
{
    const char *const tmp = getenv("TMPDIR");
    gsn_auto_mem(char) dir = gsn_format("%s/gieson.XXXXXX", tmp && tmp[0] ? tmp : "/tmp");
    gsn_auto_mem(char) database = NULL;
    int r = GSN_OK;

    if (!dir)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (!mkdtemp(dir))
        return gsn_fail(err, GSN_E_IO, "%s: %s", dir, strerror(errno));
    copy->dir = gsn_steal(&dir);
    database = gsn_format("%s/gieson.db", copy->dir);
    if (!database)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = link_folder(store, copy, "objects", err);
    /* The models of the controls, which are held against the hashes of their own runs. */
    if (r >= 0)
        r = link_folder(store, copy, "reports", err);
    if (r >= 0)
        r = gsn_store_copy(store, database, err);
    return r < 0 ? r : gsn_store_open(copy->dir, GSN_STORE_WRITE, &copy->store, err);
}

/* ---- a panel's rows ----------------------------------------------------------------------- */

static int same_mark(const struct gsn_fiducial_row *a, const struct gsn_fiducial_row *b)
{
    return a->found == b->found &&
           (!a->found ||
            (gsn_same_number(a->x_px, b->x_px) && gsn_same_number(a->y_px, b->y_px) &&
             gsn_same_number(a->radius_px, b->radius_px) && gsn_same_number(a->cov_xx, b->cov_xx) &&
             gsn_same_number(a->cov_xy, b->cov_xy) && gsn_same_number(a->cov_yy, b->cov_yy) &&
             gsn_same_number(a->score, b->score)));
}

/* What about a slot is not the same, or NULL. */
static const char *find_difference(const struct gsn_section_row *a, const struct gsn_section_row *b)
{
    if (a->slot != b->slot || a->serial != b->serial)
        return "its number";
    if (strcmp(a->state, b->state) != 0 || strcmp(a->flags, b->flags) != 0)
        return "its state";
    if (!gsn_same_number(a->bbox_x, b->bbox_x) || !gsn_same_number(a->bbox_y, b->bbox_y) ||
        !gsn_same_number(a->bbox_w, b->bbox_w) || !gsn_same_number(a->bbox_h, b->bbox_h) ||
        !gsn_same_number(a->area_px, b->area_px))
        return "where it lies";
    for (size_t m = 0; m < GSN_ROW_MARKS; m++)
        if (!same_mark(&a->marker[m], &b->marker[m]))
            return "its marks";
    return NULL;
}

static void compare_sections(const struct gsn_panel_row *panel, const struct gsn_section_rows *was,
                             const struct gsn_section_rows *is, const char *what,
                             struct listener *listener)
{
    size_t i = 0, j = 0;
    char sentence[200];

    for (;; i++, j++) {
        const char *differs = NULL;

        while (i < was->count && was->at[i].panel_id != panel->id)
            i++;
        while (j < is->count && is->at[j].panel_id != panel->id)
            j++;
        if (i == was->count && j == is->count)
            return;
        if (i == was->count || j == is->count) {
            hear_finding(listener, what,
                         "its picture shows more or fewer sections than the rows have");
            return;
        }
        differs = find_difference(&was->at[i], &is->at[j]);
        if (!differs)
            continue;
        (void)snprintf(sentence, sizeof sentence,
                       "of its section in slot %lld the row says of %s what the picture does not",
                       (long long)was->at[i].slot, differs);
        hear_finding(listener, what, sentence);
    }
}

static int same_panel(const struct gsn_panel_row *was, const struct gsn_panel_row *is)
{
    return strcmp(was->message, is->message) == 0 && was->width == is->width &&
           was->height == is->height && gsn_same_number(was->px_um, is->px_um) &&
           (!was->turn_known || (was->mirrored == is->mirrored && was->quarters == is->quarters &&
                                 strcmp(was->turn_note, is->turn_note) == 0));
}

/* A panel whose number another one has as well is held for that, however good it is. */
static int is_claimed_twice(const struct gsn_panel_rows *panels, const struct gsn_panel_row *panel)
{
    size_t count = 0;

    for (size_t i = 0; i < panels->count; i++)
        count += panels->at[i].number == panel->number;
    return count > 1;
}

static void compare_panel(const struct gsn_panel_rows *panels, const struct gsn_panel_row *was,
                          const struct gsn_panel_row *is, const char *what,
                          struct listener *listener)
{
    char sentence[900];

    if (strcmp(was->state, is->state) == 0) {
        if (strcmp(was->state, "registered") == 0 && !same_panel(was, is))
            hear_finding(
                listener, what,
                "its row says of its size, how it lies or what is odd what the picture does not");
        return;
    }
    if (strcmp(was->state, "held") == 0 && strcmp(is->state, "registered") == 0 &&
        is_claimed_twice(panels, was))
        return;
    (void)snprintf(sentence, sizeof sentence,
                   "the store has it as %s, and by its bytes it is %s%s%s", was->state, is->state,
                   is->message[0] ? ": " : "", is->message);
    hear_finding(listener, what, sentence);
}

/* Inside a transaction of the copy: what is found again stays only for a panel that is used. */
static int look_again(const struct gsn_verify *verify, struct gsn_store *copy, int64_t specimen,
                      const struct gsn_panel_rows *panels, const struct gsn_panel_row *was,
                      const struct gsn_section_rows *sections, struct listener *listener,
                      int *ret_stays, struct gsn_error *err)
{
    gsn_auto_mem(char) what = gsn_format("panel %s", was->file_name);
    gsn_auto(gsn_panel_row) is = NULL;
    gsn_auto(gsn_section_rows) found = NULL;
    int r = what ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    if (r >= 0)
        r = gsn_panel_look_again(copy, specimen, was->id, verify->options, err);
    if (r >= 0)
        r = gsn_panel_get(copy, was->id, &is, err);
    if (r >= 0)
        r = gsn_section_list(copy, specimen, &found, err);
    if (r < 0)
        return r;
    compare_panel(panels, was, is, what, listener);
    *ret_stays = strcmp(was->state, "registered") == 0 && strcmp(is->state, "registered") == 0;
    if (*ret_stays)
        compare_sections(was, sections, found, what, listener);
    return GSN_OK;
}

static int look_at_panels(const struct gsn_verify *verify, struct gsn_store *copy, int64_t specimen,
                          struct listener *listener, struct gsn_error *err)
{
    gsn_auto(gsn_panel_rows) panels = NULL;
    gsn_auto(gsn_section_rows) sections = NULL;
    int r = gsn_panel_list(verify->store, specimen, &panels, err);

    if (r >= 0)
        r = gsn_section_list(verify->store, specimen, &sections, err);
    for (size_t i = 0; r >= 0 && i < panels->count; i++) {
        int stays = 0;

        /* One that waits was never looked at, and one that a person took back was looked at and
         * does not count: the report says so. */
        if (strcmp(panels->at[i].state, "waiting") == 0 ||
            (strcmp(panels->at[i].state, "refused") == 0 &&
             strcmp(panels->at[i].code, gsn_code_name(GSN_E_WITHHELD)) == 0))
            continue;
        r = gsn_store_begin(copy, err);
        if (r < 0)
            return r;
        r = look_again(verify, copy, specimen, panels, &panels->at[i], sections, listener, &stays,
                       err);
        if (r >= 0 && stays)
            r = gsn_store_commit(copy, err);
        else
            gsn_store_rollback(copy);
    }
    return r;
}

/* ---- the run ------------------------------------------------------------------------------ */

static int look_at_store(const struct gsn_verify *verify, struct listener *listener,
                         struct gsn_verdict *verdict, struct gsn_error *err)
{
    gsn_auto_heads none = { .count = 0 };
    struct gsn_audit_heads *const heads = verify->heads ? verify->heads : &none;
    struct gsn_store *const store = verify->store;
    size_t before;
    int r = gsn_audit_pages(gsn_store_dir(store), hear_finding, listener, NULL, err);

    if (r >= 0)
        r = gsn_audit_reports(store, verify->run, heads, hear_finding, listener, err);
    before = listener->findings;
    if (r >= 0)
        r = gsn_audit_log(store, heads->at, heads->count, hear_finding, listener, &verdict->events,
                          err);
    verdict->whole_log = listener->findings == before;
    if (r >= 0)
        r = gsn_audit_runs(store, 0, hear_finding, listener, err);
    return r < 0 ? r : gsn_audit_ledger(store, hear_finding, listener, err);
}

/* Whether the run was made from such a file: its row is sealed, so what it says holds. */
static bool was_input(const json_t *then, const struct gsn_specimen_input *input)
{
    const json_t *one;
    size_t i;

    json_array_foreach(then, i, one)
    {
        const char *name = json_string_value(json_object_get(one, "name"));
        const char *sha256 = json_string_value(json_object_get(one, "sha256"));

        if (name && sha256 && strcmp(name, input->name) == 0 && strcmp(sha256, input->sha256) == 0)
            return true;
    }
    return false;
}

/* Panels, attachments and job.json that the run was not made from, by their names. */
static void name_inputs(const struct gsn_run_row *run, const struct gsn_specimen *specimen,
                        struct listener *listener)
{
    json_t *root = json_loads(run->inputs_json, 0, NULL);
    const json_t *then = json_object_get(root, "inputs");

    for (size_t i = 0; i < specimen->input_count; i++)
        if (!was_input(then, &specimen->input[i]))
            hear_finding(listener, specimen->input[i].name,
                         "is not what the run was made from: it is another file, or came later");
    json_decref(root);
}

static int compare_report(const struct gsn_run_row *run, const struct gsn_job_inputs *inputs,
                          const struct gsn_specimen_result *result, struct listener *listener,
                          struct gsn_verdict *verdict, struct gsn_error *err)
{
    struct gsn_digest json, html;
    char what[32];
    int r = gsn_sha256(result->json, result->json_size, &json, err);

    if (r >= 0)
        r = gsn_sha256(result->html, result->html_size, &html, err);
    if (r < 0)
        return r;
    (void)snprintf(what, sizeof what, "run %lld", (long long)run->id);
    verdict->same_inputs = strcmp(run->key, gsn_job_inputs_key(inputs)) == 0;
    verdict->same_json = strcmp(run->json_sha256, json.hex) == 0;
    verdict->same_html = strcmp(run->report_sha256, html.hex) == 0;
    (void)snprintf(verdict->was, sizeof verdict->was, "%s", run->json_sha256);
    (void)snprintf(verdict->is, sizeof verdict->is, "%s", json.hex);
    if (!verdict->same_inputs)
        hear_finding(
            listener, what,
            "its inputs, what was decided, its baseline or this version of gieson are not those "
            "that it was made from");
    if (!verdict->same_inputs)
        name_inputs(run, gsn_job_inputs_specimen(inputs), listener);
    if (!verdict->same_json)
        hear_finding(listener, what, "report.json comes out of the originals with other bytes");
    if (!verdict->same_html)
        hear_finding(listener, what, "report.html comes out of the originals with other bytes");
    return GSN_OK;
}

static int process_again(const struct gsn_verify *verify, struct gsn_store *copy,
                         const struct gsn_run_row *run, struct listener *listener,
                         struct gsn_verdict *verdict, struct gsn_error *err)
{
    const struct gsn_job_options *const options = verify->options;
    struct gsn_specimen_options how = { .mesher = options->mesher, .threads = options->threads };
    gsn_auto(gsn_decoder) decoder = NULL;
    gsn_auto(gsn_job_inputs) inputs = NULL;
    gsn_auto(gsn_specimen_result) result = NULL;
    gsn_auto(gsn_panel_rows) panels = NULL;
    int r = GSN_OK;

    if (options->decoder)
        r = gsn_decoder_new(options->decoder, &decoder, err);
    how.decoder = decoder;
    if (r >= 0)
        r = gsn_job_inputs_load(copy, run->specimen_id, decoder, &inputs, err);
    if (r >= 0)
        r = gsn_specimen_process(gsn_job_inputs_specimen(inputs), &how, &result, err);
    if (r >= 0)
        r = gsn_panel_list(copy, run->specimen_id, &panels, err);
    if (r >= 0)
        r = compare_report(run, inputs, result, listener, verdict, err);
    return r < 0 ? r
                 : gsn_specimen_compare_rows(verify->store, run->id, panels, result, hear_finding,
                                             listener, err);
}

int gsn_verify_run(const struct gsn_verify *verify, struct gsn_verdict *ret_verdict,
                   struct gsn_error *err)
{
    struct gsn_verdict verdict = { .run = verify->run };
    struct listener listener = { .verify = verify };
    gsn_auto(gsn_run_row) run = NULL;
    auto_copy copy = { .dir = NULL };
    int r = gsn_job_check_programs(verify->options, 1, err);

    if (r >= 0)
        r = gsn_run_get(verify->store, verify->run, &run, err);
    if (r < 0)
        return r;
    if (!run->json_sha256[0])
        return gsn_fail(err, GSN_E_INPUT, "run %lld is %s and has no report to compare with",
                        (long long)verify->run, run->state);
    r = look_at_store(verify, &listener, &verdict, err);
    if (r >= 0)
        r = make_copy(verify->store, &copy, err);
    if (r >= 0)
        r = look_at_panels(verify, copy.store, run->specimen_id, &listener, err);
    if (r >= 0)
        r = process_again(verify, copy.store, run, &listener, &verdict, err);
    if (r < 0)
        return r;
    verdict.findings = listener.findings;
    *ret_verdict = verdict;
    return GSN_OK;
}
