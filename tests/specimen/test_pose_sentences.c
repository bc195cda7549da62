/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/report_builder.h"

#include "pipeline/register/pose/pose.h"
#include "pipeline/register/pose/strain.h"
#include "tests/check.h"

#include <string.h>

static const struct gsn_pose_summary CLEAN = { .flips_told = 1, .scale_vs_declared = 1 };

static const struct gsn_strain_common SQUARE;

static int said_of(const struct gsn_pose_summary *summary, const struct gsn_strain_common *panel,
                   enum gsn_strain_mode mode, const char *words)
{
    char sentence[GSN_POSE_SENTENCES][GSN_POSE_SENTENCE];
    const size_t count = gsn_pose_sentences(summary, panel, mode, 24, sentence);
    int found = 0;

    for (size_t i = 0; i < count; i++)
        found += strstr(sentence[i], words) != NULL;
    return found;
}

static int said(const struct gsn_pose_summary *summary, const char *words)
{
    return said_of(summary, &SQUARE, GSN_STRAIN_REPORTED, words);
}

TEST(a_clean_stack_has_nothing_to_say)
{
    char sentence[GSN_POSE_SENTENCES][GSN_POSE_SENTENCE];

    CHECK(gsn_pose_sentences(&CLEAN, &SQUARE, GSN_STRAIN_REPORTED, 24, sentence) == 0);
}

/* Case 18. */
TEST(a_block_that_tells_no_flips_says_so_once)
{
    struct gsn_pose_summary s = CLEAN;

    s.flips_told = 0;
    s.isosceles_sigma = 6.5;
    CHECK(said(&s, "flip not detectable on this block") == 1);
    CHECK(said(&s, "differ by only 6.5 sigma") == 1);
}

/* Case 14. */
TEST(a_wrong_pixel_size_is_named)
{
    struct gsn_pose_summary s = CLEAN;

    s.scale_vs_declared = 1.1;
    CHECK(said(&s, "1.10 times the declared one: the pixel size is wrong") == 1);
}

/* Case 24. */
TEST(slanted_axes_are_told_per_mm_and_what_cannot_be_seen_too)
{
    struct gsn_pose_summary s = CLEAN;

    s.axes = (struct gsn_axes){ .slanted = 1,
                                .slope = { { 0.24, 0 }, { 0, 0.48 }, { -0.12, 0 } },
                                .slope_sd = 0.012 };
    CHECK(said(&s, "move by 10.0, 20.0 and 5.0 um for each mm of depth (standard deviation 0.5)"));
    CHECK(said(&s, "no section can show it") == 1);
    CHECK(said(&s, "are bent") == 0);
    s.axes.bent = 1;
    s.axes.bend[1].x = 33;
    CHECK(said(&s, "0, 33 and 0 um farther off at the ends") == 1);
}

/* Case 15. */
TEST(pixels_that_are_not_square_are_the_devices_fault)
{
    struct gsn_strain_common panel = { .anisotropic = 1, .along_x = 0.012, .sd = 0.001 };

    CHECK(said_of(&CLEAN, &panel, GSN_STRAIN_RIGID,
                  "1.2 % longer along the scan's x than along its y (standard deviation 0.1 %), "
                  "whichever way they are turned: the scan's pixels are not square") == 1);
    panel.from_declared = 1;
    CHECK(said_of(&CLEAN, &panel, GSN_STRAIN_RIGID, "measured on the declared triangle") == 1);
}

/* Case 47. */
TEST(what_becomes_of_strain_is_said_unless_the_job_says_rigid)
{
    struct gsn_pose_summary s = CLEAN;

    s.stretches = 1;
    s.strain_sd[0] = 0.008;
    s.strain_sd[1] = 0.002;
    CHECK(said(&s, "standard deviation 0.8 % in size and 0.4 % between directions. The poses stay "
                   "rigid") == 1);
    CHECK(said_of(&s, &SQUARE, GSN_STRAIN_CORRECTED, "was stretched back") == 1);
    CHECK(said_of(&s, &SQUARE, GSN_STRAIN_TISSUE, "was stretched back") == 1);
    CHECK(said_of(&s, &SQUARE, GSN_STRAIN_RIGID, "differ in shape") == 0);
    CHECK(said_of(&s, &SQUARE, GSN_STRAIN_TISSUE, "what they share against") == 0);
    s.as_declared = 1;
    CHECK(said_of(&s, &SQUARE, GSN_STRAIN_TISSUE, "what they share against the declared") == 1);
    CHECK(said_of(&s, &SQUARE, GSN_STRAIN_REPORTED, "what they share against") == 0);
}

TEST(what_became_of_sections_to_be_laid_by_tissue_is_said_with_their_areas)
{
    struct gsn_refinement r = { .done = 1,
                                .sections = 54,
                                .compared = 52,
                                .radius_um = 1200,
                                .moved_um = 9.6,
                                .area_mean = -0.0012,
                                .area_sd = 0.004,
                                .factor = { 1.1, 1 } };
    char sentence[GSN_POSE_SENTENCE];

    gsn_refinement_sentence(&r, sentence);
    CHECK(
        strstr(sentence, "52 of 54 were compared with up to four on either side, within 1200 um"));
    CHECK(strstr(sentence, "moved by 9.6 um (root mean square over the region)"));
    CHECK(strstr(sentence, "areas by -0.12 % (standard deviation 0.40 %)"));
    CHECK(strstr(sentence, "A slant of the tissue over many sections is left to the marks"));
    r = (struct gsn_refinement){ .why = "there are too few sections" };
    gsn_refinement_sentence(&r, sentence);
    CHECK(strstr(sentence, "were not laid by their tissue as the job asks: there are too few "
                           "sections. They lie as their marks have them"));
}

TEST(a_contradicting_section_names_its_three_poses)
{
    const struct gsn_pose pose = { .state = GSN_POSE_OK,
                                   .gross = 1,
                                   .candidate = { { .share = 0.02, .tre_um = 14 },
                                                  { .share = 0.9, .tre_um = 12 },
                                                  { .share = 0.08, .tre_um = 19 } } };
    char sentence[GSN_POSE_SENTENCE];

    gsn_pose_reason(&pose, sentence);
    CHECK(strstr(sentence, "do not fit the stack's triangle"));
    CHECK(strstr(sentence, "without mark 1 (2 % likely by the marks, predicted error 14 um)"));
    CHECK(strstr(sentence, "without mark 2 (90 %, 12 um), without mark 3 (8 %, 19 um)"));
    gsn_pose_reason(&(struct gsn_pose){ .state = GSN_POSE_TWO_MARKS, .gross = 1 }, sentence);
    CHECK(strstr(sentence, "its two marks are not as far apart"));
}

TEST(a_section_that_the_tissue_contradicts_says_how_far_and_what_became_of_it)
{
    struct gsn_section section = {
        .panel = 2,
        .seen = { .serial = 16, .slot = 3 },
        .finding = { .contradicted = 1, .other_face = 1, .apart = 2887, .limit = 568 }
    };
    char sentence[GSN_POSE_SENTENCE];

    gsn_tissue_sentence(&section, GSN_SECTION_DOUBTFUL, sentence);
    CHECK(strstr(sentence, "section 2.4: what looks like its marks lays it 2887 um "
                           "from where the tissue of its neighbours does, and with the other face "
                           "up; up to 568 um would be usual here. It was laid by the tissue:"));
    section.finding.other_face = 0;
    gsn_tissue_sentence(&section, GSN_SECTION_HELD, sentence);
    CHECK(strstr(sentence, "neighbours does; up to 568 um"));
    CHECK(strstr(sentence, "The tissue alone does not lay it, so it is held: look at it"));
}
