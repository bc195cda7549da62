/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/protocol.h"

#include "pipeline/core/mem.h"
#include "pipeline/stain/calibration.h"
#include "pipeline/stain/tissue_segmentation.h"
#include "tests/check.h"

#include <string.h>

static int parse(const char *text, struct gsn_protocol **ret, struct gsn_error *err)
{
    return gsn_protocol_parse(text, strlen(text), ret, err);
}

/* Every key of docs/user/job.md. */
static const char FULL[] =
    "{\"specimen\": \"A/1\", \"study\": \"s\", \"group\": \"g\", \"animal\": \"a\", \"week\": 4,"
    " \"px_um\": 10.58, \"interval_um\": 24, \"panels\": 5, \"layout\": [3, 4], \"order\": "
    "\"snake\","
    " \"sections\": 59, \"markers_um\": [[-2050, -1000], [1700, -1500], [-1500, 1300]],"
    " \"region\": {\"shape\": \"cylinder\", \"centre\": [1, 2], \"radius\": 3, \"z\": [4, 50]},"
    " \"baseline\": \"B\", \"thresholds\": [0.3, 0.5], \"tolerance\": 0.02, \"transfer\": \"srgb\","
    " \"dyes\": \"estimate\", \"strain\": \"corrected\", \"white\": [1, 0.9, 0.8], \"kind\": "
    "\"sections\", \"comment\": 1}";

TEST(every_documented_key_is_read)
{
    gsn_auto(gsn_protocol) p = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(parse(FULL, &p, &err), err);
    CHECK(strcmp(p->specimen, "A/1") == 0 && strcmp(p->baseline, "B") == 0);
    CHECK(p->order == GSN_PROTOCOL_SNAKE && p->transfer == GSN_PROTOCOL_SRGB &&
          p->dyes == GSN_PROTOCOL_DYES_ESTIMATE);
    CHECK(p->rows == 3 && p->columns == 4 && gsn_protocol_sections(p) == 59);
    CHECK(p->has_markers && p->markers_um[2].y == 1300);
    CHECK(p->region.kind == GSN_REGION_CYLINDER && p->region.high.z == 50);
    CHECK(p->threshold_count == 2 && p->has_white && p->unknown == NULL);
    CHECK(p->strain == GSN_PROTOCOL_STRAIN_CORRECTED);
    CHECK_NEAR(p->px_um, 10.58, 0);
}

TEST(what_is_not_stated_has_the_documented_default)
{
    gsn_auto(gsn_protocol) p = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(parse("{\"specimen\": \"x\"}", &p, &err), err);
    CHECK(p->rows == 3 && p->columns == 4 && p->interval_um == 24 && p->px_um == 0);
    CHECK(isnan(p->week) && p->region.kind == GSN_REGION_NONE && !p->has_markers);
    CHECK(p->kind == GSN_KIND_SECTIONS && p->transfer == GSN_PROTOCOL_TRANSFER_UNKNOWN);
    CHECK(p->strain == GSN_PROTOCOL_STRAIN_REPORTED);
    CHECK(p->registration == GSN_PROTOCOL_MARKS_AND_TISSUE && p->frame_panel == 0);
}

TEST(a_stack_may_be_laid_by_its_tissue_in_the_frame_of_a_section)
{
    gsn_auto(gsn_protocol) p = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(
        parse("{\"specimen\": \"x\", \"registration\": \"tissue\", \"frame\": [2, 12], "
              "\"region\": {\"shape\": \"cylinder\", \"centre\": [1, 2], \"radius\": 3, \"z\": "
              "[4, 50]}}",
              &p, &err),
        err);
    CHECK(p->registration == GSN_PROTOCOL_TISSUE && p->frame_panel == 2 && p->frame_slot == 12);
}

/* Coordinates without the section that they were taken from would be a guess. */
TEST(coordinates_by_tissue_need_their_frame_and_a_band_needs_none)
{
    static const char *const regions[] = {
        "\"region\": \"mask.nrrd\"",
        "\"region\": {\"shape\": \"sphere\", \"centre\": [1, 2, 3], \"radius\": 4}",
        "\"region\": {\"kind\": \"band\", \"from\": \"m.nrrd\", \"low_um\": 0, \"high_um\": 9}",
        "\"region\": {\"kind\": \"band\", \"from\": \"bone\", \"low_um\": 0, \"high_um\": 9, "
        "\"within\": {\"centre\": [1, 2], \"radius\": 3}}",
        "\"reference\": {\"tissue\": {\"shape\": \"sphere\", \"centre\": [1, 2, 3], \"radius\": "
        "4}, "
        "\"density\": 1}",
        "\"region\": {\"kind\": \"band\", \"from\": \"bone\", \"low_um\": 0, \"high_um\": 9}",
    };

    for (size_t i = 0; i < sizeof regions / sizeof regions[0]; i++)
        for (int framed = 0; framed < 2; framed++) {
            gsn_auto_mem(char) job =
                gsn_format("{\"specimen\": \"x\", \"registration\": \"tissue\", %s%s}",
                           framed ? "\"frame\": [1, 1], " : "", regions[i]);
            gsn_auto(gsn_protocol) p = NULL;
            struct gsn_error err = { 0 };
            const int refused = !framed && i < 5;

            CHECK(parse(job, &p, &err) == (refused ? GSN_E_INPUT : GSN_OK));
            CHECK(!refused || (!p && strstr(err.text, i == 4 ? "\"reference\"" : "\"region\"") &&
                               strstr(err.text, "\"frame\": [panel, slot]")));
        }
}

TEST(what_becomes_of_strain_can_be_stated)
{
    static const char *const jobs[] = { "{\"specimen\": \"x\", \"strain\": \"reported\"}",
                                        "{\"specimen\": \"x\", \"strain\": \"rigid\"}",
                                        "{\"specimen\": \"x\", \"strain\": \"corrected\"}",
                                        "{\"specimen\": \"x\", \"strain\": \"tissue\"}" };
    static const enum gsn_protocol_strain meant[] = { GSN_PROTOCOL_STRAIN_REPORTED,
                                                      GSN_PROTOCOL_STRAIN_RIGID,
                                                      GSN_PROTOCOL_STRAIN_CORRECTED,
                                                      GSN_PROTOCOL_STRAIN_TISSUE };

    for (size_t i = 0; i < 4; i++) {
        gsn_auto(gsn_protocol) p = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(parse(jobs[i], &p, &err), err);
        CHECK(p->strain == meant[i]);
    }
}

TEST(an_unknown_key_is_named_and_not_refused)
{
    gsn_auto(gsn_protocol) p = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(parse("{\"specimen\": \"x\", \"pxum\": 3, \"lens\": 1}", &p, &err), err);
    CHECK(strcmp(p->unknown, "\"pxum\", \"lens\"") == 0);
}

TEST(a_wrong_value_is_refused_by_the_name_of_its_key)
{
    static const struct {
        const char *text, *named;
    } cases[] = {
        { "[]", "not a JSON object" },
        { "{\"specimen\": \"x\",}", "line 1" },
        { "{\"specimen\": \"x\", \"specimen\": \"y\"}", "duplicate" },
        { "{}", "\"specimen\" is missing" },
        { "{\"specimen\": \"\"}", "\"specimen\" is missing" },
        { "{\"specimen\": 3}", "\"specimen\"" },
        { "{\"specimen\": \"x\", \"px_um\": 0}", "\"px_um\"" },
        { "{\"specimen\": \"x\", \"px_um\": \"16\"}", "\"px_um\"" },
        { "{\"specimen\": \"x\", \"layout\": [0, 4]}", "\"layout\"" },
        { "{\"specimen\": \"x\", \"layout\": [3.5, 4]}", "\"layout\"" },
        { "{\"specimen\": \"x\", \"layout\": [1e9, 1e9]}", "\"layout\"" },
        { "{\"specimen\": \"x\", \"order\": \"zigzag\"}", "\"order\"" },
        { "{\"specimen\": \"x\", \"markers_um\": [[1, 2], [3, 4]]}", "\"markers_um\"" },
        { "{\"specimen\": \"x\", \"thresholds\": []}", "\"thresholds\"" },
        { "{\"specimen\": \"x\", \"region\": {\"shape\": \"cube\"}}", "\"shape\"" },
        { "{\"specimen\": \"x\", \"region\": {\"shape\": \"box\", \"min\": [0,0,0], \"max\": "
          "[0,1,1]}}",
          "\"region\"" },
        { "{\"specimen\": \"x\", \"baseline\": \"x\"}", "names the specimen itself" },
        { "{\"specimen\": \"x\", \"kind\": \"volume\"}", "\"file\" is missing" },
        { "{\"specimen\": \"x\", \"panels\": -1}", "\"panels\"" },
        { "{\"specimen\": \"x\", \"panels\": 1.5}", "\"panels\"" },
        { "{\"specimen\": \"x\", \"sections\": 0}", "\"sections\"" },
        { "{\"specimen\": \"x\", \"study\": 1}", "\"study\"" },
        { "{\"specimen\": \"x\", \"week\": -1}", "\"week\"" },
        { "{\"specimen\": \"x\", \"interval_um\": 0}", "\"interval_um\"" },
        { "{\"specimen\": \"x\", \"tolerance\": 0}", "\"tolerance\"" },
        { "{\"specimen\": \"x\", \"kind\": \"slide\"}", "\"kind\"" },
        { "{\"specimen\": \"x\", \"kind\": \"tile\"}", "\"file\" is missing" },
        { "{\"specimen\": \"x\", \"transfer\": \"gamma\"}", "\"transfer\"" },
        { "{\"specimen\": \"x\", \"dyes\": 3}", "\"dyes\"" },
        { "{\"specimen\": \"x\", \"reference\": \"mask.png\"}", "\"reference\"" },
        { "{\"specimen\": \"x\", \"reference\": {\"density\": 1}}", "\"reference\"" },
        { "{\"specimen\": \"x\", \"reference\": {\"tissue\": {\"shape\": \"box\"}, \"density\": "
          "1}}",
          "\"tissue\"" },
        { "{\"specimen\": \"x\", \"batch\": \"a name that is far too long to keep\"}",
          "\"batch\"" },
        { "{\"specimen\": \"x\", \"strain\": \"affine\"}", "\"strain\"" },
        { "{\"specimen\": \"x\", \"registration\": \"sift\"}", "\"registration\"" },
        { "{\"specimen\": \"x\", \"registration\": \"tissue\", \"strain\": \"tissue\"}",
          "\"strain\"" },
        { "{\"specimen\": \"x\", \"frame\": [1, 1]}", "\"frame\"" },
        { "{\"specimen\": \"x\", \"registration\": \"tissue\", \"frame\": [1, 13]}", "\"frame\"" },
        { "{\"specimen\": \"x\", \"registration\": \"tissue\", \"frame\": [0, 1]}", "\"frame\"" },
        { "{\"specimen\": \"x\", \"stained\": \"31.3.2026\"}", "\"stained\"" },
        { "{\"specimen\": \"x\", \"scanned\": 20260331}", "\"scanned\"" },
        { "{\"specimen\": \"x\", \"stained\": \"2026-03-31\", \"scanned\": \"2026-03-30\"}",
          "no earlier than \"stained\"" },
        { "{\"specimen\": \"x\", \"yellow_to_red\": [0.6, 0.4]}", "\"yellow_to_red\"" },
        { "{\"specimen\": \"x\", \"yellow_to_red\": 0.5}", "\"yellow_to_red\"" },
        { "{\"specimen\": \"x\", \"white\": [1, 1, 0]}", "\"white\"" },
        { "{\"specimen\": \"x\", \"white\": [255, 255, 255]}", "\"white\"" },
        { "{\"specimen\": \"x\", \"layout\": 3}", "\"layout\"" },
        { "{\"specimen\": \"x\", \"markers_um\": [[1, 2], [3, 4], [5, \"6\"]]}", "\"markers_um\"" },
        { "{\"specimen\": \"x\", \"thresholds\": [1, 2, 3, 4, 5, 6, 7, 8, 9]}", "\"thresholds\"" },
        { "{\"specimen\": \"x\", \"thresholds\": 0.5}", "\"thresholds\"" },
        { "{\"specimen\": \"x\", \"region\": 7}", "\"region\"" },
        { "{\"specimen\": \"x\", \"region\": {\"shape\": \"sphere\", \"centre\": [0, 0], "
          "\"radius\": 3}}",
          "\"region\"" },
        { "{\"specimen\": \"x\", \"region\": {\"shape\": \"sphere\", \"centre\": [0, 0, 0], "
          "\"radius\": -3}}",
          "\"region\"" },
        { "{\"specimen\": \"x\", \"region\": {\"shape\": \"cylinder\", \"centre\": [0, 0], "
          "\"radius\": 3, \"z\": [9, 4]}}",
          "\"region\"" },
        { "{\"specimen\": \"x\", \"region\": {\"kind\": \"shell\"}}", "\"band\"" },
        { "{\"specimen\": \"x\", \"region\": {\"kind\": \"band\", \"from\": \"root\", "
          "\"low_um\": 630, \"high_um\": 180}}",
          "\"low_um\"" },
        { "{\"specimen\": \"x\", \"region\": {\"kind\": \"band\", \"from\": \"root\", "
          "\"low_um\": 1, \"high_um\": 2, \"within\": {\"centre\": [0, 0]}}}",
          "\"within\"" },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct gsn_protocol *p = NULL;
        struct gsn_error err = { 0 };

        CHECK(parse(cases[i].text, &p, &err) == GSN_E_INPUT);
        CHECK(p == NULL);
        if (!strstr(err.text, cases[i].named))
            fail_msg("%s\nsays: %s\nand does not name %s", cases[i].text, err.text, cases[i].named);
    }
}

TEST(a_band_is_read_with_and_without_its_limits)
{
    gsn_auto(gsn_protocol) p = NULL;
    gsn_auto(gsn_protocol) q = NULL;
    gsn_auto(gsn_protocol) bone = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(parse("{\"specimen\": \"x\", \"region\": {\"kind\": \"band\", \"from\": \"root\", "
                   "\"low_um\": 180, \"high_um\": 630}}",
                   &p, &err),
             err);
    CHECK(p->region.kind == GSN_REGION_BAND && p->region.file == NULL);
    CHECK(p->region.low_um == 180 && p->region.high_um == 630 && p->region.radius_um == 0);
    CHECK(p->region.low.z == -INFINITY && p->region.high.z == INFINITY);
    CHECK_OK(parse("{\"specimen\": \"x\", \"region\": {\"kind\": \"band\", \"from\": "
                   "\"root.mhd\", \"low_um\": -20, \"high_um\": 30, \"z\": [120, 720], "
                   "\"within\": {\"centre\": [411, 646], \"radius\": 900}}}",
                   &q, &err),
             err);
    CHECK(strcmp(q->region.file, "root.mhd") == 0 && q->region.low.z == 120);
    CHECK_OK(parse("{\"specimen\": \"x\", \"region\": {\"kind\": \"band\", \"from\": \"bone\", "
                   "\"low_um\": -50, \"high_um\": 0}}",
                   &bone, &err),
             err);
    CHECK(p->region.from == GSN_TISSUE_ROOT && bone->region.from == GSN_TISSUE_BONE);
    CHECK(q->region.centre.y == 646 && q->region.radius_um == 900);
}

#define SHAPE "{\"shape\": \"sphere\", \"centre\": [1, 2, 3], \"radius\": 40}"

TEST(named_regions_are_read_in_their_order_beside_the_main_one)
{
    static const char job[] = "{\"specimen\": \"x\", \"region\": \"r.mhd\", \"regions\": "
                              "{\"septum\": \"s.mhd\", \"mesial-2\": " SHAPE "}}";
    gsn_auto(gsn_protocol) p = NULL;
    gsn_auto(gsn_protocol) none = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(parse(job, &p, &err), err);
    CHECK(p->named_count == 2 && !p->unknown && strcmp(p->region.file, "r.mhd") == 0);
    CHECK(strcmp(p->named[0].name, "septum") == 0 && strcmp(p->named[0].region.file, "s.mhd") == 0);
    CHECK(strcmp(p->named[1].name, "mesial-2") == 0 &&
          p->named[1].region.kind == GSN_REGION_SPHERE && p->named[1].region.radius_um == 40);
    CHECK_EVERY_OOM(parse(job, &none, &err), err);
}

TEST(named_regions_that_are_none_are_refused_by_name)
{
    static const char *const wrong[][2] = {
        { "\"region\": " SHAPE ", \"regions\": {\"a/b\": " SHAPE "}", "\"a/b\" is no name" },
        { "\"region\": " SHAPE ", \"regions\": {\"\": " SHAPE "}", "\"\" is no name" },
        { "\"region\": " SHAPE ", \"regions\": [" SHAPE "]", "\"regions\" must be" },
        { "\"region\": " SHAPE ", \"regions\": {\"a\": 5}", "\"a\" must be" },
        { "\"regions\": {\"a\": " SHAPE "}", "which is the main one" },
        { "\"kind\": \"tile\", \"file\": \"t.png\", \"regions\": {\"a\": " SHAPE "}",
          "a tile is one picture" },
        { "\"region\": " SHAPE ", \"registration\": \"tissue\", \"frame\": [1, 1], \"regions\": "
          "{\"1\": 1, \"2\": 1, \"3\": 1, \"4\": 1, \"5\": 1, \"6\": 1, \"7\": 1, \"8\": 1, \"9\": "
          "1}",
          "at most 8" },
    };

    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        gsn_auto_mem(char) job = gsn_format("{\"specimen\": \"x\", %s}", wrong[i][0]);
        gsn_auto(gsn_protocol) p = NULL;
        struct gsn_error err = { 0 };

        CHECK(parse(job, &p, &err) == GSN_E_INPUT && !p);
        if (!strstr(err.text, wrong[i][1]))
            fail_msg("%s: %s", job, err.text);
    }
}

TEST(the_sections_are_the_slots_or_as_many_as_stated)
{
    static const struct {
        const char *text;
        unsigned sections;
    } cases[] = {
        { "{\"specimen\": \"x\"}", 0 },
        { "{\"specimen\": \"x\", \"sections\": 7}", 7 },
        { "{\"specimen\": \"x\", \"panels\": 2, \"layout\": [2, 3]}", 12 },
        { "{\"specimen\": \"x\", \"panels\": 2, \"layout\": [2, 3], \"sections\": 11}", 11 },
        { "{\"specimen\": \"x\", \"panels\": 2, \"layout\": [2, 3], \"sections\": 13}", 12 },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        gsn_auto(gsn_protocol) p = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(parse(cases[i].text, &p, &err), err);
        CHECK(gsn_protocol_sections(p) == cases[i].sections);
    }
}

static int parse_once(struct gsn_error *err)
{
    gsn_auto(gsn_protocol) p = NULL;

    return parse("{\"specimen\": \"x\", \"region\": \"m.mhd\", \"pxum\": 3}", &p, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(parse_once(&err), err);
}

TEST(calibration_panels_are_read_with_their_patches)
{
    gsn_auto(gsn_protocol) one = NULL;
    gsn_auto(gsn_protocol) two = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(parse("{\"specimen\": \"x\", \"calibration\": \"c.png\"}", &one, &err), err);
    CHECK(one->calibration_count == 1 && strcmp(one->calibration[0].file, "c.png") == 0);
    CHECK(one->calibration[0].patch_count == 3);
    CHECK(one->calibration[0].patch[1].kind == GSN_PATCH_YELLOW);
    CHECK(gsn_protocol_calibration_of(one->calibration, 1, 7) == &one->calibration[0]);
    CHECK(!gsn_protocol_calibration_has_standards(&one->calibration[0]));
    CHECK_OK(parse("{\"specimen\": \"x\", \"calibration\": [{\"file\": \"a.png\", \"panels\": [1, "
                   "3]}, {\"file\": \"b.png\", \"panels\": [2], \"patches\": [[0, 0.5], "
                   "[\"dark\"]]}]}",
                   &two, &err),
             err);
    CHECK(gsn_protocol_calibration_of(two->calibration, 2, 3) == &two->calibration[0]);
    CHECK(gsn_protocol_calibration_of(two->calibration, 2, 2) == &two->calibration[1]);
    CHECK(gsn_protocol_calibration_of(two->calibration, 2, 4) == NULL);
    CHECK(two->calibration[1].patch_count == 3);
    CHECK(two->calibration[1].patch[1].kind == GSN_PATCH_STANDARD);
    CHECK_NEAR(two->calibration[1].patch[1].density, 0.5, 0);
    CHECK(two->calibration[1].patch[2].row == 2 && two->calibration[1].patch[2].place == 1);
    CHECK(gsn_protocol_calibration_has_standards(&two->calibration[1]));
}

TEST(a_calibration_that_is_wrong_is_refused_with_its_form)
{
    static const char *const wrong[] = {
        "1",
        "\"\"",
        "[]",
        "{\"panels\": [1]}",
        "{\"file\": \"a\", \"panels\": [0]}",
        "{\"file\": \"a\", \"panels\": []}",
        "{\"file\": \"a\", \"patches\": []}",
        "{\"file\": \"a\", \"patches\": [[\"green\"]]}",
        "{\"file\": \"a\", \"patches\": [[-1]]}",
        "{\"file\": \"a\", \"pannels\": [1]}",
        "[{\"file\": \"a\", \"panels\": [1]}, {\"file\": \"b\", \"panels\": [1]}]",
        "[\"a\", \"b\"]",
    };

    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        gsn_auto_mem(char) job = gsn_format("{\"specimen\": \"x\", \"calibration\": %s}", wrong[i]);
        struct gsn_protocol *p = NULL;
        struct gsn_error err = { 0 };

        if (parse(job, &p, &err) != GSN_E_INPUT)
            fail_msg("%s is not refused", wrong[i]);
        CHECK(p == NULL && strstr(err.text, "\"calibration\" must be a file beside job.json"));
    }
}

static int parse_calibrations(struct gsn_error *err)
{
    gsn_auto(gsn_protocol) p = NULL;

    return parse("{\"specimen\": \"x\", \"calibration\": [{\"file\": \"a.png\", \"panels\": [1]}, "
                 "{\"file\": \"b.png\", \"panels\": [2]}]}",
                 &p, err);
}

TEST(running_out_of_memory_over_calibrations_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(parse_calibrations(&err), err);
}
