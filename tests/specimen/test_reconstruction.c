/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/reconstruction.h"

#include "tests/specimen/flags.h"
#include "tests/check.h"
#include "tests/specimen/drawn_assembly.h"
#include "tests/specimen/often.h"

#include <stdio.h>
#include <string.h>

TEST(every_section_lies_where_it_was_cut)
{
    struct drawn_panel panels[3];

    drawn_three_panels(panels);
    panels[1].section[2].flipped = 1;
    panels[2].section[1].turn_deg += 180;
    gsn_auto(gsn_reconstruction) a = drawn_assembly_from(panels);

    CHECK(a->poses.solved && a->poses.section_count == 12 && a->densities.panel_count == 3);
    CHECK(a->poses.unsolved[0] == '\0');
    for (unsigned i = 0; i < 12; i++) {
        const struct gsn_section *s = &a->poses.section[i];
        const struct gsn_point corners[3] = { { 0, 0 }, { 600, 300 }, { -500, 500 } };

        CHECK(s->state == GSN_SECTION_USED && s->posed && s->seen.serial == i);
        CHECK(s->pose.flipped == (i == 6) && s->pose.rotated180 == (i == 9));
        CHECK(gsn_flags_has(&s->flags, GSN_FLAG_FLIPPED) == (i == 6));
        CHECK(gsn_flags_has(&s->flags, GSN_FLAG_TURNED) == (i == 9));
        for (size_t c = 0; c < 3; c++) {
            const struct gsn_point px = drawn_panel_place(&panels[i / 4], i % 4, corners[c]);
            const struct gsn_point um = gsn_affine_apply(&s->pose.panel_to_block_um, px);

            CHECK_NEAR(hypot(um.x - corners[c].x, um.y - corners[c].y), 0, 2.4);
        }
    }
}

TEST(every_plane_holds_the_density_of_its_own_section)
{
    struct drawn_panel panels[3];

    drawn_three_panels(panels);
    for (unsigned i = 0; i < 12; i++)
        panels[i / 4].section[i % 4].density = 0.5 + 0.03 * i;
    gsn_auto(gsn_reconstruction) a = drawn_assembly_from(panels);

    /* The region begins at plane 2 and ends with plane 9; one more on either side is shown. */
    CHECK(a->densities.grid->at.nz == 10);
    CHECK_NEAR(a->densities.grid->at.origin_um.z, 36, 1e-9);
    for (unsigned serial = 1; serial <= 10; serial++) {

        drawn_check_plane(a->densities.grid, serial, 0.5 + 0.03 * serial);
    }
    CHECK(gsn_mask_count(a->region) == 24 * 14 * 8);
}

TEST(a_gap_stays_a_gap)
{
    struct drawn_panel panels[3];

    drawn_three_panels(panels);
    panels[1].section[1].missing = 1;
    gsn_auto(gsn_reconstruction) a = drawn_assembly_from(panels);

    CHECK(a->densities.section[5].state == GSN_SECTION_MISSING && !a->poses.section[5].posed);
    drawn_check_gap(a->densities.grid, 5);
    drawn_check_plane(a->densities.grid, 4, DRAWN_DENSITY);
    drawn_check_plane(a->densities.grid, 6, DRAWN_DENSITY);
    CHECK(a->densities.section[5].thumbnail.size == 0 &&
          a->densities.section[6].thumbnail.size > 0);
}

TEST(a_section_with_one_mark_is_held_and_one_with_two_is_used_with_doubt)
{
    struct drawn_panel panels[3];

    drawn_three_panels(panels);
    panels[0].section[3].no_marks = 6;
    panels[1].section[3].no_marks = 2;
    gsn_auto(gsn_reconstruction) a = drawn_assembly_from(panels);

    CHECK(a->densities.section[3].state == GSN_SECTION_HELD && !a->poses.section[3].posed);
    drawn_check_gap(a->densities.grid, 3);
    CHECK(a->densities.section[7].state == GSN_SECTION_DOUBTFUL && a->poses.section[7].posed);
    drawn_check_plane(a->densities.grid, 7, DRAWN_DENSITY);
    CHECK(a->densities.section[3].thumbnail.size > 0);
}

/* Cases 17 and 20: two marks say nothing of mirroring, so what the tissue said decides. */
TEST(a_flipped_section_with_two_marks_is_laid_the_right_way_up)
{
    struct drawn_panel panels[3];

    drawn_three_panels(panels);
    panels[1].section[2].no_marks = 2;
    panels[1].section[2].flipped = 1;
    gsn_auto(gsn_reconstruction) a = drawn_assembly_from(panels);

    CHECK(a->poses.section[6].posed ==
          gsn_flags_has(&a->poses.section[6].seen.flags, GSN_FLAG_TWO_MARKS));
    if (gsn_flags_has(&a->poses.section[6].seen.flags, GSN_FLAG_MIRRORED))
        CHECK(a->poses.section[6].pose.flipped);
}

/* One mark moved by a third of a millimetre: the triangle is another one, so its place is not
 * known, and the char that no mark accounts for is debris. */
TEST(a_section_whose_marks_contradict_the_stack_is_held)
{
    drawn_auto d;

    drawn_specimen_even(&d,
                        "{\"specimen\": \"drawn\", \"registration\": \"marks\", " DRAWN_JOB_HEAD
                        ", \"region\": " DRAWN_REGION "}",
                        DRAWN_DENSITY);
    d.findings[1]->section[0].mark[1].px.x += 14;
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->densities.section[4].state == GSN_SECTION_HELD);
    CHECK(strcmp(text_of(&a->densities.section[4].flags).text, "residual-too-large debris") == 0);
    drawn_check_gap(a->densities.grid, 4);
    drawn_check_plane(a->densities.grid, 5, DRAWN_DENSITY);
}

/* With tissue it is laid where its neighbours are, and what it shows there is right. */
TEST(a_section_whose_marks_contradict_the_stack_is_laid_by_its_tissue)
{
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DRAWN_DENSITY);
    d.findings[1]->section[0].mark[1].px.x += 14;
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->densities.section[4].state == GSN_SECTION_DOUBTFUL);
    CHECK(strcmp(text_of(&a->densities.section[4].flags).text,
                 "residual-too-large by-tissue debris") == 0);
    drawn_check_plane(a->densities.grid, 4, DRAWN_DENSITY);
}

TEST(a_second_section_of_one_serial_is_held_and_flagged)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    drawn_three_panels(panels);
    panels[1].section[0].density = 0.4;
    drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
    d.findings[1]->section[0].serial = 2;
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->poses.section[2].seen.serial == 2 && a->poses.section[2].panel == 1);
    CHECK(a->densities.section[2].state == GSN_SECTION_USED);
    CHECK(a->poses.section[3].seen.serial == 2 && a->poses.section[3].panel == 2);
    CHECK(a->densities.section[3].state == GSN_SECTION_HELD);
    CHECK(strcmp(text_of(&a->densities.section[3].flags).text, "duplicate-serial") == 0);
    drawn_check_plane(a->densities.grid, 2, DRAWN_DENSITY);
    drawn_check_gap(a->densities.grid, 4);
}

/* Two marks radii of 75 um lie in the region's corner: nothing is read there. */
TEST(the_halo_of_a_mark_is_masked)
{
    static const char job[] =
        "{\"specimen\": \"x\", " DRAWN_JOB_HEAD ", \"region\": {\"shape\": \"box\", \"min\": "
        "[400, -700, 72], \"max\": [760, -360, 120]}}";
    drawn_auto d;
    size_t inside = 0, outside = 0;

    drawn_specimen_even(&d, job, DRAWN_DENSITY);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);
    const struct gsn_lattice *at = &a->densities.grid->at;

    for (size_t i = 0; i < gsn_lattice_count(at); i++) {
        const struct gsn_vec3 u = gsn_lattice_centre(at, i % at->nx, i / at->nx % at->ny, 0);
        const double r = hypot(u.x - drawn_marks_um[1].x, u.y - drawn_marks_um[1].y);

        if (hypot(u.x / DRAWN_WIDTH_UM, u.y / DRAWN_HEIGHT_UM) > 0.93)
            continue;
        if (r < 120) {
            if (!isnan(a->densities.grid->value[i]))
                fail_msg("%g um from the mark a voxel has a density", r);
            inside++;
        } else if (r > 200) {
            CHECK_NEAR((double)a->densities.grid->value[i], DRAWN_DENSITY * (1 + DRAWN_SLOPE * u.x),
                       0.02);
            outside++;
        }
    }
    CHECK(inside > 100 && outside > 500);
}

TEST(a_block_without_marks_is_unsolved_with_its_reason)
{
    struct drawn_panel panels[3];

    drawn_three_panels(panels);
    for (unsigned i = 0; i < 12; i++)
        panels[i / 4].section[i % 4].no_marks = 7;
    gsn_auto(gsn_reconstruction) a = drawn_assembly_from(panels);

    CHECK(!a->poses.solved && !a->densities.grid && a->poses.unsolved[0] != '\0');
    for (unsigned i = 0; i < 12; i++)
        CHECK(a->densities.section[i].state == GSN_SECTION_HELD);
}

TEST(a_panel_that_is_not_there_leaves_its_slots_missing)
{
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DRAWN_DENSITY);
    d.panel[1].section_count = 0;
    d.panel[1].state = "refused";
    d.panel[1].message = "the file is cut off";
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->poses.section_count == 12 && !a->densities.panel[1].opened &&
          a->densities.panel[2].opened);
    for (unsigned i = 4; i < 8; i++) {
        CHECK(a->densities.section[i].state == GSN_SECTION_MISSING);
        CHECK(strcmp(text_of(&a->densities.section[i].flags).text, "no-panel") == 0 &&
              a->poses.section[i].seen.serial == i);
        drawn_check_gap(a->densities.grid, i);
    }
    drawn_check_plane(a->densities.grid, 8, DRAWN_DENSITY);
}

/* A panel beyond the stated number came: its sections are listed as well. */
TEST(sections_expected_come_from_the_job_and_from_what_came)
{
    drawn_auto d;

    drawn_specimen_even(&d,
                        "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [2, 2], \"sections\": "
                        "10, \"markers_um\": " DRAWN_MARKS_JSON "}",
                        DRAWN_DENSITY);
    d.panel[2].section_count = 0;
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->poses.section_count == 8);
}

TEST(a_panel_whose_bytes_are_gone_stops_the_work)
{
    struct gsn_reconstruction *assembly = NULL;
    struct gsn_error err = { 0 };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DRAWN_DENSITY);
    d.panel[1].sha256 = "none";
    CHECK(gsn_reconstruct(&d.specimen, &DRAWN_OPTIONS, &assembly, &err) == GSN_E_NOTFOUND);
    CHECK(strstr(err.text, "panel 2 (P02.png): ") == err.text && assembly == NULL);
}

TEST(the_number_of_threads_does_not_matter)
{
    const struct gsn_specimen_options two = { .threads = 2 };
    gsn_auto(gsn_reconstruction) other = NULL;
    struct gsn_error err = { 0 };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DRAWN_DENSITY);
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK_OK(gsn_reconstruct(&d.specimen, &two, &other, &err), err);
    CHECK(memcmp(a->densities.grid->value, other->densities.grid->value,
                 gsn_lattice_count(&a->densities.grid->at) * sizeof *a->densities.grid->value) ==
          0);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DRAWN_DENSITY);
    CHECK_MANY_OOM(drawn_assemble_once(&d, &err), err, 40, 20);
}
