/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include "pipeline/core/file.h"
#include "pipeline/phantom/panel.h"
#include "pipeline/phantom/planning.h"
#include "pipeline/phantom/truth.h"

#include <dirent.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define DEG_PER_RAD (180 / M_PI)

static int parse(const char *text, struct gsn_phantom_variant *ret_variant, struct gsn_error *err)
{
    return gsn_phantom_variant_parse(text, strlen(text), "v.json", ret_variant, err);
}

/* gives: a plan for free(); the variant's text is not needed after. */
static struct gsn_phantom_plan *planned(const char *text, const char *specimen, const char *level,
                                        double px_um)
{
    struct gsn_phantom_plan *plan = malloc(sizeof *plan);
    struct gsn_phantom_variant variant;
    struct gsn_error err = { 0 };

    CHECK_OK(parse(text, &variant, &err), err);
    CHECK_OK(gsn_phantom_plan_make_variant(specimen, level, 4, px_um, &variant, plan, &err), err);
    gsn_phantom_variant_done(&variant);
    plan->variant.text = NULL;
    return plan;
}

static double angle_between(const double a[3], const double b[3])
{
    const double cross[3] = { a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                              a[0] * b[1] - a[1] * b[0] };

    return DEG_PER_RAD *
           atan2(sqrt(cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]),
                 a[0] * b[0] + a[1] * b[1] + a[2] * b[2]);
}

/* --- the bath --- */

TEST(a_bath_turns_each_dye_by_exactly_its_angle)
{
    struct gsn_phantom_plan *plan =
        planned("{\"bath_turn_deg\": 5, \"bath_seed\": 9}", "S02", "L1", 24);

    for (int panel = 0; panel < plan->panels; panel++)
        for (int dye = 0; dye < GSN_PHANTOM_DYES; dye++) {
            double usual[3];

            gsn_phantom_dye_vector((enum gsn_phantom_dye)dye, usual);
            CHECK_NEAR(angle_between(usual, plan->batch[panel].dye[dye]),
                       dye == GSN_PHANTOM_MARK ? 0 : 5, 1e-9);
        }
    free(plan);
}

TEST(a_bath_is_one_for_control_and_treated_and_another_seed_is_another)
{
    struct gsn_phantom_plan *s00 =
        planned("{\"bath_turn_deg\": 5, \"bath_seed\": 9}", "S00", "L1", 24);
    struct gsn_phantom_plan *s02 =
        planned("{\"bath_turn_deg\": 5, \"bath_seed\": 9}", "S02", "L2", 24);
    struct gsn_phantom_plan *other =
        planned("{\"bath_turn_deg\": 5, \"bath_seed\": 10}", "S00", "L1", 24);
    double bath[3];

    gsn_phantom_variant_dye(&s02->variant, GSN_PHANTOM_YELLOW, bath);
    CHECK(memcmp(s00->batch[3].dye[GSN_PHANTOM_YELLOW], bath, sizeof bath) == 0);
    CHECK(angle_between(other->batch[3].dye[GSN_PHANTOM_YELLOW], bath) > 0.1);
    free(s00);
    free(s02);
    free(other);
}

TEST(panels_scatter_about_their_bath_at_a_level_that_is_not_handled_too)
{
    struct gsn_phantom_plan *plan = planned(
        "{\"bath_turn_deg\": 10, \"bath_seed\": 2, \"panel_turn_deg\": 0.5}", "S00", "L1", 24);
    double squares = 0, bath[3];

    gsn_phantom_variant_dye(&plan->variant, GSN_PHANTOM_RED, bath);
    for (int panel = 0; panel < plan->panels; panel++) {
        const double turned = angle_between(bath, plan->batch[panel].dye[GSN_PHANTOM_RED]);

        CHECK(turned > 0 && turned < 2.5);
        CHECK(plan->batch[panel].red_gain == 1 && plan->batch[panel].yellow_gain == 1);
        squares += turned * turned;
    }
    CHECK_NEAR(sqrt(squares / plan->panels), 0.5, 0.4);
    free(plan);
}

/* Ruifrok and Johnston, 2001, table of stain vectors: .650 .704 .286. */
TEST(haematoxylin_is_the_published_vector)
{
    struct gsn_phantom_plan *plan =
        planned("{\"counterstain\": \"haematoxylin\"}", "S00", "L1", 24);
    const double *v = plan->batch[0].dye[GSN_PHANTOM_NUCLEAR];

    CHECK_NEAR(v[0] / v[1], .650 / .704, 1e-12);
    CHECK_NEAR(v[2] / v[1], .286 / .704, 1e-12);
    CHECK_NEAR(v[0] * v[0] + v[1] * v[1] + v[2] * v[2], 1, 1e-12);
    free(plan);
}

TEST(strength_texture_and_quality_change_what_they_say)
{
    struct gsn_phantom_plan *plan = planned(
        "{\"stain_strength\": 1.2, \"texture\": 0.5, \"jpeg_quality\": 60, \"size_percent\": 2}",
        "S00", "L1", 24);
    struct gsn_phantom_plan *png = planned("{\"jpeg_quality\": null}", "S00", "L2", 24);
    double squares = 0;

    CHECK_NEAR(plan->batch[2].red_gain, 1.2, 1e-12);
    CHECK_NEAR(plan->level.texture, 0.5, 1e-12);
    CHECK(strcmp(plan->file[0].extension, "jpg") == 0 && plan->level.quality == 60);
    CHECK(strcmp(png->file[0].extension, "png") == 0);
    for (int k = 0; k < plan->sections; k++) {
        CHECK(plan->section[k].sx == plan->section[k].sy && !plan->section[k].flip);
        squares += (plan->section[k].sx - 1) * (plan->section[k].sx - 1);
    }
    CHECK_NEAR(sqrt(squares / plan->sections), 0.02, 0.006);
    free(plan);
    free(png);
}

/* --- the block --- */

TEST(no_tissue_is_paler_than_the_floor_and_the_density_stays_linear_in_the_lesion)
{
    struct gsn_phantom_plan *plan = planned("{\"collagen_floor\": 0.3}", "S02", "L0", 24);
    struct gsn_phantom_random random = gsn_phantom_random_make(5, 0, 0, 0);

    for (int i = 0; i < 20000; i++) {
        const struct gsn_vec3 at = { gsn_phantom_between(&random, -2600, 2600),
                                     gsn_phantom_between(&random, -2050, 2050),
                                     gsn_phantom_between(&random, 0, 1440) };
        struct gsn_phantom_field f;

        gsn_phantom_field_at(&plan->variant.geometry, at, &f);
        CHECK(gsn_phantom_density(&f, 1) >= 0.3 * f.tissue - 1e-12);
        CHECK(f.lost >= -1e-12);
    }
    free(plan);
}

TEST(a_second_anatomy_lies_in_its_slots_and_loses_what_its_second_program_says)
{
    struct gsn_phantom_plan *plan = planned("{\"block\": \"P\"}", "S02", "L0", 24);
    struct gsn_phantom_sums sums;
    struct gsn_error err = { 0 };
    const struct gsn_phantom_geometry *g = &plan->variant.geometry;

    CHECK(plan->sections == 48 && plan->panels == 4);
    CHECK_NEAR(plan->section[47].z_um, 15 + 30 * 47, 1e-9);
    CHECK_OK(gsn_phantom_truth_sums(g, &plan->specimen, 0, &sums, &err), err);
    /* recompute_loss.py --step 6 on the same specimen. */
    CHECK_NEAR(gsn_phantom_truth_loss(&plan->specimen, &sums), 43.372, 0.01);
    for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
        struct gsn_phantom_field f;

        gsn_phantom_field_at(g, (struct gsn_vec3){ g->mark[i].x, g->mark[i].y, 700 }, &f);
        CHECK(f.tissue == 1);
    }
    free(plan);
}

TEST(a_loss_of_nothing_is_the_control)
{
    struct gsn_phantom_plan *plan = planned("{\"loss\": 0}", "S02", "L0", 24);

    CHECK(plan->specimen.depth == 0);
    free(plan);
}

/* --- marks --- */

TEST(a_hole_is_glass_within_a_dark_rim)
{
    struct gsn_phantom_variant v;
    struct gsn_error err = { 0 };
    double inside[3] = { .3, .4, .5 }, rim[3] = { .3, .4, .5 }, beyond[3] = { .3, .4, .5 };
    double mark[3];

    CHECK_OK(parse("{\"marks\": {\"radius_um\": 150, \"kind\": \"hole\"}}", &v, &err), err);
    gsn_phantom_dye_vector(GSN_PHANTOM_MARK, mark);
    gsn_phantom_burn(&v.burning, 130, inside);
    gsn_phantom_burn(&v.burning, 190, rim);
    gsn_phantom_burn(&v.burning, 250, beyond);
    for (int c = 0; c < 3; c++) {
        CHECK_NEAR(inside[c], 0, 1e-12);
        CHECK_NEAR(rim[c], 1.15 * mark[c], 1e-12);
        CHECK_NEAR(beyond[c], .3 + .1 * c, 1e-12);
    }
    gsn_phantom_variant_done(&v);
}

TEST(marks_have_their_radius_and_aspect_and_decoys_their_number)
{
    struct gsn_phantom_plan *plan = planned(
        "{\"marks\": {\"radius_um\": 40, \"aspect\": 1.6, \"decoys\": 37}}", "S00", "L1", 24);
    struct gsn_phantom_plan *none = planned("{\"marks\": {\"none\": true}}", "S00", "L2", 24);
    double longest = 0;

    for (int k = 0; k < plan->sections; k++) {
        CHECK(plan->section[k].decoys == 37);
        for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
            CHECK(plan->section[k].mark[i].radius_um == 40 && !plan->section[k].mark[i].missing);
            CHECK(none->section[k].mark[i].missing);
            longest = fmax(longest, plan->section[k].mark[i].ratio);
        }
    }
    CHECK(longest > 1.5 && longest <= 1.6);
    free(plan);
    free(none);
}

/* --- panels --- */

TEST(another_layout_has_other_panels_and_every_section_a_slot_of_its_own)
{
    struct gsn_phantom_plan *plan = planned("{\"layout\": [2, 5]}", "S00", "L3-whole", 24);

    CHECK(plan->panels == 6 && plan->sections == 60 && plan->files == 6);
    CHECK_NEAR(plan->width * 24.0, 4800 + 5 * 8000, 24);
    CHECK_NEAR(plan->height * 24.0, 960 + 2 * 8000, 24);
    for (int k = 0; k < plan->sections; k++) {
        const struct gsn_point c = gsn_phantom_slot_centre_um(plan, plan->section[k].slot);

        CHECK(plan->section[k].panel == k / 10 + 1 && plan->section[k].slot == k % 10);
        CHECK_NEAR(c.x, 8200 + 8000 * (k % 5), 1e-9);
        CHECK_NEAR(c.y, 4300 + 8000 * (k / 5 % 2), 1e-9);
    }
    free(plan);
}

static struct gsn_image *drawn(const struct gsn_phantom_plan *plan)
{
    struct gsn_phantom_extent extent[GSN_PHANTOM_SLOTS_MOST];
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_panel_draw(plan, &plan->file[0], 0, &image, extent, &err), err);
    return image;
}

/* At L0 nothing depends on where in the picture a pixel lies. */
TEST(within_a_black_frame_lies_the_same_panel)
{
    struct gsn_phantom_plan *plain = planned("{}", "S02", "L0", 40);
    struct gsn_phantom_plan *framed = planned("{\"black_frame_px\": 30}", "S02", "L0", 40);
    gsn_auto(gsn_image) a = drawn(plain);
    gsn_auto(gsn_image) b = drawn(framed);
    const uint8_t *in = a->samples, *out = b->samples;
    int apart = 0;

    CHECK(b->width == a->width + 60 && b->height == a->height + 60);
    for (uint32_t y = 0; y < b->height; y++)
        for (uint32_t x = 0; x < b->width; x++) {
            const uint8_t *p = out + 3 * ((size_t)y * b->width + x);
            const int bed = x < 30 || y < 30 || x >= b->width - 30 || y >= b->height - 30;

            if (bed)
                apart += p[0] > 10 || p[1] > 10 || p[2] > 10;
            else
                apart += memcmp(p, in + 3 * ((size_t)(y - 30) * a->width + x - 30), 3) != 0;
        }
    /* The frame moves slots by whole pixels, and rounding moves a sample now and then. */
    CHECK(apart < 100);
    CHECK_NEAR(framed->section[5].centre_px.x, plain->section[5].centre_px.x + 30, 1e-9);
    free(plain);
    free(framed);
}

TEST(a_label_on_its_head_is_the_label_turned_by_half)
{
    struct gsn_phantom_plan *up = planned("{}", "S02", "L0", 40);
    struct gsn_phantom_plan *down = planned("{\"label\": \"turned\"}", "S02", "L0", 40);
    struct gsn_phantom_plan *none = planned("{\"label\": \"none\"}", "S02", "L0", 40);
    gsn_auto(gsn_image) a = drawn(up);
    gsn_auto(gsn_image) b = drawn(down);
    gsn_auto(gsn_image) c = drawn(none);
    const uint8_t *upright = a->samples, *turned = b->samples, *bare = c->samples;
    int ink = 0, apart = 0;

    /* The label is 3200 um wide and reaches from 1200 to 5200: 80 and 30 to 130 pixels. */
    for (size_t y = 0; y < 160; y++)
        for (size_t x = 0; x < 80; x++) {
            const size_t j = y >= 30 && y < 130 ? 159 - y : y, i = j == y ? x : 79 - x;

            ink += upright[3 * (y * a->width + x)] < 100;
            apart += upright[3 * (y * a->width + x)] != turned[3 * (j * a->width + i)];
            CHECK(bare[3 * (y * a->width + x)] > 200);
        }
    CHECK(ink > 300 && apart == 0);
    free(up);
    free(down);
    free(none);
}

/* --- what job.json says --- */

static json_t *job_of(const char *text, const char *level)
{
    char folder[] = "/tmp/gsn-variant-XXXXXX", path[64];
    struct gsn_phantom_plan *plan = planned(text, "S02", level, 48);
    struct gsn_error err = { 0 };
    json_error_t why;
    json_t *job;

    CHECK(mkdtemp(folder));
    CHECK_OK(gsn_phantom_write_job(plan, folder, &err), err);
    (void)snprintf(path, sizeof path, "%s/job.json", folder);
    job = json_load_file(path, 0, &why);
    CHECK(job);
    (void)unlink(path);
    (void)snprintf(path, sizeof path, "%s/region.mhd", folder);
    (void)unlink(path);
    (void)snprintf(path, sizeof path, "%s/region.raw", folder);
    (void)unlink(path);
    (void)rmdir(folder);
    free(plan);
    return job;
}

TEST(job_json_says_what_the_operator_got_wrong)
{
    json_t *job = job_of("{\"markers_key\": \"marker_um\", \"markers_y_up\": true, "
                         "\"order\": \"snake\", \"layout\": [2, 4], \"calibration\": true}",
                         "L1");
    json_t *marks = json_object_get(job, "marker_um");

    CHECK(!json_object_get(job, "markers_um") && json_array_size(marks) == 3);
    CHECK_NEAR(json_number_value(json_array_get(json_array_get(marks, 0), 1)), 1000, 1e-9);
    CHECK(strcmp(json_string_value(json_object_get(job, "order")), "snake") == 0);
    CHECK(json_integer_value(json_array_get(json_object_get(job, "layout"), 1)) == 4);
    CHECK(json_integer_value(json_object_get(job, "sections")) == 56);
    CHECK(strcmp(json_string_value(json_object_get(job, "calibration")), "GVP-D-S02-C01.png") == 0);
    json_decref(job);
    job = job_of("{\"calibration\": \"patches\"}", "L2");
    CHECK(json_array_size(json_object_get(job, "calibration")) == 5);
    json_decref(job);
}

/* --- what is refused --- */

static void check_refused(const char *text, const char *sentence)
{
    struct gsn_phantom_variant untouched = { .rows = 77 };
    struct gsn_error err = { 0 };

    CHECK(parse(text, &untouched, &err) == GSN_E_INPUT);
    if (!strstr(err.text, sentence))
        fail_msg("%s: \"%s\", not \"%s\"", text, err.text, sentence);
    CHECK(untouched.rows == 77);
}

TEST(a_key_that_nobody_defined_is_refused_with_the_nearest)
{
    check_refused("{\"bath_turn\": 5}",
                  "v.json: there is no key \"bath_turn\"; the nearest is \"bath_turn_deg\"");
    check_refused("{\"counter_stain\": \"haematoxylin\"}", "the nearest is \"counterstain\"");
    check_refused("{\"marks\": {\"radius\": 40}}", "the nearest is \"radius_um\"");
    check_refused("{\"block\": {\"sektions\": 40}}", "the nearest is \"sections\"");
}

TEST(a_value_out_of_its_range_is_refused_with_its_key)
{
    check_refused("{\"bath_turn_deg\": \"five\"}",
                  "v.json: \"bath_turn_deg\" must be a number, 0 to 45");
    check_refused("{\"bath_seed\": -1}", "\"bath_seed\"");
    check_refused("{\"counterstain\": \"eosin\"}", "\"counterstain\" must be \"haematoxylin\"");
    check_refused("{\"jpeg_quality\": 0}", "\"jpeg_quality\"");
    check_refused("{\"marks\": {\"radius_um\": 4}}", "\"radius_um\"");
    check_refused("{\"marks\": {\"aspect\": 2}}", "\"aspect\"");
    check_refused("{\"marks\": {\"kind\": \"cross\"}}", "\"disc\" or \"hole\"");
    check_refused("{\"marks\": {\"decoys\": 61}}", "\"decoys\"");
    check_refused("{\"marks\": {\"none\": 1}}", "\"none\"");
    check_refused("{\"layout\": [1, 3]}", "\"layout\"");
    check_refused("{\"layout\": [2.5, 4]}", "\"layout\"");
    check_refused("{\"triangle_um\": [[0, 0], [1, 1]]}", "three points");
    check_refused("{\"triangle_um\": [[0, 0], [1, 1], [2900, 2900]]}", "mark 3");
    check_refused("{\"label\": \"upside down\"}", "\"label\"");
    check_refused("{\"markers_key\": \"\"}", "\"markers_key\"");
    check_refused("{\"markers_y_up\": 1}", "\"markers_y_up\"");
    check_refused("{\"black_frame_px\": 1.5}", "\"black_frame_px\"");
    check_refused("{\"calibration\": \"panels\"}", "\"calibration\"");
    check_refused("{\"block\": \"Q\"}", "\"block\"");
    check_refused("{\"block\": {\"half_axes_um\": [2900, 2900]}}", "make \"half_axes_um\" smaller");
    check_refused("{\"block\": {\"sections\": 20}}", "the region lies at z = 120 to 720 um");
    check_refused("{\"block\": {\"lesion_um\": [411, 646, 430]}}",
                  "the region ends within a section");
    check_refused("[]", "must be a JSON object");
    check_refused("{\"loss\": 1, \"loss\": 2}", "line 1");
}

TEST(a_lesion_cannot_be_deeper_than_there_is_tissue)
{
    struct gsn_phantom_plan *plan = malloc(sizeof *plan);
    struct gsn_phantom_variant v;
    struct gsn_error err = { 0 };

    CHECK_OK(parse("{\"loss\": 1.3}", &v, &err), err);
    CHECK(gsn_phantom_plan_make_variant("S02", "L0", 1, 24, &v, plan, &err) == GSN_E_LIMIT);
    CHECK(strstr(err.text, "\"loss\" can be 1.227 at most"));
    CHECK_OK(gsn_phantom_plan_make_variant("S01", "L0", 1, 24, &v, plan, &err), err);
    gsn_phantom_variant_done(&v);
    free(plan);
}

static int parse_once(struct gsn_error *err)
{
    gsn_auto_phantom_variant v = gsn_phantom_variant_usual();

    return parse("{\"loss\": 0, \"marks\": {\"radius_um\": 40}}", &v, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(parse_once(&err), err);
}

/* --- the files --- */

TEST(every_variant_file_is_read_planned_and_named_in_the_readme)
{
    gsn_auto_mem(uint8_t) readme = NULL;
    struct gsn_phantom_plan *plan = malloc(sizeof *plan);
    struct gsn_error err = { 0 };
    size_t size, files = 0, geometries = 0;
    DIR *folder = opendir(VARIANTS);

    CHECK(folder);
    CHECK_OK(gsn_file_read(VARIANTS "/README.md", 100000, &readme, &size, &err), err);
    for (struct dirent *entry = readdir(folder); entry; entry = readdir(folder)) {
        char path[512], named[300];
        struct gsn_phantom_variant v;

        if (!strstr(entry->d_name, ".json"))
            continue;
        (void)snprintf(path, sizeof path, VARIANTS "/%s", entry->d_name);
        (void)snprintf(named, sizeof named, "`%s`", entry->d_name);
        CHECK_OK(gsn_phantom_variant_read(path, &v, &err), err);
        CHECK_OK(gsn_phantom_plan_make_variant("S02", "L1", 1, 24, &v, plan, &err), err);
        if (!strstr((const char *)readme, named))
            fail_msg("README.md says nothing of %s", entry->d_name);
        gsn_phantom_variant_done(&v);
        geometries += strncmp(entry->d_name, "geometry-", 9) == 0;
        files++;
    }
    (void)closedir(folder);
    CHECK(files >= 20 && geometries >= 10);
    free(plan);
}
