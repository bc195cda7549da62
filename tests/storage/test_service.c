/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/bench.h"

#include "pipeline/core/mem.h"

#include <signal.h>
#include <sys/wait.h>
#include <string.h>
#include <unistd.h>

#include "tests/check.h"
#include "tests/storage/scratch.h"

static int there(const char *dir, enum gsn_service service)
{
    struct gsn_error err = { 0 };
    int is = -1;

    CHECK_OK(gsn_service_is_there(dir, service, &is, &err), err);
    return is;
}

TEST(a_service_is_there_from_taking_to_closing_and_each_for_itself)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_error err = { 0 };
    int lock = -1;

    CHECK(!there(scratch.dir, GSN_SERVICE_INTAKE));
    CHECK_OK(gsn_service_take(scratch.dir, GSN_SERVICE_INTAKE, &lock, &err), err);
    CHECK(there(scratch.dir, GSN_SERVICE_INTAKE));
    CHECK(!there(scratch.dir, GSN_SERVICE_QUEUE));
    CHECK(there(scratch.dir, GSN_SERVICE_INTAKE)); /* asking did not drop it */
    (void)close(lock);
    CHECK(!there(scratch.dir, GSN_SERVICE_INTAKE));
}

/* Case 59. */
TEST(a_second_service_is_refused_and_its_output_stays_untouched)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_error err = { 0 };
    int lock = -1, second = -7, other = -1;

    CHECK_OK(gsn_service_take(scratch.dir, GSN_SERVICE_QUEUE, &lock, &err), err);
    CHECK(gsn_service_take(scratch.dir, GSN_SERVICE_QUEUE, &second, &err) == GSN_E_BUSY);
    CHECK(second == -7);
    CHECK(strstr(err.text, "another giesond does the jobs for ") == err.text);
    CHECK_OK(gsn_service_take(scratch.dir, GSN_SERVICE_INTAKE, &other, &err), err);
    (void)close(other);
    (void)close(lock);
}

TEST(a_killed_service_is_not_there)
{
    scratch_auto scratch = gsn_scratch_new();
    int told[2], lock = -1;
    char byte = 0;
    pid_t child;

    CHECK(pipe(told) == 0);
    child = fork();
    if (child == 0) {
        if (gsn_service_take(scratch.dir, GSN_SERVICE_INTAKE, &lock, NULL) < 0)
            _exit(1);
        (void)!write(told[1], "x", 1);
        for (;;)
            (void)pause();
    }
    CHECK(read(told[0], &byte, 1) == 1);
    CHECK(there(scratch.dir, GSN_SERVICE_INTAKE));
    CHECK(kill(child, SIGKILL) == 0);
    CHECK(waitpid(child, NULL, 0) == child);
    CHECK(!there(scratch.dir, GSN_SERVICE_INTAKE));
    (void)close(told[0]);
    (void)close(told[1]);
}

TEST(a_folder_that_is_not_there_has_no_service_and_takes_none)
{
    struct gsn_error err = { 0 };
    int lock = -7;

    CHECK(!there("/nowhere/at/all", GSN_SERVICE_INTAKE));
    CHECK(gsn_service_take("/nowhere/at/all", GSN_SERVICE_INTAKE, &lock, &err) == GSN_E_IO);
    CHECK(lock == -7);
}

static int take_once(const char *dir, struct gsn_error *err)
{
    int lock = -1, is = 0;
    int r = gsn_service_take(dir, GSN_SERVICE_INTAKE, &lock, err);

    if (r >= 0)
        r = gsn_service_is_there(dir, GSN_SERVICE_INTAKE, &is, err);
    if (lock >= 0)
        (void)close(lock);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(take_once(scratch.dir, &err), err);
}
