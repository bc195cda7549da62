/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/work_verbs.h"

#include <stdio.h>
#include <stdlib.h>
#include <sysexits.h>

int gsn_work_complain(const struct gsn_error *err, int code)
{
    (void)fprintf(stderr, "gieson: %s\n", err->text);
    return gsn_code_exit(code);
}

int gsn_work_usage(const char *sentence)
{
    (void)fprintf(stderr, "gieson: %s\n", sentence);
    return EX_USAGE;
}

const char *gsn_work_actor(void)
{
    const char *user = getenv("SUDO_USER"); /* who asked, not whom they became */

    if (!user || !user[0])
        user = getenv("USER");
    return user && user[0] ? user : "gieson";
}

json_t *gsn_work_number(const char *text)
{
    return json_loads(text, JSON_DECODE_ANY, NULL);
}
