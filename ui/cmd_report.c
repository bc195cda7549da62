/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verbs that show what a finished run left: report, trace.
 *
 * Both hold the run's files against their hashes first: a report that is not what the run wrote is
 * not shown. `report` gives where the page, its JSON and its PDF lie, or its JSON. `trace` goes
 * from a figure back to what it rests on. Steps, of a specimen: (1) its latest report; (2) the
 * figure and how it is computed; the baseline's runs, and whether their density is still the one
 * that was used; (3) sections, those that were not used with why, panels and files with their
 * hashes, what people decided; (4) the run before it with another key, and every parameter, file
 * and figure in which the two differ. Of a study: its animals and their specimens, each with its
 * run; groups are not named, it may be blind.
 *
 * Failure: 66 without a report, 65 where a file was changed. Cost: two JSON files read. */

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sysexits.h>
#include <time.h>

#include "pipeline/core/file.h"
#include "storage/audit.h"
#include "storage/catalog.h"
#include "storage/result.h"
#include "ui/text.h"
#include "ui/ui.h"

enum { MOST_REPORT_BYTES = 1 << 28 };

/* ---- the report ------------------------------------------------------------------------------ */

/* A report that is not what the run wrote is not handed out, whichever half of it was asked for. */
static int check_files(struct gsn_store *store, const struct gsn_run_row *run,
                       struct gsn_error *err)
{
    struct gsn_error why = { 0 };
    int r = gsn_audit_file(store, run->json_path, run->json_sha256, &why);

    if (r >= 0)
        r = gsn_audit_file(store, run->report_path, run->report_sha256, &why);
    if (r >= 0)
        return r;
    return gsn_fail(err, r, "%s; it is not shown. `gieson verify %lld` says what else changed",
                    why.text, (long long)run->id);
}

static int print_file(const char *path, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size;
    const int r = gsn_file_read(path, MOST_REPORT_BYTES, &bytes, &size, err);

    if (r >= 0)
        (void)fwrite(bytes, 1, size, stdout);
    return r;
}

/* gives: where the page on paper lies, from the store's folder, held against its hash in the
 * report; NULL for a run of a gieson that made none. */
static int check_pdf(struct gsn_store *store, const struct gsn_run_row *run, const char *json,
                     char **ret_path, struct gsn_error *err)
{
    json_t *report = json_load_file(json, 0, NULL);
    const json_t *outputs = json_object_get(json_object_get(report, "provenance"), "outputs");
    gsn_auto_mem(char) path = NULL;
    json_t *output;
    size_t i;
    int r = GSN_OK;

    json_array_foreach(outputs, i, output)
    {
        const char *name = json_string_value(json_object_get(output, "name"));
        const char *sha256 = json_string_value(json_object_get(output, "sha256"));

        if (!name || !sha256 || strcmp(name, "report.pdf") != 0)
            continue;
        path = gsn_format("%.*s%s", (int)(strrchr(run->report_path, '/') + 1 - run->report_path),
                          run->report_path, name);
        r = path ? gsn_audit_file(store, path, sha256, err)
                 : gsn_fail(err, GSN_E_NOMEM, "out of memory");
        break;
    }
    json_decref(report);
    if (r >= 0)
        *ret_path = gsn_steal(&path);
    return r;
}

static void print_region(const json_t *region)
{
    const char *const name = json_string_value(json_object_get(region, "name"));
    const char *const why = json_string_value(json_object_get(region, "withheld"));
    const json_t *const interval = json_object_get(region, "loss_interval");
    const json_t *const loss = json_object_get(region, "loss_percent");
    char said[200] = "no loss", range[80] = "";

    if (json_is_object(interval))
        (void)snprintf(range, sizeof range, " (%.1f to %.1f)",
                       json_number_value(json_object_get(interval, "lower")),
                       json_number_value(json_object_get(interval, "upper")));
    if (json_is_number(loss))
        (void)snprintf(said, sizeof said, "loss %.1f %%%s", json_number_value(loss), range);
    if (json_is_number(json_object_get(region, "mean_density")))
        gsn_text_line(stdout, "region %s: %s, mean density %.3f, %.4g mm3%s%s", name ? name : "",
                      said, json_number_value(json_object_get(region, "mean_density")),
                      json_number_value(json_object_get(region, "volume_mm3")), why ? "; " : "",
                      why ? why : "");
    else
        gsn_text_line(stdout, "region %s: withheld: %s", name ? name : "", why ? why : "");
}

/* A line a named region of the report. */
static int print_regions(const char *path, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    const json_t *region;
    json_t *report;
    size_t size, i;
    const int r = gsn_file_read(path, MOST_REPORT_BYTES, &bytes, &size, err);

    if (r < 0)
        return r;
    report = json_loadb((const char *)bytes, size, 0, NULL);
    json_array_foreach(json_object_get(report, "regions"), i, region) print_region(region);
    json_decref(report);
    return GSN_OK;
}

int gsn_cmd_report(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_run_row) run = NULL;
    gsn_auto_mem(char) json = NULL;
    gsn_auto_mem(char) pdf = NULL;
    struct gsn_error err = { 0 };
    int status = EX_OK, r;

    if (argc != 2)
        return gsn_ui_usage(ui, "report of which specimen? Say `gieson report SPECIMEN`");
    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    r = gsn_run_latest_report(store, argv[1], &run, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    json = gsn_format("%s/%s", gsn_store_dir(store), run->json_path);
    if (!json)
        return gsn_ui_fail(ui, EX_OSERR, "out of memory");
    r = check_files(store, run, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    if (ui->json) {
        r = print_file(json, &err);
        return r < 0 ? gsn_ui_complain(ui, &err, r) : EX_OK;
    }
    r = check_pdf(store, run, json, &pdf, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    gsn_text_line(stdout, "run %lld, %s%s%s", (long long)run->id, run->state,
                  run->message[0] ? ": " : "", run->message);
    (void)printf("%s/%s\n%s\n", gsn_store_dir(store), run->report_path, json);
    if (pdf)
        (void)printf("%s/%s\n", gsn_store_dir(store), pdf);
    r = print_regions(json, &err);
    return r < 0 ? gsn_ui_complain(ui, &err, r) : EX_OK;
}

/* ---- what a figure rests on ------------------------------------------------------------------ */

/* A run and its report. */
struct traced {
    struct gsn_run_row *run; /* owned; NULL: there is none */
    json_t *report;          /* owned; NULL: its file is not what the run wrote */
};

static void traced_done(struct traced *traced)
{
    gsn_run_row_free(traced->run);
    json_decref(traced->report);
}
#define auto_traced __attribute__((cleanup(traced_done))) struct traced

static int read_run(struct gsn_store *store, int64_t id, struct traced *ret_traced,
                    struct gsn_error *err)
{
    gsn_auto(gsn_run_row) run = NULL;
    gsn_auto_mem(char) path = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    json_t *report;
    size_t size;
    int r = gsn_run_get(store, id, &run, err);

    if (r >= 0)
        r = check_files(store, run, err);
    if (r < 0)
        return r;
    path = gsn_format("%s/%s", gsn_store_dir(store), run->json_path);
    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = gsn_file_read(path, MOST_REPORT_BYTES, &bytes, &size, err);
    if (r < 0)
        return r;
    report = json_loadb((const char *)bytes, size, 0, NULL);
    if (!report)
        return gsn_fail(err, GSN_E_INPUT, "%s is no JSON", path);
    *ret_traced = (struct traced){ gsn_steal(&run), report };
    return GSN_OK;
}

/* The run before this one that left a report of other inputs, parameters or version; none: nothing
 * in ret_traced. One whose files were changed since is passed over. */
static int find_run_before(struct gsn_store *store, const struct gsn_run_row *run,
                           struct traced *ret_traced, struct gsn_error *err)
{
    gsn_auto(gsn_run_rows) runs = NULL;
    int r = gsn_run_list(store, run->specimen_id, &runs, err);

    if (r < 0)
        return r;
    for (size_t i = runs->count; i-- > 0;) {
        const struct gsn_run_row *const other = &runs->at[i];

        if (other->id < run->id && other->json_path[0] && strcmp(other->key, run->key) != 0 &&
            read_run(store, other->id, ret_traced, NULL) >= 0)
            return GSN_OK;
    }
    return GSN_OK;
}

static void add_text(json_t *array, char *owned)
{
    if (owned)
        (void)json_array_append_new(array, gsn_text_json(owned));
    gsn_free(owned);
}

/* A value of the report as a person reads it. gives. */
static char *value_words(const json_t *value)
{
    if (json_is_string(value))
        return gsn_strdup(json_string_value(value));
    if (json_is_number(value))
        return gsn_format("%.6g", json_number_value(value));
    return gsn_strdup("nothing");
}

static const json_t *find_named(const json_t *rows, const char *name)
{
    const json_t *row;
    size_t i;

    json_array_foreach(rows, i, row)
    {
        const char *const said = json_string_value(json_object_get(row, "name"));

        if (said && strcmp(said, name) == 0)
            return row;
    }
    return NULL;
}

/* What rows of one list of two reports differ in, by their names. */
static void compare_rows(json_t *changes, const json_t *was, const json_t *is, const char *key,
                         const char *what)
{
    const json_t *row;
    size_t i;

    json_array_foreach(is, i, row)
    {
        const char *const name = json_string_value(json_object_get(row, "name"));
        const json_t *const old = name ? find_named(was, name) : NULL;
        const json_t *const now = json_object_get(row, key);
        gsn_auto_mem(char) before = old ? value_words(json_object_get(old, key)) : NULL;
        gsn_auto_mem(char) after = value_words(now);

        if (!name || !after || (old && before && strcmp(before, after) == 0))
            continue;
        add_text(changes, old ? gsn_format("%s %s: %s, was %s", what, name, after, before)
                              : gsn_format("%s %s is new: %s", what, name, after));
    }
    json_array_foreach(was, i, row)
    {
        const char *const name = json_string_value(json_object_get(row, "name"));

        if (name && !find_named(is, name))
            add_text(changes, gsn_format("%s %s is there no more", what, name));
    }
}

static void compare_values(json_t *changes, const json_t *was, const json_t *is, const char *what)
{
    gsn_auto_mem(char) before = value_words(was);
    gsn_auto_mem(char) after = value_words(is);

    if (before && after && strcmp(before, after) != 0)
        add_text(changes, gsn_format("%s: %s, was %s", what, after, before));
}

/* gives: sentences. */
static json_t *compare_reports(const json_t *was, const json_t *is)
{
    json_t *changes = json_array();
    const json_t *const old = json_object_get(was, "provenance");
    const json_t *const now = json_object_get(is, "provenance");
    const json_t *const old_region = json_object_get(was, "region");
    const json_t *const region = json_object_get(is, "region");

    compare_values(changes, json_object_get(was, "loss_percent"),
                   json_object_get(is, "loss_percent"), "loss, %");
    compare_values(changes, json_object_get(was, "baseline_mean_density"),
                   json_object_get(is, "baseline_mean_density"), "mean density of the baseline");
    compare_values(changes, json_object_get(old_region, "mean_density"),
                   json_object_get(region, "mean_density"), "mean density of the region");
    compare_values(changes, json_object_get(old, "version"), json_object_get(now, "version"),
                   "gieson");
    compare_rows(changes, json_object_get(old, "inputs"), json_object_get(now, "inputs"), "sha256",
                 "file");
    compare_rows(changes, json_object_get(old, "parameters"), json_object_get(now, "parameters"),
                 "value", "parameter");
    return changes;
}

/* gives: each specimen of the baseline with its latest run, and whether its density moved since. */
static json_t *trace_baseline(struct gsn_store *store, const struct gsn_specimen_row *specimen,
                              struct gsn_error *err)
{
    gsn_auto(gsn_specimen_rows) rows = NULL;
    json_t *list = json_array();

    if (!*specimen->baseline)
        return list;
    if (gsn_specimen_baseline(store, specimen->study, specimen->baseline, &rows, err) < 0)
        return list;
    for (size_t i = 0; i < rows->count; i++) {
        auto_traced of = { 0 };
        gsn_auto(gsn_run_row) run = NULL;
        const json_t *region;

        if (gsn_run_latest_report(store, rows->at[i].name, &run, NULL) < 0 ||
            read_run(store, run->id, &of, NULL) < 0) {
            (void)json_array_append_new(list, json_pack("{s:o, s:n, s:n, s:n}", "specimen",
                                                        gsn_text_json(rows->at[i].name), "run",
                                                        "key", "mean_density"));
            continue;
        }
        region = json_object_get(of.report, "region");
        (void)json_array_append_new(
            list, json_pack("{s:o, s:I, s:s, s:O?}", "specimen", gsn_text_json(rows->at[i].name),
                            "run", (json_int_t)of.run->id, "key", of.run->key, "mean_density",
                            json_object_get(region, "mean_density")));
    }
    return list;
}

/* "2.1": as every other sheet counts. */
static char *section_place(const json_t *section)
{
    return gsn_format("%lld.%lld", (long long)json_integer_value(json_object_get(section, "panel")),
                      (long long)json_integer_value(json_object_get(section, "slot")) + 1);
}

/* gives: the sections that were not used, each with its state and flags; *ret_used counts the
 * rest. */
static json_t *trace_sections(const json_t *report, size_t *ret_used, size_t *ret_count)
{
    const json_t *section;
    json_t *left = json_array();
    size_t i;

    *ret_used = *ret_count = 0;
    json_array_foreach(json_object_get(report, "sections"), i, section)
    {
        const char *const state = json_string_value(json_object_get(section, "state"));
        gsn_auto_mem(char) place = section_place(section);

        if (!state || strcmp(state, "empty") == 0 || !place)
            continue;
        (*ret_count)++;
        if (strcmp(state, "used") == 0)
            (*ret_used)++;
        else
            (void)json_array_append_new(left, json_pack("{s:s, s:s, s:O?}", "section", place,
                                                        "state", state, "flags",
                                                        json_object_get(section, "flags")));
    }
    return left;
}

/* gives: all of it, for people and programs alike. */
static json_t *trace_specimen(struct gsn_store *store, const struct gsn_specimen_row *specimen,
                              const struct traced *now, const struct traced *before,
                              struct gsn_error *err)
{
    const json_t *const report = now->report;
    const json_t *const provenance = json_object_get(report, "provenance");
    size_t used, count;
    json_t *left = trace_sections(report, &used, &count);

    return json_pack(
        "{s:o, s:I, s:s, s:s, s:O?, s:O?, s:O?, s:O?, s:O?, s:O?, s:o, s:I, s:I, s:o, s:O?, s:O?, "
        "s:O?, s:O?, s:o, s:o}",
        "specimen", gsn_text_json(specimen->name), "run", (json_int_t)now->run->id, "key",
        now->run->key, "version", now->run->version, "loss_percent",
        json_object_get(report, "loss_percent"), "loss_interval",
        json_object_get(report, "loss_interval"), "loss_reason",
        json_object_get(report, "loss_reason"), "zero_density",
        json_object_get(report, "zero_density"), "baseline_mean_density",
        json_object_get(report, "baseline_mean_density"), "region",
        json_object_get(report, "region"), "baseline", trace_baseline(store, specimen, err),
        "sections", (json_int_t)count, "sections_used", (json_int_t)used, "not_used", left,
        "panels", json_object_get(report, "panels"), "decisions",
        json_object_get(report, "decisions"), "inputs", json_object_get(provenance, "inputs"),
        "outputs", json_object_get(provenance, "outputs"), "compared_with_run",
        before->run ? json_integer((json_int_t)before->run->id) : json_null(), "changes",
        before->report ? compare_reports(before->report, report) : json_array());
}

/* ---- the same for people --------------------------------------------------------------------- */

static const char *text_of(const json_t *object, const char *key)
{
    const char *const said = json_string_value(json_object_get(object, key));

    return said ? said : "";
}

static double number_of(const json_t *object, const char *key)
{
    const json_t *const value = json_object_get(object, key);

    return json_is_number(value) ? json_number_value(value) : NAN;
}

static void say_figure(const struct gsn_ui *ui, const json_t *trace, const struct gsn_run_row *run)
{
    const json_t *const interval = json_object_get(trace, "loss_interval");
    const json_t *const region = json_object_get(trace, "region");
    const double loss = number_of(trace, "loss_percent"), zero = number_of(trace, "zero_density");
    const double mean = number_of(region, "mean_density");
    const double baseline = number_of(trace, "baseline_mean_density");
    gsn_auto_mem(char) figure =
        gsn_look_loss(loss, number_of(interval, "lower"), number_of(interval, "upper"));
    const time_t when = (time_t)run->finished;
    struct tm at = { 0 };
    char day[16] = "";

    (void)gmtime_r(&when, &at);
    (void)strftime(day, sizeof day, "%Y-%m-%d", &at);
    gsn_ui_say(ui, "%s: %s%s; run %lld of %s, gieson %s, key %.8s", text_of(trace, "specimen"),
               isfinite(loss) ? "loss " : "no loss", isfinite(loss) && figure ? figure : "",
               (long long)run->id, day, run->version, run->key);
    if (!isfinite(loss) && *text_of(trace, "loss_reason"))
        gsn_ui_say(ui, "  %s", text_of(trace, "loss_reason"));
    if (isfinite(loss) && isfinite(mean) && isfinite(baseline))
        gsn_ui_say(ui,
                   "  100 (1 - %.4f / %.4f): mean density of the region here and in the baseline, "
                   "both above %.4f",
                   mean - (isfinite(zero) ? zero : 0), baseline - (isfinite(zero) ? zero : 0),
                   isfinite(zero) ? zero : 0);
    else if (isfinite(mean))
        gsn_ui_say(ui, "  mean density of the region %.4f", mean);
    if (isfinite(number_of(region, "volume_mm3")))
        gsn_ui_say(ui, "  region %s: %.4g mm3, %.0f %% of it with data",
                   text_of(region, "description"), number_of(region, "volume_mm3"),
                   100 * number_of(region, "coverage"));
}

static void say_baseline(const struct gsn_ui *ui, const json_t *trace)
{
    const json_t *row;
    size_t i;

    json_array_foreach(json_object_get(trace, "baseline"), i, row)
    {
        if (json_is_null(json_object_get(row, "run")))
            gsn_ui_say(ui, "  baseline %s: has no report that is whole", text_of(row, "specimen"));
        else
            gsn_ui_say(ui, "  baseline %s: mean density %.4f in its own stain, run %lld, key %.8s",
                       text_of(row, "specimen"), number_of(row, "mean_density"),
                       (long long)json_integer_value(json_object_get(row, "run")),
                       text_of(row, "key"));
    }
}

static void say_sections(const struct gsn_ui *ui, const json_t *trace)
{
    const json_t *row, *flag;
    size_t i, k;

    if (json_integer_value(json_object_get(trace, "sections")) > 0)
        gsn_ui_say(ui, "  %lld of %lld sections used",
                   (long long)json_integer_value(json_object_get(trace, "sections_used")),
                   (long long)json_integer_value(json_object_get(trace, "sections")));
    json_array_foreach(json_object_get(trace, "not_used"), i, row)
    {
        gsn_auto_mem(char) why = gsn_strdup("");

        json_array_foreach(json_object_get(row, "flags"), k, flag)
        {
            char *longer = gsn_format("%s%s%s", why ? why : "", k ? ", " : ": ",
                                      json_string_value(flag) ? json_string_value(flag) : "");

            gsn_free(why);
            why = longer;
        }
        gsn_ui_say(ui, "    not %s, %s%s", text_of(row, "section"), text_of(row, "state"),
                   why ? why : "");
    }
}

static void say_files(const struct gsn_ui *ui, const json_t *trace)
{
    const json_t *row;
    size_t i;

    json_array_foreach(json_object_get(trace, "inputs"), i, row)
        gsn_ui_say(ui, "  from %s, sha256 %s", text_of(row, "name"), text_of(row, "sha256"));
    json_array_foreach(json_object_get(trace, "outputs"), i, row)
        gsn_ui_say(ui, "  made %s, sha256 %s", text_of(row, "name"), text_of(row, "sha256"));
    json_array_foreach(json_object_get(trace, "decisions"), i, row)
        gsn_ui_say(ui, "  decided by %s, %s: %s", text_of(row, "by"), text_of(row, "time"),
                   text_of(row, "answer"));
}

static void say_changes(const struct gsn_ui *ui, const json_t *trace)
{
    const json_t *row;
    size_t i;

    if (json_is_null(json_object_get(trace, "compared_with_run")))
        return;
    gsn_ui_say(ui, "  against run %lld:%s",
               (long long)json_integer_value(json_object_get(trace, "compared_with_run")),
               json_array_size(json_object_get(trace, "changes")) ? "" : " no difference is told");
    json_array_foreach(json_object_get(trace, "changes"), i, row)
        gsn_ui_say(ui, "    %s", json_string_value(row));
}

/* Animals, their specimens and the run of each. Groups and losses are not said: a study may be
 * blind. */
static int trace_study(const struct gsn_ui *ui, struct gsn_store *store, const char *study,
                       struct gsn_error *err)
{
    gsn_auto(gsn_specimen_rows) rows = NULL;
    json_t *list;
    size_t found = 0;
    int r = gsn_specimen_list(store, &rows, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < rows->count; i++)
        found += strcmp(rows->at[i].study, study) == 0;
    if (!found || !*study)
        return gsn_fail(err, GSN_E_NOTFOUND, "there is no specimen and no study %s", study);
    list = json_array();
    for (size_t i = 0; i < rows->count; i++) {
        const struct gsn_specimen_row *const row = &rows->at[i];
        gsn_auto(gsn_run_row) run = NULL;

        if (strcmp(row->study, study) != 0)
            continue;
        if (gsn_run_latest_report(store, row->name, &run, NULL) < 0) {
            (void)json_array_append_new(
                list, json_pack("{s:o, s:o, s:n, s:n}", "animal",
                                gsn_text_json(*row->animal ? row->animal : row->name), "specimen",
                                gsn_text_json(row->name), "run", "json_sha256"));
            if (!ui->json)
                gsn_ui_say(ui, "animal %s, specimen %s: has no report yet",
                           *row->animal ? row->animal : row->name, row->name);
            continue;
        }
        (void)json_array_append_new(
            list, json_pack("{s:o, s:o, s:I, s:s}", "animal",
                            gsn_text_json(*row->animal ? row->animal : row->name), "specimen",
                            gsn_text_json(row->name), "run", (json_int_t)run->id, "json_sha256",
                            run->json_sha256));
        if (!ui->json)
            gsn_ui_say(ui, "animal %s, specimen %s: run %lld, report.json %s: `gieson trace %s`",
                       *row->animal ? row->animal : row->name, row->name, (long long)run->id,
                       run->json_sha256, row->name);
    }
    if (ui->json)
        gsn_ui_print_json(
            ui, json_pack("{s:o, s:O}", "study", gsn_text_json(study), "specimens", list));
    json_decref(list);
    return GSN_OK;
}

static int trace_one(const struct gsn_ui *ui, struct gsn_store *store,
                     const struct gsn_specimen_row *specimen, struct gsn_error *err)
{
    auto_traced now = { 0 };
    auto_traced before = { 0 };
    gsn_auto(gsn_run_row) run = NULL;
    json_t *trace;
    int r = gsn_run_latest_report(store, specimen->name, &run, err);

    if (r >= 0)
        r = read_run(store, run->id, &now, err);
    if (r >= 0)
        r = find_run_before(store, run, &before, err);
    if (r < 0)
        return r;
    trace = trace_specimen(store, specimen, &now, &before, err);
    if (!trace)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (ui->json) {
        gsn_ui_print_json(ui, trace);
        return GSN_OK;
    }
    say_figure(ui, trace, now.run);
    say_baseline(ui, trace);
    say_sections(ui, trace);
    say_files(ui, trace);
    say_changes(ui, trace);
    json_decref(trace);
    return GSN_OK;
}

int gsn_cmd_trace(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_specimen_row) specimen = NULL;
    struct gsn_error err = { 0 };
    int status = EX_OK, r;

    if (argc != 2)
        return gsn_ui_usage(ui, "trace what? Say `gieson trace SPECIMEN`, or a study's name");
    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    r = gsn_specimen_get(store, argv[1], &specimen, &err);
    r = r == GSN_E_NOTFOUND ? trace_study(ui, store, argv[1], &err)
        : r < 0             ? r
                            : trace_one(ui, store, specimen, &err);
    return r < 0 ? gsn_ui_complain(ui, &err, r) : EX_OK;
}
