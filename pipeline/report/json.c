/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* JSON (RFC 8259) as jansson's values. Numbers that are not finite do not exist in JSON and become
 * null; text that is not UTF-8 is mended first, for jansson takes no other. */
#include "pipeline/report/json.h"

#include "pipeline/report/text.h"

#include <math.h>

void gsn_json_put(struct gsn_json_writer *writer, json_t *object, const char *key, json_t *value)
{
    if (json_object_set_new(object, key, value) < 0)
        writer->failed = 1;
}

void gsn_json_append(struct gsn_json_writer *writer, json_t *array, json_t *value)
{
    if (json_array_append_new(array, value) < 0)
        writer->failed = 1;
}

json_t *gsn_json_text(const char *said)
{
    gsn_auto_report_text text = { .bytes = NULL };

    gsn_report_text_utf8(&text, said);
    return text.failed ? NULL : json_stringn(text.bytes, text.size);
}

json_t *gsn_json_text_or_null(const char *said)
{
    return said && *said ? gsn_json_text(said) : json_null();
}

json_t *gsn_json_figure(double value)
{
    return isfinite(value) ? json_real(value == 0 ? 0 : value) : json_null();
}

json_t *gsn_json_count(size_t count)
{
    return json_integer((json_int_t)count);
}

json_t *gsn_json_figures(const double *values, size_t count, struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++)
        gsn_json_append(writer, array, gsn_json_figure(values[i]));
    return array;
}

json_t *gsn_json_texts(const char *const *said, size_t count, struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++)
        gsn_json_append(writer, array, gsn_json_text(said[i]));
    return array;
}
