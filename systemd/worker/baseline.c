/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The baseline of a specimen: what the last runs of its controls hand on to its own run.
 *
 * Steps.
 * 1. The controls: the specimens of its study that its protocol names, by specimen or by group.
 * 2. Of each the latest run with a report; its measures and its parameters (what its figures mean,
 * and what the colours of its tissue were).
 * 3. Region by region: the mean density, tissues and volume over them, errors in quadrature.
 * 4. Their models, for the map of the loss.
 *
 * How it fails: a control without a figure is counted and adds nothing; a model that is not at hand
 * costs the map, not the loss. Costs some milliseconds a control; its model is read once. */
#include "systemd/worker/baseline.h"

#include <jansson.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "storage/result.h"
#include "systemd/worker/audit.h"
#include "systemd/worker/kept_run.h"
#include "systemd/worker/study.h"

/* Of one region: the sums while controls are added, then the means, and what they point to. */
struct region_baseline {
    struct gsn_specimen_baseline mean;
    const char *name; /* of the region; NULL: the main one */
    char *definition, *dyes, *rule;
    struct gsn_specimen_control *control;
};

/* The model that the last run of a control kept. */
struct control_model {
    char *specimen;
    struct gsn_model *model; /* NULL: none is at hand, and why */
    char *lacks;
};

struct gsn_baseline {
    size_t regions;
    struct region_baseline region[1 + GSN_MOST_REGIONS]; /* the main one, and each named one */
    struct control_model *model; /* of each control with figures of the main region */
    char *page;
    json_t *keys;
};

/* Parameters of a run, kept with it for the runs that compare with it. */

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

/* gives; NULL: out of memory. */
static json_t *parameters_of(const char *own_key, const struct gsn_specimen_result *result)
{
    const struct gsn_specimen_control *c = &result->colours;

    return json_pack("{s:s, s:s, s:s, s:s, s:{s:o, s:o, s:f, s:o, s:o}}", "definition",
                     result->definition, "dyes", result->dyes, "region", result->region, "own_key",
                     own_key, "colours", "region_od", numbers_of(c->region_od, 3), "free_od",
                     numbers_of(c->free_od, 3), "free_panels", c->free_panels, "yellow",
                     numbers_of(c->yellow, GSN_CONTROL_TISSUES), "panels", panels_of(c->cloud));
}

char *gsn_run_parameters(const char *own_key, const struct gsn_specimen_result *result)
{
    json_t *root = parameters_of(own_key, result), *named = json_object();
    int failed = 0;
    char *dumped, *text;

    for (size_t i = 0; i < result->part_count; i++)
        failed |= json_object_set_new(named, result->part[i]->name,
                                      parameters_of(own_key, result->part[i])) < 0;
    if (result->part_count > 0)
        failed |= json_object_set(root, "regions", named) < 0;
    json_decref(named);
    dumped = failed ? NULL : json_dumps(root, JSON_COMPACT);
    text = dumped ? gsn_strdup(dumped) : NULL;
    free(dumped); /* door */
    json_decref(root);
    return text;
}

/* A run's parameters: its own, or those of a region of that name; NULL where an older version wrote
 * none or there is no such region. Borrowed. */
static const json_t *find_parameters(const json_t *root, const char *region)
{
    return region ? json_object_get(json_object_get(root, "regions"), region) : root;
}

/* A text of parameters ("definition", "dyes", "region", "own_key"), or "" where there is none.
 * gives; NULL: out of memory. */
static char *read_parameter(const json_t *parameters, const char *name)
{
    const char *text = json_string_value(json_object_get(parameters, name));

    return gsn_strdup(text ? text : "");
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

/* What the colours of its tissue were: region_od, yellow and cloud, which is given; not known (NaN,
 * NULL) where an older version told none. Fails with GSN_E_NOMEM. */
static int read_colours(const json_t *parameters, struct gsn_specimen_control *colours,
                        struct gsn_error *err)
{
    const json_t *from = json_object_get(parameters, "colours");
    const json_t *panels = json_object_get(from, "panels");
    gsn_auto(gsn_cloud) cloud = NULL;
    int r = GSN_OK;

    take_numbers(json_object_get(from, "region_od"), colours->region_od, 3);
    take_numbers(json_object_get(from, "free_od"), colours->free_od, 3);
    colours->free_panels = json_number_value(json_object_get(from, "free_panels"));
    take_numbers(json_object_get(from, "yellow"), colours->yellow, GSN_CONTROL_TISSUES);
    if (json_array_size(panels) > 0)
        r = gsn_cloud_new(json_array_size(panels), &cloud, err);
    for (size_t p = 0; r >= 0 && p < json_array_size(panels); p++)
        r = take_bins(json_array_get(panels, p), &cloud->panel[p], err);
    if (r >= 0)
        colours->cloud = gsn_steal(&cloud);
    return r;
}

/* The figures of controls. */

/* The figures of a run's main region, or of one of its named ones. */
struct figures {
    const struct gsn_measure_rows *rows;
    const char *region; /* NULL: the main one */
};

static const struct gsn_measure_row *row_named(const struct figures *figures, const char *name)
{
    const size_t length = figures->region ? strlen(figures->region) : 0;

    for (size_t i = 0; i < figures->rows->count; i++) {
        const char *row = figures->rows->at[i].name;

        if (figures->region &&
            (strncmp(row, figures->region, length) != 0 || row[length] != GSN_SPECIMEN_IN_REGION))
            continue;
        if (strcmp(figures->region ? row + length + 1 : row, name) == 0)
            return &figures->rows->at[i];
    }
    return NULL;
}

static double measure_named(const struct figures *rows, const char *name)
{
    const struct gsn_measure_row *row = row_named(rows, name);

    return row ? row->value : (double)NAN;
}

static double known_measure(const struct figures *rows, const char *name)
{
    const double value = measure_named(rows, name);

    return isnan(value) ? 0 : value;
}

/* The specimen's latest run with a report, whichever way it ended. */
static int finished_run(struct gsn_store *store, int64_t specimen, struct gsn_run_row **ret_run,
                        struct gsn_error *err)
{
    gsn_auto(gsn_run_row) reported = NULL;
    gsn_auto(gsn_run_row) withheld = NULL;
    int r = gsn_run_latest(store, specimen, "reported", &reported, err);

    if (r >= 0 || r == GSN_E_NOTFOUND)
        r = gsn_run_latest(store, specimen, "withheld", &withheld, err);
    if (r < 0 && r != GSN_E_NOTFOUND)
        return r;
    if (!reported && !withheld)
        return r;
    *ret_run = withheld && (!reported || withheld->id > reported->id) ? gsn_steal(&withheld)
                                                                      : gsn_steal(&reported);
    return GSN_OK;
}

/* A control's; NaN: it does not have that. */
static struct gsn_control_tissues tissues_of(const struct figures *rows)
{
    struct gsn_control_tissues ret;

    for (unsigned t = 0; t < GSN_CONTROL_TISSUES; t++) {
        const struct gsn_measure_row *row = row_named(rows, gsn_specimen_tissue_measure(t));
        const double error = row ? (row->upper - row->lower) / (2 * 1.96) : (double)NAN;

        ret.value[t] = row ? row->value : (double)NAN;
        ret.covariance[t][t] = error * error;
        for (unsigned u = 0; u < t; u++)
            ret.covariance[t][u] = ret.covariance[u][t] =
                measure_named(rows, gsn_specimen_tissues_measure(t, u));
    }
    return ret;
}

/* Sums over controls; what one of them lacks is not known of all. */
static void add_tissues(const struct gsn_control_tissues *tissues, struct gsn_specimen_baseline *b)
{
    for (unsigned t = 0; t < GSN_CONTROL_TISSUES; t++) {
        b->tissues.value[t] += tissues->value[t];
        for (unsigned u = 0; u < GSN_CONTROL_TISSUES; u++)
            b->tissues.covariance[t][u] += tissues->covariance[t][u];
    }
}

/* Their mean. */
static void share_tissues(struct gsn_specimen_baseline *b)
{
    const double n = (double)b->specimens;

    for (unsigned t = 0; t < GSN_CONTROL_TISSUES; t++) {
        b->tissues.value[t] /= n;
        for (unsigned u = 0; u < GSN_CONTROL_TISSUES; u++)
            b->tissues.covariance[t][u] /= n * n;
    }
}

static void add_turns(const struct figures *rows, struct gsn_specimen_baseline *b)
{
    const struct gsn_vector_scatter turns = { known_measure(rows, "vector_turns"),
                                              known_measure(rows, "vector_turns_freedom") };

    b->turns = gsn_vector_scatter_pool(&b->turns, &turns);
}

/* One more of the specimens, and what it hands on beside its figures. */
static int take_control(struct region_baseline *t, const struct figures *measures,
                        const json_t *parameters, struct gsn_error *err)
{
    struct gsn_specimen_baseline *b = &t->mean;
    struct gsn_specimen_control *control = &t->control[b->specimens++];

    *control =
        (struct gsn_specimen_control){ .tissues = tissues_of(measures),
                                       .plane_error = measure_named(measures, "plane_error") };
    add_tissues(&control->tissues, b);
    add_turns(measures, b);
    return read_colours(parameters, control, err);
}

/* Adds the figures of one region of a control's run to the sums. */
static int add_figures(struct region_baseline *t, const struct gsn_measure_rows *rows,
                       const json_t *parameters, struct gsn_error *err)
{
    struct gsn_specimen_baseline *b = &t->mean;
    const struct figures measures = { rows, t->name };
    gsn_auto_mem(char) region = NULL;
    const double mean = measure_named(&measures, "mean_density");
    int r;

    if (isnan(mean)) {
        b->withheld++;
        b->lacking += t->name && !parameters;
        return GSN_OK;
    }
    b->mean_density += mean;
    b->mean_density_error =
        hypot(b->mean_density_error, known_measure(&measures, "mean_density_error"));
    b->own_scale_error = hypot(b->own_scale_error, known_measure(&measures, "own_scale_error"));
    b->section_error = hypot(b->section_error, known_measure(&measures, "section_error"));
    r = take_control(t, &measures, parameters, err);
    if (r < 0)
        return r;
    b->unmeasured = fmax(b->unmeasured, 1 - measure_named(&measures, "coverage"));
    b->unknown = fmax(b->unknown, 1 - measure_named(&measures, "known"));
    b->volume_mm3 += measure_named(&measures, "region_volume");
    region = read_parameter(parameters, "region");
    if (!t->definition) {
        t->definition = read_parameter(parameters, "definition");
        t->dyes = read_parameter(parameters, "dyes");
        t->rule = region ? gsn_strdup(region) : NULL;
    }
    if (!t->definition || !t->dyes || !t->rule || !region)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
    if (strcmp(t->rule, region) != 0)
        t->rule[0] = '\0';
    return GSN_OK;
}

/* Adds one control; one without a figure adds nothing to the sums, but this run rests on its having
 * none: else two such specimens, each the other's baseline, would ask for each other for ever. */
static int add_control(struct gsn_baseline *b, struct gsn_store *store,
                       const struct gsn_specimen_row *control, struct gsn_error *err)
{
    gsn_auto(gsn_run_row) run = NULL;
    gsn_auto(gsn_measure_rows) measures = NULL;
    gsn_auto_mem(char) own_key = NULL;
    const size_t before = b->region[0].mean.specimens;
    struct gsn_error quiet = { 0 };
    json_t *root;
    int r = finished_run(store, control->id, &run, &quiet);

    if (r == GSN_E_NOTFOUND)
        return GSN_OK;
    if (r >= 0)
        r = gsn_measure_list(store, run->id, &measures, &quiet);
    if (r < 0)
        return gsn_fail(err, r, "%s", quiet.text);
    root = json_loads(run->parameters_json, 0, NULL);
    own_key = read_parameter(root, "own_key");
    if (!own_key || json_array_append_new(b->keys, json_string(own_key)) < 0)
        r = gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
    for (size_t i = 0; r >= 0 && i < b->regions; i++)
        r = add_figures(&b->region[i], measures, find_parameters(root, b->region[i].name), err);
    json_decref(root);
    if (r >= 0 && b->region[0].mean.specimens > before) {
        b->model[before].specimen = gsn_strdup(control->name);
        if (!b->model[before].specimen)
            r = gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
    }
    return r;
}

/* From the folder of one specimen's run to the last report of another, by names alone: the same
 * whichever run that is. */
static int link_control(struct gsn_baseline *b, struct gsn_store *store,
                        const struct gsn_specimen_row *control, struct gsn_error *err)
{
    gsn_auto_mem(char) folder = NULL;
    gsn_auto_mem(char) link = NULL;
    const int r = gsn_store_report_dir(store, control->name, &folder, err);

    if (r < 0)
        return r;
    link = gsn_study_link(strrchr(folder, '/'));
    b->page = link ? gsn_format("../..%s/" GSN_LATEST "/report.html", link) : NULL;
    b->region[0].mean.page = b->page;
    return b->page ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
}

/* The sums become means. */
static void finish_region(struct region_baseline *t)
{
    struct gsn_specimen_baseline *b = &t->mean;

    if (b->specimens > 0) {
        b->mean_density /= (double)b->specimens;
        b->mean_density_error /= (double)b->specimens;
        b->own_scale_error /= (double)b->specimens;
        b->section_error /= (double)b->specimens;
        share_tissues(b);
        b->volume_mm3 /= (double)b->specimens;
    }
    b->definition = t->definition ? t->definition : "";
    b->dyes = t->dyes ? t->dyes : "";
    b->region = t->rule ? t->rule : "";
}

static int alloc_controls(struct gsn_baseline *b, size_t controls, struct gsn_error *err)
{
    int failed = 0;

    b->model = gsn_alloc_array(controls + 1, sizeof *b->model);
    for (size_t i = 0; i < b->regions; i++) {
        struct region_baseline *t = &b->region[i];

        t->mean.control = t->control = gsn_alloc_array(controls + 1, sizeof *t->control);
        failed |= !t->control;
    }
    return b->model && !failed ? GSN_OK
                               : gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
}

static int add_controls(struct gsn_baseline *b, struct gsn_store *store,
                        const struct gsn_specimen_row *row, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_rows) controls = NULL;
    int r = gsn_specimen_baseline(store, row->study, row->baseline, &controls, err);

    if (r >= 0)
        r = alloc_controls(b, controls->count, err);
    for (size_t i = 0; r >= 0 && i < controls->count; i++)
        if (controls->at[i].id != row->id)
            r = add_control(b, store, &controls->at[i], err);
    if (r >= 0 && controls->count == 1 &&
        b->region[0].mean.specimens + b->region[0].mean.withheld == 1)
        r = link_control(b, store, &controls->at[0], err);
    for (size_t i = 0; i < b->regions; i++)
        finish_region(&b->region[i]);
    return r;
}

int gsn_baseline_load(struct gsn_store *store, const struct gsn_specimen_row *row,
                      const struct gsn_protocol *protocol, struct gsn_baseline **ret_baseline,
                      struct gsn_error *err)
{
    gsn_auto(gsn_baseline) b = gsn_alloc_array(1, sizeof *b);
    int r = GSN_OK;

    if (b)
        b->keys = json_array();
    if (!b || !b->keys)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
    b->regions = 1 + protocol->named_count;
    for (size_t i = 0; i < b->regions; i++) {
        b->region[i].name = i == 0 ? NULL : protocol->named[i - 1].name;
        b->region[i].mean.name = row->baseline;
    }
    if (row->baseline[0])
        r = add_controls(b, store, row, err);
    if (r < 0)
        return r;
    *ret_baseline = gsn_steal(&b);
    return GSN_OK;
}

int gsn_baseline_take_models(struct gsn_baseline *b, struct gsn_store *store, struct gsn_error *err)
{
    for (size_t i = 0; i < b->region[0].mean.specimens; i++) {
        struct control_model *const c = &b->model[i];
        struct gsn_specimen_control *const control = &b->region[0].control[i];
        gsn_auto(gsn_kept_run) kept = NULL;
        struct gsn_error why = { 0 };
        int r = gsn_kept_run_open(store, c->specimen, &kept, &why);

        if (r >= 0)
            r = gsn_kept_run_model(store, kept, &c->model, &why);
        if (r < 0 && r != GSN_E_NOTFOUND && r != GSN_E_INPUT)
            return gsn_fail(err, r, "the model of the baseline %s: %s", c->specimen, why.text);
        c->lacks =
            r < 0 ? gsn_format("the model of %s is not at hand: %s", c->specimen, why.text) : NULL;
        if (r < 0 && !c->lacks)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
        control->model = c->model;
        control->model_lacks = c->lacks;
    }
    return GSN_OK;
}

const struct gsn_specimen_baseline *gsn_baseline_of_region(const struct gsn_baseline *b,
                                                           size_t region)
{
    return &b->region[region].mean;
}

json_t *gsn_baseline_keys(const struct gsn_baseline *b)
{
    return b->keys;
}

static void free_region(struct region_baseline *t)
{
    gsn_free(t->definition);
    gsn_free(t->dyes);
    gsn_free(t->rule);
    for (size_t i = 0; t->control && i < t->mean.specimens; i++)
        gsn_cloud_free(t->control[i].cloud);
    gsn_free(t->control);
}

void gsn_baseline_free(struct gsn_baseline *b)
{
    if (!b)
        return;
    json_decref(b->keys);
    gsn_free(b->page);
    for (size_t i = 0; b->model && i < b->region[0].mean.specimens; i++) {
        gsn_free(b->model[i].specimen);
        gsn_model_free(b->model[i].model);
        gsn_free(b->model[i].lacks);
    }
    gsn_free(b->model);
    for (size_t i = 0; i < b->regions; i++)
        free_region(&b->region[i]);
    gsn_free(b);
}
