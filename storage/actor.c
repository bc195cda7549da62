/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* credentials(7) for the real uid, proc(5) for /proc/self/loginuid, which pam_loginuid(8) writes
 * and audit relies on: without CAP_AUDIT_CONTROL nobody changes it. A uid without a name is told as
 * a number. A claim of the environment is cut, and what a terminal would obey in it is shown as
 * '?'. */
#include "storage/actor.h"

#include <pwd.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"

static const uid_t NOBODY_LOGGED_IN = (uid_t)-1;

struct name {
    char text[48];
};

static struct name name_of(uid_t uid)
{
    struct name name;
    struct passwd entry, *found = NULL;
    char buffer[4096];

    if (getpwuid_r(uid, &entry, buffer, sizeof buffer, &found) == 0 && found)
        (void)snprintf(name.text, sizeof name.text, "%s", found->pw_name);
    else
        (void)snprintf(name.text, sizeof name.text, "uid %lu", (unsigned long)uid);
    return name;
}

static struct name tame(const char *claimed)
{
    struct name name;

    (void)snprintf(name.text, sizeof name.text, "%s", claimed);
    for (char *at = name.text; *at; at++)
        if (*at < ' ' || *at > '~' || *at == '(' || *at == ')')
            *at = '?';
    return name;
}

static uid_t login_uid(void)
{
    char text[32] = "";
    gsn_auto_fd fd = -1;
    ssize_t got = -1;

    if (gsn_file_open("/proc/self/loginuid", &fd, NULL) >= 0)
        got = read(fd, text, sizeof text - 1);
    return got > 0 ? (uid_t)strtoul(text, NULL, 10) : NOBODY_LOGGED_IN;
}

struct gsn_actor gsn_actor_of(uid_t login, uid_t real, const char *claimed)
{
    const struct name who = name_of(login == NOBODY_LOGGED_IN ? real : login);
    const struct name became = name_of(real);
    const struct name said = tame(claimed ? claimed : "");
    const int is_other = login != NOBODY_LOGGED_IN && login != real;
    const int is_claimed = said.text[0] && strcmp(said.text, who.text) != 0;
    struct gsn_actor actor;

    (void)snprintf(actor.name, sizeof actor.name, "%s%s%s%s%s%s", who.text, is_other ? " as " : "",
                   is_other ? became.text : "", is_claimed ? " (SUDO_USER says " : "",
                   is_claimed ? said.text : "", is_claimed ? ")" : "");
    return actor;
}

struct gsn_actor gsn_actor_now(void)
{
    return gsn_actor_of(login_uid(), getuid(), getenv("SUDO_USER"));
}
