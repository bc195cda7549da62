/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The records of a study, from the store.
 *
 * Steps. 1. All specimens of the study, each with its last run. 2. The report of that run, its hash
 * checked, gives density, loss, volumes and errors. A control counts with its own mean density; any
 * other with (1 - loss) times the mean density of its baseline, which is its density in the
 * baseline's stain. 3. What has no such figure is left out, and so is what a person excluded; both
 * say why. 4. In a blind study groups get letters, in an order that only the audit log explains,
 * and whatever tells a control from a treatment is kept back.
 *
 * Failure: one report that is damaged costs its specimen. Cost: a report.json read a specimen. */
#include "systemd/worker/study.h"

#include "systemd/worker/study_cells.h"

#include <jansson.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "pipeline/specimen/specimen.h"
#include "storage/audit.h"
#include "storage/audit_log.h"
#include "storage/catalog.h"
#include "storage/result.h"

enum { MOST_REPORT_BYTES = 1 << 28, MOST_VOLUMES = GSN_STUDY_MEASURES - 2 };

/* An interval of 95 % has so many standard errors either way. */
static const double TWO_SIDED_95 = 1.96;

/* What a report says of one of its named regions. */
struct named {
    size_t specimen;
    const char *region;
    double density, error, volume, loss, lower, upper;
    const char *why; /* there is no density; NULL: there is */
};

struct gsn_study_files {
    struct gsn_study_input input;
    struct named *named;
    size_t named_count, named_room;
    struct gsn_study_input *part; /* each with specimens of its own, owned */
    struct gsn_study_measure measure[GSN_STUDY_MEASURES];
    double threshold[MOST_VOLUMES];
    size_t threshold_count;
    struct gsn_study_specimen *specimen;
    struct gsn_specimen_rows *rows; /* of the whole store; names are borrowed from here */
    struct gsn_event_rows *events;
    char **text; /* all other texts */
    size_t text_count, text_room;
    struct gsn_digest digest;
    int frozen;
    const char *baseline; /* that was read last; NULL: none yet */
    double baseline_density;
    const char *baseline_group;
};

void gsn_study_files_free(struct gsn_study_files *f)
{
    if (!f)
        return;
    for (size_t i = 0; i < f->text_count; i++)
        gsn_free(f->text[i]);
    gsn_free(f->text);
    for (size_t k = 0; k < f->input.part_count; k++)
        gsn_free((void *)(uintptr_t)f->part[k].specimen);
    gsn_free(f->part);
    gsn_free(f->named);
    for (size_t i = 0; i < f->input.specimen_count; i++)
        gsn_free((void *)(uintptr_t)f->specimen[i].place);
    gsn_free(f->specimen);
    gsn_specimen_rows_free(f->rows);
    gsn_event_rows_free(f->events);
    gsn_free(f);
}

const struct gsn_study_input *gsn_study_files_input(const struct gsn_study_files *files)
{
    return &files->input;
}

const char *gsn_study_files_digest(const struct gsn_study_files *files)
{
    return files->digest.hex;
}

int gsn_study_is_frozen(const struct gsn_study_files *files)
{
    return files->frozen;
}

/* Keeps a text (NULL: memory ran out) until the end. */
static const char *keep_text(struct gsn_study_files *f, char *text)
{
    if (text && f->text_count == f->text_room) {
        char **const more = gsn_realloc_array(f->text, 2 * f->text_room + 16, sizeof *f->text);

        if (!more) {
            gsn_free(text);
            return NULL;
        }
        f->text = more;
        f->text_room = 2 * f->text_room + 16;
    }
    if (text)
        f->text[f->text_count++] = text;
    return text;
}

static int fail_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for a study");
}

/* ---- events -------------------------------------------------------------------------------- */

/* The last event of one of these kinds (the second may be NULL) about a subject. */
static const struct gsn_event_row *find_event(const struct gsn_event_rows *events,
                                              const char *subject, const char *kind,
                                              const char *other)
{
    for (size_t i = events->count; i-- > 0;)
        if ((strcmp(events->at[i].kind, kind) == 0 ||
             (other && strcmp(events->at[i].kind, other) == 0)) &&
            strcmp(events->at[i].subject, subject) == 0)
            return &events->at[i];
    return NULL;
}

static void write_day(int64_t time, char day[16])
{
    const time_t when = (time_t)time;
    struct tm parts;

    if (!gmtime_r(&when, &parts) || strftime(day, 16, "%Y-%m-%d", &parts) == 0)
        day[0] = '\0';
}

/* ---- one report ---------------------------------------------------------------------------- */

static double read_number(const json_t *object, const char *key)
{
    const json_t *const value = json_object_get(object, key);

    return json_is_number(value) ? json_number_value(value) : NAN;
}

/* A row of the report's further figures. */
static double read_row(const json_t *root, const char *name)
{
    const json_t *const rows = json_object_get(root, "measures");
    const json_t *row;
    size_t i;

    json_array_foreach(rows, i, row)
    {
        const char *const said = json_string_value(json_object_get(row, "name"));

        if (said && strcmp(said, name) == 0)
            return read_number(row, "value");
    }
    return NAN;
}

/* The mean of the glass over all panels that are used and its three channels. */
static double read_white(const json_t *root)
{
    const json_t *panel, *code;
    double sum = 0;
    size_t i, c, count = 0;

    json_array_foreach(json_object_get(root, "panels"), i, panel)
        json_array_foreach(json_object_get(panel, "white"), c, code)
    {
        sum += json_number_value(code);
        count++;
    }
    return count ? sum / (double)count : NAN;
}

static void read_bench(const json_t *root, struct gsn_study_specimen *s)
{
    const json_t *const registration = json_object_get(root, "registration");

    s->bench[GSN_BENCH_WHITE] = read_white(root);
    s->bench[GSN_BENCH_STAIN] = read_row(root, "Stain against the baseline's, factor");
    s->bench[GSN_BENCH_FLE] = read_number(registration, "fle_um");
    s->bench[GSN_BENCH_TRE] = read_number(registration, "mean_tre_um");
}

/* The number of a threshold among the study's; adds it while there is room. */
static size_t find_threshold(struct gsn_study_files *f, double threshold)
{
    size_t i = 0;

    while (i < f->threshold_count && fabs(f->threshold[i] - threshold) > 1e-9)
        i++;
    if (i == f->threshold_count && i < MOST_VOLUMES)
        f->threshold[f->threshold_count++] = threshold;
    return i;
}

/* Of sections what the report says of the tissue, nothing where it withholds that; an imported
 * volume has no sections that could tell, so there it is the fitted model's. */
static void read_volumes(struct gsn_study_files *f, const json_t *root,
                         struct gsn_study_specimen *s)
{
    const char *const kind = json_string_value(json_object_get(root, "kind"));
    const int of_sections = kind && strcmp(kind, "specimen") == 0;
    const json_t *row;
    size_t i;

    json_array_foreach(json_object_get(root, "volumes"), i, row)
    {
        const size_t t = find_threshold(f, read_number(row, "threshold"));

        if (t >= MOST_VOLUMES)
            continue;
        if (!of_sections) {
            s->value[2 + t] = 0.5 * (read_number(row, "lower_mm3") + read_number(row, "upper_mm3"));
            continue;
        }
        s->value[2 + t] = read_number(row, "estimate_mm3");
        s->error[2 + t] =
            (read_number(row, "interval_upper_mm3") - read_number(row, "interval_lower_mm3")) /
            (2 * TWO_SIDED_95);
    }
}

/* gives: the report of a run, when it is what the run wrote. */
static int open_report(struct gsn_store *store, const struct gsn_run_row *run, json_t **ret_root,
                       struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto_mem(char) path = gsn_format("%s/%s", gsn_store_dir(store), run->json_path);
    size_t size;
    int r = path ? gsn_audit_file(store, run->json_path, run->json_sha256, err) : fail_memory(err);

    if (r >= 0)
        r = gsn_file_read(path, MOST_REPORT_BYTES, &bytes, &size, err);
    if (r < 0)
        return r;
    *ret_root = json_loadb((const char *)bytes, size, 0, NULL);
    return *ret_root ? GSN_OK : gsn_fail(err, GSN_E_INPUT, "%s is no JSON", run->json_path);
}

/* Mean of a measure of the specimens that a baseline stands for, without this one, and the group of
 * the first. */
static int average_controls(struct gsn_study_files *f, struct gsn_store *store,
                            const struct gsn_specimen_row *row, const char *measure,
                            double *ret_density, const char **ret_group, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_rows) controls = NULL;
    double sum = 0;
    size_t n = 0;
    int r = gsn_specimen_baseline(store, row->study, row->baseline, &controls, err);

    for (size_t i = 0; r >= 0 && i < controls->count; i++) {
        gsn_auto(gsn_run_row) run = NULL;
        gsn_auto(gsn_measure_rows) rows = NULL;

        if (controls->at[i].id == row->id)
            continue;
        if (!*ret_group) {
            *ret_group = keep_text(f, gsn_strdup(controls->at[i].group));
            if (!*ret_group)
                return fail_memory(err);
        }
        r = gsn_run_latest(store, controls->at[i].id, "reported", &run, err);
        if (r == GSN_E_NOTFOUND) {
            r = GSN_OK;
            continue;
        }
        if (r >= 0)
            r = gsn_measure_list(store, run->id, &rows, err);
        for (size_t k = 0; r >= 0 && k < rows->count; k++)
            if (strcmp(rows->at[k].name, measure) == 0) {
                sum += rows->at[k].value;
                n++;
            }
    }
    if (r >= 0)
        *ret_density = n ? sum / (double)n : NAN;
    return r;
}

static void read_own_density(const struct gsn_measure_rows *rows, struct gsn_study_specimen *s)
{
    for (size_t i = 0; i < rows->count; i++) {
        if (strcmp(rows->at[i].name, "mean_density") == 0)
            s->value[0] = rows->at[i].value;
        else if (strcmp(rows->at[i].name, "mean_density_error") == 0)
            s->error[0] = rows->at[i].value;
    }
}

/* The stored error of a mean density is of stain and white alone. */
static void read_section_error(const json_t *root, struct gsn_study_specimen *s)
{
    s->section_error =
        read_row(root, "Standard error of the mean density by sections") / 100 * s->value[0];
    if (isfinite(s->section_error) && isfinite(s->error[0]))
        s->error[0] = hypot(s->error[0], s->section_error);
}

/* The same, read once for all specimens that are compared with one baseline and are none of its
 * own. */
static int read_baseline(struct gsn_study_files *f, struct gsn_store *store,
                         const struct gsn_specimen_row *row, double *ret_density,
                         const char **ret_group, struct gsn_error *err)
{
    const int is_own =
        strcmp(row->baseline, row->group) == 0 || strcmp(row->baseline, row->name) == 0;
    int r;

    if (f->baseline && !is_own && strcmp(f->baseline, row->baseline) == 0) {
        *ret_density = f->baseline_density;
        *ret_group = f->baseline_group;
        return GSN_OK;
    }
    r = average_controls(f, store, row, "mean_density", ret_density, ret_group, err);
    if (r >= 0 && !is_own) {
        f->baseline = row->baseline;
        f->baseline_density = *ret_density;
        f->baseline_group = *ret_group;
    }
    return r;
}

/* From a loss and its interval (1.96 standard errors to either side). */
static void read_loss(const json_t *root, double baseline, struct gsn_study_specimen *s)
{
    const json_t *const interval = json_object_get(root, "loss_interval");
    const double by_vectors = read_row(root, "Standard error of the loss by dye vectors");

    s->loss = read_number(root, "loss_percent");
    s->loss_lower = read_number(interval, "lower");
    s->loss_upper = read_number(interval, "upper");
    s->value[0] = (1 - s->loss / 100) * baseline;
    s->error[0] = (s->loss_upper - s->loss_lower) / (2 * 1.96) / 100 * baseline;
    s->vector_error = by_vectors / 100 * baseline;
}

static const char *say_text(struct gsn_study_files *f, const char *format, ...)
    __attribute__((format(printf, 2, 3)));
static const char *say_text(struct gsn_study_files *f, const char *format, ...)
{
    char said[600];
    va_list args;

    va_start(args, format);
    (void)vsnprintf(said, sizeof said, format, args);
    va_end(args);
    return keep_text(f, gsn_strdup(said));
}

char *gsn_study_link(const char *path)
{
    gsn_auto_mem(char) link = gsn_alloc_array(3 * strlen(path) + 1, 1);
    size_t used = 0;

    if (!link)
        return NULL;
    for (; *path; path++) {
        if (*path == '%') {
            memcpy(link + used, "%25", 3);
            used += 3;
        } else {
            link[used++] = *path;
        }
    }
    return gsn_steal(&link);
}

static int add_named(struct gsn_study_files *f, const struct named *named, struct gsn_error *err)
{
    if (f->named_count == f->named_room) {
        struct named *const more =
            gsn_realloc_array(f->named, 2 * f->named_room + 16, sizeof *f->named);

        if (!more)
            return fail_memory(err);
        f->named = more;
        f->named_room = 2 * f->named_room + 16;
    }
    f->named[f->named_count++] = *named;
    return GSN_OK;
}

/* A loss as read_loss() has it; of a control the density itself. */
static int read_named(struct gsn_study_files *f, struct gsn_store *store,
                      const struct gsn_specimen_row *row, const json_t *region,
                      struct gsn_error *err)
{
    const char *const name = json_string_value(json_object_get(region, "name"));
    const char *const why = json_string_value(json_object_get(region, "withheld"));
    const json_t *const interval = json_object_get(region, "loss_interval");
    gsn_auto_mem(char) measure =
        gsn_format("%s%c%s", name ? name : "", GSN_SPECIMEN_IN_REGION, "mean_density");
    struct named n = { .specimen = f->input.specimen_count,
                       .region = keep_text(f, gsn_strdup(name ? name : "")),
                       .density = read_number(region, "mean_density"),
                       .error = read_number(region, "mean_density_error"),
                       .volume = read_number(region, "volume_mm3"),
                       .loss = read_number(region, "loss_percent"),
                       .lower = read_number(interval, "lower"),
                       .upper = read_number(interval, "upper") };
    const char *group = "";
    double baseline = NAN;
    int r = measure && n.region ? GSN_OK : fail_memory(err);

    if (r >= 0 && *row->baseline) {
        r = average_controls(f, store, row, measure, &baseline, &group, err);
        n.density = (1 - n.loss / 100) * baseline;
        n.error = (n.upper - n.lower) / (2 * TWO_SIDED_95) / 100 * baseline;
    }
    if (r >= 0 && !isfinite(n.density)) {
        n.why = say_text(f, "%s: %.400s", *row->baseline ? "no loss" : "no mean density",
                         why ? why : "its report says no more");
        r = n.why ? GSN_OK : fail_memory(err);
    }
    return r < 0 ? r : add_named(f, &n, err);
}

static int read_report(struct gsn_study_files *f, struct gsn_store *store,
                       const struct gsn_specimen_row *row, const struct gsn_run_row *run,
                       struct gsn_study_specimen *s, struct gsn_error *err)
{
    gsn_auto(gsn_measure_rows) rows = NULL;
    struct gsn_error why = { 0 };
    json_t *root = NULL;
    double baseline = NAN;
    int r = open_report(store, run, &root, &why);

    if (r < 0) {
        s->left_out =
            say_text(f, "%s: `gieson verify %s` says what else changed", why.text, row->name);
        return r == GSN_E_NOMEM || !s->left_out ? fail_memory(err) : GSN_OK;
    }
    r = gsn_measure_list(store, run->id, &rows, err);
    if (r >= 0 && *row->baseline)
        r = read_baseline(f, store, row, &baseline, &s->control, err);
    if (r >= 0) {
        s->value[1] = read_number(json_object_get(root, "region"), "volume_mm3");
        read_volumes(f, root, s);
        read_bench(root, s);
        if (*row->baseline)
            read_loss(root, baseline, s);
        else
            read_own_density(rows, s);
        read_section_error(root, s);
        s->key = keep_text(f, gsn_strdup(run->key));
        s->warnings = json_array_size(json_object_get(root, "warnings"));
        if (!s->key)
            r = fail_memory(err);
    }
    for (size_t i = 0; r >= 0 && i < json_array_size(json_object_get(root, "regions")); i++)
        r = read_named(f, store, row, json_array_get(json_object_get(root, "regions"), i), err);
    if (r >= 0 && !isfinite(s->value[0])) {
        const char *const reason = json_string_value(json_object_get(root, "loss_reason"));

        s->left_out = say_text(f, "%s: %.400s", *row->baseline ? "no loss" : "no mean density",
                               reason ? reason : run->message);
        if (!s->left_out)
            r = fail_memory(err);
    }
    json_decref(root);
    return r;
}

/* ---- one specimen -------------------------------------------------------------------------- */

static int note_exclusion(struct gsn_study_files *f, const struct gsn_specimen_row *row,
                          int64_t first_report, struct gsn_study_specimen *s, struct gsn_error *err)
{
    const struct gsn_event_row *const e =
        find_event(f->events, row->name, GSN_STUDY_EXCLUDE, GSN_STUDY_INCLUDE);
    char day[16];

    if (!e || strcmp(e->kind, GSN_STUDY_EXCLUDE) != 0)
        return GSN_OK;
    write_day(e->time, day);
    s->excluded = 1;
    s->left_out =
        say_text(f, "excluded by %s on %s, %s its first report: %.300s", e->actor, day,
                 first_report == 0 || e->time < first_report ? "before" : "after", e->text);
    return s->left_out ? GSN_OK : fail_memory(err);
}

static int read_specimen(struct gsn_study_files *f, struct gsn_store *store,
                         const struct gsn_specimen_row *row, struct gsn_study_specimen *s,
                         struct gsn_error *err)
{
    gsn_auto(gsn_run_rows) runs = NULL;
    const struct gsn_run_row *last = NULL;
    int64_t first_report = 0;
    int r = gsn_run_list(store, row->id, &runs, err);

    *s = (struct gsn_study_specimen){ .name = row->name,
                                      .animal = *row->animal ? row->animal : row->name,
                                      .group = row->group,
                                      .week = row->week,
                                      .vector_error = NAN,
                                      .section_error = NAN,
                                      .loss = NAN,
                                      .loss_lower = NAN,
                                      .loss_upper = NAN,
                                      .key = "" };
    for (size_t m = 0; m < GSN_STUDY_MEASURES; m++)
        s->value[m] = s->error[m] = NAN;
    for (size_t k = 0; k < GSN_BENCH_FIGURES; k++)
        s->bench[k] = NAN;
    for (size_t i = 0; r >= 0 && i < runs->count; i++)
        if (strcmp(runs->at[i].state, "running") != 0) {
            last = &runs->at[i];
            first_report = first_report == 0 && last->json_path[0] ? last->finished : first_report;
        }
    if (r >= 0 && last) {
        s->finished = last->finished;
        s->first = first_report;
        s->page = *last->report_path ? keep_text(f, gsn_study_link(last->report_path)) : NULL;
        if (*last->report_path && !s->page)
            r = fail_memory(err);
    }
    if (r < 0)
        return r;
    if (!last)
        s->left_out = say_text(f, "has no report yet: `gieson run` does the jobs");
    else if (strcmp(last->state, "reported") != 0)
        s->left_out = say_text(f, "%s: %.400s", last->state, last->message);
    else
        r = read_report(f, store, row, last, s, err);
    if (r >= 0 && (!last || strcmp(last->state, "reported") != 0) && !s->left_out)
        r = fail_memory(err);
    /* The side that it would be on, so that a table has it there. */
    if (r >= 0 && *row->baseline && !s->control)
        s->control = "";
    if (r >= 0)
        r = note_exclusion(f, row, first_report, s, err);
    return r;
}

/* ---- the whole ----------------------------------------------------------------------------- */

static int name_measures(struct gsn_study_files *f, struct gsn_error *err)
{
    f->measure[0] = (struct gsn_study_measure){
        "density", "density",
        "mean collagen density of the region, 0 none and 1 full, in the stain of the control"
    };
    f->measure[1] = (struct gsn_study_measure){ "region_volume", "mm3", "volume of the region" };
    for (size_t i = 0; i < f->threshold_count; i++) {
        const char *const name = say_text(f, "volume_above_%.9g", f->threshold[i]);
        const char *const what =
            say_text(f,
                     "volume of the region's tissue with a density above %.9g; of an imported "
                     "volume, of its fitted model",
                     f->threshold[i]);

        if (!name || !what)
            return fail_memory(err);
        f->measure[2 + i] = (struct gsn_study_measure){ name, "mm3", what };
    }
    f->input.measure = f->measure;
    f->input.measure_count = 2 + f->threshold_count;
    return GSN_OK;
}

static int digest_specimens(struct gsn_study_files *f, struct gsn_error *err)
{
    struct gsn_sha256_text {
        char *bytes;
        size_t size;
    } all = { NULL, 0 };
    int r;

    for (size_t i = 0; i < f->input.specimen_count; i++) {
        const struct gsn_study_specimen *const s = &f->specimen[i];
        char *const more = gsn_format("%s%zu:%s %s %s\n", all.bytes ? all.bytes : "",
                                      strlen(s->name), s->name, s->key, s->left_out ? "out" : "in");

        gsn_free(all.bytes);
        all.bytes = more;
        if (!more)
            return fail_memory(err);
    }
    r = gsn_sha256(all.bytes ? all.bytes : "", all.bytes ? strlen(all.bytes) : 0, &f->digest, err);
    gsn_free(all.bytes);
    return r;
}

/* ---- blind --------------------------------------------------------------------------------- */

/* A group's place in an order that nobody can tell beforehand. */
struct code {
    const char *group;
    struct gsn_digest order;
    const char *letter;
};

static int compare_codes(const void *left, const void *right)
{
    return strcmp(((const struct code *)left)->order.hex, ((const struct code *)right)->order.hex);
}

static const char *find_code(const struct code *code, size_t count, const char *group)
{
    for (size_t i = 0; i < count; i++)
        if (strcmp(code[i].group, group) == 0)
            return code[i].letter;
    return NULL;
}

static void hide_specimen(struct gsn_study_specimen *s, const char *letter)
{
    s->group = letter;
    s->control = NULL;
    s->page = NULL;
    s->key = "";
    s->loss = s->loss_lower = s->loss_upper = NAN;
    s->name = s->animal;
    /* A reason of ours may name the baseline. */
    if (s->left_out && !s->excluded)
        s->left_out = "has no figure; why is shown once the study is no longer blind";
}

/* salt: the hash of the event that made the study blind. */
static int hide_groups(struct gsn_study_files *f, const char *salt, struct gsn_error *err)
{
    gsn_auto_mem(struct code) code = gsn_alloc_array(f->input.specimen_count + 1, sizeof *code);
    size_t count = 0;

    if (!code)
        return fail_memory(err);
    for (size_t i = 0; i < f->input.specimen_count; i++) {
        const char *const group = f->specimen[i].group;
        size_t k = 0;

        while (k < count && strcmp(code[k].group, group) != 0)
            k++;
        if (k == count) {
            gsn_auto_mem(char) salted = gsn_format("%s%s", salt, group);

            if (!salted || gsn_sha256(salted, strlen(salted), &code[k].order, err) < 0)
                return fail_memory(err);
            code[count++].group = group;
        }
    }
    qsort(code, count, sizeof *code, compare_codes);
    for (size_t k = 0; k < count; k++) {
        code[k].letter = say_text(f, "group %c%s", (char)('A' + k % 26), k < 26 ? "" : "'");
        if (!code[k].letter)
            return fail_memory(err);
    }
    for (size_t i = 0; i < f->input.specimen_count; i++)
        hide_specimen(&f->specimen[i], find_code(code, count, f->specimen[i].group));
    return GSN_OK;
}

static int note_freeze(struct gsn_study_files *f, struct gsn_error *err)
{
    const struct gsn_event_row *const freeze =
        find_event(f->events, f->input.name, GSN_STUDY_FREEZE, NULL);
    const struct gsn_event_row *const blind =
        find_event(f->events, f->input.name, GSN_STUDY_BLIND, GSN_STUDY_UNBLIND);
    char day[16];

    if (freeze) {
        f->frozen = 1;
        write_day(freeze->time, day);
        f->input.frozen = say_text(f, "on %s by %s%s", day, freeze->actor,
                                   strcmp(freeze->text, f->digest.hex) == 0
                                       ? ""
                                       : "; specimens, runs or exclusions have changed since");
        if (!f->input.frozen)
            return fail_memory(err);
    }
    if (!blind || strcmp(blind->kind, GSN_STUDY_BLIND) != 0)
        return GSN_OK;
    f->input.blind = 1;
    return hide_groups(f, blind->hash, err);
}

/* ---- further regions ----------------------------------------------------------------------- */

static const struct named *find_region(const struct gsn_study_files *f, size_t specimen,
                                       const char *region)
{
    for (size_t i = 0; i < f->named_count; i++)
        if (f->named[i].specimen == specimen && strcmp(f->named[i].region, region) == 0)
            return &f->named[i];
    return NULL;
}

/* A specimen with the figures of one of its regions. Who was excluded is so in all of them. */
static struct gsn_study_specimen show_region(const struct gsn_study_files *f, size_t specimen,
                                             const char *region)
{
    const struct named *const n = find_region(f, specimen, region);
    struct gsn_study_specimen s = f->specimen[specimen];

    for (size_t m = 0; m < GSN_STUDY_MEASURES; m++)
        s.value[m] = s.error[m] = NAN;
    s.vector_error = s.section_error = s.loss = s.loss_lower = s.loss_upper = NAN;
    if (s.excluded)
        return s;
    if (!n) {
        s.left_out = s.left_out && f->input.blind ? s.left_out : "it has no report of this region";
        return s;
    }
    s.value[0] = n->density;
    s.error[0] = n->error;
    s.value[1] = n->volume;
    s.left_out = n->why && f->input.blind
                     ? "has no figure; why is shown once the study is no longer blind"
                     : n->why;
    if (!f->input.blind) {
        s.loss = n->loss;
        s.loss_lower = n->lower;
        s.loss_upper = n->upper;
    }
    return s;
}

/* One more input a region, in order of first sight; comes after names were hidden. */
static int make_parts(struct gsn_study_files *f, struct gsn_error *err)
{
    f->part = gsn_alloc_array(f->named_count + 1, sizeof *f->part);
    if (!f->part)
        return fail_memory(err);
    for (size_t i = 0; i < f->named_count; i++) {
        struct gsn_study_specimen *specimen;
        size_t k = 0;

        while (k < f->input.part_count && strcmp(f->part[k].region, f->named[i].region) != 0)
            k++;
        if (k < f->input.part_count)
            continue;
        specimen = gsn_alloc_array(f->input.specimen_count + 1, sizeof *specimen);
        if (!specimen)
            return fail_memory(err);
        for (size_t s = 0; s < f->input.specimen_count; s++)
            specimen[s] = show_region(f, s, f->named[i].region);
        f->part[k] = f->input;
        f->part[k].region = f->named[i].region;
        f->part[k].measure_count = 2;
        f->part[k].specimen = specimen;
        f->part[k].part = NULL;
        f->part[k].part_count = 0;
        f->input.part_count++;
    }
    f->input.part = f->part;
    return GSN_OK;
}

static int fail_unknown(struct gsn_store *store, const char *name, struct gsn_error *err)
{
    gsn_auto(gsn_study_names) names = NULL;
    gsn_auto_mem(char) list = NULL;
    int r = gsn_study_list(store, &names, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < names->count; i++) {
        char *const more = gsn_format("%s%s%s", list ? list : "", i ? ", " : "", names->at[i]);

        gsn_free(list);
        list = more;
    }
    return gsn_fail(err, GSN_E_NOTFOUND,
                    "no specimen is of a study \"%.80s\"; studies here: %.300s", name,
                    list ? list : "none (state `study` in job.json)");
}

int gsn_study_gather(struct gsn_store *store, const char *name, struct gsn_study_files **ret_files,
                     struct gsn_error *err)
{
    gsn_auto(gsn_study_files) f = gsn_alloc_array(1, sizeof *f);
    int r = f ? gsn_specimen_list(store, &f->rows, err) : fail_memory(err);

    if (r >= 0)
        r = gsn_event_list(store, 0, &f->events, err);
    if (r >= 0) {
        f->specimen = gsn_alloc_array(f->rows->count + 1, sizeof *f->specimen);
        r = f->specimen ? GSN_OK : fail_memory(err);
    }
    if (r < 0)
        return r;
    f->input = (struct gsn_study_input){ .version = GSN_VERSION,
                                         .specimen = f->specimen,
                                         .region = "the region that each job.json states" };
    for (size_t i = 0; r >= 0 && i < f->rows->count; i++)
        if (strcmp(f->rows->at[i].study, name) == 0) {
            f->input.name = f->rows->at[i].study;
            r = read_specimen(f, store, &f->rows->at[i], &f->specimen[f->input.specimen_count],
                              err);
            f->input.specimen_count += r >= 0;
        }
    if (r >= 0 && f->input.specimen_count == 0)
        return fail_unknown(store, name, err);
    if (r >= 0)
        r = name_measures(f, err);
    if (r >= 0)
        r = digest_specimens(f, err);
    if (r >= 0)
        r = note_freeze(f, err);
    if (r >= 0)
        r = make_parts(f, err);
    if (r >= 0)
        *ret_files = gsn_steal(&f);
    return r;
}

static const struct gsn_specimen_row *find_row(const struct gsn_study_files *f, const char *name)
{
    for (size_t i = 0; i < f->rows->count; i++)
        if (strcmp(f->rows->at[i].name, name) == 0)
            return &f->rows->at[i];
    return NULL;
}

int gsn_study_read_cells(struct gsn_study_files *f, struct gsn_store *store, struct gsn_error *err)
{
    gsn_auto(gsn_cell_tables) tables = gsn_cell_tables_new();
    int r = tables ? GSN_OK : fail_memory(err);

    for (size_t i = 0; r >= 0 && !f->input.blind && i < f->input.specimen_count; i++) {
        struct gsn_study_specimen *const s = &f->specimen[i];
        const struct gsn_specimen_row *const row = s->left_out ? NULL : find_row(f, s->name);
        struct gsn_study_place *place = NULL;

        if (!row)
            continue;
        r = gsn_study_places(tables, store, row, &place, &s->place_count, err);
        s->place = place;
    }
    return r;
}

/* ---- files --------------------------------------------------------------------------------- */

static int write_one(const char *folder, const char *name, const struct gsn_study *study,
                     int (*make)(const struct gsn_study *, char **, size_t *, struct gsn_error *),
                     struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", folder, name);
    gsn_auto_mem(char) bytes = NULL;
    size_t size;
    int r = path ? make(study, &bytes, &size, err) : fail_memory(err);

    return r < 0 ? r : gsn_file_write(path, bytes, size, err);
}

int gsn_study_write(struct gsn_store *store, const struct gsn_study *study, char **ret_folder,
                    struct gsn_error *err)
{
    gsn_auto_mem(char) folder = NULL;
    int r = gsn_store_study_dir(store, study->input.name, &folder, err);

    if (r >= 0)
        r = gsn_file_mkdir(folder, err);
    if (r >= 0)
        r = write_one(folder, "animals.csv", study, gsn_study_csv, err);
    if (r >= 0)
        r = write_one(folder, "loss-cells.csv", study, gsn_study_cells_csv, err);
    if (r >= 0)
        r = write_one(folder, "study.json", study, gsn_study_json, err);
    if (r >= 0)
        r = write_one(folder, "index.html", study, gsn_study_page, err);
    if (r >= 0)
        *ret_folder = gsn_steal(&folder);
    return r;
}

void gsn_study_names_free(struct gsn_study_names *names)
{
    if (!names)
        return;
    for (size_t i = 0; i < names->count; i++)
        gsn_free(names->at[i]);
    gsn_free(names->at);
    gsn_free(names);
}

static int compare_names(const void *left, const void *right)
{
    return strcmp(*(char *const *)left, *(char *const *)right);
}

int gsn_study_list(struct gsn_store *store, struct gsn_study_names **ret_names,
                   struct gsn_error *err)
{
    gsn_auto(gsn_specimen_rows) rows = NULL;
    gsn_auto(gsn_study_names) names = gsn_alloc_array(1, sizeof *names);
    int r = names ? gsn_specimen_list(store, &rows, err) : fail_memory(err);

    if (r < 0)
        return r;
    names->at = gsn_alloc_array(rows->count + 1, sizeof *names->at);
    if (!names->at)
        return fail_memory(err);
    for (size_t i = 0; i < rows->count; i++) {
        size_t k = 0;

        while (k < names->count && strcmp(names->at[k], rows->at[i].study) != 0)
            k++;
        if (k < names->count || !*rows->at[i].study)
            continue;
        names->at[k] = gsn_strdup(rows->at[i].study);
        if (!names->at[k])
            return fail_memory(err);
        names->count++;
    }
    qsort(names->at, names->count, sizeof *names->at, compare_names);
    *ret_names = gsn_steal(&names);
    return GSN_OK;
}
