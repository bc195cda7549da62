/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A panel is set upright once and for all: what its label tells when it is examined holds whenever
 * it is opened again. */
#include "pipeline/specimen/orientation.h"

#include "pipeline/register/fiducial/fiducial.h"
#include "tests/check.h"
#include "tests/specimen/drawn_assembly.h"
#include "tests/specimen/drawn_label.h"

#include <string.h>

/* Every panel is opened three times more: to look at the tissue of its sections, to lay them on by
 * it, and to measure. */
#define JOB                                                                                        \
    "{\"specimen\": \"drawn\", " DRAWN_JOB_HEAD                                                    \
    ", \"strain\": \"tissue\", \"region\": " DRAWN_REGION "}"

/* Three panels that were fed like this, examined with a label that says so. */
static void examine(struct drawn_specimen *d, int mirrored, int quarters)
{
    struct drawn_panel panels[3];

    drawn_three_panels(panels);
    for (size_t i = 0; i < 3; i++) {
        panels[i].mirrored = mirrored;
        panels[i].quarters = quarters;
    }
    drawn_label_lies(mirrored, quarters);
    drawn_specimen_init(d, JOB, panels, 3);
    CHECK(drawn_label_asked() == 3);
}

static void check_stack(const struct gsn_reconstruction *a)
{
    CHECK(a->poses.refinement.done);
    for (size_t i = 0; i < a->poses.section_count; i++)
        CHECK(a->densities.section[i].state == GSN_SECTION_USED &&
              !a->poses.section[i].finding.contradicted);
    for (unsigned serial = 2; serial < 10; serial++)
        drawn_check_plane(a->densities.grid, serial, DRAWN_DENSITY);
}

/* Case 16. Density falls from one side to the other, so a section that is laid from a picture the
 * wrong way round has another. */
TEST(a_panel_is_laid_as_it_was_examined_though_its_label_cannot_be_read_again)
{
    static const struct {
        int mirrored, quarters;
        const char *says;
    } fed[] = { { 0, 2, "turned by 180 degrees: the code on its label stood on its head" },
                { 1, 0, "mirrored back as a whole: the code on its label was mirrored" },
                { 1, 1, "turned by 90 degrees clockwise: the code on its label and its sections" },
                { 0, 3, "turned by 90 degrees clockwise: the code on its label and its sections" },
                { 0, 0, "" } };

    for (size_t i = 0; i < sizeof fed / sizeof fed[0]; i++) {
        drawn_auto d;

        examine(&d, fed[i].mirrored, fed[i].quarters);
        drawn_label_fails();
        gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

        check_stack(a);
        for (size_t p = 0; p < 3; p++)
            if (fed[i].says[0] ? !strstr(a->densities.panel[p].note, fed[i].says)
                               : a->densities.panel[p].note[0] != 0)
                fail_msg("fed %zu, panel %zu: %s", i, p + 1, a->densities.panel[p].note);
    }
}

TEST(codes_are_read_when_a_panel_is_examined_and_never_again)
{
    drawn_auto d;

    examine(&d, 0, 2);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    check_stack(a);
    CHECK(drawn_label_asked() == 3);
}

/* It is said where the panel is examined and wherever it is used, as it may lie the wrong way. */
TEST(a_reader_that_failed_is_said_of_the_panel_from_then_on)
{
    static const char *const FAILED =
        "the code on its label could not be read: the reader failed on this picture";
    struct drawn_panel panels[3];
    drawn_auto d;

    drawn_three_panels(panels);
    drawn_label_lies(0, 0);
    drawn_label_fails();
    drawn_specimen_init(&d, JOB, panels, 3);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    check_stack(a);
    for (size_t p = 0; p < 3; p++) {
        CHECK(strstr(d.findings[p]->note, FAILED));
        CHECK(strstr(a->densities.panel[p].note, FAILED));
    }
}

/* ---- label against marks ------------------------------------------------------------------- */

#define MARKED "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [2, 2], \"markers_um\": "
static const char JOB_MARKED[] = MARKED DRAWN_MARKS_JSON "}";
static const char JOB_Y_UP[] = MARKED "[[-717.5, 350], [595, 525], [-525, -455]]}";
static const char JOB_X_LEFT[] = MARKED "[[717.5, -350], [-595, -525], [525, 455]]}";

/* A panel that was fed like this, whose label says that; in findings what is found. */
static int examine_labelled(int mirrored, int quarters, const char *job,
                            const struct gsn_panel_answers *answers,
                            struct gsn_panel_findings **ret_findings, struct gsn_error *err)
{
    gsn_auto(gsn_protocol) protocol = drawn_protocol(job);
    struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    gsn_auto_mem(uint8_t) png = NULL;
    size_t size;

    panel.mirrored = mirrored;
    panel.quarters = quarters;
    png = drawn_panel_png(&panel, &size);
    return gsn_panel_analyse(NULL, gsn_check_fd(png, size), protocol, 1, answers, 1, NULL,
                             ret_findings, err);
}

/* What holds a panel names both readings. A scanner that mirrors and a triangle that is drawn so
 * look alike, and so does a label on its head and a panel of sections that are. */
TEST(a_label_that_contradicts_the_marks_holds_the_panel_and_names_both)
{
    static const struct {
        int label[2], fed[2]; /* mirrored, quarters */
        const char *job, *says[2];
    } lies[] = {
        { { 0, 2 },
          { 0, 0 },
          JOB_MARKED,
          { "the code on its label stands on its head", "the marks of 4 of 4 sections" } },
        { { 0, 0 },
          { 0, 2 },
          JOB_MARKED,
          { "the code on its label stands upright", "the marks of 4 of 4 sections" } },
        { { -1, 0 },
          { 0, 2 },
          JOB_MARKED,
          { "no code was read on its label", "the marks of 4 of 4 sections" } },
        { { 1, 0 },
          { 0, 0 },
          JOB_MARKED,
          { "4 of 4 sections are mirrored", "the code on its label is mirrored" } },
        { { 0, 0 },
          { 0, 0 },
          JOB_Y_UP,
          { "mirrored top to bottom", "are the markers' y pointing up?" } },
        { { -1, 0 },
          { 0, 0 },
          JOB_Y_UP,
          { "no code was read on its label", "are the markers' y pointing up?" } },
        { { 0, 0 },
          { 0, 0 },
          JOB_X_LEFT,
          { "its label is not mirrored", "are the markers' x pointing left" } },
    };

    for (size_t i = 0; i < sizeof lies / sizeof lies[0]; i++) {
        struct gsn_panel_findings *findings = NULL;
        struct gsn_error err = { 0 };

        drawn_label_lies(lies[i].label[0], lies[i].label[1]);
        if (lies[i].label[0] < 0)
            drawn_label_fails();
        CHECK(examine_labelled(lies[i].fed[0], lies[i].fed[1], lies[i].job, NULL, &findings,
                               &err) == GSN_E_WITHHELD);
        CHECK(findings == NULL);
        for (int k = 0; k < 2; k++)
            if (!strstr(err.text, lies[i].says[k]))
                fail_msg("case %zu: \"%s\" is not in \"%s\"", i, lies[i].says[k], err.text);
        CHECK(strlen(err.text) + 1 < sizeof err.text);
    }
}

/* Three of four sections are not a bench's chance, two may be. */
TEST(two_of_four_turned_sections_leave_the_panel_to_its_label)
{
    gsn_auto(gsn_protocol) protocol = drawn_protocol(JOB_MARKED);

    for (unsigned turned = 2; turned < 4; turned++) {
        struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
        gsn_auto(gsn_panel_findings) findings = NULL;
        gsn_auto_mem(uint8_t) png = NULL;
        size_t size;

        for (unsigned slot = 0; slot < turned; slot++)
            panel.section[slot].turn_deg += 180;
        png = drawn_panel_png(&panel, &size);
        drawn_label_lies(0, 0);
        CHECK(gsn_panel_analyse(NULL, gsn_check_fd(png, size), protocol, 1, NULL, 1, NULL,
                                &findings, NULL) == (turned < 3 ? GSN_OK : GSN_E_WITHHELD));
    }
}

/* The label says half a turn too much: by the marks the panel is as it was fed. */
TEST(a_person_says_whether_label_or_marks_are_right)
{
    static const struct gsn_panel_answer as_set = { .said = GSN_SAID_AS_SET },
                                         as_marked = { .said = GSN_SAID_AS_MARKED };
    const struct gsn_panel_answers set = { 1, &as_set }, marked = { 1, &as_marked };

    for (int mirrored = 0; mirrored < 2; mirrored++)
        for (int quarters = 0; quarters < 4; quarters += 2) {
            gsn_auto(gsn_panel_findings) truth = NULL;
            gsn_auto(gsn_panel_findings) by_label = NULL;
            gsn_auto(gsn_panel_findings) by_marks = NULL;
            struct gsn_error err = { 0 };

            drawn_label_lies(mirrored, quarters);
            CHECK_OK(examine_labelled(mirrored, quarters, JOB_MARKED, NULL, &truth, &err), err);
            drawn_label_lies(mirrored, (quarters + 2) % 4);
            CHECK_OK(examine_labelled(mirrored, quarters, JOB_MARKED, &set, &by_label, &err), err);
            CHECK_OK(examine_labelled(mirrored, quarters, JOB_MARKED, &marked, &by_marks, &err),
                     err);
            for (size_t i = 0; i < truth->count; i++) {
                const struct gsn_fiducial *is = &truth->section[i].mark[0];

                CHECK_NEAR(by_marks->section[i].mark[0].px.x, is->px.x, 1e-3);
                CHECK_NEAR(by_marks->section[i].mark[0].px.y, is->px.y, 1e-3);
                CHECK_NEAR(by_label->section[truth->count - 1 - i].mark[0].px.x,
                           truth->width - is->px.x, 1e-3);
            }
            CHECK(strstr(by_marks->note, "set as its marks say, as was decided"));
            CHECK(strstr(by_label->note, "against its marks, as was decided"));
        }
}
