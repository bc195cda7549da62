/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/material_parts.h"

#include "systemd/run_parameters.h"

#include <math.h>
#include <string.h>

static const struct gsn_measure_row *row_named(const struct gsn_measure_rows *rows,
                                               const char *name)
{
    for (size_t i = 0; i < rows->count; i++)
        if (strcmp(rows->at[i].name, name) == 0)
            return &rows->at[i];
    return NULL;
}

static double measure_named(const struct gsn_measure_rows *rows, const char *name)
{
    const struct gsn_measure_row *row = row_named(rows, name);

    return row ? row->value : (double)NAN;
}

static double known(const struct gsn_measure_rows *rows, const char *name)
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
static struct gsn_level_tissues tissues_of(const struct gsn_measure_rows *rows)
{
    struct gsn_level_tissues ret;

    for (unsigned t = 0; t < GSN_LEVEL_TISSUES; t++) {
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
static void add_tissues(const struct gsn_level_tissues *tissues, struct gsn_specimen_baseline *b)
{
    for (unsigned t = 0; t < GSN_LEVEL_TISSUES; t++) {
        b->tissues.value[t] += tissues->value[t];
        for (unsigned u = 0; u < GSN_LEVEL_TISSUES; u++)
            b->tissues.covariance[t][u] += tissues->covariance[t][u];
    }
}

/* Their mean. */
static void share_tissues(struct gsn_specimen_baseline *b)
{
    const double n = (double)b->specimens;

    for (unsigned t = 0; t < GSN_LEVEL_TISSUES; t++) {
        b->tissues.value[t] /= n;
        for (unsigned u = 0; u < GSN_LEVEL_TISSUES; u++)
            b->tissues.covariance[t][u] /= n * n;
    }
}

static void add_turns(const struct gsn_measure_rows *rows, struct gsn_specimen_baseline *b)
{
    const struct gsn_turned_scatter turns = { known(rows, "vector_turns"),
                                              known(rows, "vector_turns_freedom") };

    b->turns = gsn_turned_together(&b->turns, &turns);
}

/* One more of the specimens, and what it hands on beside its figures. */
static int take_control(struct gsn_material *m, const struct gsn_measure_rows *measures,
                        const struct gsn_run_row *run, struct gsn_error *err)
{
    struct gsn_specimen_baseline *b = &m->specimen.baseline;
    struct gsn_specimen_control *control = &m->control[b->specimens++];

    *control = (struct gsn_specimen_control){ .tissues = tissues_of(measures) };
    add_tissues(&control->tissues, b);
    add_turns(measures, b);
    return gsn_run_colours(run, control, err);
}

/* Adds one control to the sums; a control without a figure adds nothing to them, but this run rests
 * on its having none: else two such specimens, each the other's baseline, would ask for each other
 * for ever. */
static int add_control(struct gsn_material *m, const struct gsn_specimen_row *control,
                       struct gsn_error *err)
{
    struct gsn_specimen_baseline *b = &m->specimen.baseline;
    gsn_auto(gsn_run_row) run = NULL;
    gsn_auto(gsn_measure_rows) measures = NULL;
    gsn_auto_mem(char) own_key = NULL;
    struct gsn_error quiet = { 0 };
    double mean;
    int r = finished_run(m->store, control->id, &run, &quiet);

    if (r == GSN_E_NOTFOUND)
        return GSN_OK;
    if (r >= 0)
        r = gsn_measure_list(m->store, run->id, &measures, &quiet);
    if (r < 0)
        return gsn_fail(err, r, "%s", quiet.text);
    own_key = gsn_run_parameter(run, "own_key");
    if (!own_key || json_array_append_new(m->baseline_keys, json_string(own_key)) < 0)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
    mean = measure_named(measures, "mean_density");
    if (isnan(mean)) {
        b->withheld++;
        return GSN_OK;
    }
    b->mean_density += mean;
    b->mean_density_error = hypot(b->mean_density_error, known(measures, "mean_density_error"));
    b->own_scale_error = hypot(b->own_scale_error, known(measures, "own_scale_error"));
    r = take_control(m, measures, run, err);
    if (r < 0)
        return r;
    b->unmeasured = fmax(b->unmeasured, 1 - measure_named(measures, "coverage"));
    b->unknown = fmax(b->unknown, 1 - measure_named(measures, "known"));
    b->volume_mm3 += measure_named(measures, "region_volume");
    if (!m->definition) {
        m->definition = gsn_run_parameter(run, "definition");
        m->dyes = gsn_run_parameter(run, "dyes");
    }
    return m->definition && m->dyes ? GSN_OK
                                    : gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
}

int gsn_material_take_baseline(struct gsn_material *m, struct gsn_error *err)
{
    struct gsn_specimen_baseline *b = &m->specimen.baseline;
    gsn_auto(gsn_specimen_rows) controls = NULL;
    int r = GSN_OK;

    m->baseline_keys = json_array();
    b->name = m->row->baseline;
    if (!b->name[0])
        return GSN_OK;
    r = gsn_specimen_baseline(m->store, m->row->study, b->name, &controls, err);
    if (r >= 0) {
        b->control = m->control = gsn_alloc_array(controls->count + 1, sizeof *m->control);
        r = m->control ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
    }
    for (size_t i = 0; r >= 0 && i < controls->count; i++)
        if (controls->at[i].id != m->row->id)
            r = add_control(m, &controls->at[i], err);
    if (b->specimens > 0) {
        b->mean_density /= (double)b->specimens;
        b->mean_density_error /= (double)b->specimens;
        b->own_scale_error /= (double)b->specimens;
        share_tissues(b);
        b->volume_mm3 /= (double)b->specimens;
    }
    b->definition = m->definition ? m->definition : "";
    b->dyes = m->dyes ? m->dyes : "";
    return r;
}
