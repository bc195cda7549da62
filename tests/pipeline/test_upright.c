/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A panel is set upright once and for all: what its label tells when it is examined holds whenever
 * it is opened again. */
#include "pipeline/upright.h"

#include "tests/check.h"
#include "tests/pipeline/drawn_assembly.h"
#include "tests/pipeline/drawn_label.h"

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

static void check_stack(const struct gsn_assembly *a)
{
    CHECK(a->refinement.done);
    for (size_t i = 0; i < a->section_count; i++)
        CHECK(a->section[i].state == GSN_SECTION_USED && !a->section[i].finding.contradicted);
    for (unsigned serial = 2; serial < 10; serial++)
        drawn_check_plane(a->grid, serial, DRAWN_DENSITY);
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
        gsn_auto(gsn_assembly) a = drawn_assembly(&d);

        check_stack(a);
        for (size_t p = 0; p < 3; p++)
            if (fed[i].says[0] ? !strstr(a->panel[p].note, fed[i].says) : a->panel[p].note[0] != 0)
                fail_msg("fed %zu, panel %zu: %s", i, p + 1, a->panel[p].note);
    }
}

TEST(codes_are_read_when_a_panel_is_examined_and_never_again)
{
    drawn_auto d;

    examine(&d, 0, 2);
    gsn_auto(gsn_assembly) a = drawn_assembly(&d);

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
    gsn_auto(gsn_assembly) a = drawn_assembly(&d);

    check_stack(a);
    for (size_t p = 0; p < 3; p++) {
        CHECK(strstr(d.findings[p]->note, FAILED));
        CHECK(strstr(a->panel[p].note, FAILED));
    }
}
