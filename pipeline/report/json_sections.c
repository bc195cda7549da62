/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/report/json_parts.h"

static json_t *markers_of(const struct gsn_point px[3], const int found[3],
                          struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < 3; i++) {
        const double pair[2] = { px[i].x, px[i].y };

        gsn_json_append(writer, array, found[i] ? gsn_json_numbers(pair, 2, writer) : json_null());
    }
    return array;
}

static json_t *residuals_of(const struct gsn_report_section *section,
                            struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < 3; i++)
        gsn_json_append(writer, array,
                        section->marker_found[i] ? gsn_json_number(section->residual_um[i])
                                                 : json_null());
    return array;
}

static json_t *pose_of(const struct gsn_affine *map, struct gsn_json_writer *writer)
{
    const double entries[6] = { map->m00, map->m01, map->m02, map->m10, map->m11, map->m12 };

    return gsn_json_numbers(entries, 6, writer);
}

static json_t *strain_of(const struct gsn_report_section *section, struct gsn_json_writer *writer)
{
    json_t *object = json_object();

    gsn_json_put(writer, object, "along_percent", gsn_json_number(section->strain_percent[0]));
    gsn_json_put(writer, object, "across_percent", gsn_json_number(section->strain_percent[1]));
    gsn_json_put(writer, object, "deg", gsn_json_number(section->strain_deg));
    return object;
}

static json_t *masked_of(const struct gsn_report_section *section, struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < section->masked_count; i++) {
        const struct gsn_report_masked *masked = &section->masked[i];
        json_t *object = json_object();

        gsn_json_put(writer, object, "reason", gsn_json_text(masked->reason));
        gsn_json_put(writer, object, "area_mm2", gsn_json_number(masked->area_mm2));
        gsn_json_put(writer, object, "region_share", gsn_json_number(masked->region_share));
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
        gsn_json_put(writer, object, "share", gsn_json_number(c->share));
        gsn_json_put(writer, object, "panel_to_block_um",
                     c->laid ? pose_of(&c->panel_to_block_um, writer) : json_null());
        gsn_json_put(writer, object, "predicted_tre_um", gsn_json_number(c->predicted_tre_um));
        gsn_json_append(writer, array, object);
    }
    return array;
}

static json_t *section_of(const struct gsn_report_section *section, struct gsn_json_writer *writer)
{
    json_t *object = json_object();

    gsn_json_put(writer, object, "serial", gsn_json_count(section->serial));
    gsn_json_put(writer, object, "z_um", gsn_json_number(section->z_um));
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
                 section->posed ? gsn_json_number(section->predicted_tre_um) : json_null());
    gsn_json_put(writer, object, "strain",
                 section->strained ? strain_of(section, writer) : json_null());
    gsn_json_put(writer, object, "outline_mm2", gsn_json_number(section->outline_mm2));
    gsn_json_put(writer, object, "masked_mm2", gsn_json_number(section->masked_mm2));
    gsn_json_put(writer, object, "region_masked", gsn_json_number(section->region_masked));
    gsn_json_put(writer, object, "masked", masked_of(section, writer));
    gsn_json_put(writer, object, "candidates", candidates_of(section, writer));
    return object;
}

json_t *gsn_json_sections(const struct gsn_report *report, struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->section_count; i++)
        gsn_json_append(writer, array, section_of(&report->sections[i], writer));
    return array;
}
