/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/run_parameters.h"

#include "pipeline/core/mem.h"

#include <jansson.h>
#include <stdlib.h>

/* gives; NULL: out of memory. */
static json_t *zeros_of(const struct gsn_specimen_result *result)
{
    json_t *zeros = json_array();

    for (size_t i = 0; i < result->zero_count; i++)
        if (json_array_append_new(zeros, json_real(result->zero[i])) < 0) {
            json_decref(zeros);
            return NULL;
        }
    return zeros;
}

char *gsn_run_parameters(const char *own_key, const struct gsn_specimen_result *result)
{
    json_t *root = json_pack("{s:s, s:s, s:s, s:o}", "definition", result->definition, "dyes",
                             result->dyes, "own_key", own_key, "panel_zeros", zeros_of(result));
    char *dumped = json_dumps(root, JSON_COMPACT);
    char *text = dumped ? gsn_strdup(dumped) : NULL;

    free(dumped); /* door */
    json_decref(root);
    return text;
}

char *gsn_run_parameter(const struct gsn_run_row *run, const char *name)
{
    json_t *root = json_loads(run->parameters_json, 0, NULL);
    const char *text = json_string_value(json_object_get(root, name));
    char *copy = gsn_strdup(text ? text : "");

    json_decref(root);
    return copy;
}

size_t gsn_run_panel_zeros(const struct gsn_run_row *run, double ret_zero[GSN_LEVEL_PANELS])
{
    json_t *root = json_loads(run->parameters_json, 0, NULL);
    const json_t *zeros = json_object_get(root, "panel_zeros");
    size_t count = 0;

    for (; count < json_array_size(zeros) && count < GSN_LEVEL_PANELS; count++)
        ret_zero[count] = json_number_value(json_array_get(zeros, count));
    json_decref(root);
    return count;
}
