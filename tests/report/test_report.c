/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <jansson.h>
#include <string.h>

#include "pipeline/core/hash.h"
#include "pipeline/core/mem.h"
#include "tests/report/sample.h"

static json_t *parsed(const struct gsn_report *report)
{
    gsn_auto_mem(char) text = NULL;
    struct gsn_error err = { 0 };
    json_error_t where;
    size_t size = 0;
    json_t *root;

    CHECK_OK(gsn_report_json(report, &text, &size, &err), err);
    CHECK(text[size] == '\0' && strlen(text) == size);
    root = json_loads(text, JSON_REJECT_DUPLICATES, &where);
    if (!root)
        fail_msg("line %d: %s", where.line, where.text);
    return root;
}

/* A path like "region.volume_mm3" or "sections.3.markers_px". */
static json_t *at(json_t *root, const char *path)
{
    char step[64];

    while (*path) {
        const size_t length = strcspn(path, ".");

        CHECK(length < sizeof step);
        memcpy(step, path, length);
        step[length] = '\0';
        if (json_is_array(root)) {
            size_t index = 0;

            for (size_t i = 0; i < length; i++)
                index = index * 10 + (size_t)(step[i] - '0');
            root = json_array_get(root, index);
        } else {
            root = json_object_get(root, step);
        }
        if (!root)
            fail_msg("there is no %s", step);
        path += length + (path[length] == '.');
    }
    return root;
}

static double number(json_t *root, const char *path)
{
    json_t *value = at(root, path);

    if (!json_is_number(value))
        fail_msg("%s is no number", path);
    return json_number_value(value);
}

static const char *string(json_t *root, const char *path)
{
    json_t *value = at(root, path);

    if (!json_is_string(value))
        fail_msg("%s is no text", path);
    return json_string_value(value);
}

TEST(the_keys_that_scripts_rely_on_are_there)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 24);
    const struct gsn_report *report = sample_report(sample);
    json_t *root = parsed(report);

    assert_string_equal(string(root, "schema"), "gieson-report-1");
    assert_string_equal(string(root, "specimen"), "GVP-D-S02");
    assert_string_equal(string(root, "baseline"), "GVP-D-S00");
    assert_string_equal(string(root, "verdict"), "reported with warnings");
    CHECK_NEAR(number(root, "loss_percent"), 36.585, 1e-12);
    CHECK_NEAR(number(root, "baseline_mean_density"), 0.8431, 1e-12);
    CHECK_NEAR(number(root, "zero_density"), 0, 0);
    CHECK_NEAR(number(root, "loss_interval.lower"), 34.08, 1e-12);
    CHECK_NEAR(number(root, "loss_interval.upper"), 38.94, 1e-12);
    CHECK_NEAR(number(root, "loss_map.edge_um"), 200, 0);
    CHECK_NEAR(number(root, "loss_map.cells"), 1265, 0);
    CHECK_NEAR(number(root, "loss_map.shared"), 0.98, 1e-12);
    CHECK_NEAR(number(root, "loss_map.low_percent"), 8.5, 1e-12);
    CHECK_NEAR(number(root, "loss_map.median_percent"), 35.5, 1e-12);
    CHECK_NEAR(number(root, "loss_map.high_percent"), 69.1, 1e-12);
    CHECK_NEAR(number(root, "loss_map.cell_error_percent"), 3.7, 1e-12);
    assert_string_equal(string(root, "loss_map.pictures.0.id"), string(root, "pictures.0.id"));
    CHECK(json_is_null(at(root, "loss_map_reason")));
    CHECK_NEAR(number(root, "region.volume_mm3"), 0.9802, 1e-12);
    CHECK_NEAR(number(root, "region.mean_density"), 0.53466, 1e-12);
    CHECK(json_array_size(at(root, "volumes")) == 3);
    CHECK_NEAR(number(root, "volumes.1.threshold"), 0.5, 0);
    CHECK_NEAR(number(root, "volumes.1.lower_mm3"), 0.5826, 1e-12);
    CHECK_NEAR(number(root, "volumes.1.upper_mm3"), 0.5834, 1e-12);
    CHECK_NEAR(number(root, "volumes.1.estimate_mm3"), 0.5812, 1e-12);
    CHECK_NEAR(number(root, "volumes.1.interval_lower_mm3"), 0.5650, 1e-12);
    CHECK_NEAR(number(root, "volumes.1.interval_upper_mm3"), 0.5974, 1e-12);
    CHECK(json_is_null(at(root, "volumes.2.estimate_mm3")));
    CHECK(json_array_size(at(root, "sections")) == 60);
    CHECK_NEAR(number(root, "sections.14.serial"), 14, 0);
    CHECK_NEAR(number(root, "sections.14.z_um"), 24 * 14.5, 0);
    CHECK_NEAR(number(root, "sections.14.panel"), 2, 0);
    CHECK_NEAR(number(root, "sections.14.slot"), 2, 0);
    assert_string_equal(string(root, "sections.14.state"), "used");
    CHECK(json_is_false(at(root, "sections.14.flipped")));
    CHECK(json_is_true(at(root, "sections.20.flipped")));
    CHECK(json_is_true(at(root, "sections.33.rotated180")));
    CHECK(json_array_size(at(root, "sections.14.flags")) == 0);
    CHECK(json_array_size(at(root, "sections.17.flags")) == 2);
    CHECK_NEAR(number(root, "sections.14.markers_px.0.0"), 114.25, 0);
    CHECK_NEAR(number(root, "sections.14.markers_px.2.1"), 400, 0);
    CHECK(json_array_size(at(root, "sections.14.panel_to_block_um")) == 6);
    CHECK_NEAR(number(root, "sections.14.panel_to_block_um.5"), -2050.5, 0);
    CHECK(number(root, "sections.14.predicted_tre_um") > 1);
    CHECK_NEAR(number(root, "fit.tets"), 8412, 0);
    CHECK_NEAR(number(root, "registration.fle_um"), 1.21, 0);
    CHECK(strcmp(json_string_value(at(root, "registration.by")), "marks+tissue") == 0);
    CHECK(json_is_null(at(root, "registration.comparison_um")));
    CHECK(json_array_size(at(root, "units.bins")) == 40);
    assert_string_equal(string(root, "provenance.inputs.5.name"), "job.json");
    assert_string_equal(string(root, "provenance.parameters.1.value"), "van-gieson-gvp-1");
    CHECK_NEAR(number(root, "provenance.parameters.0.value"), 1e-6, 0);
    json_decref(root);
    sample_free(sample);
}

TEST(what_is_not_known_is_null)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 0);
    struct gsn_report *report = sample_report(sample);
    json_t *root;

    report->loss_percent = report->zero_density = (double)NAN;
    report->region.mean_density = (double)INFINITY;
    report->baseline = "";
    report->study = NULL;
    report->registration = NULL;
    report->fit = NULL;
    report->units = NULL;
    report->loss_map = NULL;
    report->loss_map_reason = "the two regions do not meet";
    root = parsed(report);
    CHECK(json_is_null(at(root, "loss_map")));
    assert_string_equal(string(root, "loss_map_reason"), "the two regions do not meet");
    CHECK(json_is_null(at(root, "loss_percent")));
    CHECK(json_is_null(at(root, "loss_interval")));
    CHECK(json_is_null(at(root, "zero_density")));
    CHECK(json_is_null(at(root, "region.mean_density")));
    CHECK(json_is_null(at(root, "baseline")));
    CHECK(json_is_null(at(root, "study")));
    CHECK(json_is_null(at(root, "registration")));
    CHECK(json_is_null(at(root, "fit")));
    CHECK(json_is_null(at(root, "units")));
    CHECK(json_is_null(at(root, "tile")));
    CHECK(json_is_null(at(root, "sections.17.markers_px.1")));
    CHECK(json_is_null(at(root, "sections.17.marker_residuals_um.1")));
    CHECK(json_is_array(at(root, "sections.17.markers_px.2")));
    CHECK(json_is_null(at(root, "sections.29.panel_to_block_um")));
    CHECK(json_is_null(at(root, "sections.29.predicted_tre_um")));
    json_decref(root);
    sample_free(sample);
}

TEST(numbers_read_well)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 0);
    gsn_auto_mem(char) text = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0;

    sample_report(sample)->loss_percent = 0.1 + 0.2;
    sample_report(sample)->loss_points = -0.0;
    CHECK_OK(gsn_report_json(sample_report(sample), &text, &size, &err), err);
    assert_non_null(strstr(text, "\"loss_percent\": 0.3,"));
    assert_non_null(strstr(text, "\"loss_points\": 0.0,"));
    assert_null(strstr(text, ": nan"));
    sample_free(sample);
}

TEST(hostile_names_stay_data)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 0);
    struct gsn_report *report = sample_report(sample);
    json_t *root;

    report->specimen = "a\"\\</script>\x01\n\xC3\xA4";
    report->study = "cut \xE2\x82";
    root = parsed(report);
    assert_string_equal(string(root, "specimen"), report->specimen);
    assert_string_equal(string(root, "study"), "cut \xEF\xBF\xBD\xEF\xBF\xBD");
    json_decref(root);
    sample_free(sample);
}

TEST(a_tile_has_its_comparison_or_says_that_there_is_none)
{
    struct sample *sample = sample_new(GSN_REPORT_TILE, 24);
    struct gsn_report_tile tile = *sample_report(sample)->tile;
    json_t *root = parsed(sample_report(sample));

    assert_string_equal(string(root, "kind"), "tile");
    CHECK_NEAR(number(root, "tile.area_fraction"), 0.311, 0);
    CHECK_NEAR(number(root, "tile.mask.dice"), 0.875, 0);
    CHECK(json_array_size(at(root, "sections")) == 0);
    json_decref(root);
    tile.compared = 0;
    sample_report(sample)->tile = &tile;
    root = parsed(sample_report(sample));
    CHECK(json_is_null(at(root, "tile.mask")));
    json_decref(root);
    sample_free(sample);
}

TEST(pictures_are_named_by_their_hash)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 24);
    const struct gsn_report_png *png = &sample_report(sample)->pictures[3].png;
    json_t *root = parsed(sample_report(sample));
    struct gsn_error err = { 0 };
    struct gsn_digest digest;

    CHECK_OK(gsn_sha256(png->bytes, png->size, &digest, &err), err);
    assert_string_equal(string(root, "pictures.3.id"), "xray");
    assert_string_equal(string(root, "pictures.3.sha256"), digest.hex);
    json_decref(root);
    sample_free(sample);
}

TEST(the_same_record_gives_the_same_bytes)
{
    struct sample *one = sample_new(GSN_REPORT_SPECIMEN, 24);
    struct sample *two = sample_new(GSN_REPORT_SPECIMEN, 24);
    gsn_auto_mem(char) first = NULL;
    gsn_auto_mem(char) second = NULL;
    struct gsn_error err = { 0 };
    size_t first_size = 0, second_size = 0;

    CHECK_OK(gsn_report_json(sample_report(one), &first, &first_size, &err), err);
    CHECK_OK(gsn_report_json(sample_report(two), &second, &second_size, &err), err);
    CHECK(first_size == second_size);
    assert_memory_equal(first, second, first_size);
    sample_free(one);
    sample_free(two);
}

static int json_once(const struct gsn_report *report, struct gsn_error *err)
{
    gsn_auto_mem(char) text = NULL;
    size_t size = 0;

    return gsn_report_json(report, &text, &size, err);
}

TEST(running_out_of_memory_leaks_nothing_not_even_in_jansson)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 0);
    struct gsn_report *report = sample_report(sample);
    struct gsn_error err = { 0 };

    report->section_count = 2; /* every allocation is tried: keep them few */
    report->panel_count = 1;
    report->input_count = 1;
    json_set_alloc_funcs(gsn_alloc, gsn_free);
    CHECK_EVERY_OOM(json_once(report, &err), err);
    sample_free(sample);
}
