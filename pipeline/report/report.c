/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* report.json: everything a report says, for programs; docs/report.md is its schema.
 *
 * Method: a tree of jansson values, written in the order of the schema with nine digits, so that
 * the same figures are the same bytes. A figure that does not exist is null, minus zero is zero;
 * times and paths are left out, for a report must be made again byte by byte.
 *
 * Steps: values, then the parts of the report in the order of the schema, then the text.
 *
 * Failure: jansson takes NULL for a value kindly, so every part adds what it has and notes a
 * failure; it is looked at once, at the end: GSN_E_NOMEM, or the code of the part that has a
 * sentence of its own. Cost: linear in sections and figures. */
#include "pipeline/report/report.h"

#include "pipeline/core/hash.h"
#include "pipeline/report/text.h"
#include "pipeline/report/words.h"

#include <jansson.h>

#include <math.h>

struct json_writer {
    int failed;
    int code; /* of a failure that has its own sentence; 0: memory ran out */
};

/* --- values --- */

/* takes: value. */
static void json_put(struct json_writer *writer, json_t *object, const char *key, json_t *value)
{
    if (json_object_set_new(object, key, value) < 0)
        writer->failed = 1;
}

static void json_append(struct json_writer *writer, json_t *array, json_t *value)
{
    if (json_array_append_new(array, value) < 0)
        writer->failed = 1;
}

static json_t *json_text(const char *said)
{
    gsn_auto_report_text text = { .bytes = NULL };

    gsn_report_text_utf8(&text, said);
    return text.failed ? NULL : json_stringn(text.bytes, text.size);
}

static json_t *json_text_or_null(const char *said)
{
    return said && *said ? json_text(said) : json_null();
}

/* NaN is a figure that does not exist. Minus zero is zero. */
static json_t *json_figure(double value)
{
    return isfinite(value) ? json_real(value == 0 ? 0 : value) : json_null();
}

static json_t *json_count(size_t count)
{
    return json_integer((json_int_t)count);
}

static json_t *json_figures(const double *values, size_t count, struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++)
        json_append(writer, array, json_figure(values[i]));
    return array;
}

static json_t *json_texts(const char *const *said, size_t count, struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++)
        json_append(writer, array, json_text(said[i]));
    return array;
}

/* --- figures --- */

static json_t *json_region(const struct gsn_report_region *region, struct json_writer *writer)
{
    json_t *object = json_object();

    json_put(writer, object, "volume_mm3", json_figure(region->volume_mm3));
    json_put(writer, object, "mean_density", json_figure(region->mean_density));
    json_put(writer, object, "coverage", json_figure(region->coverage));
    json_put(writer, object, "description", json_text(region->description));
    return object;
}

static json_t *json_volumes(const struct gsn_report *report, struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->volume_count; i++) {
        const struct gsn_report_volume *volume = &report->volumes[i];
        json_t *object = json_object();

        json_put(writer, object, "threshold", json_figure(volume->threshold));
        json_put(writer, object, "lower_mm3", json_figure(volume->lower_mm3));
        json_put(writer, object, "upper_mm3", json_figure(volume->upper_mm3));
        json_append(writer, array, object);
    }
    return array;
}

static json_t *json_registration(const struct gsn_report_registration *done,
                                 struct json_writer *writer)
{
    json_t *object;

    if (!done)
        return json_null();
    object = json_object();
    json_put(writer, object, "fle_um", json_figure(done->fle_um));
    json_put(writer, object, "rms_residual_um", json_figure(done->rms_residual_um));
    json_put(writer, object, "worst_residual_um", json_figure(done->worst_residual_um));
    json_put(writer, object, "mean_tre_um", json_figure(done->mean_tre_um));
    json_put(writer, object, "worst_tre_um", json_figure(done->worst_tre_um));
    json_put(writer, object, "sections_posed", json_count(done->sections_posed));
    json_put(writer, object, "sections_expected", json_count(done->sections_expected));
    json_put(writer, object, "by", json_string(done->by));
    json_put(writer, object, "comparison_um", json_figure(done->comparison_um));
    return object;
}

static json_t *json_fit(const struct gsn_report_fit *fit, struct json_writer *writer)
{
    json_t *object;

    if (!fit)
        return json_null();
    object = json_object();
    json_put(writer, object, "degree", json_count(fit->degree));
    json_put(writer, object, "tets", json_count(fit->tets));
    json_put(writer, object, "unknowns", json_count(fit->unknowns));
    json_put(writer, object, "samples", json_count(fit->samples));
    json_put(writer, object, "empty_tets", json_count(fit->empty_tets));
    json_put(writer, object, "rms", json_figure(fit->rms));
    json_put(writer, object, "worst", json_figure(fit->worst));
    json_put(writer, object, "smoothing", json_figure(fit->smoothing));
    json_put(writer, object, "tolerance", json_figure(fit->tolerance));
    json_put(writer, object, "tets_in_tolerance", json_count(fit->tets_in_tolerance));
    return object;
}

static json_t *json_units(const struct gsn_report_units *units, struct json_writer *writer)
{
    json_t *object, *bins;

    if (!units)
        return json_null();
    object = json_object();
    bins = json_array();
    for (size_t i = 0; i < units->bin_count; i++)
        json_append(writer, bins, json_count(units->bin[i]));
    json_put(writer, object, "first", json_figure(units->first));
    json_put(writer, object, "last", json_figure(units->last));
    json_put(writer, object, "bins", bins);
    json_put(writer, object, "smallest", json_figure(units->smallest));
    json_put(writer, object, "median", json_figure(units->median));
    json_put(writer, object, "largest", json_figure(units->largest));
    return object;
}

static json_t *json_tile(const struct gsn_report_tile *tile, struct json_writer *writer)
{
    json_t *object, *mask = NULL;

    if (!tile)
        return json_null();
    object = json_object();
    json_put(writer, object, "area_fraction", json_figure(tile->area_fraction));
    json_put(writer, object, "mean_density", json_figure(tile->mean_density));
    json_put(writer, object, "threshold", json_figure(tile->threshold));
    json_put(writer, object, "mean_density_lower", json_figure(tile->mean_lower));
    json_put(writer, object, "mean_density_upper", json_figure(tile->mean_upper));
    json_put(writer, object, "red_share", json_figure(tile->red_share));
    if (tile->compared) {
        mask = json_object();
        json_put(writer, mask, "name", json_text(tile->mask_name));
        json_put(writer, mask, "dice", json_figure(tile->dice));
        json_put(writer, mask, "map_fraction", json_figure(tile->map_fraction));
        json_put(writer, mask, "mask_fraction", json_figure(tile->mask_fraction));
        json_put(writer, mask, "false_positive", json_figure(tile->false_positive));
        json_put(writer, mask, "false_negative", json_figure(tile->false_negative));
    }
    json_put(writer, object, "mask", tile->compared ? mask : json_null());
    return object;
}

/* --- sections --- */

static json_t *markers_of(const struct gsn_point px[3], const int found[3],
                          struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < 3; i++) {
        const double pair[2] = { px[i].x, px[i].y };

        json_append(writer, array, found[i] ? json_figures(pair, 2, writer) : json_null());
    }
    return array;
}

static json_t *residuals_of(const struct gsn_report_section *section, struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < 3; i++)
        json_append(writer, array,
                    section->marker_found[i] ? json_figure(section->residual_um[i]) : json_null());
    return array;
}

static json_t *pose_of(const struct gsn_affine *map, struct json_writer *writer)
{
    const double entries[6] = { map->m00, map->m01, map->m02, map->m10, map->m11, map->m12 };

    return json_figures(entries, 6, writer);
}

static json_t *strain_of(const struct gsn_report_section *section, struct json_writer *writer)
{
    json_t *object = json_object();

    json_put(writer, object, "along_percent", json_figure(section->strain_percent[0]));
    json_put(writer, object, "across_percent", json_figure(section->strain_percent[1]));
    json_put(writer, object, "deg", json_figure(section->strain_deg));
    return object;
}

static json_t *masked_of(const struct gsn_report_section *section, struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < section->masked_count; i++) {
        const struct gsn_report_masked *masked = &section->masked[i];
        json_t *object = json_object();

        json_put(writer, object, "reason", json_text(masked->reason));
        json_put(writer, object, "area_mm2", json_figure(masked->area_mm2));
        json_put(writer, object, "region_share", json_figure(masked->region_share));
        json_append(writer, array, object);
    }
    return array;
}

static json_t *candidates_of(const struct gsn_report_section *section, struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < section->candidate_count; i++) {
        const struct gsn_report_candidate *c = &section->candidates[i];
        json_t *object = json_object();

        json_put(writer, object, "number", json_count(i + 1));
        json_put(writer, object, "chosen", json_boolean(section->chosen == i + 1));
        json_put(writer, object, "differs", json_text(c->differs));
        json_put(writer, object, "markers_px", markers_of(c->marker_px, c->marker_found, writer));
        json_put(writer, object, "flipped", json_boolean(c->flipped));
        json_put(writer, object, "rotated180", json_boolean(c->rotated180));
        json_put(writer, object, "share", json_figure(c->share));
        json_put(writer, object, "panel_to_block_um",
                 c->laid ? pose_of(&c->panel_to_block_um, writer) : json_null());
        json_put(writer, object, "predicted_tre_um", json_figure(c->predicted_tre_um));
        json_append(writer, array, object);
    }
    return array;
}

static json_t *section_of(const struct gsn_report_section *section, struct json_writer *writer)
{
    json_t *object = json_object();

    json_put(writer, object, "serial", json_count(section->serial));
    json_put(writer, object, "z_um", json_figure(section->z_um));
    json_put(writer, object, "panel", json_count(section->panel));
    json_put(writer, object, "slot", json_count(section->slot));
    json_put(writer, object, "row", json_count(section->row));
    json_put(writer, object, "column", json_count(section->column));
    json_put(writer, object, "state", json_text(section->state));
    json_put(writer, object, "flipped", json_boolean(section->flipped));
    json_put(writer, object, "rotated180", json_boolean(section->rotated180));
    json_put(writer, object, "flags", json_texts(section->flags, section->flag_count, writer));
    json_put(writer, object, "markers_px",
             markers_of(section->marker_px, section->marker_found, writer));
    json_put(writer, object, "marker_residuals_um", residuals_of(section, writer));
    json_put(writer, object, "panel_to_block_um",
             section->posed ? pose_of(&section->panel_to_block_um, writer) : json_null());
    json_put(writer, object, "predicted_tre_um",
             section->posed ? json_figure(section->predicted_tre_um) : json_null());
    json_put(writer, object, "strain",
             section->strained ? strain_of(section, writer) : json_null());
    json_put(writer, object, "outline_mm2", json_figure(section->outline_mm2));
    json_put(writer, object, "masked_mm2", json_figure(section->masked_mm2));
    json_put(writer, object, "region_masked", json_figure(section->region_masked));
    json_put(writer, object, "masked", masked_of(section, writer));
    json_put(writer, object, "candidates", candidates_of(section, writer));
    return object;
}

static json_t *json_sections(const struct gsn_report *report, struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->section_count; i++)
        json_append(writer, array, section_of(&report->sections[i], writer));
    return array;
}

/* --- the report --- */

/* report.json; docs/report.md is its schema. */

static json_t *value_of(const struct gsn_report_value *row, struct json_writer *writer)
{
    json_t *object = json_object();

    json_put(writer, object, "name", json_text(row->name));
    json_put(writer, object, "value", row->text ? json_text(row->text) : json_figure(row->value));
    json_put(writer, object, "unit", json_text(row->unit));
    return object;
}

static json_t *values_of(const struct gsn_report_value *rows, size_t count,
                         struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++)
        json_append(writer, array, value_of(&rows[i], writer));
    return array;
}

static json_t *panels_of(const struct gsn_report *report, struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->panel_count; i++) {
        const struct gsn_report_panel *panel = &report->panels[i];
        json_t *object = json_object();

        json_put(writer, object, "number", json_count(panel->number));
        json_put(writer, object, "file", json_text(panel->file));
        json_put(writer, object, "sha256", json_text_or_null(panel->sha256));
        json_put(writer, object, "state", json_text(panel->state));
        json_put(writer, object, "message", json_text(panel->message));
        json_put(writer, object, "rows", json_count(panel->rows));
        json_put(writer, object, "columns", json_count(panel->columns));
        json_put(writer, object, "white", json_figures(panel->white, 3, writer));
        json_put(writer, object, "glass_fraction", json_figure(panel->glass));
        json_append(writer, array, object);
    }
    return array;
}

static json_t *decisions_of(const struct gsn_report *report, struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->decision_count; i++) {
        const struct gsn_report_decision *decision = &report->decisions[i];
        json_t *object = json_object();

        json_put(writer, object, "panel", json_count(decision->panel));
        json_put(writer, object, "slot",
                 decision->slot ? json_count(decision->slot - 1) : json_null());
        json_put(writer, object, "answer", json_text(decision->answer));
        json_put(writer, object, "by", json_text(decision->actor));
        json_put(writer, object, "time", json_text(decision->time));
        json_put(writer, object, "reason", json_text_or_null(decision->reason));
        json_put(writer, object, "effect", json_text_or_null(decision->effect));
        json_append(writer, array, object);
    }
    return array;
}

static json_t *pictures_of(const struct gsn_report *report, struct json_writer *writer,
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
        json_put(writer, object, "id", json_text(picture->id));
        json_put(writer, object, "title", json_text(picture->title));
        json_put(writer, object, "caption", json_text(picture->caption));
        json_put(writer, object, "width", json_count(picture->png.width));
        json_put(writer, object, "height", json_count(picture->png.height));
        json_put(writer, object, "sha256", json_text(digest.hex));
        json_append(writer, array, object);
    }
    return array;
}

static json_t *exclusions_of(const struct gsn_report *report, struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->exclusion_count; i++) {
        json_t *object = json_object();

        json_put(writer, object, "what", json_text(report->exclusions[i].what));
        json_put(writer, object, "reason", json_text(report->exclusions[i].reason));
        json_append(writer, array, object);
    }
    return array;
}

static json_t *files_of(const struct gsn_report_input *files, size_t count,
                        struct json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++) {
        json_t *file = json_object();

        json_put(writer, file, "name", json_text(files[i].name));
        json_put(writer, file, "bytes", json_count(files[i].size));
        json_put(writer, file, "sha256", json_text_or_null(files[i].sha256));
        json_append(writer, array, file);
    }
    return array;
}

static json_t *provenance_of(const struct gsn_report *report, struct json_writer *writer)
{
    json_t *object = json_object();

    json_put(writer, object, "version", json_text(report->version));
    json_put(writer, object, "key", json_text(report->key));
    json_put(writer, object, "inputs", files_of(report->inputs, report->input_count, writer));
    if (report->output_count > 0)
        json_put(writer, object, "outputs",
                 files_of(report->outputs, report->output_count, writer));
    json_put(writer, object, "parameters",
             values_of(report->parameters, report->parameter_count, writer));
    return object;
}

static json_t *interval_of(const struct gsn_report *report, struct json_writer *writer)
{
    json_t *object;

    if (!report->loss_interval || !isfinite(report->loss_percent))
        return json_null();
    object = json_object();
    json_put(writer, object, "lower", json_figure(report->loss_lower));
    json_put(writer, object, "upper", json_figure(report->loss_upper));
    json_put(writer, object, "of", json_text(report->loss_interval));
    return object;
}

static void put_head(const struct gsn_report *report, json_t *root, struct json_writer *writer)
{
    json_t *density = json_object();

    json_put(writer, root, "schema", json_string("gieson-report-1"));
    json_put(writer, root, "kind", json_string(gsn_report_kind_word(report->kind)));
    json_put(writer, root, "specimen", json_text(report->specimen));
    json_put(writer, root, "study", json_text_or_null(report->study));
    json_put(writer, root, "group", json_text_or_null(report->group));
    json_put(writer, root, "animal", json_text_or_null(report->animal));
    json_put(writer, root, "week", json_text_or_null(report->week));
    json_put(writer, root, "verdict", json_string(gsn_report_verdict_word(report->verdict)));
    json_put(writer, root, "verdict_reason", json_text_or_null(report->verdict_reason));
    json_put(writer, root, "baseline", json_text_or_null(report->baseline));
    json_put(writer, root, "baseline_mean_density", json_figure(report->baseline_mean));
    json_put(writer, root, "zero_density", json_figure(report->zero_density));
    json_put(writer, root, "loss_percent", json_figure(report->loss_percent));
    json_put(writer, root, "loss_interval", interval_of(report, writer));
    json_put(writer, root, "loss_points", json_figure(report->loss_points));
    json_put(writer, root, "loss_reason", json_text_or_null(report->loss_reason));
    json_put(writer, density, "name", json_text(report->density_name));
    json_put(writer, density, "version", json_text(report->density_version));
    json_put(writer, root, "density", density);
    json_put(writer, root, "area",
             report->area_figure.name ? value_of(&report->area_figure, writer) : json_null());
}

static int dump_piece(const char *bytes, size_t size, void *context)
{
    struct gsn_report_text *text = context;

    gsn_report_text_bytes(text, bytes, size);
    return text->failed ? -1 : 0;
}

static json_t *build(const struct gsn_report *report, struct json_writer *writer,
                     struct gsn_error *err)
{
    json_t *root = json_object();

    put_head(report, root, writer);
    json_put(writer, root, "region", json_region(&report->region, writer));
    json_put(writer, root, "volumes", json_volumes(report, writer));
    json_put(writer, root, "sections", json_sections(report, writer));
    json_put(writer, root, "panels", panels_of(report, writer));
    json_put(writer, root, "decisions", decisions_of(report, writer));
    json_put(writer, root, "registration", json_registration(report->registration, writer));
    json_put(writer, root, "fit", json_fit(report->fit, writer));
    json_put(writer, root, "units", json_units(report->units, writer));
    json_put(writer, root, "tile", json_tile(report->tile, writer));
    json_put(writer, root, "measures", values_of(report->measures, report->measure_count, writer));
    json_put(writer, root, "pictures", pictures_of(report, writer, err));
    json_put(writer, root, "warnings", json_texts(report->warnings, report->warning_count, writer));
    json_put(writer, root, "exclusions", exclusions_of(report, writer));
    json_put(writer, root, "provenance", provenance_of(report, writer));
    return root;
}

int gsn_report_json(const struct gsn_report *report, char **ret_text, size_t *ret_size,
                    struct gsn_error *err)
{
    /* Nine digits are more than any figure deserves, and 0.1 stays 0.1. */
    const size_t flags = JSON_INDENT(2) | JSON_REAL_PRECISION(9);
    gsn_auto_report_text text = { .bytes = NULL };
    struct json_writer writer = { .failed = 0 };
    json_t *root = build(report, &writer, err);

    if (!writer.failed && json_dump_callback(root, dump_piece, &text, flags) < 0)
        writer.failed = 1;
    json_decref(root);
    gsn_report_text_raw(&text, "\n");
    if (writer.code < 0)
        return writer.code;
    if (writer.failed || text.failed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for report.json");
    gsn_report_text_give(&text, ret_text, ret_size);
    return GSN_OK;
}
