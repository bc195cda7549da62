/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/work_verbs.h"

#include "storage/actor.h"
#include "storage/event.h"
#include "systemd/import.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sysexits.h>
#include <unistd.h>

/* Who asked, and what was left out, for --json. */
struct told {
    const struct gsn_work_request *request;
    json_t *left_out;
};

static void say_notice(void *context, const char *name, const char *sentence)
{
    const struct told *const told = context;
    gsn_auto_mem(char) before = gsn_format("gieson: %s: ", name);

    gsn_work_tell(told->request, stderr, before ? before : "gieson: ", sentence);
}

static void say_left_out(void *context, const char *name, const char *reason, const char *action)
{
    const struct told *const told = context;
    gsn_auto_mem(char) before = gsn_format("gieson: %s: not taken: it %s; next: ", name, reason);

    gsn_work_tell(told->request, stderr, before ? before : "gieson: ", action);
    (void)json_array_append_new(told->left_out,
                                json_pack("{s:o, s:o, s:o}", "name", gsn_work_text(name), "reason",
                                          gsn_work_text(reason), "action",
                                          gsn_work_advice(told->request, action)));
}

static const char *base_name(const char *path)
{
    const char *slash = strrchr(path, '/');

    return slash ? slash + 1 : path;
}

/* The job of a single file: what the command states, and nothing that nobody did. gives. */
static char *job_for_file(const struct gsn_work_request *request, const char *file)
{
    const char *name = base_name(file);
    const char *dot = strrchr(name, '.');
    gsn_auto_mem(char) stem = gsn_format("%.*s", dot ? (int)(dot - name) : (int)strlen(name), name);
    json_t *job = json_pack("{s:s, s:s, s:s}", "specimen",
                            request->specimen ? request->specimen : (stem ? stem : name), "kind",
                            request->volume ? "volume" : "tile", "file", name);
    char *dumped, *text;

    if (request->thresholds)
        (void)json_object_set(job, "thresholds", request->thresholds);
    if (request->volume && request->spacing_unit)
        (void)json_object_set_new(job, "spacing_unit", json_string(request->spacing_unit));
    if (request->tile && request->reference)
        (void)json_object_set_new(job, "reference", json_string(base_name(request->reference)));
    dumped = json_dumps(job, JSON_INDENT(2) | JSON_REAL_PRECISION(9));
    text = dumped ? gsn_strdup(dumped) : NULL;
    free(dumped); /* door */
    json_decref(job);
    return text;
}

static void print_import(const struct gsn_work_request *request, const char *specimen,
                         const struct gsn_import_counts *counts, json_t *left_out)
{
    if (request->json) {
        json_t *root =
            json_pack("{s:s, s:i, s:i, s:i, s:i, s:O}", "specimen", specimen, "panels_taken",
                      counts->taken, "panels_again", counts->again, "panels_unnumbered",
                      counts->held, "files", counts->attached, "left_out", left_out);

        (void)json_dumpf(root, stdout, JSON_INDENT(2));
        (void)putchar('\n');
        json_decref(root);
        return;
    }
    gsn_work_say(stdout, "%s:", specimen);
    if (counts->taken || counts->again || !counts->attached)
        gsn_work_say(stdout, " %u panel%s taken,", counts->taken, counts->taken == 1 ? "" : "s");
    if (counts->again)
        gsn_work_say(stdout, " %u here already,", counts->again);
    if (counts->attached)
        gsn_work_say(stdout, " %u file%s that the job names,", counts->attached,
                     counts->attached == 1 ? "" : "s");
    if (counts->left_out)
        gsn_work_say(stdout, " %u file%s left out,", counts->left_out,
                     counts->left_out == 1 ? "" : "s");
    gsn_work_tell(request, stdout, " ", "`gieson run` works the queue");
}

static int is_file(const char *path)
{
    struct stat what;

    return stat(path, &what) == 0 && S_ISREG(what.st_mode);
}

/* The service tells files that are left out by itself; it asks whether it may not read the rest. */
static int end_import(const struct gsn_work_request *request, const struct gsn_error *err, int code)
{
    const int status = gsn_work_complain(request, err, code);

    return request->served && code == GSN_E_DENIED ? EX_NOPERM : status;
}

int gsn_work_import(const struct gsn_work_request *request)
{
    const char *file = request->volume ? request->volume : request->tile;
    const struct gsn_actor who = gsn_actor_now();
    gsn_auto_mem(char) folder = NULL;
    gsn_auto_mem(char) job = NULL;
    gsn_auto_mem(char) specimen = NULL;
    gsn_auto(gsn_store) store = NULL;
    __attribute__((cleanup(json_decrefp))) json_t *left_out = json_array();
    struct told told = { request, left_out };
    struct gsn_import import = { .notice = say_notice,
                                 .left_out = say_left_out,
                                 .context = &told,
                                 .replace = request->replace,
                                 .served = request->served };
    struct gsn_import_counts counts;
    struct gsn_error err = { 0 };
    int r;

    if (!file && request->rest_count != 1)
        return gsn_work_usage(request, "import needs one folder");
    if (file) {
        const int length = (int)(base_name(file) - file);

        folder = length ? gsn_format("%.*s", length > 1 ? length - 1 : 1, file) : gsn_strdup(".");
        job = job_for_file(request, file);
    } else {
        folder = gsn_strdup(request->rest[0]);
    }
    if (!folder || (file && !job))
        return gsn_work_usage(request, "out of memory");
    if (file && access(file, F_OK) < 0) {
        (void)gsn_fail(&err, GSN_E_NOTFOUND, "there is no file %s", file);
        return gsn_work_complain(request, &err, GSN_E_NOTFOUND);
    }
    if (!file && is_file(folder)) {
        (void)gsn_fail(&err, GSN_E_INPUT,
                       "%s is a file: import the folder that it lies in, with its job.json, or say "
                       "`gieson import --tile %s`",
                       folder, folder);
        return gsn_work_complain(request, &err, GSN_E_INPUT);
    }
    r = gsn_store_open(request->store_dir, GSN_STORE_CREATE, &store, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    import.store = store;
    import.dir = folder;
    import.job_text = job;
    import.actor = who.name;
    r = gsn_import_folder(&import, &specimen, &counts, &err);
    if (r < 0)
        return end_import(request, &err, r);
    print_import(request, specimen, &counts, left_out);
    return counts.left_out && !request->served ? EX_NOPERM : EX_OK;
}
