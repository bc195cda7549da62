/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/run_parameters.h"

#include "pipeline/core/mem.h"

#include <jansson.h>
#include <math.h>
#include <stdlib.h>

/* ---- colours ----------------------------------------------------------------------------- */

/* Bins are [at, cells, 1000 R + G + B] one after another: some thousand a panel. */
enum { BIN = 3 };
static const double OD_STEPS = 1000;

/* gives; NaN becomes null. NULL: out of memory, as of the next. */
static json_t *numbers_of(const double *value, size_t count)
{
    json_t *numbers = json_array();

    for (size_t i = 0; i < count; i++)
        if (json_array_append_new(numbers, isnan(value[i]) ? json_null() : json_real(value[i])) <
            0) {
            json_decref(numbers);
            return NULL;
        }
    return numbers;
}

static json_t *bins_of(const struct gsn_cloud_panel *panel)
{
    json_t *bins = json_array();

    for (size_t i = 0; i < panel->bins; i++)
        if (json_array_append_new(bins, json_integer(panel->bin[i].at)) < 0 ||
            json_array_append_new(bins, json_integer(llround(panel->bin[i].cells))) < 0 ||
            json_array_append_new(bins, json_integer(llround(OD_STEPS * panel->bin[i].od))) < 0) {
            json_decref(bins);
            return NULL;
        }
    return bins;
}

static json_t *panels_of(const struct gsn_cloud *cloud)
{
    json_t *panels = json_array();

    for (size_t p = 0; cloud && p < cloud->panels; p++)
        if (cloud->panel[p].bins > 0 &&
            json_array_append_new(
                panels, json_pack("{s:i, s:f, s:b, s:o}", "panel", (int)cloud->panel[p].panel,
                                  "noise", cloud->panel[p].noise, "lossy", cloud->panel[p].lossy,
                                  "bins", bins_of(&cloud->panel[p]))) < 0) {
            json_decref(panels);
            return NULL;
        }
    return panels;
}

char *gsn_run_parameters(const char *own_key, const struct gsn_specimen_result *result)
{
    const struct gsn_specimen_control *c = &result->colours;
    json_t *root =
        json_pack("{s:s, s:s, s:s, s:{s:o, s:o, s:o, s:o}}", "definition", result->definition,
                  "dyes", result->dyes, "own_key", own_key, "colours", "region_od",
                  numbers_of(c->region_od, 3), "free_od", numbers_of(c->free_od, 3), "yellow",
                  numbers_of(c->yellow, GSN_LEVEL_TISSUES), "panels", panels_of(c->cloud));
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

static void take_numbers(const json_t *numbers, double *ret_value, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const json_t *number = json_array_get(numbers, i);

        ret_value[i] = json_is_number(number) ? json_number_value(number) : (double)NAN;
    }
}

static int take_bins(const json_t *from, struct gsn_cloud_panel *panel, struct gsn_error *err)
{
    const json_t *bins = json_object_get(from, "bins");
    const size_t count = json_array_size(bins) / BIN;

    panel->panel = (unsigned)json_integer_value(json_object_get(from, "panel"));
    panel->noise = json_number_value(json_object_get(from, "noise"));
    panel->lossy = json_is_true(json_object_get(from, "lossy"));
    panel->bin = gsn_alloc_array(count + 1, sizeof *panel->bin);
    if (!panel->bin)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the colours of a baseline");
    panel->bins = count;
    for (size_t i = 0; i < count; i++)
        panel->bin[i] = (struct gsn_cloud_bin){
            .at = (uint32_t)json_integer_value(json_array_get(bins, BIN * i)) %
                  (GSN_CLOUD_GREENS * GSN_CLOUD_BLUES),
            .cells = json_number_value(json_array_get(bins, BIN * i + 1)),
            .od = json_number_value(json_array_get(bins, BIN * i + 2)) / OD_STEPS
        };
    return GSN_OK;
}

int gsn_run_colours(const struct gsn_run_row *run, struct gsn_specimen_control *colours,
                    struct gsn_error *err)
{
    json_t *root = json_loads(run->parameters_json, 0, NULL);
    const json_t *from = json_object_get(root, "colours");
    const json_t *panels = json_object_get(from, "panels");
    gsn_auto(gsn_cloud) cloud = NULL;
    int r = GSN_OK;

    take_numbers(json_object_get(from, "region_od"), colours->region_od, 3);
    take_numbers(json_object_get(from, "free_od"), colours->free_od, 3);
    take_numbers(json_object_get(from, "yellow"), colours->yellow, GSN_LEVEL_TISSUES);
    if (json_array_size(panels) > 0)
        r = gsn_cloud_new(json_array_size(panels), &cloud, err);
    for (size_t p = 0; r >= 0 && p < json_array_size(panels); p++)
        r = take_bins(json_array_get(panels, p), &cloud->panel[p], err);
    json_decref(root);
    if (r >= 0)
        colours->cloud = gsn_steal(&cloud);
    return r;
}
