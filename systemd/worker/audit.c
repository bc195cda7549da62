/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* An audit of a whole store: storage/audit.c asks the database, this file asks the rest.
 *
 * 1. Reports: report.html and report.json have the hashes of their run's row; what report.json
 * names as outputs (the true-colour volume) has the hashes that stand there; audit-RUN.json says
 * what row and log say.
 * 2. Jobs: a specimen's row says what its job.json says, and the hash beside that is its hash.
 * 3. Objects: each that a row rests on is there in its full size (its bytes are read by scrub.c),
 *    and nothing lies among them that no row knows.
 * 4. Report folders: each belongs to a run.
 *
 * What a crash leaves (an object or a report whose row was never committed) is taken up by whoever
 * does the work again, so it is a finding only after a day. Costs one pass over the reports. */
#include "systemd/worker/audit.h"

#include <dirent.h>
#include <errno.h>
#include <inttypes.h>
#include <jansson.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <syslog.h>
#include <time.h>

#include "pipeline/core/file.h"
#include "pipeline/specimen/protocol.h"
#include "storage/catalog.h"

enum {
    MOST_REPORT_BYTES = 1 << 28,
    MOST_BESIDE_BYTES = 1 << 16,
    MOST_JOURNAL_BYTES = 1 << 30,
    CRASH_S = 24 * 3600,
};

/* In a journal, between what others say. */
static const char JOURNAL[] = "audit log: %" PRId64 " events, head %s";
static const char IN_JOURNAL[] = "audit log: %" SCNd64 " events, head %64[0-9a-f]";

static int no_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for an audit");
}

/* A failure that is a finding: the file is not what it must be. Memory that ran out is none. */
static int tell_failure(gsn_audit_found *found, void *context, const char *what, int r,
                        const struct gsn_error *why, struct gsn_error *err)
{
    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why->text);
    if (r < 0 && found)
        found(context, what, why->text);
    return GSN_OK;
}

/* ---- where the log ended ------------------------------------------------------------------ */

void gsn_audit_heads_done(struct gsn_audit_heads *heads)
{
    gsn_free(heads->at);
}

static int add_head(struct gsn_audit_heads *heads, const struct gsn_audit_head *head,
                    struct gsn_error *err)
{
    if (heads->count == heads->room) {
        const size_t room = heads->room ? 2 * heads->room : 16;
        struct gsn_audit_head *at = gsn_realloc_array(heads->at, room, sizeof *at);

        if (!at)
            return no_memory(err);
        heads->at = at;
        heads->room = room;
    }
    heads->at[heads->count++] = *head;
    return GSN_OK;
}

static int take_lines(const char *text, struct gsn_audit_heads *heads, struct gsn_error *err)
{
    int r = GSN_OK;

    for (const char *at = text; r >= 0 && (at = strstr(at, "audit log: ")); at++) {
        struct gsn_audit_head head = { .where = "the journal" };

        if (sscanf(at, IN_JOURNAL, &head.events, head.head.hex) == 2)
            r = add_head(heads, &head, err);
    }
    return r;
}

int gsn_audit_read_journal(const char *path, struct gsn_audit_heads *heads, struct gsn_error *err)
{
    const size_t before = heads->count;
    gsn_auto_mem(uint8_t) text = NULL;
    char line[1024];
    size_t size;
    int r = GSN_OK;

    if (strcmp(path, "-") != 0) {
        r = gsn_file_read(path, MOST_JOURNAL_BYTES, &text, &size, err);
        if (r >= 0)
            r = take_lines((const char *)text, heads, err);
    } else {
        while (r >= 0 && fgets(line, sizeof line, stdin))
            r = take_lines(line, heads, err);
    }
    if (r >= 0 && heads->count == before)
        r = gsn_fail(
            err, GSN_E_INPUT,
            "%s: no line of it says where the audit log ended; of the system's journal say "
            "`journalctl -t gieson-work | gieson verify --journal - SPECIMEN`",
            strcmp(path, "-") == 0 ? "standard input" : path);
    return r;
}

void gsn_audit_write_journal(struct gsn_store *store)
{
    struct gsn_audit_head head;

    if (gsn_audit_tail(store, &head, NULL) < 0)
        return;
    openlog("gieson-work", LOG_PID, LOG_DAEMON);
    syslog(LOG_NOTICE, JOURNAL, head.events, head.head.hex);
    closelog();
}

/* ---- beside a report ---------------------------------------------------------------------- */

static char *path_beside(const struct gsn_run_row *run)
{
    const char *const end = strrchr(run->json_path, '/');

    return end ? gsn_format("%.*s/audit-%" PRId64 ".json", (int)(end - run->json_path),
                            run->json_path, run->id)
               : NULL;
}

int gsn_audit_write_beside(struct gsn_store *store, int64_t id, struct gsn_error *err)
{
    gsn_auto(gsn_run_row) run = NULL;
    struct gsn_audit_head head;
    struct gsn_digest seal;
    gsn_auto_mem(char) name = NULL;
    gsn_auto_mem(char) path = NULL;
    json_t *root;
    char *text;
    int late, r = gsn_run_get(store, id, &run, err);

    if (r >= 0)
        r = gsn_audit_sealed(store, id, &seal, &late, err);
    if (r >= 0)
        r = gsn_audit_tail(store, &head, err);
    if (r < 0)
        return r;
    name = path_beside(run);
    path = name ? gsn_format("%s/%s", gsn_store_dir(store), name) : NULL;
    root = json_pack("{s:s, s:I, s:s, s:I, s:s, s:s, s:s, s:s}", "schema", "gieson-audit-1", "run",
                     (json_int_t)id, "key", run->key, "events", (json_int_t)head.events, "head",
                     head.head.hex, "rows_sha256", seal.hex, "html_sha256", run->report_sha256,
                     "json_sha256", run->json_sha256);
    text = json_dumps(root, JSON_INDENT(2));
    json_decref(root);
    r = path && text ? gsn_file_write(path, text, strlen(text), err) : no_memory(err);
    free(text); /* door */
    return r;
}

static int same_text(const json_t *root, const char *key, const char *is)
{
    const char *const text = json_string_value(json_object_get(root, key));

    return text && strcmp(text, is) == 0;
}

/* What lies beside a report against the run's row and its seal. */
static int check_beside(struct gsn_store *store, const struct gsn_run_row *run,
                        struct gsn_audit_heads *heads, gsn_audit_found *found, void *context,
                        struct gsn_error *err)
{
    gsn_auto_mem(char) name = path_beside(run);
    gsn_auto_mem(char) path = name ? gsn_format("%s/%s", gsn_store_dir(store), name) : NULL;
    gsn_auto_mem(uint8_t) text = NULL;
    struct gsn_audit_head head = { 0 };
    struct gsn_error why = { 0 };
    struct gsn_digest seal = { "" };
    json_t *root;
    size_t size;
    int late = 0, r = gsn_audit_sealed(store, run->id, &seal, &late, &why);

    if (!path)
        return no_memory(err);
    if (r < 0 && r != GSN_E_NOTFOUND)
        return gsn_fail(err, r, "%s", why.text);
    /* An older gieson put nothing there; a run without a seal is found where seals are. */
    if (r == GSN_E_NOTFOUND || late)
        return GSN_OK;
    r = gsn_file_read(path, MOST_BESIDE_BYTES, &text, &size, &why);
    if (r < 0)
        return tell_failure(found, context, name, r, &why, err);
    root = json_loadb((const char *)text, size, 0, NULL);
    if (!same_text(root, "schema", "gieson-audit-1") || !same_text(root, "key", run->key) ||
        json_integer_value(json_object_get(root, "run")) != run->id ||
        json_integer_value(json_object_get(root, "events")) <= 0 ||
        json_string_length(json_object_get(root, "head")) != sizeof head.head.hex - 1 ||
        !same_text(root, "rows_sha256", seal.hex) ||
        !same_text(root, "html_sha256", run->report_sha256) ||
        !same_text(root, "json_sha256", run->json_sha256)) {
        if (found)
            found(context, name,
                  "it is not what was written with the run: it contradicts the "
                  "run's row or its seal");
    } else if (heads) {
        const char *const hex = json_string_value(json_object_get(root, "head"));

        head.events = json_integer_value(json_object_get(root, "events"));
        (void)snprintf(head.head.hex, sizeof head.head.hex, "%s", hex ? hex : "");
        (void)snprintf(head.where, sizeof head.where, "%.240s", name);
        r = add_head(heads, &head, err);
    }
    json_decref(root);
    return r;
}

/* What report.json says lies beside it. */
static int check_outputs(struct gsn_store *store, const struct gsn_run_row *run,
                         gsn_audit_found *found, void *context, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", gsn_store_dir(store), run->json_path);
    const char *const end = strrchr(run->json_path, '/');
    gsn_auto_mem(uint8_t) text = NULL;
    struct gsn_error why = { 0 };
    json_t *root, *outputs;
    size_t size;
    int r = path ? gsn_file_read(path, MOST_REPORT_BYTES, &text, &size, &why) : no_memory(&why);

    if (r < 0 || !end)
        return r == GSN_E_NOMEM ? gsn_fail(err, r, "%s", why.text) : GSN_OK;
    root = json_loadb((const char *)text, size, 0, NULL);
    outputs = json_object_get(json_object_get(root, "provenance"), "outputs");
    for (size_t i = 0; r >= 0 && i < json_array_size(outputs); i++) {
        const json_t *const output = json_array_get(outputs, i);
        const char *const name = json_string_value(json_object_get(output, "name"));
        const char *const sha256 = json_string_value(json_object_get(output, "sha256"));
        gsn_auto_mem(char) file = NULL;

        if (!name || !sha256 || strchr(name, '/'))
            continue;
        file = gsn_format("%.*s/%s", (int)(end - run->json_path), run->json_path, name);
        r = file ? gsn_audit_file(store, file, sha256, &why) : no_memory(&why);
        r = tell_failure(found, context, file ? file : name, r, &why, err);
    }
    json_decref(root);
    return r;
}

static int check_report(struct gsn_store *store, const struct gsn_run_row *run,
                        struct gsn_audit_heads *heads, gsn_audit_found *found, void *context,
                        struct gsn_error *err)
{
    struct gsn_error why = { 0 };
    int r;

    if (!run->json_path[0])
        return GSN_OK;
    r = gsn_audit_file(store, run->report_path, run->report_sha256, &why);
    r = tell_failure(found, context, run->report_path, r, &why, err);
    if (r < 0)
        return r;
    r = gsn_audit_file(store, run->json_path, run->json_sha256, &why);
    if (r >= 0)
        r = check_outputs(store, run, found, context, err);
    else
        r = tell_failure(found, context, run->json_path, r, &why, err);
    return r < 0 ? r : check_beside(store, run, heads, found, context, err);
}

int gsn_audit_reports(struct gsn_store *store, int64_t id, struct gsn_audit_heads *heads,
                      gsn_audit_found *found, void *context, struct gsn_error *err)
{
    gsn_auto(gsn_run_rows) runs = NULL;
    int r = gsn_run_list(store, 0, &runs, err);

    for (size_t i = 0; r >= 0 && i < runs->count; i++)
        if (id == 0 || runs->at[i].id == id)
            r = check_report(store, &runs->at[i], heads, found, context, err);
    return r;
}

/* ---- what specimens' jobs say ------------------------------------------------------------- */

static int check_job(const struct gsn_specimen_row *row, gsn_audit_found *found, void *context,
                     struct gsn_error *err)
{
    static const char *const kinds[] = { "sections", "volume", "tile" };
    gsn_auto_mem(char) what = gsn_format("specimen %s", row->name);
    gsn_auto(gsn_protocol) p = NULL;
    struct gsn_error why = { 0 };
    struct gsn_digest digest;
    int r = what ? gsn_sha256(row->job_json, strlen(row->job_json), &digest, err) : no_memory(err);

    if (r < 0)
        return r;
    if (strcmp(digest.hex, row->job_sha256) != 0)
        found(context, what, "its job.json is not the one that was taken in");
    r = gsn_protocol_parse(row->job_json, strlen(row->job_json), &p, &why);
    if (r < 0)
        return tell_failure(found, context, what, r, &why, err);
    if (strcmp(row->name, p->specimen) != 0 || strcmp(row->study, p->study) != 0 ||
        strcmp(row->group, p->group) != 0 || strcmp(row->animal, p->animal) != 0 ||
        strcmp(row->baseline, p->baseline) != 0 || strcmp(row->kind, kinds[p->kind]) != 0 ||
        !(fabs(row->week - p->week) <= 0 || (isnan(row->week) && isnan(p->week))))
        found(context, what,
              "its row contradicts its job.json: name, study, group, animal, week, kind or "
              "baseline");
    return GSN_OK;
}

static int check_jobs(struct gsn_store *store, gsn_audit_found *found, void *context,
                      struct gsn_error *err)
{
    gsn_auto(gsn_specimen_rows) rows = NULL;
    int r = gsn_specimen_list(store, &rows, err);

    for (size_t i = 0; r >= 0 && i < rows->count; i++)
        r = check_job(&rows->at[i], found, context, err);
    return r;
}

/* ---- what lies there and what is known ---------------------------------------------------- */

static int by_digest(const void *a, const void *b)
{
    return strcmp(((const struct gsn_object_row *)a)->sha256,
                  ((const struct gsn_object_row *)b)->sha256);
}

/* Whether a crash may have left it, for its work to be done again. */
static int is_fresh(const char *path)
{
    struct stat st;

    return stat(path, &st) < 0 || time(NULL) - st.st_mtime < CRASH_S;
}

/* A path and what is left of it behind the store's directory: "objects/ab/cdef...". */
struct path {
    char text[PATH_MAX];
    size_t store;
};

static const char *put_path(struct path *path, const struct gsn_store *store, const char *one,
                            const char *two, const char *three)
{
    path->store = strlen(gsn_store_dir(store)) + 1;
    (void)snprintf(path->text, sizeof path->text, "%s/%s/%s%s%s", gsn_store_dir(store), one, two,
                   three ? "/" : "", three ? three : "");
    return path->text;
}

/* objects/ab */
static void check_folder_of_objects(struct gsn_store *store, const char *shelf,
                                    const struct gsn_object_rows *rows, gsn_audit_found *found,
                                    void *context)
{
    struct path path;
    gsn_auto_dir folder = opendir(put_path(&path, store, "objects", shelf, NULL));

    for (const struct dirent *e; folder && (e = readdir(folder));) {
        char sha256[2 + 256];
        struct gsn_object_row key = { .sha256 = sha256 };

        (void)snprintf(sha256, sizeof sha256, "%.2s%.250s", shelf, e->d_name);
        if (e->d_name[0] == '.' || bsearch(&key, rows->at, rows->count, sizeof key, by_digest) ||
            is_fresh(put_path(&path, store, "objects", shelf, e->d_name)))
            continue;
        found(context, path.text + path.store,
              "no row of the store knows it: what it was came in and is forgotten, or it was put "
              "there; look at it, then move it away");
    }
}

/* sizes: whether it is looked at that each is there; not where its bytes are read anyway. */
static int check_objects(struct gsn_store *store, int sizes, gsn_audit_found *found, void *context,
                         struct gsn_error *err)
{
    gsn_auto(gsn_object_rows) rows = NULL;
    struct path all;
    gsn_auto_dir folder = opendir(put_path(&all, store, "objects", ".", NULL));
    int r = gsn_object_list(store, "", INT32_MAX, &rows, err);

    for (size_t i = 0; r >= 0 && sizes && i < rows->count; i++) {
        gsn_auto_mem(char) path = NULL;
        gsn_auto_mem(char) what = gsn_format("object %s", rows->at[i].sha256);
        struct stat st;

        r = what ? gsn_store_object_path(store, rows->at[i].sha256, &path, err) : no_memory(err);
        if (r == GSN_E_INPUT) {
            found(context, "object", err ? err->text : "a row names no object");
            r = GSN_OK;
        } else if (r >= 0 && stat(path, &st) < 0) {
            if (errno == ENOENT)
                found(context, what, "it is lost: a row rests on it and there is no such file");
            else
                r = gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
        } else if (r >= 0 && st.st_size != rows->at[i].size) {
            found(context, what, "its size is not the one it came in with");
        }
    }
    for (const struct dirent *e; r >= 0 && folder && (e = readdir(folder));)
        if (strlen(e->d_name) == 2 && e->d_name[0] != '.')
            check_folder_of_objects(store, e->d_name, rows, found, context);
    return r;
}

static int is_of_a_run(const struct gsn_run_rows *runs, const char *folder)
{
    const size_t length = strlen(folder);

    for (size_t i = 0; i < runs->count; i++)
        if (strncmp(runs->at[i].json_path, folder, length) == 0 &&
            runs->at[i].json_path[length] == '/')
            return 1;
    return 0;
}

/* reports/SPECIMEN/KEY */
static void check_folders_of(struct gsn_store *store, const char *specimen,
                             const struct gsn_run_rows *runs, gsn_audit_found *found, void *context)
{
    struct path path;
    gsn_auto_dir folder = opendir(put_path(&path, store, "reports", specimen, NULL));

    for (const struct dirent *e; folder && (e = readdir(folder));) {
        (void)put_path(&path, store, "reports", specimen, e->d_name);
        if (e->d_name[0] != '.' && strcmp(e->d_name, GSN_LATEST) != 0 &&
            !is_of_a_run(runs, path.text + path.store) && !is_fresh(path.text))
            found(context, path.text + path.store, "no run of the store wrote this report");
    }
}

static int check_report_folders(struct gsn_store *store, gsn_audit_found *found, void *context,
                                struct gsn_error *err)
{
    struct path path;
    gsn_auto_dir folder = opendir(put_path(&path, store, "reports", ".", NULL));
    gsn_auto(gsn_run_rows) runs = NULL;
    const int r = gsn_run_list(store, 0, &runs, err);

    for (const struct dirent *e; r >= 0 && folder && (e = readdir(folder));)
        if (e->d_name[0] != '.')
            check_folders_of(store, e->d_name, runs, found, context);
    return r;
}

int gsn_audit_store(struct gsn_store *store, struct gsn_audit_heads *heads, int sizes,
                    gsn_audit_found *found, void *context, int64_t *ret_events,
                    struct gsn_error *err)
{
    int r = gsn_audit_tables(store, found, context, err);

    if (r >= 0)
        r = gsn_audit_reports(store, 0, heads, found, context, err);
    if (r >= 0)
        r = gsn_audit_log(store, heads->at, heads->count, found, context, ret_events, err);
    if (r >= 0)
        r = gsn_audit_runs(store, 0, found, context, err);
    if (r >= 0)
        r = gsn_audit_ledger(store, found, context, err);
    if (r >= 0)
        r = check_jobs(store, found, context, err);
    if (r >= 0)
        r = check_objects(store, sizes, found, context, err);
    return r < 0 ? r : check_report_folders(store, found, context, err);
}
