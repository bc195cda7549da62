/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What goes wrong between the glass and the scanner, and the sentence that a technician reads. */
#include "pipeline/specimen/panel_analysis.h"

#include "pipeline/decode/png_write.h"
#include "pipeline/phantom/panel.h"
#include "pipeline/phantom/planning.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/specimen/orientation.h"
#include "pipeline/stain/artefact/dust.h"
#include "tests/check.h"
#include "tests/specimen/drawn_panel.h"
#include "tests/specimen/flags.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char JOB[] =
    "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [2, 2], \"panels\": 2, \"sections\": 7, "
    "\"markers_um\": " DRAWN_MARKS_JSON "}";

static struct gsn_panel_findings *examined_as(const struct gsn_image *image, unsigned number,
                                              const char *job)
{
    gsn_auto(gsn_protocol) protocol = NULL;
    struct gsn_panel_findings *findings = NULL;
    gsn_auto_mem(uint8_t) png = NULL;
    struct gsn_error err = { 0 };
    size_t size;

    CHECK_OK(gsn_protocol_parse(job, strlen(job), &protocol, &err), err);
    CHECK_OK(gsn_png_encode(image, &png, &size, &err), err);
    CHECK_OK(gsn_panel_analyse(NULL, gsn_check_fd(png, size), protocol, number, NULL, 1, NULL,
                               &findings, &err),
             err);
    return findings;
}

static void says(const struct gsn_panel_findings *findings, const char *sentence)
{
    if (!strstr(findings->note, sentence))
        fail_msg("\"%s\" is not in \"%s\"", sentence, findings->note);
}

/* A square of tissue on the picture. */
static void add_tissue(struct gsn_image *image, uint32_t x0, uint32_t y0, uint32_t side)
{
    static const uint8_t ROSE[3] = { 200, 70, 100 };

    for (uint32_t i = 0; i < side * side; i++)
        memcpy((uint8_t *)image->samples +
                   3 * ((size_t)(y0 + i / side) * image->width + x0 + i % side),
               ROSE, 3);
}

/* Case 45. */
TEST(a_blank_panel_is_a_row_that_says_so)
{
    struct drawn_panel panel = drawn_panel_of(2, 24, 0.8);

    for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++)
        panel.section[slot].missing = 1;
    gsn_auto(gsn_image) image = drawn_panel_image(&panel);
    add_tissue(image, 100, 100, 1); /* dust; a picture without any is no scan */
    gsn_auto(gsn_panel_findings) findings = examined_as(image, 2, JOB);

    CHECK(findings->count == DRAWN_SLOTS);
    for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++) {
        CHECK(findings->section[slot].serial == 4 + slot);
        CHECK(findings->section[slot].sighting == (slot < 3 ? GSN_SIGHT_MISSING : GSN_SIGHT_EMPTY));
    }
    says(findings, "no tissue on this panel");
}

/* Cases 25 and 26. */
TEST(a_scrap_in_an_empty_slot_is_held_and_the_slot_stays_empty)
{
    struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);

    panel.section[1].missing = 1;
    gsn_auto(gsn_image) image = drawn_panel_image(&panel);
    add_tissue(image, 160, 50, 12);
    gsn_auto(gsn_panel_findings) findings = examined_as(image, 1, JOB);

    CHECK(findings->count == DRAWN_SLOTS + 1);
    CHECK(findings->section[1].sighting == GSN_SIGHT_MISSING && findings->section[1].serial == 1);
    CHECK(findings->section[2].sighting == GSN_SIGHT_FOUND && findings->section[2].serial == 2);
    CHECK(findings->section[4].sighting == GSN_SIGHT_HELD);
    CHECK(findings->section[4].serial == GSN_NO_SERIAL && findings->section[4].slot == 4);
    assert_string_equal(text_of(&findings->section[4].flags).text, "scrap");
    CHECK(abs(findings->section[4].x - 160) <= 2 && abs(findings->section[4].width - 12) <= 2);
    says(findings, "1 piece between the slots belongs to no section: held");
}

/* Case 27. */
TEST(sections_that_grew_together_are_held_with_a_cut)
{
    struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    const char *cut;
    double at[4];

    panel.section[0].shift_um.x = 330;
    panel.section[1].shift_um.x = -330;
    panel.section[0].turn_deg = panel.section[1].turn_deg = 0;
    gsn_auto(gsn_image) image = drawn_panel_image(&panel);
    gsn_auto(gsn_panel_findings) findings = examined_as(image, 1, JOB);

    for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++) {
        CHECK(findings->section[slot].sighting == (slot < 2 ? GSN_SIGHT_HELD : GSN_SIGHT_FOUND));
        assert_string_equal(text_of(&findings->section[slot].flags).text,
                            slot < 2 ? "touching" : "");
        /* What their marks say is known, for when they are parted. */
        CHECK(findings->section[slot].mark[0].found);
    }
    says(findings, "the sections in slots 1 and 2 have grown together and are held: cut along the "
                   "line from (");
    says(findings, " px, or mount them again");
    cut = strstr(findings->note, "from (");
    CHECK(sscanf(cut, "from (%lf, %lf) to (%lf, %lf)", &at[0], &at[1], &at[2], &at[3]) == 4);
    CHECK_NEAR(at[0], 108, 3);
    CHECK_NEAR(at[2], 108, 3);
}

/* Case 28. */
TEST(a_section_over_the_edge_says_how_much_is_lost)
{
    struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);

    panel.section[0].shift_um.y = -900;
    gsn_auto(gsn_image) image = drawn_panel_image(&panel);
    gsn_auto(gsn_panel_findings) findings = examined_as(image, 1, JOB);
    const char *at = strstr(findings->note, "the section in slot 1 runs over the edge: ");
    double percent = 0;

    CHECK(at && sscanf(at, "the section in slot 1 runs over the edge: %lf", &percent) == 1);
    says(findings, " % of its tissue is lost");
    print_message("  %g %% lost\n", percent);
    CHECK(percent > 5 && percent < 40);
}

/* Case 17: one of four is a fault of the mounting. */
TEST(one_mirrored_section_is_its_own_fault)
{
    struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);

    panel.section[1].flipped = 1;
    gsn_auto(gsn_image) one = drawn_panel_image(&panel);
    gsn_auto(gsn_panel_findings) single = examined_as(one, 1, JOB);

    CHECK(!strstr(single->note, "mirrored"));
}

/* ---- with a label ------------------------------------------------------------------------ */

static const char PHANTOM_JOB[] = "{\"specimen\": \"S02-L0\", \"study\": \"GVP-D\", \"px_um\": 24, "
                                  "\"layout\": [3, 4]}";

static struct gsn_image *phantom_panel(int panel)
{
    struct gsn_phantom_extent extent[GSN_PHANTOM_SLOTS];
    struct gsn_phantom_plan plan;
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make("S02", "L0", 7, 24, &plan, &err), err);
    CHECK_OK(gsn_phantom_panel_draw(&plan, &plan.file[panel - 1], 0, &image, extent, &err), err);
    return image;
}

/* The picture mirrored left to right and, or, turned by 180 degrees. */
static void turn(struct gsn_image *image, int mirrored, int turned)
{
    const size_t width = image->width, count = width * image->height;
    uint8_t *pixel = image->samples;

    for (size_t i = 0; i < count; i++) {
        const size_t x = i % width, y = i / width;
        const size_t onto_y = turned ? image->height - 1 - y : y;
        const size_t k = onto_y * width + (mirrored != turned ? width - 1 - x : x);

        for (size_t c = 0; c < 3 && i < k; c++) {
            const uint8_t kept = pixel[3 * i + c];

            pixel[3 * i + c] = pixel[3 * k + c];
            pixel[3 * k + c] = kept;
        }
    }
}

/* Case 16. */
TEST(a_panel_fed_the_wrong_way_round_is_set_upright_by_its_label)
{
    static const char *const MIRRORED =
        "mirrored back as a whole: the code on its label was mirrored";
    static const char *const TURNED =
        "turned by 180 degrees: the code on its label stood on its head";
    gsn_auto(gsn_image) image = phantom_panel(3);
    gsn_auto(gsn_panel_findings) upright = examined_as(image, 3, PHANTOM_JOB);

    CHECK(upright->count >= GSN_PHANTOM_SLOTS && upright->label_number == 3);
    assert_string_equal(upright->label, "GVP-D-S02-P03");
    assert_string_equal(upright->label_subject, "GVP-D-S02");
    CHECK(!strstr(upright->note, MIRRORED) && !strstr(upright->note, TURNED));
    for (int way = 1; way < 4; way++) {
        turn(image, way & 1, way >> 1);
        gsn_auto(gsn_panel_findings) findings = examined_as(image, 3, PHANTOM_JOB);

        turn(image, way & 1, way >> 1);
        CHECK(!strstr(findings->note, MIRRORED) == !(way & 1));
        CHECK(!strstr(findings->note, TURNED) == !(way >> 1));
        CHECK(findings->count == upright->count);
        for (size_t i = 0; i < findings->count; i++) {
            CHECK(findings->section[i].serial == upright->section[i].serial);
            CHECK(findings->section[i].x == upright->section[i].x);
            CHECK(findings->section[i].y == upright->section[i].y);
            CHECK_NEAR(findings->section[i].mark[0].px.x, upright->section[i].mark[0].px.x, 1e-3);
        }
    }
}

/* ---- on its side -------------------------------------------------------------------------- */

static const char MARKED_JOB[] =
    "{\"specimen\": \"S02-L0\", \"study\": \"GVP-D\", \"px_um\": 24, \"layout\": [3, 4], "
    "\"markers_um\": [[-2050, -1000], [1700, -1500], [-1500, 1300]]}";

/* A pen line through the code of a label that stands upright. */
static void scratch_code(struct gsn_image *image)
{
    for (uint32_t y = 0; y < image->height; y++)
        for (uint32_t x = 60; x < 75; x++)
            memset((uint8_t *)image->samples + 3 * ((size_t)y * image->width + x), 30, 3);
}

static void check_same(const struct gsn_panel_findings *a, const struct gsn_panel_findings *b)
{
    CHECK(a->count == b->count && a->width == b->width && a->height == b->height);
    for (size_t i = 0; i < a->count; i++) {
        CHECK(a->section[i].serial == b->section[i].serial);
        CHECK(a->section[i].sighting == b->section[i].sighting);
        CHECK(a->section[i].x == b->section[i].x && a->section[i].y == b->section[i].y);
        for (int m = 0; m < GSN_FIDUCIALS; m++) {
            CHECK_NEAR(a->section[i].mark[m].px.x, b->section[i].mark[m].px.x, 1e-3);
            CHECK_NEAR(a->section[i].mark[m].px.y, b->section[i].mark[m].px.y, 1e-3);
        }
    }
}

/* Case 16. By the code where it can be read, else by the marks of most sections. */
static void check_every_way(const struct gsn_image *image, const char *job, int coded)
{
    gsn_auto(gsn_panel_findings) upright = examined_as(image, 3, job);
    size_t found = 0;

    for (size_t i = 0; i < upright->count; i++)
        found += upright->section[i].sighting == GSN_SIGHT_FOUND;
    CHECK(found == GSN_PHANTOM_SLOTS);
    for (int way = 1; way < 8; way++) {
        const int quarters = way >> 1;

        if (quarters % 2 == 0 && !coded)
            continue;
        gsn_auto(gsn_image) picture = drawn_turned(image, way & 1, quarters);
        gsn_auto(gsn_panel_findings) findings = examined_as(picture, 3, job);

        check_same(findings, upright);
        CHECK(!strstr(findings->note, "mirrored back as a whole") == !(way & 1));
        if (quarters % 2 == 0)
            continue;
        says(findings, (quarters == 1) == !(way & 1) ? "turned by 270 degrees clockwise: "
                                                     : "turned by 90 degrees clockwise: ");
        says(findings, coded ? "the code on its label and its sections lay on their side"
                             : "so lie the marks of most of its sections");
    }
}

TEST(a_panel_fed_on_its_side_is_set_upright_by_its_label)
{
    gsn_auto(gsn_image) image = phantom_panel(3);

    check_every_way(image, PHANTOM_JOB, 1);
}

TEST(a_panel_fed_on_its_side_is_set_upright_by_its_marks)
{
    gsn_auto(gsn_image) image = phantom_panel(3);

    scratch_code(image);
    check_every_way(image, MARKED_JOB, 0);
}

static void refused(const struct gsn_image *image, const char *job, const char *sentence)
{
    gsn_auto(gsn_protocol) protocol = NULL;
    struct gsn_panel_findings *findings = NULL;
    gsn_auto_mem(uint8_t) png = NULL;
    struct gsn_error err = { 0 };
    size_t size;

    CHECK_OK(gsn_protocol_parse(job, strlen(job), &protocol, &err), err);
    CHECK_OK(gsn_png_encode(image, &png, &size, &err), err);
    CHECK(gsn_panel_analyse(NULL, gsn_check_fd(png, size), protocol, 3, NULL, 1, NULL, &findings,
                            &err) == GSN_E_WITHHELD);
    CHECK(findings == NULL);
    if (!strstr(err.text, sentence))
        fail_msg("\"%s\" is not in \"%s\"", sentence, err.text);
}

TEST(a_panel_of_which_nothing_tells_which_way_it_lies_is_refused)
{
    static const char SQUARE[] = "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [4, 4]}";
    static const char SWAPPED[] = "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [4, 3]}";
    gsn_auto(gsn_image) image = phantom_panel(3);
    gsn_auto(gsn_image) lying = drawn_turned(image, 0, 1);

    refused(lying, SQUARE, "its label lies on its side, and neither the grid of its sections nor");
    refused(image, SWAPPED, "its label stands upright, but its sections lie as 3 rows of 4");
    scratch_code(image);
    gsn_auto(gsn_image) blind = drawn_turned(image, 0, 1);
    refused(blind, PHANTOM_JOB, "nor the marks of its sections tell which way it was turned: ");
}

/* The square of the label that holds the code, turned by a quarter where it is. */
TEST(a_label_that_lies_on_its_side_by_make_leaves_the_panel_as_it_is)
{
    enum { X = 2, Y = 124, SIDE = 128 };
    gsn_auto(gsn_image) image = phantom_panel(3);
    gsn_auto(gsn_image) made = drawn_turned(image, 0, 0);

    for (uint32_t y = 0; y < SIDE; y++)
        for (uint32_t x = 0; x < SIDE; x++)
            memcpy(
                (uint8_t *)made->samples + 3 * ((size_t)(Y + x) * made->width + X + SIDE - 1 - y),
                (const uint8_t *)image->samples + 3 * ((size_t)(Y + y) * image->width + X + x), 3);
    gsn_auto(gsn_panel_findings) upright = examined_as(image, 3, PHANTOM_JOB);
    gsn_auto(gsn_panel_findings) findings = examined_as(made, 3, PHANTOM_JOB);

    assert_string_equal(findings->label, "GVP-D-S02-P03");
    check_same(findings, upright);
    CHECK(!strstr(findings->note, "turned by"));
}

static int look_once(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                     struct gsn_error *err)
{
    struct gsn_dust_turn turn;
    const char *why;

    return gsn_orientation_find(scan, protocol, &turn, &why, err);
}

TEST(running_out_of_memory_while_turning_leaves_the_picture_as_it_was)
{
    const struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    gsn_auto(gsn_protocol) protocol = NULL;
    gsn_auto(gsn_scan) scan = NULL;
    struct gsn_error err = { 0 };
    size_t size;
    gsn_auto_mem(uint8_t) png = drawn_panel_png(&panel, &size);

    CHECK_OK(gsn_protocol_parse(JOB, strlen(JOB), &protocol, &err), err);
    CHECK_OK(gsn_scan_survey(NULL, gsn_check_fd(png, size), protocol, NULL, &scan, &err), err);
    CHECK_EVERY_OOM(look_once(scan, protocol, &err), err);

    struct gsn_image *image = scan->picture->image;
    gsn_auto(gsn_image) before = drawn_turned(image, 0, 0);
    gsn_auto(gsn_image) after = drawn_turned(image, 1, 3);
    const struct gsn_dust_turn turn = { 1, 3 };

    gsn_check_fail_allocation(1);
    const int r = gsn_orientation_turn(scan->picture, turn, &err);
    gsn_check_fail_allocation(0);
    CHECK(r == GSN_E_NOMEM && image->width == before->width);
    CHECK(memcmp(image->samples, before->samples, gsn_image_bytes(image)) == 0);
    CHECK_OK(gsn_orientation_turn(scan->picture, turn, &err), err);
    CHECK(image->width == after->width && image->height == after->height);
    CHECK(memcmp(image->samples, after->samples, gsn_image_bytes(image)) == 0);
}

/* Case 34: the code scratched off, the writing is still there. */
TEST(a_label_that_cannot_be_read_is_shown_where_it_is)
{
    gsn_auto(gsn_image) image = phantom_panel(1);

    scratch_code(image);
    gsn_auto(gsn_panel_findings) findings = examined_as(image, 1, PHANTOM_JOB);

    CHECK(findings->label_number == 0);
    says(findings, "no code could be read on its label: compare what is written from (");
}

/* Case 14: the same panel, and a job or a file that states other pixels. */
TEST(the_marks_tell_that_the_pixels_are_not_as_large_as_stated)
{
    const struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    static const double stated[] = { 12, 60, 100 };
    size_t size;
    gsn_auto_mem(uint8_t) png = drawn_panel_png(&panel, &size);

    for (size_t i = 0; i < sizeof stated / sizeof stated[0]; i++) {
        gsn_auto_mem(char) job =
            gsn_format("{\"specimen\": \"x\", \"px_um\": %g, \"layout\": [2, 2], \"panels\": 2, "
                       "\"markers_um\": " DRAWN_MARKS_JSON "}",
                       stated[i]);
        gsn_auto(gsn_protocol) protocol = NULL;
        struct gsn_panel_findings *findings = NULL;
        struct gsn_error err = { 0 };
        double said = 0;
        const char *at;

        CHECK_OK(gsn_protocol_parse(job, strlen(job), &protocol, &err), err);
        const int r = gsn_panel_analyse(NULL, gsn_check_fd(png, size), protocol, 1, NULL, 1, NULL,
                                        &findings, &err);

        if (r != GSN_E_WITHHELD)
            fail_msg("%g um: %d (%s)", stated[i], r, r < 0 ? err.text : findings->note);
        CHECK(findings == NULL);
        CHECK(strstr(err.text, "job.json states pixels of "));
        CHECK(strstr(err.text, "put \"px_um\" (or \"markers_um\") in job.json right"));
        at = strstr(err.text, "they are ");
        CHECK(at && sscanf(at, "they are %lf um", &said) == 1);
        CHECK_NEAR(said, 24, 0.25);
    }
}
