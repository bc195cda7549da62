/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stated_value.h"

#include "pipeline/core/mem.h"

#include <jansson.h>
#include <math.h>
#include <string.h>

enum { LONGEST_NAME = 1000 };

int gsn_stated_bad(struct gsn_error *err, const char *key, const char *wanted)
{
    return gsn_fail(err, GSN_E_INPUT, "job.json: \"%s\" must be %s", key, wanted);
}

int gsn_stated_text(const json_t *job, const char *key, char **text, struct gsn_error *err)
{
    const json_t *value = json_object_get(job, key);

    if (value && (!json_is_string(value) || json_string_length(value) > LONGEST_NAME ||
                  strlen(json_string_value(value)) != json_string_length(value)))
        return gsn_stated_bad(err, key, "text of at most 1000 bytes");
    *text = gsn_strdup(value ? json_string_value(value) : "");
    return *text ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
}

int gsn_stated_number(const json_t *job, const char *key, double low, double high, double *number,
                      struct gsn_error *err)
{
    const json_t *value = json_object_get(job, key);

    if (!value)
        return GSN_OK;
    if (!json_is_number(value) || !(json_number_value(value) >= low) ||
        !(json_number_value(value) <= high))
        return gsn_fail(err, GSN_E_INPUT, "job.json: \"%s\" must be a number from %g to %g%s", key,
                        low, high, strstr(key, "_um") ? " micrometres" : "");
    *number = json_number_value(value);
    return GSN_OK;
}

int gsn_stated_count(const json_t *job, const char *key, unsigned most, unsigned *count,
                     struct gsn_error *err)
{
    const json_t *value = json_object_get(job, key);

    if (!value)
        return GSN_OK;
    if (!json_is_integer(value) || json_integer_value(value) < 1 ||
        json_integer_value(value) > (json_int_t)most)
        return gsn_fail(err, GSN_E_INPUT, "job.json: \"%s\" must be a whole number from 1 to %u",
                        key, most);
    *count = (unsigned)json_integer_value(value);
    return GSN_OK;
}

int gsn_stated_word(const json_t *job, const char *key, const char *const *words, int *chosen,
                    struct gsn_error *err)
{
    const json_t *value = json_object_get(job, key);

    if (!value)
        return GSN_OK;
    for (int i = 0; words[i]; i++)
        if (json_is_string(value) && strcmp(json_string_value(value), words[i]) == 0) {
            *chosen = i;
            return GSN_OK;
        }
    return gsn_fail(err, GSN_E_INPUT, "job.json: \"%s\" must be one of \"%s\", \"%s\"%s%s%s", key,
                    words[0], words[1], words[2] ? ", \"" : "", words[2] ? words[2] : "",
                    words[2] ? "\"" : "");
}

int gsn_stated_numbers(const json_t *array, size_t count, double *numbers)
{
    if (!json_is_array(array) || json_array_size(array) != count)
        return -1;
    for (size_t i = 0; i < count; i++) {
        const json_t *value = json_array_get(array, i);

        if (!json_is_number(value) || !isfinite(json_number_value(value)))
            return -1;
        numbers[i] = json_number_value(value);
    }
    return 0;
}
