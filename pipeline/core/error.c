/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The sentence of a failure: formatted where it is noticed, places put before it on the way up, cut
 * where the room ends. The exit statuses are those of sysexits.h. */
#include "pipeline/core/error.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sysexits.h>

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
    struct gsn_error said;
    va_list args;
    size_t used;

    if (!err)
        return GSN_E_INPUT;
    said = *err;
    va_start(args, format);
    (void)vsnprintf(err->text, sizeof err->text, format, args);
    va_end(args);
    used = strlen(err->text);
    for (const char *more = ": "; *more && used + 1 < sizeof err->text; more++)
        err->text[used++] = *more;
    for (const char *more = said.text; *more && used + 1 < sizeof err->text; more++)
        err->text[used++] = *more;
    err->text[used] = '\0';
    return err->code;
}

const char *gsn_code_name(int code)
{
    static const char *const names[] = { "ok",  "nomem",    "input",   "unsupported", "limit",
                                         "io",  "notfound", "markers", "stain",       "mesh",
                                         "fit", "store",    "busy",    "process",     "withheld",
                                         "denied" };

    if (code > 0 || code <= -(int)(sizeof names / sizeof names[0]))
        return "unknown";
    return names[-code];
}

int gsn_code_exit(int code)
{
    switch (code) {
    case GSN_OK:
        return EX_OK;
    case GSN_E_NOMEM:
        return EX_OSERR;
    case GSN_E_IO:
    case GSN_E_DENIED:
    case GSN_E_STORE:
        return EX_IOERR;
    case GSN_E_NOTFOUND:
        return EX_NOINPUT;
    case GSN_E_BUSY:
        return EX_TEMPFAIL;
    case GSN_E_PROCESS:
    case GSN_E_MESH:
    case GSN_E_FIT:
        return EX_UNAVAILABLE;
    default:
        return code > 0 ? EX_OK : EX_DATAERR;
    }
}
