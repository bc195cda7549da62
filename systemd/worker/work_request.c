/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the verbs of gieson-work have in common: how they answer, and how they take numbers.
 *
 * Words go out without what moves a terminal's cursor; a sentence that names a command of `gieson`
 * names it as this store is called. JSON is UTF-8, so of a text that is not, what is beyond ASCII
 * becomes a question mark. Numbers are JSON's, which no locale changes. Failure: out of memory is
 * said in place of the words. */
#include "systemd/worker/work_request.h"

#include <stdarg.h>
#include <sysexits.h>

#include "pipeline/core/mem.h"
#include "pipeline/core/printable.h"
#include "storage/advice.h"

void gsn_work_print(FILE *to, const char *format, ...)
{
    gsn_auto_mem(char) text = NULL;
    va_list args, again;
    int length;

    va_start(args, format);
    va_copy(again, args);
    length = vsnprintf(NULL, 0, format, args);
    text = length < 0 ? NULL : gsn_alloc_array((size_t)length + 1, 1);
    if (text)
        (void)vsnprintf(text, (size_t)length + 1, format, again);
    va_end(again);
    va_end(args);
    if (text)
        gsn_printable(text);
    (void)fputs(text ? text : "out of memory\n", to);
}

void gsn_work_print_advice(const struct gsn_work_request *request, FILE *to, const char *before,
                           const char *text)
{
    gsn_auto_mem(char) advice = gsn_advice(request->store_dir, text);

    gsn_work_print(to, "%s%s\n", before, advice ? advice : text);
}

int gsn_work_complain(const struct gsn_work_request *request, const struct gsn_error *err, int code)
{
    gsn_work_print_advice(request, stderr, "gieson: ", err->text);
    return gsn_code_exit(code);
}

int gsn_work_usage(const struct gsn_work_request *request, const char *sentence)
{
    gsn_work_print_advice(request, stderr, "gieson: ", sentence);
    return EX_USAGE;
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

json_t *gsn_work_advice(const struct gsn_work_request *request, const char *text)
{
    gsn_auto_mem(char) advice = gsn_advice(request->store_dir, text);

    return gsn_work_text(advice ? advice : text);
}

json_t *gsn_work_number(const char *text)
{
    return json_loads(text, JSON_DECODE_ANY, NULL);
}

int gsn_work_numbers(const char *text, size_t count, double *ret_number)
{
    gsn_auto_mem(char) list = gsn_format("[%s]", text);
    json_t *root = list ? json_loads(list, 0, NULL) : NULL;
    int ok = json_array_size(root) == count;

    for (size_t i = 0; ok && i < count; i++)
        ok = json_is_number(json_array_get(root, i));
    for (size_t i = 0; ok && i < count; i++)
        ret_number[i] = json_number_value(json_array_get(root, i));
    json_decref(root);
    return ok;
}
