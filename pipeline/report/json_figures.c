/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/report/json_parts.h"

json_t *gsn_json_region(const struct gsn_report_region *region, struct gsn_json_writer *writer)
{
    json_t *object = json_object();

    gsn_json_put(writer, object, "volume_mm3", gsn_json_number(region->volume_mm3));
    gsn_json_put(writer, object, "mean_density", gsn_json_number(region->mean_density));
    gsn_json_put(writer, object, "coverage", gsn_json_number(region->coverage));
    gsn_json_put(writer, object, "description", gsn_json_text(region->description));
    return object;
}

json_t *gsn_json_volumes(const struct gsn_report *report, struct gsn_json_writer *writer)
{
    json_t *array = json_array();

    for (size_t i = 0; i < report->volume_count; i++) {
        const struct gsn_report_volume *volume = &report->volumes[i];
        json_t *object = json_object();

        gsn_json_put(writer, object, "threshold", gsn_json_number(volume->threshold));
        gsn_json_put(writer, object, "lower_mm3", gsn_json_number(volume->lower_mm3));
        gsn_json_put(writer, object, "upper_mm3", gsn_json_number(volume->upper_mm3));
        gsn_json_append(writer, array, object);
    }
    return array;
}

json_t *gsn_json_registration(const struct gsn_report_registration *done,
                              struct gsn_json_writer *writer)
{
    json_t *object;

    if (!done)
        return json_null();
    object = json_object();
    gsn_json_put(writer, object, "fle_um", gsn_json_number(done->fle_um));
    gsn_json_put(writer, object, "rms_residual_um", gsn_json_number(done->rms_residual_um));
    gsn_json_put(writer, object, "worst_residual_um", gsn_json_number(done->worst_residual_um));
    gsn_json_put(writer, object, "mean_tre_um", gsn_json_number(done->mean_tre_um));
    gsn_json_put(writer, object, "worst_tre_um", gsn_json_number(done->worst_tre_um));
    gsn_json_put(writer, object, "sections_posed", gsn_json_count(done->sections_posed));
    gsn_json_put(writer, object, "sections_expected", gsn_json_count(done->sections_expected));
    gsn_json_put(writer, object, "by", json_string(done->by));
    gsn_json_put(writer, object, "comparison_um", gsn_json_number(done->comparison_um));
    return object;
}

json_t *gsn_json_fit(const struct gsn_report_fit *fit, struct gsn_json_writer *writer)
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
    gsn_json_put(writer, object, "rms", gsn_json_number(fit->rms));
    gsn_json_put(writer, object, "worst", gsn_json_number(fit->worst));
    gsn_json_put(writer, object, "smoothing", gsn_json_number(fit->smoothing));
    gsn_json_put(writer, object, "tolerance", gsn_json_number(fit->tolerance));
    gsn_json_put(writer, object, "tets_in_tolerance", gsn_json_count(fit->tets_in_tolerance));
    return object;
}

json_t *gsn_json_units(const struct gsn_report_units *units, struct gsn_json_writer *writer)
{
    json_t *object, *bins;

    if (!units)
        return json_null();
    object = json_object();
    bins = json_array();
    for (size_t i = 0; i < units->bin_count; i++)
        gsn_json_append(writer, bins, gsn_json_count(units->bin[i]));
    gsn_json_put(writer, object, "first", gsn_json_number(units->first));
    gsn_json_put(writer, object, "last", gsn_json_number(units->last));
    gsn_json_put(writer, object, "bins", bins);
    gsn_json_put(writer, object, "smallest", gsn_json_number(units->smallest));
    gsn_json_put(writer, object, "median", gsn_json_number(units->median));
    gsn_json_put(writer, object, "largest", gsn_json_number(units->largest));
    return object;
}

json_t *gsn_json_tile(const struct gsn_report_tile *tile, struct gsn_json_writer *writer)
{
    json_t *object, *mask = NULL;

    if (!tile)
        return json_null();
    object = json_object();
    gsn_json_put(writer, object, "area_fraction", gsn_json_number(tile->area_fraction));
    gsn_json_put(writer, object, "mean_density", gsn_json_number(tile->mean_density));
    gsn_json_put(writer, object, "threshold", gsn_json_number(tile->threshold));
    gsn_json_put(writer, object, "mean_density_lower", gsn_json_number(tile->mean_lower));
    gsn_json_put(writer, object, "mean_density_upper", gsn_json_number(tile->mean_upper));
    gsn_json_put(writer, object, "red_share", gsn_json_number(tile->red_share));
    if (tile->compared) {
        mask = json_object();
        gsn_json_put(writer, mask, "name", gsn_json_text(tile->mask_name));
        gsn_json_put(writer, mask, "dice", gsn_json_number(tile->dice));
        gsn_json_put(writer, mask, "map_fraction", gsn_json_number(tile->map_fraction));
        gsn_json_put(writer, mask, "mask_fraction", gsn_json_number(tile->mask_fraction));
        gsn_json_put(writer, mask, "false_positive", gsn_json_number(tile->false_positive));
        gsn_json_put(writer, mask, "false_negative", gsn_json_number(tile->false_negative));
    }
    gsn_json_put(writer, object, "mask", tile->compared ? mask : json_null());
    return object;
}
