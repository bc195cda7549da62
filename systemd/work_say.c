/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/work_verbs.h"

#include <stdio.h>
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

json_t *gsn_work_number(const char *text)
{
    return json_loads(text, JSON_DECODE_ANY, NULL);
}
