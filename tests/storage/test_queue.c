/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/queue.h"

#include <math.h>
#include <signal.h>
#include <sqlite3.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "tests/storage/bench.h"

enum { LEASE = 60 };

static int64_t add(struct gsn_store *store, int64_t specimen, int64_t panel)
{
    struct gsn_error err = { 0 };
    int64_t id = 0;

    CHECK_OK(gsn_queue_add(store, specimen, panel, &id, &err), err);
    return id;
}

static struct gsn_job_row *claim_as(struct gsn_store *store, pid_t pid, int64_t now)
{
    struct gsn_job_row *job = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_queue_claim(store, "worker", pid, LEASE, now, &job, &err), err);
    return job;
}

static struct gsn_job_row *claim(struct gsn_store *store)
{
    return claim_as(store, getpid(), NOON);
}

/* Claims, checks that it is this one, and does it. */
static void does(struct gsn_store *store, int64_t id)
{
    gsn_auto(gsn_job_row) job = claim(store);
    struct gsn_error err = { 0 };

    if (job->id != id)
        fail_msg("job %lld came, not %lld", (long long)job->id, (long long)id);
    CHECK_OK(gsn_queue_done(store, job, &err), err);
}

static void gives_none(struct gsn_store *store, int64_t now, int code, const char *sentence)
{
    struct gsn_job_row *job = NULL;
    struct gsn_error err = { 0 };
    const int r = gsn_queue_claim(store, "w", getpid(), LEASE, now, &job, &err);

    if (r != code || !strstr(err.text, sentence))
        fail_msg("claiming gave %d (%s), not %d (%s)", r, err.text, code, sentence);
    CHECK(job == NULL);
}

TEST(an_empty_queue_says_so)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    gives_none(store, NOON, GSN_E_NOTFOUND, "the queue is empty");
}

TEST(panels_go_first_by_id_then_specimens_after_their_baseline)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t treated = bench_add_specimen(store, "S02", "treated", "S00");
    const int64_t control = bench_add_specimen(store, "S00", "control", "");
    const int64_t jobs[4] = { add(store, treated, 0), add(store, control, 0),
                              add(store, treated, bench_add_panel(store, treated, 1)),
                              add(store, control, bench_add_panel(store, control, 1)) };

    does(store, jobs[2]);
    does(store, jobs[3]);
    does(store, jobs[1]);
    does(store, jobs[0]);
    gives_none(store, NOON, GSN_E_NOTFOUND, "the queue is empty");
}

TEST(a_claimed_job_tells_whose_it_is)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t panel = bench_add_panel(store, specimen, 1);
    const int64_t id = add(store, specimen, panel);
    gsn_auto(gsn_job_row) job = claim(store);

    CHECK(job->id == id && job->specimen_id == specimen && job->panel_id == panel);
    CHECK(strcmp(job->kind, "panel") == 0 && strcmp(job->state, "running") == 0);
    CHECK(strcmp(job->specimen, "S") == 0 && strcmp(job->panel, "P.tif") == 0);
    CHECK(strcmp(job->owner, "worker") == 0 && job->pid == getpid());
    CHECK(job->lease_until == NOON + LEASE && job->attempts == 0 && job->claim == 1);
    CHECK(job->eta_s != job->eta_s);
}

TEST(a_specimen_waits_for_its_own_running_panels)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    struct gsn_error err = { 0 };
    const int64_t whole = add(store, specimen, 0);

    (void)add(store, specimen, bench_add_panel(store, specimen, 1));
    gsn_auto(gsn_job_row) panel = claim(store);

    gives_none(store, NOON, GSN_E_BUSY, "1 waiting for 1 running");
    /* A panel that failed is no longer waited for: the rest of the specimen goes on. */
    CHECK_OK(gsn_queue_fail(store, panel, GSN_E_INPUT, "cut off", &err), err);
    does(store, whole);
}

TEST(the_order_of_asking_lets_no_specimen_pass_its_panel)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    struct gsn_error err = { 0 };

    (void)add(store, specimen, bench_add_panel(store, specimen, 1));
    const int64_t whole = add(store, specimen, 0);
    gsn_auto(gsn_job_row) panel = claim(store);

    gives_none(store, NOON, GSN_E_BUSY, "1 waiting for 1 running");
    CHECK_OK(gsn_queue_done(store, panel, &err), err);
    does(store, whole);
}

TEST(a_baseline_may_be_a_group_of_the_same_study)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t treated = bench_add_specimen(store, "T", "treated", "control");
    const int64_t c1 = bench_add_specimen(store, "C1", "control", "");
    const int64_t c2 = bench_add_specimen(store, "C2", "control", "");
    const int64_t jobs[3] = { add(store, treated, 0), add(store, c1, 0), add(store, c2, 0) };
    struct gsn_error err = { 0 };

    does(store, jobs[1]);
    gsn_auto(gsn_job_row) second = claim(store);

    CHECK(second->id == jobs[2]);
    gives_none(store, NOON, GSN_E_BUSY, "waiting for");
    CHECK_OK(gsn_queue_done(store, second, &err), err);
    does(store, jobs[0]);
}

TEST(a_circle_of_baselines_does_not_stand_still)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t a = bench_add_specimen(store, "A", "g", "B");
    const int64_t b = bench_add_specimen(store, "B", "g", "A");
    const int64_t self = bench_add_specimen(store, "self", "g", "self");
    const int64_t group = bench_add_specimen(store, "group", "h", "h");
    const int64_t jobs[4] = { add(store, b, 0), add(store, a, 0), add(store, self, 0),
                              add(store, group, 0) };

    for (size_t i = 0; i < 4; i++)
        does(store, jobs[i]);
}

/* Case 67. */
TEST(asking_twice_is_asking_once)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t id = add(store, specimen, 0);
    struct gsn_job_counts counts;
    struct gsn_error err = { 0 };

    CHECK(add(store, specimen, 0) == id);
    does(store, id);
    CHECK_OK(gsn_queue_counts(store, &counts, &err), err);
    CHECK(counts.done == 1 && counts.waiting == 0);
    CHECK(add(store, specimen, 0) == id); /* done before, wanted again */
    does(store, id);
}

TEST(a_running_job_asked_for_again_is_redone)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t id = add(store, specimen, 0);
    struct gsn_error err = { 0 };
    gsn_auto(gsn_job_row) job = claim(store);

    CHECK(add(store, specimen, 0) == id);
    CHECK_OK(gsn_queue_done(store, job, &err), err);
    gsn_auto(gsn_job_row) anew = claim(store);

    CHECK(anew->id == id && anew->again == 0 && anew->claim == 2);
    CHECK(add(store, specimen, 0) == id);
    CHECK_OK(gsn_queue_fail(store, anew, GSN_E_FIT, "no", &err), err);
    does(store, id);
    gives_none(store, NOON, GSN_E_NOTFOUND, "empty");
}

TEST(what_does_not_exist_cannot_be_asked_for)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t other = bench_add_specimen(store, "T", "g", "");
    const int64_t panel = bench_add_panel(store, other, 1);
    struct gsn_error err = { 0 };
    int64_t id = -7;

    CHECK(gsn_queue_add(store, 99, 0, &id, &err) == GSN_E_INPUT);
    CHECK(gsn_queue_add(store, specimen, 99, &id, &err) == GSN_E_INPUT);
    CHECK(gsn_queue_add(store, specimen, panel, &id, &err) == GSN_E_INPUT);
    CHECK(id == -7);
}

TEST(progress_is_seen_by_others_and_renews_the_lease)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_store) reader = bench_open(&scratch, GSN_STORE_READ);
    gsn_auto(gsn_job_rows) seen = NULL;
    struct gsn_error err = { 0 };

    (void)add(store, bench_add_specimen(store, "S", "g", ""), 0);
    gsn_auto(gsn_job_row) job = claim(store);

    CHECK_OK(gsn_queue_progress(store, job, "fit", 3, 10, 12.5, NOON + 50, &err), err);
    CHECK_OK(gsn_queue_list(reader, &seen, &err), err);
    CHECK(seen->count == 1 && strcmp(seen->at[0].stage, "fit") == 0);
    CHECK(seen->at[0].done == 3 && seen->at[0].total == 10);
    CHECK_NEAR(seen->at[0].eta_s, 12.5, 0);
    CHECK(seen->at[0].lease_until == NOON + 50 + LEASE);
    gives_none(store, NOON + 109, GSN_E_BUSY, "only running jobs");
    CHECK_OK(gsn_queue_progress(store, job, "fit", 4, 10, NAN, NOON + 109, &err), err);
}

TEST(a_lease_that_runs_out_frees_the_job_and_its_old_owner_is_told)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    (void)add(store, bench_add_specimen(store, "S", "g", ""), 0);
    gsn_auto(gsn_job_row) old = claim(store);

    gives_none(store, NOON + LEASE - 1, GSN_E_BUSY, "only running jobs");
    gsn_auto(gsn_job_row) anew = claim_as(store, getpid(), NOON + LEASE);

    CHECK(anew->id == old->id && anew->attempts == 1 && anew->claim == 2);
    CHECK(gsn_queue_progress(store, old, "fit", 1, 2, 1, NOON, &err) == GSN_E_BUSY);
    CHECK(gsn_queue_done(store, old, &err) == GSN_E_BUSY);
    CHECK(gsn_queue_fail(store, old, GSN_E_FIT, "x", &err) == GSN_E_BUSY);
    CHECK_OK(gsn_queue_done(store, anew, &err), err);
}

/* Case 58. The worker lives and its lease has time left: only the date was put right. */
TEST(a_clock_that_is_set_takes_no_job_away)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct timespec up;

    CHECK(clock_gettime(CLOCK_BOOTTIME, &up) == 0);
    CHECK(llabs(gsn_queue_clock() - (int64_t)up.tv_sec) <= 1);
    (void)add(store, bench_add_specimen(store, "S", "g", ""), 0);
    gsn_auto(gsn_job_row) job = claim_as(store, getpid(), gsn_queue_clock());
    gives_none(store, gsn_queue_clock(), GSN_E_BUSY, "only running jobs");
}

/* What another start of the machine counted, or a store of the days when leases went by the date.
 */
TEST(a_lease_that_ends_too_late_to_be_of_this_clock_is_taken_back)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    (void)add(store, bench_add_specimen(store, "S", "g", ""), 0);
    gsn_auto(gsn_job_row) old = claim_as(store, getpid(), NOON);

    gives_none(store, NOON, GSN_E_BUSY, "only running jobs");
    gsn_auto(gsn_job_row) anew = claim_as(store, getpid(), NOON - 1);
    CHECK(anew->id == old->id && anew->attempts == 0);
}

TEST(the_job_of_a_killed_process_is_free_at_once)
{
    scratch_auto scratch = gsn_scratch_new();
    const pid_t child = fork();

    if (child == 0) {
        for (;;)
            (void)pause();
    }

    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t id = add(store, bench_add_specimen(store, "S", "g", ""), 0);
    gsn_auto(gsn_job_row) job = claim_as(store, child, NOON);
    siginfo_t gone;

    gives_none(store, NOON, GSN_E_BUSY, "only running jobs");
    CHECK(kill(child, SIGKILL) == 0);
    /* Dead, though not yet reaped. */
    CHECK(waitid(P_PID, (id_t)child, &gone, WEXITED | WNOWAIT) == 0);
    gsn_auto(gsn_job_row) anew = claim(store);

    CHECK(anew->id == id && anew->attempts == 1);
    CHECK(waitpid(child, NULL, 0) == child);
}

static void frees(const char *edit, int freed)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    (void)add(store, bench_add_specimen(store, "S", "g", ""), 0);
    gsn_auto(gsn_job_row) job = claim(store);

    CHECK(bench_raw(&scratch, edit) == SQLITE_OK);
    if (freed)
        gsn_job_row_free(claim(store));
    else
        gives_none(store, NOON, GSN_E_BUSY, "only running jobs");
}

TEST(an_owner_is_known_by_boot_and_start_and_not_by_its_number_alone)
{
    frees("UPDATE job SET pid_start = pid_start + 1", 1); /* the number was given out again */
    frees("UPDATE job SET boot = 'an earlier one'", 1);
    frees("UPDATE job SET pid = 4194305, processes = 'of a container'", 0);
    frees("UPDATE job SET pid = 4194305, boot = ''", 0);
    frees("UPDATE job SET pid = 4194305", 1); /* above any number Linux gives */
}

TEST(a_job_that_is_given_back_waits_again_and_no_death_is_counted)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    gsn_auto(gsn_job_row) none = NULL;
    struct gsn_error err = { 0 };

    (void)add(store, specimen, 0);
    for (int i = 0; i < 2 * GSN_QUEUE_DEATHS; i++) {
        gsn_auto(gsn_job_row) job = claim(store);
        gsn_auto(gsn_job_row) found = NULL;

        CHECK_OK(gsn_queue_of_process(store, getpid(), &found, &err), err);
        CHECK(found->id == job->id && found->claim == job->claim && found->attempts == 0);
        CHECK_OK(gsn_queue_release(store, job, &err), err);
        CHECK(gsn_queue_release(store, job, &err) == GSN_E_BUSY);
    }
    CHECK(gsn_queue_of_process(store, getpid(), &none, &err) == GSN_E_NOTFOUND && none == NULL);
}

TEST(after_five_deaths_a_job_is_given_up_until_somebody_retries)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_job_rows) rows = NULL;
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t id = add(store, specimen, 0);
    struct gsn_error err = { 0 };
    size_t count = 99;

    for (int64_t death = 0; death < GSN_QUEUE_DEATHS; death++) {
        gsn_auto(gsn_job_row) job = claim_as(store, getpid(), NOON + death * LEASE);

        CHECK(job->attempts == death);
    }
    gives_none(store, NOON + GSN_QUEUE_DEATHS * LEASE, GSN_E_NOTFOUND, "empty");
    CHECK_OK(gsn_queue_list(store, &rows, &err), err);
    CHECK(strcmp(rows->at[0].state, "failed") == 0 && strcmp(rows->at[0].code, "process") == 0);
    CHECK(strcmp(rows->at[0].message, "the worker died 5 times") == 0);
    CHECK_OK(gsn_queue_retry(store, specimen + 1, &count, &err), err);
    CHECK(count == 0);
    CHECK_OK(gsn_queue_retry(store, specimen, &count, &err), err);
    CHECK(count == 1);
    does(store, id);
    CHECK_OK(gsn_queue_retry(store, 0, &count, &err), err);
    CHECK(count == 0); /* what is done is not retried */
}

/* The job is in no hurry: the power fails more often than a job may kill its worker. */
TEST(a_power_cut_is_no_death_of_the_job_and_deaths_between_two_cuts_still_are)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t id = add(store, bench_add_specimen(store, "S", "g", ""), 0);

    for (int64_t cut = 0; cut <= 2 * GSN_QUEUE_DEATHS; cut++) {
        /* Later than the lease as well: the machine was without power for longer. */
        gsn_auto(gsn_job_row) job = claim_as(store, getpid(), NOON + cut * LEASE);

        CHECK(job->id == id && job->attempts == 0 && job->claim == cut + 1);
        CHECK(bench_raw(&scratch, "UPDATE job SET boot = 'an earlier one'") == SQLITE_OK);
    }
    gsn_job_row_free(claim(store));
    CHECK(bench_raw(&scratch, "UPDATE job SET pid_start = pid_start + 1") == SQLITE_OK);
    gsn_auto(gsn_job_row) died = claim(store);

    CHECK(died->attempts == 1);
    CHECK(bench_raw(&scratch, "UPDATE job SET boot = 'an earlier one'") == SQLITE_OK);
    gsn_auto(gsn_job_row) anew = claim(store);
    CHECK(anew->attempts == 1); /* neither counted nor forgiven */
}

TEST(a_failed_job_keeps_its_sentence)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_job_rows) rows = NULL;
    struct gsn_job_counts counts;
    struct gsn_error err = { 0 };

    (void)add(store, bench_add_specimen(store, "S", "g", ""), 0);
    gsn_auto(gsn_job_row) job = claim(store);

    CHECK_OK(gsn_queue_fail(store, job, GSN_E_MARKERS, "section 3: 2 marks", &err), err);
    CHECK_OK(gsn_queue_list(store, &rows, &err), err);
    CHECK(strcmp(rows->at[0].message, "section 3: 2 marks") == 0);
    CHECK(strcmp(rows->at[0].code, "markers") == 0 && rows->at[0].pid == 0);
    CHECK_OK(gsn_queue_counts(store, &counts, &err), err);
    CHECK(counts.failed == 1 && counts.running == 0);
}

enum { PANELS = 40, CHILDREN = 3 };

struct share {
    const char *dir;
    int out;
};

/* Claims and does until the queue is empty, and writes down what it did. */
static int work(void *context)
{
    const struct share *const share = context;
    gsn_auto(gsn_store) store = NULL;

    if (gsn_store_open(share->dir, GSN_STORE_WRITE, &store, NULL) < 0)
        return 1;
    for (;;) {
        gsn_auto(gsn_job_row) job = NULL;
        const int r = gsn_queue_claim(store, "w", getpid(), LEASE, NOON, &job, NULL);

        if (r == GSN_E_NOTFOUND || r == GSN_E_BUSY)
            return 0;
        if (r < 0 || gsn_queue_done(store, job, NULL) < 0 ||
            write(share->out, &job->id, sizeof job->id) != sizeof job->id)
            return 2;
    }
}

TEST(several_workers_share_the_queue_and_none_does_anothers_job)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_scratch_child child[CHILDREN];
    struct share share = { scratch.dir, -1 };
    int pipes[2], done[PANELS + 1] = { 0 };
    int64_t id;

    CHECK(pipe(pipes) == 0);
    share.out = pipes[1];
    for (int i = 0; i < CHILDREN; i++)
        child[i] = gsn_scratch_start(0, work, &share);
    {
        gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
        const int64_t specimen = bench_add_specimen(store, "S", "g", "");

        for (unsigned i = 1; i <= PANELS; i++)
            CHECK(add(store, specimen, bench_add_panel(store, specimen, i)) == i);
    }
    for (int i = 0; i < CHILDREN; i++)
        gsn_scratch_open_gate(&child[i]);
    for (int i = 0; i < CHILDREN; i++)
        CHECK(gsn_scratch_wait(&child[i]) == 0);
    (void)close(pipes[1]);
    while (read(pipes[0], &id, sizeof id) == sizeof id)
        done[id]++;
    (void)close(pipes[0]);
    for (int i = 1; i <= PANELS; i++)
        CHECK(done[i] == 1);
}

static int claim_once(struct gsn_store *store, struct gsn_error *err)
{
    gsn_auto(gsn_job_row) job = NULL;

    return gsn_queue_claim(store, "w", getpid(), LEASE, NOON, &job, err);
}

TEST(running_out_of_memory_leaves_the_job_unclaimed)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_job_rows) rows = NULL;
    struct gsn_error err = { 0 };

    (void)add(store, bench_add_specimen(store, "S", "g", ""), 0);
    CHECK_EVERY_OOM(claim_once(store, &err), err);
    CHECK_OK(gsn_queue_list(store, &rows, &err), err);
    CHECK(rows->at[0].claim == 1);
}
