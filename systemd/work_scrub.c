/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/work_verbs.h"

#include "storage/actor.h"
#include "systemd/backup.h"
#include "systemd/scrub.h"

#include <stdio.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sysexits.h>
#include <unistd.h>

/* Of what was found: the list of damaged objects, and that of findings. */
struct told {
    const struct gsn_work_request *request;
    json_t *damaged, *findings;
};

static void say_damaged(void *context, const char *sha256, const char *sentence)
{
    const struct told *const told = context;

    gsn_work_tell(told->request, stderr, "gieson: damaged: ", sentence);
    (void)json_array_append_new(told->damaged, json_pack("{s:s, s:o}", "sha256", sha256, "message",
                                                         gsn_work_advice(told->request, sentence)));
}

static void say_found(void *context, const char *what, const char *sentence)
{
    const struct told *const told = context;

    gsn_auto_mem(char) before = gsn_format("gieson: damaged: %s: ", what);

    gsn_work_tell(told->request, stderr, before ? before : "gieson: damaged: ", sentence);
    (void)json_array_append_new(told->findings,
                                json_pack("{s:o, s:o}", "what", gsn_work_text(what), "message",
                                          gsn_work_advice(told->request, sentence)));
}

static void print_scrub(const struct gsn_work_request *request, const struct gsn_scrub_counts *c,
                        const struct told *told)
{
    if (request->json) {
        json_t *root =
            json_pack("{s:I, s:I, s:b, s:I, s:O, s:O, s:I}", "checked", (json_int_t)c->checked,
                      "bytes", (json_int_t)c->bytes, "complete", c->complete, "round_checked",
                      (json_int_t)c->round_checked, "damaged", told->damaged, "findings",
                      told->findings, "audit_log_events", (json_int_t)c->events);

        (void)json_dumpf(root, stdout, JSON_INDENT(2));
        (void)putchar('\n');
        json_decref(root);
        return;
    }
    gsn_work_say(stdout,
                 "database, reports and an audit log of %lld events looked over, %lld findings\n",
                 (long long)c->events, (long long)c->findings);
    if (!request->quick)
        gsn_work_say(stdout, "%lld objects (%.1f MB) read again, %lld damaged",
                     (long long)c->checked, 1e-6 * (double)c->bytes, (long long)c->damaged);
    if (!request->quick)
        gsn_work_tell(request, stdout, "",
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
    struct told told = { request, json_array(), json_array() };
    struct gsn_scrub scrub = { .actor = who.name,
                               .quick = request->quick,
                               .minutes = request->minutes,
                               .heads = &heads,
                               .damaged = say_damaged,
                               .found = say_found,
                               .context = &told };
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
        gsn_audit_tell_journal(store);
        print_scrub(request, &counts, &told);
    }
    json_decref(told.damaged);
    json_decref(told.findings);
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

int gsn_work_restore(const struct gsn_work_request *request)
{
    if (request->rest_count != 1)
        return gsn_work_usage(request,
                              "restore from where? Say `gieson --store NEW restore FOLDER`");
    return copy_store(request, request->rest[0], request->store_dir);
}
