/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* report.json; docs/report.md is its schema. */
#include "pipeline/report/report.h"

#include <jansson.h>
#include <math.h>

#include "pipeline/core/hash.h"
#include "pipeline/core/mem.h"
#include "pipeline/report/text.h"
#include "pipeline/report/words.h"

/* A failure anywhere is remembered here and looked at once; jansson takes NULL for a value kindly.
 */
struct writer {
    int failed;
    int code; /* of a failure that has its own sentence; 0: memory ran out */
};

/* takes: value. */
static void put(struct writer *writer, json_t *object, const char *key, json_t *value)
{
    if (json_object_set_new(object, key, value) < 0)
        writer->failed = 1;
}

/* takes: value. */
static void append(struct writer *writer, json_t *array, json_t *value)
{
    if (json_array_append_new(array, value) < 0)
        writer->failed = 1;
}

static json_t *text_of(const char *said)
{
    gsn_auto_text text = { .bytes = NULL };

    gsn_text_utf8(&text, said);
    return text.failed ? NULL : json_stringn(text.bytes, text.size);
}

static json_t *text_or_null(const char *said)
{
    return said && *said ? text_of(said) : json_null();
}

/* NaN is a figure that does not exist. Minus zero is zero. */
static json_t *number_of(double value)
{
    return isfinite(value) ? json_real(value == 0 ? 0 : value) : json_null();
}

static json_t *count_of(size_t count)
{
    return json_integer((json_int_t)count);
}

static json_t *numbers_of(const double *values, size_t count, struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++)
        append(writer, array, number_of(values[i]));
    return array;
}

static json_t *texts_of(const char *const *said, size_t count, struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++)
        append(writer, array, text_of(said[i]));
    return array;
}

static json_t *value_of(const struct gsn_report_value *row, struct writer *writer)
{
    json_t *object = json_object();

    put(writer, object, "name", text_of(row->name));
    put(writer, object, "value", row->text ? text_of(row->text) : number_of(row->value));
    put(writer, object, "unit", text_of(row->unit));
    return object;
}

static json_t *values_of(const struct gsn_report_value *rows, size_t count, struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++)
        append(writer, array, value_of(&rows[i], writer));
    return array;
}

static json_t *region_of(const struct gsn_report_region *region, struct writer *writer)
{
    json_t *object = json_object();

    put(writer, object, "volume_mm3", number_of(region->volume_mm3));
    put(writer, object, "mean_density", number_of(region->mean_density));
    put(writer, object, "coverage", number_of(region->coverage));
    put(writer, object, "description", text_of(region->description));
    return object;
}

static json_t *volumes_of(const struct gsn_report *report, struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->volume_count; i++) {
        const struct gsn_report_volume *volume = &report->volumes[i];
        json_t *object = json_object();

        put(writer, object, "threshold", number_of(volume->threshold));
        put(writer, object, "lower_mm3", number_of(volume->lower_mm3));
        put(writer, object, "upper_mm3", number_of(volume->upper_mm3));
        append(writer, array, object);
    }
    return array;
}

static json_t *markers_of(const struct gsn_point px[3], const int found[3], struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < 3; i++) {
        const double pair[2] = { px[i].x, px[i].y };

        append(writer, array, found[i] ? numbers_of(pair, 2, writer) : json_null());
    }
    return array;
}

static json_t *residuals_of(const struct gsn_report_section *section, struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < 3; i++)
        append(writer, array,
               section->marker_found[i] ? number_of(section->residual_um[i]) : json_null());
    return array;
}

static json_t *pose_of(const struct gsn_affine *map, struct writer *writer)
{
    const double entries[6] = { map->m00, map->m01, map->m02, map->m10, map->m11, map->m12 };

    return numbers_of(entries, 6, writer);
}

static json_t *strain_of(const struct gsn_report_section *section, struct writer *writer)
{
    json_t *object = json_object();

    put(writer, object, "along_percent", number_of(section->strain_percent[0]));
    put(writer, object, "across_percent", number_of(section->strain_percent[1]));
    put(writer, object, "deg", number_of(section->strain_deg));
    return object;
}

static json_t *masked_of(const struct gsn_report_section *section, struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < section->masked_count; i++) {
        const struct gsn_report_masked *masked = &section->masked[i];
        json_t *object = json_object();

        put(writer, object, "reason", text_of(masked->reason));
        put(writer, object, "area_mm2", number_of(masked->area_mm2));
        put(writer, object, "region_share", number_of(masked->region_share));
        append(writer, array, object);
    }
    return array;
}

static json_t *candidates_of(const struct gsn_report_section *section, struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < section->candidate_count; i++) {
        const struct gsn_report_candidate *c = &section->candidates[i];
        json_t *object = json_object();

        put(writer, object, "number", count_of(i + 1));
        put(writer, object, "chosen", json_boolean(section->chosen == i + 1));
        put(writer, object, "differs", text_of(c->differs));
        put(writer, object, "markers_px", markers_of(c->marker_px, c->marker_found, writer));
        put(writer, object, "flipped", json_boolean(c->flipped));
        put(writer, object, "rotated180", json_boolean(c->rotated180));
        put(writer, object, "share", number_of(c->share));
        put(writer, object, "panel_to_block_um",
            c->laid ? pose_of(&c->panel_to_block_um, writer) : json_null());
        put(writer, object, "predicted_tre_um", number_of(c->predicted_tre_um));
        append(writer, array, object);
    }
    return array;
}

static json_t *section_of(const struct gsn_report_section *section, struct writer *writer)
{
    json_t *object = json_object();

    put(writer, object, "serial", count_of(section->serial));
    put(writer, object, "z_um", number_of(section->z_um));
    put(writer, object, "panel", count_of(section->panel));
    put(writer, object, "slot", count_of(section->slot));
    put(writer, object, "row", count_of(section->row));
    put(writer, object, "column", count_of(section->column));
    put(writer, object, "state", text_of(section->state));
    put(writer, object, "flipped", json_boolean(section->flipped));
    put(writer, object, "rotated180", json_boolean(section->rotated180));
    put(writer, object, "flags", texts_of(section->flags, section->flag_count, writer));
    put(writer, object, "markers_px",
        markers_of(section->marker_px, section->marker_found, writer));
    put(writer, object, "marker_residuals_um", residuals_of(section, writer));
    put(writer, object, "panel_to_block_um",
        section->posed ? pose_of(&section->panel_to_block_um, writer) : json_null());
    put(writer, object, "predicted_tre_um",
        section->posed ? number_of(section->predicted_tre_um) : json_null());
    put(writer, object, "strain", section->strained ? strain_of(section, writer) : json_null());
    put(writer, object, "outline_mm2", number_of(section->outline_mm2));
    put(writer, object, "masked_mm2", number_of(section->masked_mm2));
    put(writer, object, "region_masked", number_of(section->region_masked));
    put(writer, object, "masked", masked_of(section, writer));
    put(writer, object, "candidates", candidates_of(section, writer));
    return object;
}

static json_t *sections_of(const struct gsn_report *report, struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->section_count; i++)
        append(writer, array, section_of(&report->sections[i], writer));
    return array;
}

static json_t *panels_of(const struct gsn_report *report, struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->panel_count; i++) {
        const struct gsn_report_panel *panel = &report->panels[i];
        json_t *object = json_object();

        put(writer, object, "number", count_of(panel->number));
        put(writer, object, "file", text_of(panel->file));
        put(writer, object, "sha256", text_or_null(panel->sha256));
        put(writer, object, "state", text_of(panel->state));
        put(writer, object, "message", text_of(panel->message));
        put(writer, object, "rows", count_of(panel->rows));
        put(writer, object, "columns", count_of(panel->columns));
        put(writer, object, "white", numbers_of(panel->white, 3, writer));
        put(writer, object, "glass_fraction", number_of(panel->glass));
        append(writer, array, object);
    }
    return array;
}

static json_t *decisions_of(const struct gsn_report *report, struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->decision_count; i++) {
        const struct gsn_report_decision *decision = &report->decisions[i];
        json_t *object = json_object();

        put(writer, object, "panel", count_of(decision->panel));
        put(writer, object, "slot", decision->slot ? count_of(decision->slot - 1) : json_null());
        put(writer, object, "answer", text_of(decision->answer));
        put(writer, object, "by", text_of(decision->actor));
        put(writer, object, "time", text_of(decision->time));
        put(writer, object, "reason", text_or_null(decision->reason));
        put(writer, object, "effect", text_or_null(decision->effect));
        append(writer, array, object);
    }
    return array;
}

static json_t *registration_of(const struct gsn_report_registration *done, struct writer *writer)
{
    json_t *object;

    if (!done)
        return json_null();
    object = json_object();
    put(writer, object, "fle_um", number_of(done->fle_um));
    put(writer, object, "rms_residual_um", number_of(done->rms_residual_um));
    put(writer, object, "worst_residual_um", number_of(done->worst_residual_um));
    put(writer, object, "mean_tre_um", number_of(done->mean_tre_um));
    put(writer, object, "worst_tre_um", number_of(done->worst_tre_um));
    put(writer, object, "sections_posed", count_of(done->sections_posed));
    put(writer, object, "sections_expected", count_of(done->sections_expected));
    return object;
}

static json_t *fit_of(const struct gsn_report_fit *fit, struct writer *writer)
{
    json_t *object;

    if (!fit)
        return json_null();
    object = json_object();
    put(writer, object, "degree", count_of(fit->degree));
    put(writer, object, "tets", count_of(fit->tets));
    put(writer, object, "unknowns", count_of(fit->unknowns));
    put(writer, object, "samples", count_of(fit->samples));
    put(writer, object, "empty_tets", count_of(fit->empty_tets));
    put(writer, object, "rms", number_of(fit->rms));
    put(writer, object, "worst", number_of(fit->worst));
    put(writer, object, "smoothing", number_of(fit->smoothing));
    put(writer, object, "tolerance", number_of(fit->tolerance));
    put(writer, object, "tets_in_tolerance", count_of(fit->tets_in_tolerance));
    return object;
}

static json_t *units_of(const struct gsn_report_units *units, struct writer *writer)
{
    json_t *object, *bins;

    if (!units)
        return json_null();
    object = json_object();
    bins = json_array();
    for (size_t i = 0; i < units->bin_count; i++)
        append(writer, bins, count_of(units->bin[i]));
    put(writer, object, "first", number_of(units->first));
    put(writer, object, "last", number_of(units->last));
    put(writer, object, "bins", bins);
    put(writer, object, "smallest", number_of(units->smallest));
    put(writer, object, "median", number_of(units->median));
    put(writer, object, "largest", number_of(units->largest));
    return object;
}

static json_t *tile_of(const struct gsn_report_tile *tile, struct writer *writer)
{
    json_t *object, *mask = NULL;

    if (!tile)
        return json_null();
    object = json_object();
    put(writer, object, "area_fraction", number_of(tile->area_fraction));
    put(writer, object, "mean_density", number_of(tile->mean_density));
    put(writer, object, "threshold", number_of(tile->threshold));
    if (tile->compared) {
        mask = json_object();
        put(writer, mask, "name", text_of(tile->mask_name));
        put(writer, mask, "dice", number_of(tile->dice));
        put(writer, mask, "map_fraction", number_of(tile->map_fraction));
        put(writer, mask, "mask_fraction", number_of(tile->mask_fraction));
        put(writer, mask, "false_positive", number_of(tile->false_positive));
        put(writer, mask, "false_negative", number_of(tile->false_negative));
    }
    put(writer, object, "mask", tile->compared ? mask : json_null());
    return object;
}

static json_t *pictures_of(const struct gsn_report *report, struct writer *writer,
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
        put(writer, object, "id", text_of(picture->id));
        put(writer, object, "title", text_of(picture->title));
        put(writer, object, "caption", text_of(picture->caption));
        put(writer, object, "width", count_of(picture->png.width));
        put(writer, object, "height", count_of(picture->png.height));
        put(writer, object, "sha256", text_of(digest.hex));
        append(writer, array, object);
    }
    return array;
}

static json_t *exclusions_of(const struct gsn_report *report, struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->exclusion_count; i++) {
        json_t *object = json_object();

        put(writer, object, "what", text_of(report->exclusions[i].what));
        put(writer, object, "reason", text_of(report->exclusions[i].reason));
        append(writer, array, object);
    }
    return array;
}

static json_t *files_of(const struct gsn_report_input *files, size_t count, struct writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++) {
        json_t *file = json_object();

        put(writer, file, "name", text_of(files[i].name));
        put(writer, file, "bytes", count_of(files[i].size));
        put(writer, file, "sha256", text_or_null(files[i].sha256));
        append(writer, array, file);
    }
    return array;
}

static json_t *provenance_of(const struct gsn_report *report, struct writer *writer)
{
    json_t *object = json_object();

    put(writer, object, "version", text_of(report->version));
    put(writer, object, "key", text_of(report->key));
    put(writer, object, "inputs", files_of(report->inputs, report->input_count, writer));
    if (report->output_count > 0)
        put(writer, object, "outputs", files_of(report->outputs, report->output_count, writer));
    put(writer, object, "parameters",
        values_of(report->parameters, report->parameter_count, writer));
    return object;
}

static json_t *interval_of(const struct gsn_report *report, struct writer *writer)
{
    json_t *object;

    if (!report->loss_interval || !isfinite(report->loss_percent))
        return json_null();
    object = json_object();
    put(writer, object, "lower", number_of(report->loss_lower));
    put(writer, object, "upper", number_of(report->loss_upper));
    put(writer, object, "of", text_of(report->loss_interval));
    return object;
}

static void put_head(const struct gsn_report *report, json_t *root, struct writer *writer)
{
    json_t *density = json_object();

    put(writer, root, "schema", json_string("gieson-report-1"));
    put(writer, root, "kind", json_string(gsn_report_kind_word(report->kind)));
    put(writer, root, "specimen", text_of(report->specimen));
    put(writer, root, "study", text_or_null(report->study));
    put(writer, root, "group", text_or_null(report->group));
    put(writer, root, "animal", text_or_null(report->animal));
    put(writer, root, "week", text_or_null(report->week));
    put(writer, root, "verdict", json_string(gsn_report_verdict_word(report->verdict)));
    put(writer, root, "verdict_reason", text_or_null(report->verdict_reason));
    put(writer, root, "baseline", text_or_null(report->baseline));
    put(writer, root, "baseline_mean_density", number_of(report->baseline_mean));
    put(writer, root, "loss_percent", number_of(report->loss_percent));
    put(writer, root, "loss_interval", interval_of(report, writer));
    put(writer, root, "loss_points", number_of(report->loss_points));
    put(writer, root, "loss_reason", text_or_null(report->loss_reason));
    put(writer, density, "name", text_of(report->density_name));
    put(writer, density, "version", text_of(report->density_version));
    put(writer, root, "density", density);
    put(writer, root, "area",
        report->area_figure.name ? value_of(&report->area_figure, writer) : json_null());
}

static int dump_piece(const char *bytes, size_t size, void *context)
{
    struct gsn_text *text = context;

    gsn_text_bytes(text, bytes, size);
    return text->failed ? -1 : 0;
}

static json_t *build(const struct gsn_report *report, struct writer *writer, struct gsn_error *err)
{
    json_t *root = json_object();

    put_head(report, root, writer);
    put(writer, root, "region", region_of(&report->region, writer));
    put(writer, root, "volumes", volumes_of(report, writer));
    put(writer, root, "sections", sections_of(report, writer));
    put(writer, root, "panels", panels_of(report, writer));
    put(writer, root, "decisions", decisions_of(report, writer));
    put(writer, root, "registration", registration_of(report->registration, writer));
    put(writer, root, "fit", fit_of(report->fit, writer));
    put(writer, root, "units", units_of(report->units, writer));
    put(writer, root, "tile", tile_of(report->tile, writer));
    put(writer, root, "measures", values_of(report->measures, report->measure_count, writer));
    put(writer, root, "pictures", pictures_of(report, writer, err));
    put(writer, root, "warnings", texts_of(report->warnings, report->warning_count, writer));
    put(writer, root, "exclusions", exclusions_of(report, writer));
    put(writer, root, "provenance", provenance_of(report, writer));
    return root;
}

int gsn_report_json(const struct gsn_report *report, char **ret_text, size_t *ret_size,
                    struct gsn_error *err)
{
    /* Nine digits are more than any figure deserves, and 0.1 stays 0.1. */
    const size_t flags = JSON_INDENT(2) | JSON_REAL_PRECISION(9);
    gsn_auto_text text = { .bytes = NULL };
    struct writer writer = { .failed = 0 };
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
