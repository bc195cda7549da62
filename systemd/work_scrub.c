/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/work_verbs.h"

#include "storage/actor.h"
#include "systemd/scrub.h"

#include <stdio.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sysexits.h>
#include <unistd.h>

static void say_damaged(void *context, const char *sha256, const char *sentence)
{
    json_t *list = context;

    (void)fprintf(stderr, "gieson: damaged: %s\n", sentence);
    (void)json_array_append_new(
        list, json_pack("{s:s, s:o}", "sha256", sha256, "message", json_string(sentence)));
}

static void print_scrub(const struct gsn_work_request *request, const struct gsn_scrub_counts *c,
                        json_t *damaged)
{
    if (request->json) {
        json_t *root = json_pack("{s:I, s:I, s:b, s:I, s:O}", "checked", (json_int_t)c->checked,
                                 "bytes", (json_int_t)c->bytes, "complete", c->complete,
                                 "round_checked", (json_int_t)c->round_checked, "damaged", damaged);

        (void)json_dumpf(root, stdout, JSON_INDENT(2));
        (void)putchar('\n');
        json_decref(root);
        return;
    }
    (void)printf("%lld objects (%.1f MB) read again, %lld damaged%s\n", (long long)c->checked,
                 1e-6 * (double)c->bytes, (long long)c->damaged,
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
    json_t *damaged = json_array();
    const struct gsn_actor who = gsn_actor_now();
    struct gsn_scrub scrub = {
        .actor = who.name, .minutes = request->minutes, .damaged = say_damaged, .context = damaged
    };
    struct gsn_scrub_counts counts = { 0 };
    struct gsn_error err = { 0 };
    int r = gsn_store_open(request->store_dir, GSN_STORE_WRITE, &store, &err);

    step_back();
    scrub.store = store;
    if (r >= 0)
        r = gsn_scrub_run(&scrub, &counts, &err);
    if (r >= 0)
        print_scrub(request, &counts, damaged);
    json_decref(damaged);
    if (r < 0)
        return gsn_work_complain(&err, r);
    return counts.damaged > 0 ? EX_DATAERR : EX_OK;
}
