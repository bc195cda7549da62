/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* report.json: everything a report says, for programs; docs/user/report.md is its schema.
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
#include "pipeline/report/json.h"
#include "pipeline/report/text.h"
#include "pipeline/report/words.h"

#include <math.h>

/* --- figures --- */

static json_t *json_region(const struct gsn_report_region *region, struct gsn_json_writer *writer)
{
    json_t *object = json_object();

    gsn_json_put(writer, object, "volume_mm3", gsn_json_figure(region->volume_mm3));
    gsn_json_put(writer, object, "mean_density", gsn_json_figure(region->mean_density));
    gsn_json_put(writer, object, "coverage", gsn_json_figure(region->coverage));
    gsn_json_put(writer, object, "description", gsn_json_text(region->description));
    return object;
}

static json_t *json_interval(double percent, double lower, double upper, const char *of,
                             struct gsn_json_writer *writer)
{
    json_t *object;

    if (!of || !isfinite(percent))
        return json_null();
    object = json_object();
    gsn_json_put(writer, object, "lower", gsn_json_figure(lower));
    gsn_json_put(writer, object, "upper", gsn_json_figure(upper));
    gsn_json_put(writer, object, "of", gsn_json_text(of));
    return object;
}

static json_t *json_named(const struct gsn_report_named *named, struct gsn_json_writer *writer)
{
    json_t *object = json_region(&named->region, writer);

    gsn_json_put(writer, object, "name", gsn_json_text(named->name));
    gsn_json_put(writer, object, "mean_density_error", gsn_json_figure(named->density_error));
    gsn_json_put(writer, object, "loss_percent", gsn_json_figure(named->loss_percent));
    gsn_json_put(writer, object, "loss_interval",
                 json_interval(named->loss_percent, named->loss_lower, named->loss_upper,
                               named->loss_interval, writer));
    gsn_json_put(writer, object, "loss_points", gsn_json_figure(named->loss_points));
    gsn_json_put(writer, object, "loss_reason", gsn_json_text_or_null(named->loss_reason));
    gsn_json_put(writer, object, "baseline_mean_density", gsn_json_figure(named->baseline_mean));
    gsn_json_put(writer, object, "baseline_region_volume_mm3",
                 named->baseline_volume_mm3 > 0 ? gsn_json_figure(named->baseline_volume_mm3)
                                                : json_null());
    gsn_json_put(writer, object, "withheld", gsn_json_text_or_null(named->verdict_reason));
    gsn_json_put(writer, object, "warnings", gsn_json_count(named->warnings));
    gsn_json_put(writer, object, "report", gsn_json_text(named->page));
    return object;
}

static json_t *json_all_named(const struct gsn_report *report, struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->named_count; i++)
        gsn_json_append(writer, array, json_named(&report->named[i], writer));
    return array;
}

static json_t *json_volumes(const struct gsn_report *report, struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->volume_count; i++) {
        const struct gsn_report_volume *volume = &report->volumes[i];
        json_t *object = json_object();

        gsn_json_put(writer, object, "threshold", gsn_json_figure(volume->threshold));
        gsn_json_put(writer, object, "lower_mm3", gsn_json_figure(volume->lower_mm3));
        gsn_json_put(writer, object, "upper_mm3", gsn_json_figure(volume->upper_mm3));
        gsn_json_put(writer, object, "estimate_mm3", gsn_json_figure(volume->estimate_mm3));
        gsn_json_put(writer, object, "interval_lower_mm3",
                     gsn_json_figure(volume->interval_lower_mm3));
        gsn_json_put(writer, object, "interval_upper_mm3",
                     gsn_json_figure(volume->interval_upper_mm3));
        gsn_json_append(writer, array, object);
    }
    return array;
}

static json_t *json_registration(const struct gsn_report_registration *done,
                                 struct gsn_json_writer *writer)
{
    json_t *object;

    if (!done)
        return json_null();
    object = json_object();
    gsn_json_put(writer, object, "fle_um", gsn_json_figure(done->fle_um));
    gsn_json_put(writer, object, "rms_residual_um", gsn_json_figure(done->rms_residual_um));
    gsn_json_put(writer, object, "worst_residual_um", gsn_json_figure(done->worst_residual_um));
    gsn_json_put(writer, object, "mean_tre_um", gsn_json_figure(done->mean_tre_um));
    gsn_json_put(writer, object, "worst_tre_um", gsn_json_figure(done->worst_tre_um));
    gsn_json_put(writer, object, "sections_posed", gsn_json_count(done->sections_posed));
    gsn_json_put(writer, object, "sections_expected", gsn_json_count(done->sections_expected));
    gsn_json_put(writer, object, "by", json_string(done->by));
    gsn_json_put(writer, object, "comparison_um", gsn_json_figure(done->comparison_um));
    return object;
}

static json_t *json_fit(const struct gsn_report_fit *fit, struct gsn_json_writer *writer)
{
    json_t *object;

    if (!fit)
        return json_null();
    object = json_object();
    gsn_json_put(writer, object, "degree", gsn_json_count(fit->degree));
    gsn_json_put(writer, object, "tets", gsn_json_count(fit->tets));
    gsn_json_put(writer, object, "unknowns", gsn_json_count(fit->unknowns));
    gsn_json_put(writer, object, "samples", gsn_json_count(fit->samples));
    gsn_json_put(writer, object, "empty_tets", gsn_json_count(fit->empty_tets));
    gsn_json_put(writer, object, "rms", gsn_json_figure(fit->rms));
    gsn_json_put(writer, object, "worst", gsn_json_figure(fit->worst));
    gsn_json_put(writer, object, "smoothing", gsn_json_figure(fit->smoothing));
    gsn_json_put(writer, object, "tolerance", gsn_json_figure(fit->tolerance));
    gsn_json_put(writer, object, "tets_in_tolerance", gsn_json_count(fit->tets_in_tolerance));
    return object;
}

static json_t *json_units(const struct gsn_report_units *units, struct gsn_json_writer *writer)
{
    json_t *object, *bins;

    if (!units)
        return json_null();
    object = json_object();
    bins = json_array();
    for (size_t i = 0; i < units->bin_count; i++)
        gsn_json_append(writer, bins, gsn_json_count(units->bin[i]));
    gsn_json_put(writer, object, "first", gsn_json_figure(units->first));
    gsn_json_put(writer, object, "last", gsn_json_figure(units->last));
    gsn_json_put(writer, object, "bins", bins);
    gsn_json_put(writer, object, "smallest", gsn_json_figure(units->smallest));
    gsn_json_put(writer, object, "median", gsn_json_figure(units->median));
    gsn_json_put(writer, object, "largest", gsn_json_figure(units->largest));
    return object;
}

static json_t *json_tile(const struct gsn_report_tile *tile, struct gsn_json_writer *writer)
{
    json_t *object, *mask = NULL;

    if (!tile)
        return json_null();
    object = json_object();
    gsn_json_put(writer, object, "area_fraction", gsn_json_figure(tile->area_fraction));
    gsn_json_put(writer, object, "mean_density", gsn_json_figure(tile->mean_density));
    gsn_json_put(writer, object, "threshold", gsn_json_figure(tile->threshold));
    gsn_json_put(writer, object, "mean_density_lower", gsn_json_figure(tile->mean_lower));
    gsn_json_put(writer, object, "mean_density_upper", gsn_json_figure(tile->mean_upper));
    gsn_json_put(writer, object, "red_share", gsn_json_figure(tile->red_share));
    if (tile->compared) {
        mask = json_object();
        gsn_json_put(writer, mask, "name", gsn_json_text(tile->mask_name));
        gsn_json_put(writer, mask, "dice", gsn_json_figure(tile->dice));
        gsn_json_put(writer, mask, "map_fraction", gsn_json_figure(tile->map_fraction));
        gsn_json_put(writer, mask, "mask_fraction", gsn_json_figure(tile->mask_fraction));
        gsn_json_put(writer, mask, "false_positive", gsn_json_figure(tile->false_positive));
        gsn_json_put(writer, mask, "false_negative", gsn_json_figure(tile->false_negative));
    }
    gsn_json_put(writer, object, "mask", tile->compared ? mask : json_null());
    return object;
}

/* --- sections --- */

static json_t *markers_of(const struct gsn_point px[3], const int found[3],
                          struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < 3; i++) {
        const double pair[2] = { px[i].x, px[i].y };

        gsn_json_append(writer, array, found[i] ? gsn_json_figures(pair, 2, writer) : json_null());
    }
    return array;
}

/* A residual is what is left of places some thousand times as large: its last digits are rounding,
 * which a processor without fused multiply-adds does otherwise. Picometres are kept. */
static json_t *residuals_of(const struct gsn_report_section *section,
                            struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < 3; i++)
        gsn_json_append(writer, array,
                        section->marker_found[i]
                            ? gsn_json_figure(1e-6 * round(1e6 * section->residual_um[i]))
                            : json_null());
    return array;
}

static json_t *pose_of(const struct gsn_affine *map, struct gsn_json_writer *writer)
{
    const double entries[6] = { map->m00, map->m01, map->m02, map->m10, map->m11, map->m12 };

    return gsn_json_figures(entries, 6, writer);
}

static json_t *strain_of(const struct gsn_report_section *section, struct gsn_json_writer *writer)
{
    json_t *object = json_object();

    gsn_json_put(writer, object, "along_percent", gsn_json_figure(section->strain_percent[0]));
    gsn_json_put(writer, object, "across_percent", gsn_json_figure(section->strain_percent[1]));
    gsn_json_put(writer, object, "deg", gsn_json_figure(section->strain_deg));
    return object;
}

static json_t *masked_of(const struct gsn_report_section *section, struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < section->masked_count; i++) {
        const struct gsn_report_masked *masked = &section->masked[i];
        json_t *object = json_object();

        gsn_json_put(writer, object, "reason", gsn_json_text(masked->reason));
        gsn_json_put(writer, object, "area_mm2", gsn_json_figure(masked->area_mm2));
        gsn_json_put(writer, object, "region_share", gsn_json_figure(masked->region_share));
        gsn_json_append(writer, array, object);
    }
    return array;
}

static json_t *candidates_of(const struct gsn_report_section *section,
                             struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < section->candidate_count; i++) {
        const struct gsn_report_candidate *c = &section->candidates[i];
        json_t *object = json_object();

        gsn_json_put(writer, object, "number", gsn_json_count(i + 1));
        gsn_json_put(writer, object, "chosen", json_boolean(section->chosen == i + 1));
        gsn_json_put(writer, object, "differs", gsn_json_text(c->differs));
        gsn_json_put(writer, object, "markers_px",
                     markers_of(c->marker_px, c->marker_found, writer));
        gsn_json_put(writer, object, "flipped", json_boolean(c->flipped));
        gsn_json_put(writer, object, "rotated180", json_boolean(c->rotated180));
        gsn_json_put(writer, object, "share", gsn_json_figure(c->share));
        gsn_json_put(writer, object, "panel_to_block_um",
                     c->laid ? pose_of(&c->panel_to_block_um, writer) : json_null());
        gsn_json_put(writer, object, "predicted_tre_um", gsn_json_figure(c->predicted_tre_um));
        gsn_json_append(writer, array, object);
    }
    return array;
}

static json_t *section_of(const struct gsn_report_section *section, struct gsn_json_writer *writer)
{
    json_t *object = json_object();

    gsn_json_put(writer, object, "serial", gsn_json_count(section->serial));
    gsn_json_put(writer, object, "z_um", gsn_json_figure(section->z_um));
    gsn_json_put(writer, object, "panel", gsn_json_count(section->panel));
    gsn_json_put(writer, object, "slot", gsn_json_count(section->slot));
    gsn_json_put(writer, object, "row", gsn_json_count(section->row));
    gsn_json_put(writer, object, "column", gsn_json_count(section->column));
    gsn_json_put(writer, object, "state", gsn_json_text(section->state));
    gsn_json_put(writer, object, "flipped", json_boolean(section->flipped));
    gsn_json_put(writer, object, "rotated180", json_boolean(section->rotated180));
    gsn_json_put(writer, object, "flags",
                 gsn_json_texts(section->flags, section->flag_count, writer));
    gsn_json_put(writer, object, "markers_px",
                 markers_of(section->marker_px, section->marker_found, writer));
    gsn_json_put(writer, object, "marker_residuals_um", residuals_of(section, writer));
    gsn_json_put(writer, object, "panel_to_block_um",
                 section->posed ? pose_of(&section->panel_to_block_um, writer) : json_null());
    gsn_json_put(writer, object, "predicted_tre_um",
                 section->posed ? gsn_json_figure(section->predicted_tre_um) : json_null());
    gsn_json_put(writer, object, "strain",
                 section->strained ? strain_of(section, writer) : json_null());
    gsn_json_put(writer, object, "outline_mm2", gsn_json_figure(section->outline_mm2));
    gsn_json_put(writer, object, "masked_mm2", gsn_json_figure(section->masked_mm2));
    gsn_json_put(writer, object, "region_masked", gsn_json_figure(section->region_masked));
    gsn_json_put(writer, object, "masked", masked_of(section, writer));
    gsn_json_put(writer, object, "candidates", candidates_of(section, writer));
    return object;
}

static json_t *json_sections(const struct gsn_report *report, struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->section_count; i++)
        gsn_json_append(writer, array, section_of(&report->sections[i], writer));
    return array;
}

/* --- the report --- */

/* report.json; docs/user/report.md is its schema. */

static json_t *value_of(const struct gsn_report_value *row, struct gsn_json_writer *writer)
{
    json_t *object = json_object();

    gsn_json_put(writer, object, "name", gsn_json_text(row->name));
    gsn_json_put(writer, object, "value",
                 row->text ? gsn_json_text(row->text) : gsn_json_figure(row->value));
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
        gsn_json_put(writer, object, "white", gsn_json_figures(panel->white, 3, writer));
        gsn_json_put(writer, object, "glass_fraction", gsn_json_figure(panel->glass));
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

static json_t *pictures_of(const struct gsn_report_picture *pictures, size_t count,
                           struct gsn_json_writer *writer, struct gsn_error *err)
{
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++) {
        const struct gsn_report_picture *picture = &pictures[i];
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

static json_t *json_loss_map(const struct gsn_report *report, struct gsn_json_writer *writer,
                             struct gsn_error *err)
{
    const struct gsn_report_loss_map *const map = report->loss_map;
    json_t *object;

    if (!map)
        return json_null();
    object = json_object();
    gsn_json_put(writer, object, "edge_um", gsn_json_figure(map->edge_um));
    gsn_json_put(writer, object, "cells", gsn_json_count(map->cells));
    gsn_json_put(writer, object, "shared", gsn_json_figure(map->shared));
    gsn_json_put(writer, object, "low_percent", gsn_json_figure(map->low));
    gsn_json_put(writer, object, "median_percent", gsn_json_figure(map->median));
    gsn_json_put(writer, object, "high_percent", gsn_json_figure(map->high));
    gsn_json_put(writer, object, "cell_error_percent", gsn_json_figure(map->noise));
    gsn_json_put(writer, object, "pictures",
                 pictures_of(map->pictures, map->picture_count, writer, err));
    return object;
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
    gsn_json_put(writer, root, "baseline_mean_density", gsn_json_figure(report->baseline_mean));
    gsn_json_put(writer, root, "baseline_region_volume_mm3",
                 report->baseline_volume_mm3 > 0 ? gsn_json_figure(report->baseline_volume_mm3)
                                                 : json_null());
    gsn_json_put(writer, root, "zero_density", gsn_json_figure(report->zero_density));
    gsn_json_put(writer, root, "loss_percent", gsn_json_figure(report->loss_percent));
    gsn_json_put(writer, root, "loss_interval",
                 json_interval(report->loss_percent, report->loss_lower, report->loss_upper,
                               report->loss_interval, writer));
    gsn_json_put(writer, root, "loss_points", gsn_json_figure(report->loss_points));
    gsn_json_put(writer, root, "loss_reason", gsn_json_text_or_null(report->loss_reason));
    gsn_json_put(writer, density, "name", gsn_json_text(report->density_name));
    gsn_json_put(writer, density, "version", gsn_json_text(report->density_version));
    gsn_json_put(writer, root, "density", density);
    gsn_json_put(writer, root, "area",
                 report->area_figure.name ? value_of(&report->area_figure, writer) : json_null());
}

static int dump_piece(const char *bytes, size_t size, void *context)
{
    struct gsn_report_text *text = context;

    gsn_report_text_bytes(text, bytes, size);
    return text->failed ? -1 : 0;
}

static json_t *build_json(const struct gsn_report *report, struct gsn_json_writer *writer,
                          struct gsn_error *err)
{
    json_t *root = json_object();

    put_head(report, root, writer);
    gsn_json_put(writer, root, "loss_map", json_loss_map(report, writer, err));
    gsn_json_put(writer, root, "loss_map_reason", gsn_json_text_or_null(report->loss_map_reason));
    gsn_json_put(writer, root, "region", json_region(&report->region, writer));
    if (report->named_count > 0)
        gsn_json_put(writer, root, "regions", json_all_named(report, writer));
    gsn_json_put(writer, root, "volumes", json_volumes(report, writer));
    gsn_json_put(writer, root, "sections", json_sections(report, writer));
    gsn_json_put(writer, root, "panels", panels_of(report, writer));
    gsn_json_put(writer, root, "decisions", decisions_of(report, writer));
    gsn_json_put(writer, root, "registration", json_registration(report->registration, writer));
    gsn_json_put(writer, root, "fit", json_fit(report->fit, writer));
    gsn_json_put(writer, root, "units", json_units(report->units, writer));
    gsn_json_put(writer, root, "tile", json_tile(report->tile, writer));
    gsn_json_put(writer, root, "measures",
                 values_of(report->measures, report->measure_count, writer));
    gsn_json_put(writer, root, "pictures",
                 pictures_of(report->pictures, report->picture_count, writer, err));
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
    gsn_auto_report_text text = { .bytes = NULL };
    struct gsn_json_writer writer = { .failed = 0 };
    json_t *root = build_json(report, &writer, err);

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
