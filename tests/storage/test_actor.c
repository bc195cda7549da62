/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/audit_log.h"

#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "tests/check.h"

/* /etc/passwd has root on every machine, and nobody has these numbers. */
enum { ROOT = 0, LOGGED_IN = 3999999990u, OTHER = 3999999991u };
static const uid_t NONE = (uid_t)-1;

static void is(struct gsn_actor actor, const char *expected)
{
    if (strcmp(actor.name, expected) != 0)
        fail_msg("\"%s\" is not \"%s\"", actor.name, expected);
}

TEST(who_logged_in_asks_whoever_he_became)
{
    is(gsn_actor_of(LOGGED_IN, LOGGED_IN, NULL), "uid 3999999990");
    is(gsn_actor_of(LOGGED_IN, ROOT, NULL), "uid 3999999990 as root");
    is(gsn_actor_of(LOGGED_IN, OTHER, NULL), "uid 3999999990 as uid 3999999991");
    is(gsn_actor_of(NONE, ROOT, NULL), "root");
    is(gsn_actor_of(NONE, OTHER, ""), "uid 3999999991");
}

/* `SUDO_USER=dr.mueller gieson decide ...` was "chosen by dr.mueller" in log and report. */
TEST(what_the_environment_says_is_a_remark)
{
    is(gsn_actor_of(NONE, ROOT, "dr.mueller"), "root (SUDO_USER says dr.mueller)");
    is(gsn_actor_of(LOGGED_IN, ROOT, "dr.mueller"),
       "uid 3999999990 as root (SUDO_USER says dr.mueller)");
    is(gsn_actor_of(ROOT, ROOT, "root"), "root");
    is(gsn_actor_of(NONE, ROOT, "a\033[2Jb) c\n"), "root (SUDO_USER says a?[2Jb? c?)");
}

TEST(a_claim_of_any_length_fits)
{
    char claim[5000];
    struct gsn_actor actor;

    memset(claim, 'x', sizeof claim - 1);
    claim[sizeof claim - 1] = '\0';
    actor = gsn_actor_of(LOGGED_IN, OTHER, claim);
    CHECK(strncmp(actor.name, "uid 3999999990 as uid 3999999991 (SUDO_USER says xxx", 52) == 0);
    CHECK(actor.name[strlen(actor.name) - 1] == ')');
}

TEST(this_process_is_who_the_kernel_says)
{
    struct gsn_actor honest, claimed;

    CHECK(unsetenv("SUDO_USER") == 0 && setenv("USER", "dr.mueller", 1) == 0);
    honest = gsn_actor_now();
    CHECK(honest.name[0] && !strstr(honest.name, "dr.mueller"));
    CHECK(setenv("SUDO_USER", "dr.mueller", 1) == 0);
    claimed = gsn_actor_now();
    CHECK(strncmp(claimed.name, honest.name, strlen(honest.name)) == 0);
    CHECK(strcmp(claimed.name + strlen(honest.name), " (SUDO_USER says dr.mueller)") == 0);
}
