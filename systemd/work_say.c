/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/work_verbs.h"

#include "pipeline/core/mem.h"

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

json_t *gsn_work_text(const char *text)
{
    json_t *whole = json_string(text);
    gsn_auto_mem(char) plain = whole ? NULL : gsn_strdup(text);

    if (whole || !plain)
        return whole ? whole : json_null();
    for (char *c = plain; *c; c++)
        if ((unsigned char)*c >= 0x80)
            *c = '?';
    return json_string(plain);
}
