/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/error.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

int gsn_fail(struct gsn_error *err, int code, const char *format, ...)
{
    va_list args;

    if (!err)
        return code;
    err->code = code;
    va_start(args, format);
    (void)vsnprintf(err->text, sizeof err->text, format, args);
    va_end(args);
    return code;
}

int gsn_fail_at(struct gsn_error *err, const char *format, ...)
{
    char said[sizeof err->text];
    va_list args;
    int used;

    if (!err)
        return GSN_E_INPUT;
    memcpy(said, err->text, sizeof said);
    va_start(args, format);
    used = vsnprintf(err->text, sizeof err->text, format, args);
    va_end(args);
    if (used >= 0 && (size_t)used < sizeof err->text)
        (void)snprintf(err->text + used, sizeof err->text - (size_t)used, ": %s", said);
    return err->code;
}

const char *gsn_code_name(int code)
{
    static const char *const names[] = { "ok",  "nomem",    "input",   "unsupported", "limit",
                                         "io",  "notfound", "markers", "stain",       "mesh",
                                         "fit", "store",    "busy",    "process",     "withheld" };

    if (code > 0 || (size_t)-code >= sizeof names / sizeof names[0])
        return "unknown";
    return names[-code];
}
