/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/work_verbs.h"

#include "pipeline/core/process.h"
#include "pipeline/core/sandbox.h"
#include "storage/catalog.h"
#include "storage/result.h"
#include "systemd/give_back.h"
#include "systemd/job.h"
#include "systemd/night.h"
#include "systemd/verify.h"

#include <stdio.h>
#include <sysexits.h>
#include <unistd.h>

/* The programs a job asks: their paths, or why there is none. */
struct helpers {
    char *mesher, *decoder, *lacks_mesher, *lacks_decoder, owner[64];
};

static void helpers_done(struct helpers *helpers)
{
    gsn_free(helpers->mesher);
    gsn_free(helpers->decoder);
    gsn_free(helpers->lacks_mesher);
    gsn_free(helpers->lacks_decoder);
}

/* One that is not there costs the jobs that need it, not the queue. */
static int find_helper(const char *name, char **ret_path, char **ret_lacks, struct gsn_error *err)
{
    struct gsn_error why = { 0 };
    const int r = gsn_process_sibling(name, ret_path, &why);

    if (r != GSN_E_NOTFOUND)
        return r < 0 ? gsn_fail(err, r, "%s", why.text) : r;
    *ret_lacks = gsn_format("%s; install gieson again with all its programs (apt-get install "
                            "--reinstall gieson), then `gieson retry`",
                            why.text);
    return *ret_lacks ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory");
}

static int job_options(const struct gsn_work_request *request, struct helpers *helpers,
                       struct gsn_job_options *ret_options, struct gsn_error *err)
{
    int r = find_helper("gieson-mesh", &helpers->mesher, &helpers->lacks_mesher, err);

    if (r >= 0)
        r = find_helper("gieson-decode", &helpers->decoder, &helpers->lacks_decoder, err);
    if (r < 0)
        return r;
    (void)snprintf(helpers->owner, sizeof helpers->owner, "gieson-work %ld", (long)getpid());
    *ret_options = (struct gsn_job_options){ .mesher = helpers->mesher,
                                             .decoder = helpers->decoder,
                                             .lacks_mesher = helpers->lacks_mesher,
                                             .lacks_decoder = helpers->lacks_decoder,
                                             .owner = helpers->owner,
                                             .threads = request->threads };
    return GSN_OK;
}

/* A wall that is not there must not go unnoticed. */
static void say_walls(void)
{
    if (gsn_sandbox_landlock() == 0)
        gsn_work_say(stderr, "gieson: this kernel has no Landlock: decoder and mesher are held by "
                             "their list of system calls alone\n");
}

int gsn_work_next(const struct gsn_work_request *request)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_give_back) watch = NULL;
    __attribute__((cleanup(helpers_done))) struct helpers helpers = { .mesher = NULL };
    struct gsn_job_options how;
    struct gsn_error err = { 0 };
    int r = gsn_store_open(request->store_dir, GSN_STORE_WRITE, &store, &err);

    if (r >= 0)
        r = job_options(request, &helpers, &how, &err);
    if (r >= 0)
        r = gsn_give_back_new(request->store_dir, &watch, &err);
    if (r >= 0) {
        say_walls();
        r = gsn_job_next(store, &how, &err);
        if (r >= 0)
            gsn_audit_tell_journal(store);
    }
    if (r == GSN_E_NOTFOUND || r == GSN_E_BUSY)
        return gsn_code_exit(r);
    return r < 0 ? gsn_work_complain(request, &err, r) : EX_OK;
}

/* A run by its number, or the latest of a specimen by its name. */
static int find_run(struct gsn_store *store, const char *text, int64_t *ret_run,
                    struct gsn_error *err)
{
    gsn_auto(gsn_specimen_row) specimen = NULL;
    gsn_auto(gsn_run_row) run = NULL;
    struct gsn_error quiet = { 0 };
    json_t *number = gsn_work_number(text);
    int r = gsn_specimen_get(store, text, &specimen, &quiet);

    if (r < 0 && json_is_integer(number)) {
        *ret_run = json_integer_value(number);
        json_decref(number);
        return GSN_OK;
    }
    json_decref(number);
    if (r < 0)
        return gsn_fail(err, r, "%s", quiet.text);
    r = gsn_run_latest(store, specimen->id, NULL, &run, err);
    if (r >= 0)
        *ret_run = run->id;
    return r;
}

static void hear_finding(void *context, const char *what, const char *sentence)
{
    (void)json_array_append_new(context, json_pack("{s:o, s:o}", "what", gsn_work_text(what),
                                                   "message", gsn_work_text(sentence)));
}

static void print_findings(const json_t *findings)
{
    for (size_t i = 0; i < json_array_size(findings); i++) {
        const json_t *const f = json_array_get(findings, i);

        (void)printf("  %s: %s\n", json_string_value(json_object_get(f, "what")),
                     json_string_value(json_object_get(f, "message")));
    }
}

static int print_verdict(const struct gsn_work_request *request, const struct gsn_verdict *v,
                         json_t *findings)
{
    const int same = v->findings == 0;

    if (request->json) {
        json_t *root =
            json_pack("{s:I, s:b, s:b, s:b, s:b, s:b, s:I, s:b, s:I, s:s, s:s, s:O}", "run",
                      (json_int_t)v->run, "verified", same, "same_inputs", v->same_inputs,
                      "same_json", v->same_json, "same_html", v->same_html, "diary_whole",
                      v->whole_log, "diary_events", (json_int_t)v->events, "audit_log_whole",
                      v->whole_log, "audit_log_events", (json_int_t)v->events, "json_sha256_was",
                      v->was, "json_sha256_is", v->is, "findings", findings);

        (void)json_dumpf(root, stdout, JSON_INDENT(2));
        (void)putchar('\n');
        json_decref(root);
    } else if (same) {
        gsn_work_say(stdout,
                     "run %lld: verified: the originals give report.json %.16s... and report.html "
                     "byte for byte, the files are those, the audit log of %lld events is whole\n",
                     (long long)v->run, v->is, (long long)v->events);
    } else {
        gsn_work_say(stdout, "run %lld: NOT the same:\n", (long long)v->run);
        print_findings(findings);
    }
    return same ? EX_OK : 1;
}

int gsn_work_verify(const struct gsn_work_request *request)
{
    gsn_auto(gsn_store) store = NULL;
    __attribute__((cleanup(helpers_done))) struct helpers helpers = { .mesher = NULL };
    gsn_auto_heads heads = { .count = 0 };
    struct gsn_job_options how;
    json_t *findings = json_array();
    struct gsn_verify verify = {
        .options = &how, .heads = &heads, .found = hear_finding, .context = findings
    };
    struct gsn_verdict verdict;
    struct gsn_error err = { 0 };
    int r, status;

    if (request->rest_count != 1)
        return gsn_work_usage(request, "verify needs one run number or specimen");
    r = gsn_store_open(request->store_dir, GSN_STORE_WRITE, &store, &err);
    if (r >= 0 && request->journal)
        r = gsn_audit_read_journal(request->journal, &heads, &err);
    if (r >= 0)
        r = find_run(store, request->rest[0], &verify.run, &err);
    if (r >= 0)
        r = job_options(request, &helpers, &how, &err);
    verify.store = store;
    if (r >= 0)
        r = gsn_verify_run(&verify, &verdict, &err);
    /* What was found before it failed is not lost with it. */
    if (r < 0)
        print_findings(findings);
    status =
        r < 0 ? gsn_work_complain(request, &err, r) : print_verdict(request, &verdict, findings);
    json_decref(findings);
    return status;
}

int gsn_work_changed(const struct gsn_work_request *request)
{
    gsn_auto(gsn_store) store = NULL;
    struct gsn_error err = { 0 };
    size_t count;
    int r = gsn_store_open(request->store_dir, GSN_STORE_WRITE, &store, &err);

    if (r >= 0)
        r = gsn_night_ask(store, &count, &err);
    return r < 0 ? gsn_work_complain(request, &err, r) : EX_OK;
}
