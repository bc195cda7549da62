/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verbs of gieson-work that change or check a store: import, work, changed, verify, scrub,
 * backup, restore.
 *
 * Each opens the store, calls the function of the same name in this folder, prints what came of it
 * and returns an exit status of sysexits.h. `work` releases its lease when it is asked to end: a
 * job whose worker dies too often is given up, because it may be what kills them, but a worker that
 * ends because its service was stopped says nothing about its job, and the service may be in no
 * state to say so itself. So a thread waits for SIGTERM, SIGINT and SIGHUP (mathematics does not
 * look for them), puts the job back to waiting and lets the signal end the process. Whom SIGKILL or
 * a fault ends dies with its job. */

#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sysexits.h>
#include <unistd.h>

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"
#include "pipeline/core/process.h"
#include "pipeline/core/sandbox.h"
#include "storage/audit_log.h"
#include "storage/catalog.h"
#include "storage/queue.h"
#include "storage/result.h"
#include "systemd/worker/backup.h"
#include "systemd/worker/import.h"
#include "systemd/worker/job.h"
#include "systemd/worker/scrub.h"
#include "systemd/worker/store_index.h"
#include "systemd/worker/verify.h"
#include "systemd/worker/work_verbs.h"

/* Waits for the signal that ends the worker, and releases the lease of its job. */
struct release_watch {
    struct gsn_store *store; /* the thread's own: a connection is for one */
    sigset_t ends;
    atomic_bool over; /* the signal is ours, to end the thread */
    bool has_thread;
    pthread_t thread;
};

static void release_watch_free(struct release_watch *watch)
{
    if (!watch)
        return;
    if (watch->has_thread) {
        atomic_store(&watch->over, true);
        (void)pthread_kill(watch->thread, SIGTERM);
        (void)pthread_join(watch->thread, NULL);
        (void)pthread_sigmask(SIG_UNBLOCK, &watch->ends, NULL);
    }
    gsn_store_free(watch->store);
    gsn_free(watch);
}

GSN_DEFINE_AUTO(release_watch);

/* Releasing the lease. */

/* Who is started with a signal ignored (nohup, a shell's background) is not to hear it. */
static sigset_t end_signals(void)
{
    static const int people[] = { SIGINT, SIGHUP };
    struct sigaction now;
    sigset_t set;

    (void)sigemptyset(&set);
    (void)sigaddset(&set, SIGTERM);
    for (size_t i = 0; i < sizeof people / sizeof people[0]; i++)
        if (sigaction(people[i], NULL, &now) == 0 && now.sa_handler != SIG_IGN)
            (void)sigaddset(&set, people[i]);
    return set;
}

/* No job, or somebody else's by now, is as good. */
static void release_job(struct gsn_store *store)
{
    gsn_auto(gsn_job_row) job = NULL;
    struct gsn_error quiet = { 0 };

    if (gsn_queue_of_process(store, getpid(), &job, &quiet) >= 0)
        (void)gsn_queue_release(store, job, &quiet);
}

static void *wait_for_signal(void *context)
{
    struct release_watch *const watch = context;
    int signal_number = 0;

    if (sigwait(&watch->ends, &signal_number) != 0 || atomic_load(&watch->over))
        return NULL;
    release_job(watch->store);
    /* Whoever waits for us is to see what ended us. */
    (void)pthread_sigmask(SIG_UNBLOCK, &watch->ends, NULL);
    (void)raise(signal_number);
    return NULL;
}

/* Takes the three signals away from the process, but for SIGINT and SIGHUP where they are ignored;
 * to be called before any other thread is made and before a job is claimed. gives. */
static int release_watch_new(const char *store_dir, struct release_watch **ret_watch,
                             struct gsn_error *err)
{
    gsn_auto(release_watch) watch = gsn_alloc_array(1, sizeof *watch);
    int failure, r;

    if (!watch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a worker's last words");
    watch->ends = end_signals();
    /* Opened now: who is asked to end is waited for. */
    r = gsn_store_open(store_dir, GSN_STORE_WRITE, &watch->store, err);
    if (r < 0)
        return r;
    (void)pthread_sigmask(SIG_BLOCK, &watch->ends, NULL);
    failure = pthread_create(&watch->thread, NULL, wait_for_signal, watch);
    if (failure) {
        (void)pthread_sigmask(SIG_UNBLOCK, &watch->ends, NULL);
        return gsn_fail(err, GSN_E_IO, "a thread could not be started: %s", strerror(failure));
    }
    watch->has_thread = true;
    *ret_watch = gsn_steal(&watch);
    return GSN_OK;
}

/* Who asked, and what was left out, for --json. */
struct left_files {
    const struct gsn_work_request *request;
    json_t *left_out;
};

/* import */

static void say_notice(void *context, const char *name, const char *sentence)
{
    const struct left_files *const left = context;
    gsn_auto_mem(char) before = gsn_format("gieson: %s: ", name);

    gsn_work_print_advice(left->request, stderr, before ? before : "gieson: ", sentence);
}

static void say_left_out(void *context, const char *name, const char *reason, const char *action)
{
    const struct left_files *const left = context;
    gsn_auto_mem(char) before = gsn_format("gieson: %s: not taken: it %s; next: ", name, reason);

    gsn_work_print_advice(left->request, stderr, before ? before : "gieson: ", action);
    (void)json_array_append_new(left->left_out,
                                json_pack("{s:o, s:o, s:o}", "name", gsn_work_text(name), "reason",
                                          gsn_work_text(reason), "action",
                                          gsn_work_advice(left->request, action)));
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
    gsn_work_print(stdout, "%s:", specimen);
    if (counts->taken || counts->again || !counts->attached)
        gsn_work_print(stdout, " %u panel%s taken,", counts->taken, counts->taken == 1 ? "" : "s");
    if (counts->again)
        gsn_work_print(stdout, " %u here already,", counts->again);
    if (counts->attached)
        gsn_work_print(stdout, " %u file%s that the job names,", counts->attached,
                       counts->attached == 1 ? "" : "s");
    if (counts->left_out)
        gsn_work_print(stdout, " %u file%s left out,", counts->left_out,
                       counts->left_out == 1 ? "" : "s");
    gsn_work_print_advice(request, stdout, " ", "`gieson run` does the jobs");
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
    struct left_files left = { request, left_out };
    struct gsn_import import = { .notice = say_notice,
                                 .left_out = say_left_out,
                                 .context = &left,
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

/* The programs a job asks: their paths, or why there is none. */
struct helpers {
    char *mesher, *decoder, *lacks_mesher, *lacks_decoder, owner[64];
};

/* work, changed, verify */

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
        gsn_work_print(stderr,
                       "gieson: this kernel has no Landlock: decoder and mesher are held by "
                       "their list of system calls alone\n");
}

int gsn_work_next(const struct gsn_work_request *request)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(release_watch) watch = NULL;
    __attribute__((cleanup(helpers_done))) struct helpers helpers = { .mesher = NULL };
    struct gsn_job_options how;
    struct gsn_error err = { 0 };
    int r = gsn_store_open(request->store_dir, GSN_STORE_WRITE, &store, &err);

    if (r >= 0)
        r = job_options(request, &helpers, &how, &err);
    if (r >= 0)
        r = release_watch_new(request->store_dir, &watch, &err);
    if (r >= 0) {
        say_walls();
        r = gsn_job_next(store, &how, &err);
        if (r >= 0)
            gsn_audit_write_journal(store);
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
        gsn_work_print(
            stdout,
            "run %lld: verified: the originals give report.json %.16s... and report.html "
            "byte for byte, the files are those, the audit log of %lld events is whole\n",
            (long long)v->run, v->is, (long long)v->events);
    } else {
        gsn_work_print(stdout, "run %lld: NOT the same:\n", (long long)v->run);
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
        r = gsn_job_ask_changed(store, &count, &err);
    return r < 0 ? gsn_work_complain(request, &err, r) : EX_OK;
}

/* Of what was found: the list of damaged objects, and that of findings. */
struct findings_list {
    const struct gsn_work_request *request;
    json_t *damaged, *findings;
};

/* scrub, backup, restore */

static void say_damaged(void *context, const char *sha256, const char *sentence)
{
    const struct findings_list *const list = context;

    gsn_work_print_advice(list->request, stderr, "gieson: damaged: ", sentence);
    (void)json_array_append_new(list->damaged, json_pack("{s:s, s:o}", "sha256", sha256, "message",
                                                         gsn_work_advice(list->request, sentence)));
}

static void say_found(void *context, const char *what, const char *sentence)
{
    const struct findings_list *const list = context;

    gsn_auto_mem(char) before = gsn_format("gieson: damaged: %s: ", what);

    gsn_work_print_advice(list->request, stderr, before ? before : "gieson: damaged: ", sentence);
    (void)json_array_append_new(list->findings,
                                json_pack("{s:o, s:o}", "what", gsn_work_text(what), "message",
                                          gsn_work_advice(list->request, sentence)));
}

static void print_scrub(const struct gsn_work_request *request, const struct gsn_scrub_counts *c,
                        const struct findings_list *list)
{
    if (request->json) {
        json_t *root =
            json_pack("{s:I, s:I, s:b, s:I, s:O, s:O, s:I}", "checked", (json_int_t)c->checked,
                      "bytes", (json_int_t)c->bytes, "complete", c->complete, "round_checked",
                      (json_int_t)c->round_checked, "damaged", list->damaged, "findings",
                      list->findings, "audit_log_events", (json_int_t)c->events);

        (void)json_dumpf(root, stdout, JSON_INDENT(2));
        (void)putchar('\n');
        json_decref(root);
        return;
    }
    gsn_work_print(stdout,
                   "database, reports and an audit log of %lld events looked over, %lld findings\n",
                   (long long)c->events, (long long)c->findings);
    if (!request->quick)
        gsn_work_print(stdout, "%lld objects (%.1f MB) read again, %lld damaged",
                       (long long)c->checked, 1e-6 * (double)c->bytes, (long long)c->damaged);
    if (!request->quick)
        gsn_work_print_advice(request, stdout, "",
                              c->complete ? "" : "; the next `gieson scrub` goes on from here");
}

/* Whoever works or looks at a screen goes first. */
static void step_back(void)
{
    enum { IOPRIO_WHO_PROCESS = 1, IOPRIO_CLASS_IDLE = 3, IOPRIO_CLASS_SHIFT = 13 };

    (void)setpriority(PRIO_PROCESS, 0, PRIO_MAX - 1);
    (void)syscall(SYS_ioprio_set, IOPRIO_WHO_PROCESS, 0, IOPRIO_CLASS_IDLE << IOPRIO_CLASS_SHIFT);
}

int gsn_work_scrub(const struct gsn_work_request *request)
{
    gsn_auto(gsn_store) store = NULL;
    const struct gsn_actor who = gsn_actor_now();
    gsn_auto_heads heads = { .count = 0 };
    struct findings_list list = { request, json_array(), json_array() };
    struct gsn_scrub scrub = { .actor = who.name,
                               .quick = request->quick,
                               .minutes = request->minutes,
                               .heads = &heads,
                               .damaged = say_damaged,
                               .found = say_found,
                               .context = &list };
    struct gsn_scrub_counts counts = { 0 };
    struct gsn_error err = { 0 };
    int r = gsn_store_open(request->store_dir, GSN_STORE_WRITE, &store, &err);

    step_back();
    if (r >= 0 && request->journal)
        r = gsn_audit_read_journal(request->journal, &heads, &err);
    scrub.store = store;
    if (r >= 0)
        r = gsn_scrub_run(&scrub, &counts, &err);
    if (r >= 0) {
        gsn_audit_write_journal(store);
        print_scrub(request, &counts, &list);
    }
    json_decref(list.damaged);
    json_decref(list.findings);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    return counts.damaged > 0 || counts.findings > 0 ? EX_DATAERR : EX_OK;
}

/* ---- a second copy ------------------------------------------------------------------------ */

static void say_why_not(void *context, const char *what, const char *sentence)
{
    (void)context;
    (void)fprintf(stderr, "gieson: damaged: %s: %s\n", what, sentence);
}

static int copy_store(const struct gsn_work_request *request, const char *from, const char *to)
{
    const struct gsn_actor who = gsn_actor_now();
    gsn_auto(gsn_store) store = NULL;
    struct gsn_backup_counts counts;
    struct gsn_error err = { 0 };
    int r = gsn_store_open(from, GSN_STORE_WRITE, &store, &err);

    if (r >= 0)
        r = gsn_backup_make(store, to, who.name, say_why_not, NULL, &counts, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    if (request->json)
        (void)printf("{\"objects\": %lld, \"bytes\": %lld, \"files\": %lld, "
                     "\"audit_log_events\": %lld}\n",
                     (long long)counts.objects, (long long)counts.bytes, (long long)counts.files,
                     (long long)counts.events);
    else
        (void)printf("%s: %lld objects (%.1f MB), %lld files of reports and an audit log of %lld "
                     "events, all read back and the same\n",
                     to, (long long)counts.objects, 1e-6 * (double)counts.bytes,
                     (long long)counts.files, (long long)counts.events);
    return EX_OK;
}

int gsn_work_backup(const struct gsn_work_request *request)
{
    if (request->rest_count != 1)
        return gsn_work_usage(request,
                              "backup where? Say `gieson backup FOLDER`, a new or an empty one");
    return copy_store(request, request->store_dir, request->rest[0]);
}

/* The front page and reports/SPECIMEN/latest, which a backup does not hold. */
static int lay_index(const struct gsn_work_request *request)
{
    gsn_auto(gsn_store) store = NULL;
    struct gsn_error err = { 0 };
    int r = gsn_store_open(request->store_dir, GSN_STORE_WRITE, &store, &err);

    if (r >= 0)
        r = gsn_store_index_write(store, &err);
    return r < 0 ? gsn_work_complain(request, &err, r) : EX_OK;
}

int gsn_work_restore(const struct gsn_work_request *request)
{
    int code;

    if (request->rest_count != 1)
        return gsn_work_usage(request,
                              "restore from where? Say `gieson --store NEW restore FOLDER`");
    code = copy_store(request, request->rest[0], request->store_dir);
    return code == EX_OK ? lay_index(request) : code;
}
