/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/reconstruction.h"

#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/pose/strain.h"
#include "tests/check.h"
#include "tests/specimen/drawn_assembly.h"
#include "tests/specimen/flags.h"
#include "tests/specimen/often.h"

#include <stdio.h>
#include <string.h>

#define BY_TISSUE_JOB                                                                              \
    "{\"specimen\": \"drawn\", " DRAWN_JOB_HEAD                                                    \
    ", \"strain\": \"tissue\", \"region\": " DRAWN_REGION "}"

/* The drawn tissue is a ramp alike in all sections, and the marks are right: nothing may move them
 * off by more than marks alone would. */
TEST(sections_laid_on_by_their_tissue_lie_where_they_were_cut)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    drawn_three_panels(panels);
    panels[1].section[2].flipped = 1;
    panels[2].section[1].turn_deg += 180;
    drawn_specimen_init(&d, BY_TISSUE_JOB, panels, 3);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->poses.strain_mode == GSN_STRAIN_TISSUE && a->poses.refinement.sections == 12);
    CHECK(a->poses.refinement.done && a->poses.refinement.compared > 0 &&
          a->poses.refinement.moved_um < 2.4);
    for (unsigned i = 0; i < 12; i++) {
        const struct gsn_section *s = &a->poses.section[i];
        const struct gsn_point corners[3] = { { 0, 0 }, { 250, 150 }, { -250, 150 } };

        CHECK(s->pose.flipped == (i == 6) && s->pose.tre_um > 0 && s->pose.tre_um < 24);
        for (size_t c = 0; c < 3; c++) {
            const struct gsn_point px = drawn_panel_place(&panels[i / 4], i % 4, corners[c]);
            const struct gsn_point um = gsn_affine_apply(&s->pose.panel_to_block_um, px);

            CHECK_NEAR(hypot(um.x - corners[c].x, um.y - corners[c].y), 0, 2.4);
        }
    }
    for (unsigned serial = 2; serial < 10; serial++)
        drawn_check_plane(a->densities.grid, serial, DRAWN_DENSITY);
}

TEST(too_few_sections_are_not_laid_by_their_tissue_and_that_is_said)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    drawn_three_panels(panels);
    drawn_specimen_init(&d, BY_TISSUE_JOB, panels, 2);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(!a->poses.refinement.done && strstr(a->poses.refinement.why, "too few sections"));
    CHECK(a->densities.section[0].state == GSN_SECTION_USED);
}

/* Section 5 with marks 2 and 3 only, which could as well be 3 and 2. */
static void leave_two(struct gsn_panel_section *s)
{
    s->mark[0].found = 0;
    s->flags = gsn_flags_of_text("two-marks");
    s->candidates = (struct gsn_candidates){ .count = 2 };
    for (size_t c = 0; c < 2; c++) {
        memcpy(s->candidates.at[c].mark, s->mark, sizeof s->mark);
        s->candidates.at[c].share = c ? 0.2 : 0.8;
    }
    s->candidates.at[1].mark[1] = s->mark[2];
    s->candidates.at[1].mark[2] = s->mark[1];
}

static void lopsided_panels(struct drawn_panel panels[3])
{
    drawn_three_panels(panels);
    for (unsigned i = 0; i < 12; i++)
        panels[i / 4].section[i % 4].lopsided = 1;
}

static double off_um(const struct gsn_section *s)
{
    const struct drawn_panel panel = drawn_panel_of(2, 24, DRAWN_DENSITY);
    const struct gsn_point corners[3] = { { 0, 0 }, { 600, 300 }, { -500, 500 } };
    double most = 0;

    for (size_t c = 0; c < 3; c++) {
        const struct gsn_point um =
            gsn_affine_apply(&s->pose.panel_to_block_um, drawn_panel_place(&panel, 1, corners[c]));

        most = fmax(most, hypot(um.x - corners[c].x, um.y - corners[c].y));
    }
    return most;
}

/* Section 5 shows marks where they were burnt, of the ones in this set, and no others. */
static void check_burnt(const struct gsn_reconstruction *a, unsigned marks)
{
    const struct gsn_fiducial *mark = a->densities.marks[5].mark;
    const struct drawn_panel panel = drawn_panel_of(2, 24, DRAWN_DENSITY);

    for (unsigned m = 0; m < GSN_FIDUCIALS; m++) {
        const struct gsn_point at = drawn_panel_place(&panel, 1, drawn_marks_um[m]);

        CHECK(mark[m].found == (int)(marks >> m & 1));
        if (mark[m].found)
            CHECK_NEAR(hypot(mark[m].px.x - at.x, mark[m].px.y - at.y), 0, 0.5);
    }
}

/* One mark lays nothing; where the tissue does, it is known for what it is. */
TEST(marks_of_a_section_that_its_tissue_lays_are_those_where_it_puts_them)
{
    for (unsigned burnt = 0; burnt <= 4; burnt = burnt ? 4 * burnt : 1) {
        struct drawn_panel panels[3];

        lopsided_panels(panels);
        panels[1].section[1].no_marks = 7 & ~burnt;
        gsn_auto(gsn_reconstruction) a = drawn_assembly_from(panels);
        const struct gsn_section *laid = &a->poses.section[5];

        CHECK(laid->state == GSN_SECTION_DOUBTFUL &&
              gsn_flags_has(&laid->flags, GSN_FLAG_BY_TISSUE));
        check_burnt(a, burnt);
        CHECK_NEAR(off_um(laid), 0, 60);
    }
}

/* Case 20: what two marks leave open, the tissue settles; a person's choice it does not touch. */
TEST(two_marks_that_the_tissue_contradicts_are_not_taken_for_marks)
{
    for (unsigned swapped = 0; swapped < 2; swapped++)
        for (unsigned chosen = 0; chosen < 2; chosen++) {
            struct drawn_panel panels[3];
            drawn_auto d;

            lopsided_panels(panels);
            drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
            struct gsn_panel_section *s = &d.findings[1]->section[1];
            const struct gsn_fiducial second = s->mark[1];

            if (swapped) {
                s->mark[1] = s->mark[2];
                s->mark[2] = second;
            }
            leave_two(s);
            s->candidates.chosen = chosen;
            gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);
            const struct gsn_section *laid = &a->poses.section[5];
            const int corrected = swapped && !chosen;

            CHECK(laid->state == (chosen ? GSN_SECTION_USED : GSN_SECTION_DOUBTFUL));
            CHECK(gsn_flags_has(&laid->flags, GSN_FLAG_BY_TISSUE) == corrected);
            CHECK(gsn_flags_has(&laid->flags, GSN_FLAG_TURNED) == (swapped && chosen));
            if (corrected)
                check_burnt(a, 7);
            if (!swapped || corrected)
                CHECK_NEAR(off_um(laid), 0, 60);
            else
                CHECK(off_um(laid) > 600);
        }
}

/* Spots of section 5 that lie as its marks would if it were face down. */
static void mistake_marks(const struct drawn_panel *panel, struct gsn_panel_section *s)
{
    for (size_t m = 0; m < GSN_FIDUCIALS; m++)
        s->mark[m].px = drawn_panel_place(
            panel, 1, (struct gsn_point){ -drawn_marks_um[m].x, drawn_marks_um[m].y });
}

/* Three spots that fit the triangle, which the tissue contradicts: without a person's word they are
 * no marks, and a person may choose from them. */
TEST(three_marks_that_the_tissue_contradicts_do_not_lay_a_section)
{
    for (unsigned chosen = 0; chosen < 2; chosen++) {
        struct drawn_panel panels[3];
        drawn_auto d;

        lopsided_panels(panels);
        drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
        mistake_marks(&panels[1], &d.findings[1]->section[1]);
        if (chosen)
            d.findings[1]->section[1].candidates.chosen = 4;
        gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);
        const struct gsn_section *laid = &a->poses.section[5];

        CHECK(laid->state == (chosen ? GSN_SECTION_USED : GSN_SECTION_DOUBTFUL));
        CHECK((strstr(text_of(&laid->flags).text, "tissue-disagrees by-tissue") != NULL) ==
              !chosen);
        CHECK(laid->pose.flipped == (int)chosen &&
              (gsn_flags_has(&laid->flags, GSN_FLAG_FLIPPED) != 0) == chosen);
        if (chosen)
            continue;
        check_burnt(a, 7);
        CHECK(laid->finding.contradicted && laid->finding.other_face);
        CHECK(laid->candidates.count == 4 && laid->candidates.at[3].laid);
        CHECK_NEAR(off_um(laid), 0, 60);
        for (size_t i = 0; i < a->poses.section_count; i++)
            CHECK(a->poses.section[i].finding.contradicted == (i == 5));
    }
}

/* Section 5 with no marks told, and marks 2 and 3, or 3 and 2, or other spots, to choose from. */
static void leave_open(const struct drawn_panel *panel, struct gsn_panel_section *s, int rivals)
{
    struct gsn_fiducial second = { .radius_px = 3, .score = 0.9, .found = 1 }, third = second;

    second.px = drawn_panel_place(panel, 1, drawn_marks_um[1]);
    third.px = drawn_panel_place(panel, 1, drawn_marks_um[2]);

    leave_two(s);
    s->sighting = GSN_SIGHT_NEEDS_EYE;
    s->flags = gsn_flags_of_text("ambiguous-marks");
    memset(s->mark, 0, sizeof s->mark);
    s->candidates.at[0].mark[1] = third;
    s->candidates.at[0].mark[2] = second;
    s->candidates.at[1].mark[1] = second;
    s->candidates.at[1].mark[2] = third;
    if (rivals == 1)
        s->candidates.count = 1;
    /* A spot beside mark 3 makes much the same pose. */
    if (rivals == 3) {
        s->candidates.at[2] = s->candidates.at[1];
        s->candidates.at[2].mark[2].px.x += 3;
        s->candidates.count = 3;
    }
}

/* Of spots that could be other marks, the tissue names those that lay the section as it does, and
 * none where no candidate does or more than one. The picture shows none of them by itself. */
TEST(marks_that_could_be_others_are_named_where_the_tissue_says_which)
{
    for (int rivals = 1; rivals <= 3; rivals++) {
        struct drawn_panel panels[3];
        drawn_auto d;

        lopsided_panels(panels);
        panels[1].section[1].no_marks = 7;
        drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
        leave_open(&panels[1], &d.findings[1]->section[1], rivals);
        gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);
        const struct gsn_section *laid = &a->poses.section[5];

        CHECK(laid->state == GSN_SECTION_DOUBTFUL &&
              gsn_flags_has(&laid->flags, GSN_FLAG_BY_TISSUE));
        CHECK_NEAR(off_um(laid), 0, 60);
        check_burnt(a, rivals == 2 ? 6 : 0);
    }
}

#define ALONE_JOB(more)                                                                            \
    "{\"specimen\": \"drawn\", \"px_um\": 24, \"layout\": [2, 2], \"panels\": 3, \"transfer\": "   \
    "\"linear\", \"registration\": \"tissue\"" more "}"

/* In the picture of the second panel, um: about the middle of the section in its second slot. */
#define ALONE_REGION                                                                               \
    ", \"frame\": [2, 2], \"region\": {\"shape\": \"cylinder\", \"centre\": [3900, 1300], "        \
    "\"radius\": 300, \"z\": [48, 240]}"

/* No marks anywhere; mounted at any angle, two of them face down. */
static void unmarked_panels(struct drawn_panel panels[3])
{
    drawn_three_panels(panels);
    for (unsigned i = 0; i < 12; i++) {
        struct drawn_section *s = &panels[i / 4].section[i % 4];

        s->no_marks = 7;
        s->lopsided = 1;
        s->grain = i + 1;
        s->turn_deg += 37 * i;
        s->flipped = i == 3 || i == 8;
    }
}

/* How far, root mean square, the poses lay points of a section from where its truth and that of the
 * frame do. */
static double off_frame(const struct drawn_panel panels[3], unsigned frame, unsigned i,
                        const struct gsn_affine *panel_to_block)
{
    static const struct gsn_point at[] = { { 0, 0 }, { 500, -300 }, { -500, 300 }, { -300, -500 } };
    double sum = 0;

    for (size_t k = 0; k < 4; k++) {
        const struct gsn_point px = drawn_panel_place(&panels[i / 4], i % 4, at[k]);
        const struct gsn_point there = drawn_panel_place(&panels[frame / 4], frame % 4, at[k]);
        const struct gsn_point um = gsn_affine_apply(panel_to_block, px);

        sum += (pow(um.x - 24 * there.x, 2) + pow(um.y - 24 * there.y, 2)) / 4;
    }
    return sqrt(sum);
}

/* No triangle, no stated marks: the frame is the picture of the section that the job names. */
TEST(panels_without_marks_are_laid_by_tissue_in_the_frame_of_one_section)
{
    struct drawn_panel panels[3];
    double square = 0, told = 0;
    drawn_auto d;

    unmarked_panels(panels);
    drawn_specimen_init(&d, ALONE_JOB(ALONE_REGION), panels, 3);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->poses.solved && a->poses.by_tissue.done && a->poses.by_tissue.frame == 5);
    for (unsigned i = 0; i < 12; i++) {
        const struct gsn_section *s = &a->poses.section[i];
        const double off = off_frame(panels, 5, i, &s->pose.panel_to_block_um);

        CHECK(s->state == GSN_SECTION_USED && s->posed && s->candidates.count == 0);
        CHECK(!s->seen.mark[0].found && !s->seen.mark[1].found && !s->seen.mark[2].found);
        CHECK(s->pose.flipped == (i == 3 || i == 8));
        CHECK_NEAR(off, 0, 6);
        CHECK(i == 5 ? s->pose.tre_um < 0.1 && off < 1e-3 : s->pose.tre_um > 0.3);
        square += off * off / 11;
        told += s->pose.tre_um * s->pose.tre_um / 11;
    }
    print_message("  %.1f um off, %.1f predicted\n", sqrt(square), sqrt(told));
    CHECK(sqrt(told) > 0.5 * sqrt(square) && sqrt(told) < 2 * sqrt(square));
    CHECK(a->densities.grid && gsn_mask_count(a->region) > 0);
}

/* Without coordinates nobody needs to name a section: the middle one is the frame. */
TEST(a_region_by_tissue_needs_no_frame)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    unmarked_panels(panels);
    drawn_specimen_init(&d,
                        ALONE_JOB(", \"region\": {\"kind\": \"band\", \"from\": \"tissue\", "
                                  "\"low_um\": -100000, \"high_um\": 0}"),
                        panels, 3);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->poses.by_tissue.done && a->poses.by_tissue.frame == 6 && a->region &&
          !a->no_region[0]);
    for (unsigned i = 0; i < 12; i++)
        CHECK_NEAR(off_frame(panels, 6, i, &a->poses.section[i].pose.panel_to_block_um), 0, 48);
}

TEST(a_frame_that_shows_no_tissue_withholds_the_stack)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    unmarked_panels(panels);
    panels[1].section[1].missing = 1;
    drawn_specimen_init(&d, ALONE_JOB(ALONE_REGION), panels, 3);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(!a->poses.solved && !a->poses.by_tissue.done && !a->densities.grid);
    CHECK(strstr(a->poses.unsolved, "panel 2, slot 2") && strstr(a->poses.unsolved, "\"frame\""));
}

/* The tissue of a section that is missing between two is no way between them. */
TEST(a_section_that_is_missing_leaves_a_gap_in_a_stack_by_tissue)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    unmarked_panels(panels);
    panels[2].section[0].missing = 1;
    drawn_specimen_init(&d, ALONE_JOB(ALONE_REGION), panels, 3);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->densities.section[8].state == GSN_SECTION_MISSING &&
          a->densities.section[9].state == GSN_SECTION_USED);
    CHECK_NEAR(off_frame(panels, 5, 9, &a->poses.section[9].pose.panel_to_block_um), 0, 48);
}

TEST(marks_alone_leave_to_nobody_what_they_do_not_lay)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    lopsided_panels(panels);
    panels[1].section[1].no_marks = 7;
    drawn_specimen_init(&d,
                        "{\"specimen\": \"drawn\", \"registration\": \"marks\", " DRAWN_JOB_HEAD
                        ", \"region\": " DRAWN_REGION "}",
                        panels, 3);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->poses.solved && a->densities.section[5].state == GSN_SECTION_HELD &&
          !a->poses.section[5].posed);
    CHECK(a->densities.section[4].state == GSN_SECTION_USED &&
          a->poses.section[4].finding.compared == 0);
}

/* What to state is said where marks are asked for and none are there. */
TEST(a_stack_without_marks_says_how_it_can_be_laid)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    unmarked_panels(panels);
    drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(!a->poses.solved && strstr(a->poses.unsolved, "\"registration\": \"tissue\""));
}

TEST(running_out_of_memory_while_a_stack_is_laid_by_tissue_leaks_nothing)
{
    struct drawn_panel panels[3];
    struct gsn_error err = { 0 };
    drawn_auto d;

    unmarked_panels(panels);
    drawn_specimen_init(&d, ALONE_JOB(ALONE_REGION), panels, 2);
    CHECK_MANY_OOM(drawn_assemble_once(&d, &err), err, 1, 6);
}

TEST(running_out_of_memory_while_tissue_is_compared_leaks_nothing)
{
    struct gsn_error err = { 0 };
    drawn_auto d;

    drawn_specimen_even(&d, BY_TISSUE_JOB, DRAWN_DENSITY);
    CHECK_MANY_OOM(drawn_assemble_once(&d, &err), err, 1, 8);
}

TEST(running_out_of_memory_while_marks_are_looked_for_again_leaks_nothing)
{
    struct drawn_panel panels[3];
    struct gsn_error err = { 0 };
    drawn_auto d;

    lopsided_panels(panels);
    panels[1].section[1].no_marks = 6;
    drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
    CHECK_MANY_OOM(drawn_assemble_once(&d, &err), err, 1, 12);
}
