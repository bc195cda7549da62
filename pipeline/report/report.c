/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* report.json; docs/report.md is its schema. */
#include "pipeline/report/report.h"

#include <math.h>

#include "pipeline/core/hash.h"
#include "pipeline/report/json_parts.h"
#include "pipeline/report/text.h"
#include "pipeline/report/words.h"

static json_t *value_of(const struct gsn_report_value *row, struct gsn_json_writer *writer)
{
    json_t *object = json_object();

    gsn_json_put(writer, object, "name", gsn_json_text(row->name));
    gsn_json_put(writer, object, "value",
                 row->text ? gsn_json_text(row->text) : gsn_json_number(row->value));
    gsn_json_put(writer, object, "unit", gsn_json_text(row->unit));
    return object;
}

static json_t *values_of(const struct gsn_report_value *rows, size_t count,
                         struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++)
        gsn_json_append(writer, array, value_of(&rows[i], writer));
    return array;
}

static json_t *panels_of(const struct gsn_report *report, struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->panel_count; i++) {
        const struct gsn_report_panel *panel = &report->panels[i];
        json_t *object = json_object();

        gsn_json_put(writer, object, "number", gsn_json_count(panel->number));
        gsn_json_put(writer, object, "file", gsn_json_text(panel->file));
        gsn_json_put(writer, object, "sha256", gsn_json_text_or_null(panel->sha256));
        gsn_json_put(writer, object, "state", gsn_json_text(panel->state));
        gsn_json_put(writer, object, "message", gsn_json_text(panel->message));
        gsn_json_put(writer, object, "rows", gsn_json_count(panel->rows));
        gsn_json_put(writer, object, "columns", gsn_json_count(panel->columns));
        gsn_json_put(writer, object, "white", gsn_json_numbers(panel->white, 3, writer));
        gsn_json_put(writer, object, "glass_fraction", gsn_json_number(panel->glass));
        gsn_json_append(writer, array, object);
    }
    return array;
}

static json_t *decisions_of(const struct gsn_report *report, struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->decision_count; i++) {
        const struct gsn_report_decision *decision = &report->decisions[i];
        json_t *object = json_object();

        gsn_json_put(writer, object, "panel", gsn_json_count(decision->panel));
        gsn_json_put(writer, object, "slot",
                     decision->slot ? gsn_json_count(decision->slot - 1) : json_null());
        gsn_json_put(writer, object, "answer", gsn_json_text(decision->answer));
        gsn_json_put(writer, object, "by", gsn_json_text(decision->actor));
        gsn_json_put(writer, object, "time", gsn_json_text(decision->time));
        gsn_json_put(writer, object, "reason", gsn_json_text_or_null(decision->reason));
        gsn_json_put(writer, object, "effect", gsn_json_text_or_null(decision->effect));
        gsn_json_append(writer, array, object);
    }
    return array;
}

static json_t *pictures_of(const struct gsn_report *report, struct gsn_json_writer *writer,
                           struct gsn_error *err)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->picture_count; i++) {
        const struct gsn_report_picture *picture = &report->pictures[i];
        struct gsn_digest digest = { "" };
        json_t *object = json_object();

        const int r = gsn_sha256(picture->png.bytes, picture->png.size, &digest, err);

        if (r < 0) {
            writer->failed = 1;
            writer->code = r;
        }
        gsn_json_put(writer, object, "id", gsn_json_text(picture->id));
        gsn_json_put(writer, object, "title", gsn_json_text(picture->title));
        gsn_json_put(writer, object, "caption", gsn_json_text(picture->caption));
        gsn_json_put(writer, object, "width", gsn_json_count(picture->png.width));
        gsn_json_put(writer, object, "height", gsn_json_count(picture->png.height));
        gsn_json_put(writer, object, "sha256", gsn_json_text(digest.hex));
        gsn_json_append(writer, array, object);
    }
    return array;
}

static json_t *exclusions_of(const struct gsn_report *report, struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->exclusion_count; i++) {
        json_t *object = json_object();

        gsn_json_put(writer, object, "what", gsn_json_text(report->exclusions[i].what));
        gsn_json_put(writer, object, "reason", gsn_json_text(report->exclusions[i].reason));
        gsn_json_append(writer, array, object);
    }
    return array;
}

static json_t *files_of(const struct gsn_report_input *files, size_t count,
                        struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++) {
        json_t *file = json_object();

        gsn_json_put(writer, file, "name", gsn_json_text(files[i].name));
        gsn_json_put(writer, file, "bytes", gsn_json_count(files[i].size));
        gsn_json_put(writer, file, "sha256", gsn_json_text_or_null(files[i].sha256));
        gsn_json_append(writer, array, file);
    }
    return array;
}

static json_t *provenance_of(const struct gsn_report *report, struct gsn_json_writer *writer)
{
    json_t *object = json_object();

    gsn_json_put(writer, object, "version", gsn_json_text(report->version));
    gsn_json_put(writer, object, "key", gsn_json_text(report->key));
    gsn_json_put(writer, object, "inputs", files_of(report->inputs, report->input_count, writer));
    if (report->output_count > 0)
        gsn_json_put(writer, object, "outputs",
                     files_of(report->outputs, report->output_count, writer));
    gsn_json_put(writer, object, "parameters",
                 values_of(report->parameters, report->parameter_count, writer));
    return object;
}

static json_t *interval_of(const struct gsn_report *report, struct gsn_json_writer *writer)
{
    json_t *object;

    if (!report->loss_interval || !isfinite(report->loss_percent))
        return json_null();
    object = json_object();
    gsn_json_put(writer, object, "lower", gsn_json_number(report->loss_lower));
    gsn_json_put(writer, object, "upper", gsn_json_number(report->loss_upper));
    gsn_json_put(writer, object, "of", gsn_json_text(report->loss_interval));
    return object;
}

static void put_head(const struct gsn_report *report, json_t *root, struct gsn_json_writer *writer)
{
    json_t *density = json_object();

    gsn_json_put(writer, root, "schema", json_string("gieson-report-1"));
    gsn_json_put(writer, root, "kind", json_string(gsn_report_kind_word(report->kind)));
    gsn_json_put(writer, root, "specimen", gsn_json_text(report->specimen));
    gsn_json_put(writer, root, "study", gsn_json_text_or_null(report->study));
    gsn_json_put(writer, root, "group", gsn_json_text_or_null(report->group));
    gsn_json_put(writer, root, "animal", gsn_json_text_or_null(report->animal));
    gsn_json_put(writer, root, "week", gsn_json_text_or_null(report->week));
    gsn_json_put(writer, root, "verdict", json_string(gsn_report_verdict_word(report->verdict)));
    gsn_json_put(writer, root, "verdict_reason", gsn_json_text_or_null(report->verdict_reason));
    gsn_json_put(writer, root, "baseline", gsn_json_text_or_null(report->baseline));
    gsn_json_put(writer, root, "baseline_mean_density", gsn_json_number(report->baseline_mean));
    gsn_json_put(writer, root, "zero_density", gsn_json_number(report->zero_density));
    gsn_json_put(writer, root, "loss_percent", gsn_json_number(report->loss_percent));
    gsn_json_put(writer, root, "loss_interval", interval_of(report, writer));
    gsn_json_put(writer, root, "loss_points", gsn_json_number(report->loss_points));
    gsn_json_put(writer, root, "loss_reason", gsn_json_text_or_null(report->loss_reason));
    gsn_json_put(writer, density, "name", gsn_json_text(report->density_name));
    gsn_json_put(writer, density, "version", gsn_json_text(report->density_version));
    gsn_json_put(writer, root, "density", density);
    gsn_json_put(writer, root, "area",
                 report->area_figure.name ? value_of(&report->area_figure, writer) : json_null());
}

static int dump_piece(const char *bytes, size_t size, void *context)
{
    struct gsn_text *text = context;

    gsn_text_bytes(text, bytes, size);
    return text->failed ? -1 : 0;
}

static json_t *build(const struct gsn_report *report, struct gsn_json_writer *writer,
                     struct gsn_error *err)
{
    json_t *root = json_object();

    put_head(report, root, writer);
    gsn_json_put(writer, root, "region", gsn_json_region(&report->region, writer));
    gsn_json_put(writer, root, "volumes", gsn_json_volumes(report, writer));
    gsn_json_put(writer, root, "sections", gsn_json_sections(report, writer));
    gsn_json_put(writer, root, "panels", panels_of(report, writer));
    gsn_json_put(writer, root, "decisions", decisions_of(report, writer));
    gsn_json_put(writer, root, "registration", gsn_json_registration(report->registration, writer));
    gsn_json_put(writer, root, "fit", gsn_json_fit(report->fit, writer));
    gsn_json_put(writer, root, "units", gsn_json_units(report->units, writer));
    gsn_json_put(writer, root, "tile", gsn_json_tile(report->tile, writer));
    gsn_json_put(writer, root, "measures",
                 values_of(report->measures, report->measure_count, writer));
    gsn_json_put(writer, root, "pictures", pictures_of(report, writer, err));
    gsn_json_put(writer, root, "warnings",
                 gsn_json_texts(report->warnings, report->warning_count, writer));
    gsn_json_put(writer, root, "exclusions", exclusions_of(report, writer));
    gsn_json_put(writer, root, "provenance", provenance_of(report, writer));
    return root;
}

int gsn_report_json(const struct gsn_report *report, char **ret_text, size_t *ret_size,
                    struct gsn_error *err)
{
    /* Nine digits are more than any figure deserves, and 0.1 stays 0.1. */
    const size_t flags = JSON_INDENT(2) | JSON_REAL_PRECISION(9);
    gsn_auto_text text = { .bytes = NULL };
    struct gsn_json_writer writer = { .failed = 0 };
    json_t *root = build(report, &writer, err);

    if (!writer.failed && json_dump_callback(root, dump_piece, &text, flags) < 0)
        writer.failed = 1;
    json_decref(root);
    gsn_text_raw(&text, "\n");
    if (writer.code < 0)
        return writer.code;
    if (writer.failed || text.failed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for report.json");
    gsn_text_give(&text, ret_text, ret_size);
    return GSN_OK;
}
