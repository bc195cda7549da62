/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The inputs of a specimen's job, loaded and hashed into the key of its run.
 *
 * Steps.
 * 1. Rows: specimen, job.json, panels, sections, operator decisions, candidates, attachments.
 * 2. Panels of one number: where they show one glass (rescan.h) the better scan is used and the
 * other kept as a spare; others are held, with the reason in their rows.
 * 3. Baseline: the finished runs of its specimens, their mean density, tissues and colours.
 * 4. The list of inputs as JSON, by name and hash; what operators decided, names of people hashed.
 * 5. Key: SHA-256 of inputs, parameters, decisions and version, once with the baseline's keys and
 * once without.
 * 6. Files that the job names: mask and volume are read, calibration panels found.
 *
 * How it fails: GSN_E_IO for a damaged object, GSN_E_INPUT for a mask or volume that cannot be read
 * or a panel that an older gieson looked at. The key alone reads no object. */
#include "systemd/worker/job_inputs.h"

#include <errno.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "pipeline/core/linalg.h"
#include "pipeline/decode/volume.h"
#include "pipeline/imaging/imaging.h"
#include "pipeline/render/lettering.h"
#include "pipeline/specimen/drawn_region.h"
#include "storage/catalog.h"
#include "storage/decision.h"
#include "storage/panel_log.h"
#include "systemd/worker/audit.h"
#include "systemd/worker/kept_run.h"
#include "systemd/worker/panel_job.h"
#include "systemd/worker/rescan.h"
#include "systemd/worker/study.h"

/* What is taken of the baseline for one region. */
struct taken {
    struct gsn_specimen_baseline *into;
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

struct gsn_job_inputs {
    struct gsn_store *store;
    struct gsn_specimen specimen;
    struct gsn_specimen_row *row;
    struct gsn_protocol *protocol;
    struct gsn_panel_rows *panels;
    struct gsn_section_rows *sections;
    struct gsn_decision_rows *decided;
    struct gsn_candidate_rows *candidates;
    struct gsn_attachment_rows *attachments;
    struct gsn_specimen_panel *panel;
    struct gsn_panel_section *section; /* of all panels, panel by panel */
    struct gsn_specimen_input *input;
    struct gsn_specimen_decision *decision;
    char (*pose)[16];                /* "pose 2", for the decisions that choose one */
    const char **calibration_sha256; /* its entries are the attachments' */
    struct gsn_mask *region, *mask[GSN_MOST_REGIONS];
    char drawn[1 + GSN_MOST_REGIONS][GSN_DRAWN_SENTENCE]; /* of the main region and the named */
    struct gsn_grid *volume;
    struct gsn_specimen_region named[GSN_MOST_REGIONS];
    struct taken taken[1 + GSN_MOST_REGIONS]; /* of the main region, and of each named one */
    struct control_model *model;              /* of each control with figures of the main region */
    char *page;                               /* of the baseline */
    json_t *baseline_keys;
    char *inputs;
    struct gsn_digest key, own_key;
};

enum { MOST_VOLUME_BYTES = 1 << 30 };

/* Files that the job names. */

static const char *find_attached(const struct gsn_job_inputs *m, const char *name)
{
    for (size_t i = 0; name && i < m->attachments->count; i++)
        if (strcmp(m->attachments->at[i].name, name) == 0)
            return m->attachments->at[i].sha256;
    return NULL;
}

/* Headers name their data file, so the attached files get their own names again for a moment: as
 * links in a folder of their own. gives: the folder. */
static int link_files(const struct gsn_job_inputs *m, char **ret_folder, struct gsn_error *err)
{
    const char *tmp = getenv("TMPDIR");
    gsn_auto_mem(char) folder = gsn_format("%s/gieson.XXXXXX", tmp && tmp[0] ? tmp : "/tmp");

    if (!folder)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (!mkdtemp(folder))
        return gsn_fail(err, GSN_E_IO, "%s: %s", folder, strerror(errno));
    for (size_t i = 0; i < m->attachments->count; i++) {
        gsn_auto_mem(char) path = NULL;
        gsn_auto_mem(char) whole = NULL;
        gsn_auto_mem(char) link = gsn_format("%s/%s", folder, m->attachments->at[i].name);
        int r = gsn_store_object_path(m->store, m->attachments->at[i].sha256, &path, err);

        if (r < 0)
            return r;
        whole = realpath(path, NULL);
        if (!link || !whole || symlink(whole, link) < 0)
            return gsn_fail(err, GSN_E_IO, "the file %s of this specimen: %s",
                            m->attachments->at[i].name, strerror(errno));
    }
    *ret_folder = gsn_steal(&folder);
    return GSN_OK;
}

static void sweep_links(const struct gsn_job_inputs *m, const char *folder)
{
    for (size_t i = 0; i < m->attachments->count; i++) {
        gsn_auto_mem(char) link = gsn_format("%s/%s", folder, m->attachments->at[i].name);

        if (link)
            (void)unlink(link);
    }
    (void)rmdir(folder);
}

/* gives: the mask, where the region names a file; said: where it was drawn, if it was. */
static int read_mask(const struct gsn_region *region, const char *folder, double unit_um,
                     struct gsn_mask **ret_mask, char said[GSN_DRAWN_SENTENCE],
                     struct gsn_error *err)
{
    gsn_auto_mem(char) path = NULL;
    gsn_auto_mem(uint8_t) text = NULL;
    size_t size = 0;
    int r;

    if (!region->file)
        return GSN_OK;
    path = gsn_format("%s/%s", folder, region->file);
    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (region->kind != GSN_REGION_DRAWN)
        return gsn_volume_read_mask(path, MOST_VOLUME_BYTES, unit_um, ret_mask, err);
    r = gsn_file_read(path, GSN_DRAWN_MOST_BYTES, &text, &size, err);
    return r < 0 ? r : gsn_drawn_region_read(region, (const char *)text, size, ret_mask, said, err);
}

static int read_volumes(struct gsn_job_inputs *m, const char *folder, struct gsn_error *err)
{
    const struct gsn_protocol *p = m->protocol;
    const double unit_um = p->spacing_unit == GSN_SPACING_MM ? 1000 : 1;
    int r = read_mask(&p->region, folder, unit_um, &m->region, m->drawn[0], err);

    for (size_t i = 0; r >= 0 && i < p->named_count; i++)
        r = read_mask(&p->named[i].region, folder, unit_um, &m->mask[i], m->drawn[1 + i], err);
    if (r >= 0 && p->kind == GSN_KIND_VOLUME) {
        gsn_auto_mem(char) path = gsn_format("%s/%s", folder, p->file);

        r = path ? gsn_volume_read_grid(path, MOST_VOLUME_BYTES, unit_um, &m->volume, err)
                 : gsn_fail(err, GSN_E_NOMEM, "out of memory");
    }
    return r;
}

/* Nobody knows the folder of links: sentences begin with the file's own name. */
static void drop_folder(const char *folder, struct gsn_error *err)
{
    const size_t length = strlen(folder);

    if (strncmp(err->text, folder, length) == 0 && err->text[length] == '/')
        memmove(err->text, err->text + length + 1, strlen(err->text + length + 1) + 1);
}

static int find_calibrations(struct gsn_job_inputs *m, struct gsn_error *err)
{
    const struct gsn_protocol *p = m->protocol;

    m->calibration_sha256 =
        gsn_alloc_array(p->calibration_count + 1, sizeof *m->calibration_sha256);
    if (!m->calibration_sha256)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the calibration panels");
    for (size_t i = 0; i < p->calibration_count; i++)
        m->calibration_sha256[i] = find_attached(m, p->calibration[i].file);
    m->specimen.calibration_sha256 = m->calibration_sha256;
    return GSN_OK;
}

static int has_files(const struct gsn_protocol *p)
{
    int has = p->region.file || p->kind == GSN_KIND_VOLUME;

    for (size_t i = 0; i < p->named_count; i++)
        has |= p->named[i].region.file != NULL;
    return has;
}

/* Reads every file that the job names. */
static int take_files(struct gsn_job_inputs *m, struct gsn_error *err)
{
    gsn_auto_mem(char) folder = NULL;
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < m->attachments->count; i++) {
        gsn_auto_mem(uint8_t) bytes = NULL;
        size_t size;

        r = gsn_object_read(m->store, m->attachments->at[i].sha256, &bytes, &size, err);
    }
    if (r < 0)
        return r;
    if (has_files(m->protocol)) {
        r = link_files(m, &folder, err);
        if (r >= 0)
            r = read_volumes(m, folder, err);
        if (r < 0 && folder)
            drop_folder(folder, err);
        if (folder)
            sweep_links(m, folder);
    }
    m->specimen.region = m->region;
    m->specimen.region_drawn = m->drawn[0][0] ? m->drawn[0] : NULL;
    for (size_t i = 0; i < m->protocol->named_count; i++) {
        m->named[i].mask = m->mask[i];
        m->named[i].drawn = m->drawn[1 + i][0] ? m->drawn[1 + i] : NULL;
    }
    m->specimen.volume = m->volume;
    if (m->protocol->kind == GSN_KIND_TILE)
        m->specimen.picture_sha256 = find_attached(m, m->protocol->file);
    if (m->protocol->kind == GSN_KIND_TILE && m->protocol->reference[0])
        m->specimen.reference_sha256 = find_attached(m, m->protocol->reference);
    return r < 0 ? r : find_calibrations(m, err);
}

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

/* Baseline. */

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
static int take_control(const struct taken *t, const struct figures *measures,
                        const json_t *parameters, struct gsn_error *err)
{
    struct gsn_specimen_baseline *b = t->into;
    struct gsn_specimen_control *control = &t->control[b->specimens++];

    *control =
        (struct gsn_specimen_control){ .tissues = tissues_of(measures),
                                       .plane_error = measure_named(measures, "plane_error") };
    add_tissues(&control->tissues, b);
    add_turns(measures, b);
    return read_colours(parameters, control, err);
}

/* Adds the figures of one region of a control's run to the sums. */
static int add_figures(struct taken *t, const struct gsn_measure_rows *rows,
                       const json_t *parameters, struct gsn_error *err)
{
    struct gsn_specimen_baseline *b = t->into;
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
static int add_control(struct gsn_job_inputs *m, const struct gsn_specimen_row *control,
                       struct gsn_error *err)
{
    gsn_auto(gsn_run_row) run = NULL;
    gsn_auto(gsn_measure_rows) measures = NULL;
    gsn_auto_mem(char) own_key = NULL;
    const size_t before = m->specimen.baseline.specimens;
    struct gsn_error quiet = { 0 };
    json_t *root;
    int r = finished_run(m->store, control->id, &run, &quiet);

    if (r == GSN_E_NOTFOUND)
        return GSN_OK;
    if (r >= 0)
        r = gsn_measure_list(m->store, run->id, &measures, &quiet);
    if (r < 0)
        return gsn_fail(err, r, "%s", quiet.text);
    root = json_loads(run->parameters_json, 0, NULL);
    own_key = read_parameter(root, "own_key");
    if (!own_key || json_array_append_new(m->baseline_keys, json_string(own_key)) < 0)
        r = gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
    for (size_t i = 0; r >= 0 && i <= m->protocol->named_count; i++)
        r = add_figures(&m->taken[i], measures, find_parameters(root, m->taken[i].name), err);
    json_decref(root);
    if (r >= 0 && m->specimen.baseline.specimens > before) {
        m->model[before].specimen = gsn_strdup(control->name);
        if (!m->model[before].specimen)
            r = gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
    }
    return r;
}

/* The models of the main region's controls. One that is not at hand costs the map of the loss, not
 * the loss. */
static int take_models(struct gsn_job_inputs *m, struct gsn_error *err)
{
    for (size_t i = 0; i < m->specimen.baseline.specimens; i++) {
        struct control_model *const c = &m->model[i];
        struct gsn_specimen_control *const control = &m->taken[0].control[i];
        gsn_auto(gsn_kept_run) kept = NULL;
        struct gsn_error why = { 0 };
        int r = gsn_kept_run_open(m->store, c->specimen, &kept, &why);

        if (r >= 0)
            r = gsn_kept_run_model(m->store, kept, &c->model, &why);
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

/* From the folder of one specimen's run to the last report of another, by names alone: the same
 * whichever run that is. */
static int link_control(struct gsn_job_inputs *m, const struct gsn_specimen_row *control,
                        struct gsn_error *err)
{
    gsn_auto_mem(char) folder = NULL;
    gsn_auto_mem(char) link = NULL;
    const int r = gsn_store_report_dir(m->store, control->name, &folder, err);

    if (r < 0)
        return r;
    link = gsn_study_link(strrchr(folder, '/'));
    m->page = link ? gsn_format("../..%s/" GSN_LATEST "/report.html", link) : NULL;
    m->specimen.baseline.page = m->page;
    return m->page ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
}

/* The sums become means. */
static void finish_baseline(const struct taken *t)
{
    struct gsn_specimen_baseline *b = t->into;

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

/* The mean of the baseline's specimens, region by region, and the keys of their runs. */
static int take_baseline(struct gsn_job_inputs *m, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_rows) controls = NULL;
    const char *name = m->row->baseline;
    const size_t count = 1 + m->protocol->named_count;
    int r = GSN_OK;

    m->baseline_keys = json_array();
    for (size_t i = 0; i < count; i++) {
        m->taken[i].into = i == 0 ? &m->specimen.baseline : &m->named[i - 1].baseline;
        m->taken[i].name = i == 0 ? NULL : m->protocol->named[i - 1].name;
        m->taken[i].into->name = name;
    }
    m->specimen.named = m->named;
    if (!name[0])
        return GSN_OK;
    r = gsn_specimen_baseline(m->store, m->row->study, name, &controls, err);
    if (r >= 0) {
        m->model = gsn_alloc_array(controls->count + 1, sizeof *m->model);
        r = m->model ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
    }
    for (size_t i = 0; r >= 0 && i < count; i++) {
        struct taken *t = &m->taken[i];

        t->into->control = t->control = gsn_alloc_array(controls->count + 1, sizeof *t->control);
        r = t->control ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
    }
    for (size_t i = 0; r >= 0 && i < controls->count; i++)
        if (controls->at[i].id != m->row->id)
            r = add_control(m, &controls->at[i], err);
    if (r >= 0 && controls->count == 1 &&
        m->specimen.baseline.specimens + m->specimen.baseline.withheld == 1)
        r = link_control(m, &controls->at[0], err);
    for (size_t i = 0; i < count; i++)
        finish_baseline(&m->taken[i]);
    return r;
}

/* Panels. */

static int is_clash(const struct gsn_panel_row *a, const struct gsn_panel_row *b)
{
    return a->number == b->number && strcmp(a->state, "registered") == 0 &&
           strcmp(b->state, "registered") == 0;
}

/* Sections of a panel whose three marks were found. */
static size_t count_found(const struct gsn_section_rows *sections, const struct gsn_panel_row *p)
{
    size_t count = 0;

    for (size_t i = 0; i < sections->count; i++)
        count += sections->at[i].panel_id == p->id && strcmp(sections->at[i].state, "found") == 0;
    return count;
}

/* Of two scans of one glass the one that shows more of it: sections with their marks, then finer
 * pixels; of equals the later one, since who scans a glass again wants that scan. */
static int is_better(const struct gsn_section_rows *sections, const struct gsn_panel_row *a,
                     const struct gsn_panel_row *b)
{
    const size_t found_a = count_found(sections, a), found_b = count_found(sections, b);

    if (found_a != found_b)
        return found_a > found_b;
    if (a->px_um < b->px_um || a->px_um > b->px_um)
        return a->px_um < b->px_um;
    return a->id > b->id;
}

/* Of two scans of one glass one is used and the other kept beside it. Two glasses of one number are
 * both held: which of them is right is for a person to say. */
static int resolve_clash(struct gsn_job_inputs *m, struct gsn_decoder *decoder,
                         const struct gsn_section_rows *sections, const struct gsn_panel_row *a,
                         const struct gsn_panel_row *b, struct gsn_error *err)
{
    const struct gsn_panel_row *const pair[2] = { a, b };
    struct gsn_rescan rescan = { .same = 0 };
    int r = gsn_rescan_compare(m->store, decoder, m->protocol, sections, a, b, &rescan, err);

    for (int i = 0; r >= 0 && i < 2; i++) {
        const struct gsn_panel_row *panel = pair[i], *other = pair[1 - i];
        gsn_auto_mem(char) sentence = NULL;

        if (rescan.same && is_better(sections, panel, other))
            continue;
        sentence =
            rescan.same
                ? gsn_format(
                      "another scan of panel %lld is used, %.200s: both show the same glass "
                      "(%zu marks agree to %.1f um, the tissue to %.0f %%); this one is kept "
                      "beside it",
                      (long long)panel->number, other->file_name, rescan.marks, rescan.apart_um,
                      100 * rescan.texture)
                : gsn_format("panel number %lld is claimed by %.200s as well, which shows another "
                             "glass: say which to use, or rename one and import again",
                             (long long)panel->number, other->file_name);
        if (!sentence)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory");
        r = gsn_panel_set_state(m->store, panel->id, "held",
                                rescan.same ? GSN_PANEL_SPARE : gsn_code_name(GSN_E_WITHHELD),
                                sentence, err);
    }
    return r;
}

/* Of panels that claim one number and show one glass the better scan is used; of others all are
 * held. Lists the panels anew. decoder: as for gsn_decode_apart(). */
/* Every pair that claims one number, those that a pair before resolved left out. */
static int resolve_duplicates(struct gsn_job_inputs *m, struct gsn_decoder *decoder,
                              struct gsn_error *err)
{
    for (;;) {
        gsn_auto(gsn_section_rows) sections = NULL;
        const struct gsn_panel_row *a = NULL, *b = NULL;
        int r = gsn_section_list(m->store, m->row->id, &sections, err);

        for (size_t i = 0; r >= 0 && !b && i < m->panels->count; i++)
            for (size_t j = i + 1; !b && j < m->panels->count; j++)
                if (is_clash(&m->panels->at[i], &m->panels->at[j])) {
                    a = &m->panels->at[i];
                    b = &m->panels->at[j];
                }
        if (r < 0 || !b)
            return r;
        r = resolve_clash(m, decoder, sections, a, b, err);
        if (r < 0)
            return r;
        gsn_panel_rows_free(m->panels);
        m->panels = NULL;
        r = gsn_panel_list(m->store, m->row->id, &m->panels, err);
        if (r < 0)
            return r;
    }
}

/* Refuses panels that lack their turn (panel_job.h). */
static int check_turns(const struct gsn_job_inputs *m, struct gsn_error *err)
{
    for (size_t i = 0; i < m->panels->count; i++)
        if (gsn_panel_lacks_turn(&m->panels->at[i]))
            return gsn_fail(err, GSN_E_INPUT,
                            "panel %s was looked at by an older gieson, which did not keep how it "
                            "lies: import its folder again with --replace, then say `gieson run`",
                            m->panels->at[i].file_name);
    return GSN_OK;
}

/* The specimen's job comes after its panels' jobs, so a panel that still waits had one that failed.
 */
static const char *message_of(const struct gsn_panel_row *row)
{
    return strcmp(row->state, "waiting") == 0
               ? "its own job failed: see `gieson status`, then `gieson retry`"
               : row->message;
}

/* A section that is doubtful by itself, or that a person decided on, keeps the candidates it was
 * found with; those of one that contradicts the stack follow from the stack again. */
static struct gsn_panel_section section_of(const struct gsn_job_inputs *m,
                                           const struct gsn_section_row *row)
{
    struct gsn_panel_section section = gsn_panel_section_of_row(row);

    if (section.sighting == GSN_SIGHT_NEEDS_EYE || gsn_flags_has(&section.flags, GSN_FLAG_DECIDED))
        gsn_candidates_from_rows(m->candidates, row->panel_id, row->slot, &section.candidates);
    /* One that was taken as it was so likely, and not by a person, is taken again or not. */
    if (!gsn_flags_has(&section.flags, GSN_FLAG_DECIDED))
        section.candidates.chosen = 0;
    return section;
}

static struct gsn_orientation upright_of(const struct gsn_panel_row *row)
{
    struct gsn_orientation upright = { .turn = { .mirrored = row->mirrored != 0,
                                                 .quarters = (unsigned)row->quarters } };

    (void)snprintf(upright.note, sizeof upright.note, "%s", row->turn_note);
    return upright;
}

/* The panels and their sections as they were logged. */
static int take_panels(struct gsn_job_inputs *m, struct gsn_error *err)
{
    size_t used = 0;

    m->panel = gsn_alloc_array(m->panels->count, sizeof *m->panel);
    m->section = gsn_alloc_array(m->sections->count, sizeof *m->section);
    if (!m->panel || !m->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the panels of a specimen");
    for (size_t i = 0; i < m->panels->count; i++) {
        const struct gsn_panel_row *row = &m->panels->at[i];
        const size_t first = used;

        for (size_t s = 0; s < m->sections->count; s++)
            if (m->sections->at[s].panel_id == row->id && strcmp(row->state, "registered") == 0)
                m->section[used++] = section_of(m, &m->sections->at[s]);
        m->panel[i] = (struct gsn_specimen_panel){ .number = (unsigned)row->number,
                                                   .file = row->file_name,
                                                   .sha256 = row->sha256,
                                                   .state = row->state,
                                                   .message = message_of(row),
                                                   .size = (size_t)row->size,
                                                   .px_um = row->px_um,
                                                   .upright = upright_of(row),
                                                   .section_count = used - first,
                                                   .section = m->section + first };
    }
    m->specimen.panel = m->panel;
    m->specimen.panel_count = m->panels->count;
    return GSN_OK;
}

/* All inputs by name and hash. */
static int list_inputs(struct gsn_job_inputs *m, struct gsn_error *err)
{
    const size_t count = 1 + m->panels->count + m->attachments->count;
    size_t i = 0;

    m->input = gsn_alloc_array(count, sizeof *m->input);
    if (!m->input)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the provenance");
    m->input[i++] = (struct gsn_specimen_input){ .name = "job.json",
                                                 .sha256 = m->row->job_sha256,
                                                 .size = strlen(m->row->job_json) };
    for (size_t p = 0; p < m->panels->count; p++)
        m->input[i++] = (struct gsn_specimen_input){ .name = m->panels->at[p].file_name,
                                                     .sha256 = m->panels->at[p].sha256,
                                                     .size = (size_t)m->panels->at[p].size };
    for (size_t a = 0; a < m->attachments->count; a++)
        m->input[i++] = (struct gsn_specimen_input){ .name = m->attachments->at[a].name,
                                                     .sha256 = m->attachments->at[a].sha256,
                                                     .size = (size_t)m->attachments->at[a].size };
    m->specimen.input = m->input;
    m->specimen.input_count = count;
    return GSN_OK;
}

/* What people decided, for the report. */
static int take_decisions(struct gsn_job_inputs *m, struct gsn_error *err)
{
    m->decision = gsn_alloc_array(m->decided->count, sizeof *m->decision);
    m->pose = gsn_alloc_array(m->decided->count, sizeof *m->pose);
    if (!m->decision || !m->pose)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for what was decided");
    for (size_t i = 0; i < m->decided->count; i++) {
        const struct gsn_decision_row *row = &m->decided->at[i];
        const unsigned pose = gsn_decisions_pose(row->answer);

        (void)snprintf(m->pose[i], sizeof m->pose[i], "pose %u", pose);
        m->decision[i] = (struct gsn_specimen_decision){ .panel = (unsigned)row->number,
                                                         .slot = (unsigned)row->slot,
                                                         .answer = pose ? m->pose[i] : row->answer,
                                                         .actor = row->actor,
                                                         .reason = row->reason,
                                                         .time = row->time,
                                                         .is_pose = pose > 0 };
    }
    m->specimen.decision = m->decision;
    m->specimen.decision_count = m->decided->count;
    return GSN_OK;
}

static int hash_text(json_t *root, char **ret_text, struct gsn_digest *ret_digest,
                     struct gsn_error *err)
{
    char *dumped = json_dumps(root, JSON_COMPACT);
    gsn_auto_mem(char) text = dumped ? gsn_strdup(dumped) : NULL;
    int r;

    free(dumped); /* door */
    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the provenance");
    r = gsn_sha256(text, strlen(text), ret_digest, err);
    if (r >= 0 && ret_text)
        *ret_text = gsn_steal(&text);
    return r;
}

/* A text that may be any bytes, as something that JSON can hold. */
static json_t *hash_json(const char *text)
{
    struct gsn_digest digest = { "" };

    return gsn_sha256(text, strlen(text), &digest, NULL) < 0 ? json_null()
                                                             : json_string(digest.hex);
}

/* A report that rests on an answer is another report, and says who gave it, when and why. */
static void add_decisions(const struct gsn_job_inputs *m, json_t *root)
{
    json_t *answers = json_array();

    for (size_t i = 0; i < m->decided->count; i++)
        (void)json_array_append_new(answers, json_pack("{s:I, s:I, s:s, s:o, s:o, s:I}", "panel",
                                                       (json_int_t)m->decided->at[i].number, "slot",
                                                       (json_int_t)m->decided->at[i].slot, "answer",
                                                       m->decided->at[i].answer, "by",
                                                       hash_json(m->decided->at[i].actor), "reason",
                                                       hash_json(m->decided->at[i].reason), "time",
                                                       (json_int_t)m->decided->at[i].time));
    if (json_array_size(answers) > 0)
        (void)json_object_set(root, "decisions", answers);
    json_decref(answers);
}

/* The keys of what has been taken so far: with the baseline and without it. */
static int make_keys(struct gsn_job_inputs *m, struct gsn_error *err)
{
    json_t *root = json_object(), *inputs = json_array(), *unread = json_array();
    int r;

    for (size_t i = 0; i < m->specimen.input_count; i++)
        (void)json_array_append_new(inputs,
                                    json_pack("{s:s, s:s}", "name", m->specimen.input[i].name,
                                              "sha256", m->specimen.input[i].sha256));
    for (size_t i = 0; i < m->panels->count; i++)
        if (strcmp(m->panels->at[i].state, "waiting") == 0)
            (void)json_array_append_new(unread, json_string(m->panels->at[i].sha256));
    (void)json_object_set_new(root, "inputs", inputs);
    /* The same inputs, but a report without them: it must not take the other one's place. */
    if (json_array_size(unread) > 0)
        (void)json_object_set(root, "unread", unread);
    json_decref(unread);
    add_decisions(m, root);
    (void)json_object_set_new(root, "version", json_string(GSN_VERSION));
    /* Another version of these may change a pixel or a figure. */
    (void)json_object_set_new(root, "libraries",
                              json_pack("{s:s, s:s, s:s, s:s}", "opencv", gsn_imaging_version(),
                                        "gsl", gsn_linalg_version(), "cairo", gsn_lettering_cairo(),
                                        "pango", gsn_lettering_pango()));
    r = hash_text(root, NULL, &m->own_key, err);
    (void)json_object_set(root, "baseline", m->baseline_keys);
    if (r >= 0)
        r = hash_text(root, &m->inputs, &m->key, err);
    json_decref(root);
    m->specimen.key = m->key.hex;
    return r;
}

/* Gathering. */

static int open_object(void *context, const char *sha256, int *ret_fd, struct gsn_error *err)
{
    return gsn_object_open(context, sha256, ret_fd, err);
}

/* Which of two scans of one panel is used is found only where their pictures may be opened. */
static int load_rows(struct gsn_job_inputs *m, int64_t id, int resolves,
                     struct gsn_decoder *decoder, struct gsn_error *err)
{
    int r = gsn_specimen_get_by_id(m->store, id, &m->row, err);

    if (r >= 0)
        r = gsn_protocol_parse(m->row->job_json, strlen(m->row->job_json), &m->protocol, err);
    if (r >= 0)
        r = gsn_panel_list(m->store, id, &m->panels, err);
    if (r >= 0 && resolves)
        r = resolve_duplicates(m, decoder, err);
    if (r >= 0)
        r = gsn_section_list(m->store, id, &m->sections, err);
    if (r >= 0)
        r = gsn_decision_list(m->store, id, &m->decided, err);
    if (r >= 0)
        r = gsn_candidate_list(m->store, id, &m->candidates, err);
    if (r >= 0)
        r = gsn_attachment_list(m->store, id, &m->attachments, err);
    m->specimen.protocol = m->protocol;
    return r;
}

/* What the key is made of. */
static int take_rows(struct gsn_job_inputs *m, struct gsn_store *store, int64_t id, int resolves,
                     struct gsn_decoder *decoder, struct gsn_error *err)
{
    int r;

    m->store = store;
    m->specimen.open = open_object;
    m->specimen.context = store;
    r = load_rows(m, id, resolves, decoder, err);
    if (r >= 0)
        r = take_panels(m, err);
    if (r >= 0)
        r = take_baseline(m, err);
    if (r >= 0)
        r = list_inputs(m, err);
    if (r >= 0)
        r = take_decisions(m, err);
    return r >= 0 ? make_keys(m, err) : r;
}

int gsn_job_inputs_load(struct gsn_store *store, int64_t specimen_id, struct gsn_decoder *decoder,
                        struct gsn_job_inputs **ret_inputs, struct gsn_error *err)
{
    gsn_auto(gsn_job_inputs) m = gsn_alloc_array(1, sizeof *m);
    int r;

    if (!m)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a specimen");
    r = take_rows(m, store, specimen_id, 1, decoder, err);
    if (r >= 0)
        r = check_turns(m, err);
    if (r >= 0)
        r = take_files(m, err);
    if (r >= 0)
        r = take_models(m, err);
    if (r < 0)
        return r;
    *ret_inputs = gsn_steal(&m);
    return GSN_OK;
}

int gsn_job_inputs_key_now(struct gsn_store *store, int64_t specimen_id, struct gsn_digest *ret_key,
                           struct gsn_error *err)
{
    gsn_auto(gsn_job_inputs) m = gsn_alloc_array(1, sizeof *m);
    const int r = m ? take_rows(m, store, specimen_id, 0, NULL, err)
                    : gsn_fail(err, GSN_E_NOMEM, "out of memory for a specimen");

    if (r >= 0)
        *ret_key = m->key;
    return r;
}

void gsn_job_inputs_free(struct gsn_job_inputs *m)
{
    if (!m)
        return;
    json_decref(m->baseline_keys);
    gsn_specimen_row_free(m->row);
    gsn_protocol_free(m->protocol);
    gsn_panel_rows_free(m->panels);
    gsn_section_rows_free(m->sections);
    gsn_decision_rows_free(m->decided);
    gsn_candidate_rows_free(m->candidates);
    gsn_attachment_rows_free(m->attachments);
    gsn_mask_free(m->region);
    gsn_grid_free(m->volume);
    gsn_free(m->panel);
    gsn_free(m->section);
    gsn_free(m->input);
    gsn_free(m->decision);
    gsn_free(m->pose);
    gsn_free(m->calibration_sha256);
    gsn_free(m->page);
    for (size_t i = 0; m->model && i < m->specimen.baseline.specimens; i++) {
        gsn_free(m->model[i].specimen);
        gsn_model_free(m->model[i].model);
        gsn_free(m->model[i].lacks);
    }
    gsn_free(m->model);
    for (size_t k = 0; k < sizeof m->taken / sizeof m->taken[0]; k++) {
        struct taken *t = &m->taken[k];

        gsn_free(t->definition);
        gsn_free(t->dyes);
        gsn_free(t->rule);
        for (size_t i = 0; t->control && i < t->into->specimens; i++)
            gsn_cloud_free(t->control[i].cloud);
        gsn_free(t->control);
    }
    for (size_t i = 0; i < GSN_MOST_REGIONS; i++)
        gsn_mask_free(m->mask[i]);
    gsn_free(m->inputs);
    gsn_free(m);
}

/* Access */

const struct gsn_specimen *gsn_job_inputs_specimen(const struct gsn_job_inputs *m)
{
    return &m->specimen;
}

const char *gsn_job_inputs_key(const struct gsn_job_inputs *m)
{
    return m->key.hex;
}

const char *gsn_job_inputs_json(const struct gsn_job_inputs *m)
{
    return m->inputs;
}

const char *gsn_job_inputs_own_key(const struct gsn_job_inputs *m)
{
    return m->own_key.hex;
}
