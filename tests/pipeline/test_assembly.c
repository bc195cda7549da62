/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly.h"

#include "tests/check.h"
#include "tests/pipeline/drawn_specimen.h"
#include "tests/pipeline/often.h"

#include <stdio.h>
#include <string.h>

static const struct gsn_specimen_options OPTIONS = { .threads = 1 };
static const double DENSITY = 0.8;

static struct gsn_assembly *assembled(const struct drawn_specimen *d)
{
    struct gsn_assembly *assembly = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_assembly_make(&d->specimen, &OPTIONS, &assembly, &err), err);
    return assembly;
}

static struct gsn_assembly *assembled_from(const struct drawn_panel panels[3])
{
    drawn_auto d;

    drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
    return assembled(&d);
}

static void three_panels(struct drawn_panel panels[3])
{
    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, DENSITY);
}

/* Half a code of rounding in 8 bits is up to 0.003 in optical density; unmixing and cubic
 * convolution make at most five times that of it in one voxel, and next to nothing in the mean. */
static const double ROUNDING = 0.015, MEAN_ROUNDING = 0.002;

/* The planes of one section against what was drawn. */
struct plane {
    double filled;      /* share of the voxels with data */
    double worst, mean; /* distance from the drawn density */
};

static struct plane plane_of(const struct gsn_grid *grid, unsigned serial, double density)
{
    const struct gsn_lattice *at = &grid->at;
    struct plane plane = { 0 };
    size_t filled = 0;

    for (size_t i = 0; i < gsn_lattice_count(at); i++) {
        const struct gsn_vec3 u =
            gsn_lattice_centre(at, i % at->nx, i / at->nx % at->ny, i / at->nx / at->ny);
        const double off = (double)grid->value[i] - density * (1 + DRAWN_SLOPE * u.x);

        if (fabs(u.z - 24 * (serial + 0.5)) > 1 || isnan(off))
            continue;
        filled++;
        plane.worst = fmax(plane.worst, fabs(off));
        plane.mean += off;
    }
    plane.mean = filled ? plane.mean / (double)filled : 0;
    plane.filled = (double)filled / (double)(at->nx * at->ny);
    return plane;
}

static void check_plane(const struct gsn_grid *grid, unsigned serial, double density)
{
    const struct plane plane = plane_of(grid, serial, density);

    CHECK_NEAR(plane.filled, 1, 0);
    CHECK_NEAR(plane.worst, 0, ROUNDING);
    CHECK_NEAR(plane.mean, 0, MEAN_ROUNDING);
}

static void check_gap(const struct gsn_grid *grid, unsigned serial)
{
    CHECK_NEAR(plane_of(grid, serial, 0).filled, 0, 0);
}

TEST(every_section_lies_where_it_was_cut)
{
    struct drawn_panel panels[3];

    three_panels(panels);
    panels[1].section[2].flipped = 1;
    panels[2].section[1].turn_deg += 180;
    gsn_auto(gsn_assembly) a = assembled_from(panels);

    CHECK(a->solved && a->section_count == 12 && a->panel_count == 3);
    CHECK(a->unsolved[0] == '\0');
    for (unsigned i = 0; i < 12; i++) {
        const struct gsn_assembly_section *s = &a->section[i];
        const struct gsn_point corners[3] = { { 0, 0 }, { 600, 300 }, { -500, 500 } };

        CHECK(s->state == GSN_SECTION_USED && s->posed && s->seen.serial == i);
        CHECK(s->pose.flipped == (i == 6) && s->pose.rotated180 == (i == 9));
        CHECK((strstr(s->flags, "flipped") != NULL) == (i == 6));
        CHECK((strstr(s->flags, "turned") != NULL) == (i == 9));
        for (size_t c = 0; c < 3; c++) {
            const struct gsn_point px = drawn_panel_place(&panels[i / 4], i % 4, corners[c]);
            const struct gsn_point um = gsn_affine_apply(&s->pose.panel_to_block_um, px);

            CHECK_NEAR(hypot(um.x - corners[c].x, um.y - corners[c].y), 0, 2.4);
        }
    }
}

#define BY_TISSUE_JOB                                                                              \
    "{\"specimen\": \"drawn\", " DRAWN_JOB_HEAD                                                    \
    ", \"strain\": \"tissue\", \"region\": " DRAWN_REGION "}"

/* The drawn tissue is a ramp alike in all sections, and the marks are right: nothing may move them
 * off by more than marks alone would. */
TEST(sections_laid_on_by_their_tissue_lie_where_they_were_cut)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    three_panels(panels);
    panels[1].section[2].flipped = 1;
    panels[2].section[1].turn_deg += 180;
    drawn_specimen_init(&d, BY_TISSUE_JOB, panels, 3);
    gsn_auto(gsn_assembly) a = assembled(&d);

    CHECK(a->strain_mode == GSN_STRAIN_TISSUE && a->refinement.sections == 12);
    CHECK(a->refinement.done && a->refinement.compared > 0 && a->refinement.moved_um < 2.4);
    for (unsigned i = 0; i < 12; i++) {
        const struct gsn_assembly_section *s = &a->section[i];
        const struct gsn_point corners[3] = { { 0, 0 }, { 250, 150 }, { -250, 150 } };

        CHECK(s->pose.flipped == (i == 6) && s->pose.tre_um > 0 && s->pose.tre_um < 24);
        for (size_t c = 0; c < 3; c++) {
            const struct gsn_point px = drawn_panel_place(&panels[i / 4], i % 4, corners[c]);
            const struct gsn_point um = gsn_affine_apply(&s->pose.panel_to_block_um, px);

            CHECK_NEAR(hypot(um.x - corners[c].x, um.y - corners[c].y), 0, 2.4);
        }
    }
    for (unsigned serial = 2; serial < 10; serial++)
        check_plane(a->grid, serial, DENSITY);
}

TEST(too_few_sections_are_not_laid_by_their_tissue_and_that_is_said)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    three_panels(panels);
    drawn_specimen_init(&d, BY_TISSUE_JOB, panels, 2);
    gsn_auto(gsn_assembly) a = assembled(&d);

    CHECK(!a->refinement.done && strstr(a->refinement.why, "too few sections"));
    CHECK(a->section[0].state == GSN_SECTION_USED);
}

TEST(every_plane_holds_the_density_of_its_own_section)
{
    struct drawn_panel panels[3];

    three_panels(panels);
    for (unsigned i = 0; i < 12; i++)
        panels[i / 4].section[i % 4].density = 0.5 + 0.03 * i;
    gsn_auto(gsn_assembly) a = assembled_from(panels);

    /* The region begins at plane 2 and ends with plane 9; one more on either side is shown. */
    CHECK(a->grid->at.nz == 10);
    CHECK_NEAR(a->grid->at.origin_um.z, 36, 1e-9);
    for (unsigned serial = 1; serial <= 10; serial++) {

        check_plane(a->grid, serial, 0.5 + 0.03 * serial);
    }
    CHECK(gsn_mask_count(a->region) == 24 * 14 * 8);
}

TEST(a_gap_stays_a_gap)
{
    struct drawn_panel panels[3];

    three_panels(panels);
    panels[1].section[1].missing = 1;
    gsn_auto(gsn_assembly) a = assembled_from(panels);

    CHECK(a->section[5].state == GSN_SECTION_MISSING && !a->section[5].posed);
    check_gap(a->grid, 5);
    check_plane(a->grid, 4, DENSITY);
    check_plane(a->grid, 6, DENSITY);
    CHECK(a->section[5].thumbnail.size == 0 && a->section[6].thumbnail.size > 0);
}

TEST(a_section_with_one_mark_is_held_and_one_with_two_is_used_with_doubt)
{
    struct drawn_panel panels[3];

    three_panels(panels);
    panels[0].section[3].no_marks = 6;
    panels[1].section[3].no_marks = 2;
    gsn_auto(gsn_assembly) a = assembled_from(panels);

    CHECK(a->section[3].state == GSN_SECTION_HELD && !a->section[3].posed);
    check_gap(a->grid, 3);
    CHECK(a->section[7].state == GSN_SECTION_DOUBTFUL && a->section[7].posed);
    check_plane(a->grid, 7, DENSITY);
    CHECK(a->section[3].thumbnail.size > 0);
}

/* Cases 17 and 20: two marks say nothing of mirroring, so what the tissue said decides. */
TEST(a_flipped_section_with_two_marks_is_laid_the_right_way_up)
{
    struct drawn_panel panels[3];

    three_panels(panels);
    panels[1].section[2].no_marks = 2;
    panels[1].section[2].flipped = 1;
    gsn_auto(gsn_assembly) a = assembled_from(panels);

    CHECK(a->section[6].posed == (strstr(a->section[6].seen.flags, "two-marks") != NULL));
    if (strstr(a->section[6].seen.flags, "mirrored"))
        CHECK(a->section[6].pose.flipped);
}

/* Section 5 with marks 2 and 3 only, which could as well be 3 and 2. */
static void leave_two(struct gsn_panel_section *s)
{
    s->mark[0].found = 0;
    (void)snprintf(s->flags, sizeof s->flags, "two-marks");
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
    three_panels(panels);
    for (unsigned i = 0; i < 12; i++)
        panels[i / 4].section[i % 4].lopsided = 1;
}

static double off_um(const struct gsn_assembly_section *s)
{
    const struct drawn_panel panel = drawn_panel_of(2, 24, DENSITY);
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
static void check_burnt(const struct gsn_assembly_section *s, unsigned marks)
{
    const struct drawn_panel panel = drawn_panel_of(2, 24, DENSITY);

    for (unsigned m = 0; m < GSN_MARKS; m++) {
        const struct gsn_point at = drawn_panel_place(&panel, 1, drawn_marks_um[m]);

        CHECK(s->seen.mark[m].found == (int)(marks >> m & 1));
        if (s->seen.mark[m].found)
            CHECK_NEAR(hypot(s->seen.mark[m].px.x - at.x, s->seen.mark[m].px.y - at.y), 0, 0.5);
    }
}

/* One mark lays nothing; where the tissue does, it is known for what it is. */
TEST(marks_of_a_section_that_its_tissue_lays_are_those_where_it_puts_them)
{
    for (unsigned burnt = 0; burnt <= 4; burnt = burnt ? 4 * burnt : 1) {
        struct drawn_panel panels[3];

        lopsided_panels(panels);
        panels[1].section[1].no_marks = 7 & ~burnt;
        gsn_auto(gsn_assembly) a = assembled_from(panels);
        const struct gsn_assembly_section *laid = &a->section[5];

        CHECK(laid->state == GSN_SECTION_DOUBTFUL && strstr(laid->flags, "by-tissue"));
        check_burnt(laid, burnt);
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
            const struct gsn_mark second = s->mark[1];

            if (swapped) {
                s->mark[1] = s->mark[2];
                s->mark[2] = second;
            }
            leave_two(s);
            s->candidates.chosen = chosen;
            gsn_auto(gsn_assembly) a = assembled(&d);
            const struct gsn_assembly_section *laid = &a->section[5];
            const int corrected = swapped && !chosen;

            CHECK(laid->state == (chosen ? GSN_SECTION_USED : GSN_SECTION_DOUBTFUL));
            CHECK((strstr(laid->flags, "by-tissue") != NULL) == corrected);
            CHECK((strstr(laid->flags, "turned") != NULL) == (swapped && chosen));
            if (corrected)
                check_burnt(laid, 7);
            if (!swapped || corrected)
                CHECK_NEAR(off_um(laid), 0, 60);
            else
                CHECK(off_um(laid) > 600);
        }
}

/* Spots of section 5 that lie as its marks would if it were face down. */
static void mistake_marks(const struct drawn_panel *panel, struct gsn_panel_section *s)
{
    for (size_t m = 0; m < GSN_MARKS; m++)
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
        gsn_auto(gsn_assembly) a = assembled(&d);
        const struct gsn_assembly_section *laid = &a->section[5];

        CHECK(laid->state == (chosen ? GSN_SECTION_USED : GSN_SECTION_DOUBTFUL));
        CHECK((strstr(laid->flags, "tissue-disagrees by-tissue") != NULL) == !chosen);
        CHECK(laid->pose.flipped == (int)chosen &&
              (strstr(laid->flags, "flipped") != NULL) == chosen);
        if (chosen)
            continue;
        check_burnt(laid, 7);
        CHECK(laid->finding.contradicted && laid->finding.other_face);
        CHECK(laid->candidates.count == 4 && laid->candidates.at[3].laid);
        CHECK_NEAR(off_um(laid), 0, 60);
        for (size_t i = 0; i < a->section_count; i++)
            CHECK(a->section[i].finding.contradicted == (i == 5));
    }
}

/* Section 5 with no marks told, and marks 2 and 3, or 3 and 2, or other spots, to choose from. */
static void leave_open(const struct drawn_panel *panel, struct gsn_panel_section *s, int rivals)
{
    struct gsn_mark second = { .radius_px = 3, .score = 0.9, .found = 1 }, third = second;

    second.px = drawn_panel_place(panel, 1, drawn_marks_um[1]);
    third.px = drawn_panel_place(panel, 1, drawn_marks_um[2]);

    leave_two(s);
    s->sighting = GSN_SIGHT_NEEDS_EYE;
    (void)snprintf(s->flags, sizeof s->flags, "ambiguous-marks");
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
        gsn_auto(gsn_assembly) a = assembled(&d);
        const struct gsn_assembly_section *laid = &a->section[5];

        CHECK(laid->state == GSN_SECTION_DOUBTFUL && strstr(laid->flags, "by-tissue"));
        CHECK_NEAR(off_um(laid), 0, 60);
        check_burnt(laid, rivals == 2 ? 6 : 0);
    }
}

/* One mark moved by a third of a millimetre: the triangle is another one, so its place is not
 * known, and the char that no mark accounts for is debris. */
TEST(a_section_whose_marks_contradict_the_stack_is_held)
{
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DENSITY);
    d.findings[1]->section[0].mark[1].px.x += 14;
    gsn_auto(gsn_assembly) a = assembled(&d);

    CHECK(a->section[4].state == GSN_SECTION_HELD);
    CHECK(strcmp(a->section[4].flags, "residual-too-large debris") == 0);
    check_gap(a->grid, 4);
    check_plane(a->grid, 5, DENSITY);
}

TEST(a_second_section_of_one_serial_is_held_and_flagged)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    three_panels(panels);
    panels[1].section[0].density = 0.4;
    drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
    d.findings[1]->section[0].serial = 2;
    gsn_auto(gsn_assembly) a = assembled(&d);

    CHECK(a->section[2].seen.serial == 2 && a->section[2].panel == 1);
    CHECK(a->section[2].state == GSN_SECTION_USED);
    CHECK(a->section[3].seen.serial == 2 && a->section[3].panel == 2);
    CHECK(a->section[3].state == GSN_SECTION_HELD);
    CHECK(strcmp(a->section[3].flags, "duplicate-serial") == 0);
    check_plane(a->grid, 2, DENSITY);
    check_gap(a->grid, 4);
}

/* Two marks radii of 75 um lie in the region's corner: nothing is read there. */
TEST(the_halo_of_a_mark_is_masked)
{
    static const char job[] =
        "{\"specimen\": \"x\", " DRAWN_JOB_HEAD ", \"region\": {\"shape\": \"box\", \"min\": "
        "[400, -700, 72], \"max\": [760, -360, 120]}}";
    drawn_auto d;
    size_t inside = 0, outside = 0;

    drawn_specimen_even(&d, job, DENSITY);
    gsn_auto(gsn_assembly) a = assembled(&d);
    const struct gsn_lattice *at = &a->grid->at;

    for (size_t i = 0; i < gsn_lattice_count(at); i++) {
        const struct gsn_vec3 u = gsn_lattice_centre(at, i % at->nx, i / at->nx % at->ny, 0);
        const double r = hypot(u.x - drawn_marks_um[1].x, u.y - drawn_marks_um[1].y);

        if (hypot(u.x / DRAWN_WIDTH_UM, u.y / DRAWN_HEIGHT_UM) > 0.93)
            continue;
        if (r < 120) {
            if (!isnan(a->grid->value[i]))
                fail_msg("%g um from the mark a voxel has a density", r);
            inside++;
        } else if (r > 200) {
            CHECK_NEAR((double)a->grid->value[i], DENSITY * (1 + DRAWN_SLOPE * u.x), 0.02);
            outside++;
        }
    }
    CHECK(inside > 100 && outside > 500);
}

TEST(a_region_is_the_same_as_a_mask_and_as_a_shape)
{
    drawn_auto d;
    struct gsn_error err = { 0 };
    gsn_auto(gsn_mask) mask = NULL;
    const struct gsn_lattice lattice = { .nx = 40,
                                         .ny = 40,
                                         .nz = 12,
                                         .origin_um = { 12 - 20 * 24, 12 - 20 * 24, 12 },
                                         .step_um = { 24, 24, 24 } };

    drawn_specimen_even(&d, DRAWN_JOB, DENSITY);
    CHECK_OK(gsn_region_raster(&d.protocol->region, &lattice, &mask, &err), err);
    gsn_auto(gsn_assembly) shape = assembled(&d);

    d.specimen.region = mask;
    gsn_auto(gsn_assembly) same = assembled(&d);

    CHECK(gsn_mask_count(shape->region) == gsn_mask_count(same->region));
    for (size_t z = 0; z < shape->grid->at.nz; z++)
        for (size_t y = 0; y < shape->grid->at.ny; y++)
            for (size_t x = 0; x < shape->grid->at.nx; x++) {
                const struct gsn_vec3 u = gsn_lattice_centre(&shape->grid->at, x, y, z);

                CHECK(gsn_mask_has(shape->region, u) == gsn_mask_has(same->region, u));
            }
    /* Half a voxel lies between the two rasters; the densities are those that were drawn. */
    for (unsigned serial = 2; serial < 10; serial++) {

        check_plane(same->grid, serial, DENSITY);
    }
}

TEST(a_region_that_is_not_in_the_block_is_refused)
{
    static const struct {
        const char *region, *says;
    } cases[] = {
        { "{\"shape\": \"box\", \"min\": [-288, -168, 480], \"max\": [288, 168, 960]}",
          "does not lie in this block of 12 sections every 24 um" },
        { "{\"shape\": \"box\", \"min\": [-288, -168, -960], \"max\": [288, 168, -480]}",
          "does not lie in this block" },
        { "{\"shape\": \"sphere\", \"centre\": [0, 0, 100], \"radius\": 1e300}",
          "does not lie in this block" },
        { "{\"shape\": \"box\", \"min\": [0, 0, 50], \"max\": [1, 1, 51]}", "holds no voxel" },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        gsn_auto_mem(char) job = gsn_format(
            "{\"specimen\": \"x\", " DRAWN_JOB_HEAD ", \"region\": %s}", cases[i].region);
        struct gsn_assembly *assembly = NULL;
        struct gsn_error err = { 0 };
        drawn_auto d;

        drawn_specimen_even(&d, job, DENSITY);
        CHECK(gsn_assembly_make(&d.specimen, &OPTIONS, &assembly, &err) == GSN_E_INPUT);
        CHECK(assembly == NULL);
        if (!strstr(err.text, cases[i].says))
            fail_msg("%s\nsays: %s", cases[i].region, err.text);
    }
}

/* Else a region of which half was never cut would look fully covered. */
TEST(the_part_of_a_region_beyond_the_block_counts_as_not_seen)
{
    static const char job[] =
        "{\"specimen\": \"x\", " DRAWN_JOB_HEAD ", \"region\": {\"shape\": \"box\", \"min\": "
        "[-288, -168, -96], \"max\": [288, 168, 384]}}";
    drawn_auto d;
    size_t region = 0, filled = 0;

    drawn_specimen_even(&d, job, DENSITY);
    gsn_auto(gsn_assembly) a = assembled(&d);
    const struct gsn_lattice *at = &a->grid->at;

    for (size_t z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++)
                if (gsn_mask_has(a->region, gsn_lattice_centre(at, x, y, z))) {
                    region++;
                    filled += isfinite((double)a->grid->value[gsn_lattice_index(at, x, y, z)]) != 0;
                }
    CHECK(region == 24 * 14 * 20); /* planes -4 to 15 */
    CHECK(filled == 24 * 14 * 12);
}

TEST(an_empty_mask_is_refused)
{
    struct gsn_assembly *assembly = NULL;
    struct gsn_error err = { 0 };
    gsn_auto(gsn_mask) mask = NULL;
    const struct gsn_lattice lattice = { .nx = 4, .ny = 4, .nz = 4, .step_um = { 24, 24, 24 } };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DENSITY);
    CHECK_OK(gsn_mask_new(&lattice, &mask, &err), err);
    d.specimen.region = mask;
    CHECK(gsn_assembly_make(&d.specimen, &OPTIONS, &assembly, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "the region mask is empty") != NULL && assembly == NULL);
}

TEST(without_a_region_the_sections_are_still_laid_and_pictured)
{
    drawn_auto d;

    drawn_specimen_even(&d, "{\"specimen\": \"x\", " DRAWN_JOB_HEAD "}", DENSITY);
    gsn_auto(gsn_assembly) a = assembled(&d);

    CHECK(a->solved && !a->grid && !a->region && a->section[0].state == GSN_SECTION_USED);
    CHECK(a->panel[0].opened && a->section[0].thumbnail.size > 0);
}

TEST(a_block_without_marks_is_unsolved_with_its_reason)
{
    struct drawn_panel panels[3];

    three_panels(panels);
    for (unsigned i = 0; i < 12; i++)
        panels[i / 4].section[i % 4].no_marks = 7;
    gsn_auto(gsn_assembly) a = assembled_from(panels);

    CHECK(!a->solved && !a->grid && a->unsolved[0] != '\0');
    for (unsigned i = 0; i < 12; i++)
        CHECK(a->section[i].state == GSN_SECTION_HELD);
}

TEST(a_panel_that_is_not_there_leaves_its_slots_missing)
{
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DENSITY);
    d.panel[1].section_count = 0;
    d.panel[1].state = "refused";
    d.panel[1].message = "the file is cut off";
    gsn_auto(gsn_assembly) a = assembled(&d);

    CHECK(a->section_count == 12 && !a->panel[1].opened && a->panel[2].opened);
    for (unsigned i = 4; i < 8; i++) {
        CHECK(a->section[i].state == GSN_SECTION_MISSING);
        CHECK(strcmp(a->section[i].flags, "no-panel") == 0 && a->section[i].seen.serial == i);
        check_gap(a->grid, i);
    }
    check_plane(a->grid, 8, DENSITY);
}

/* A panel beyond the stated number came: its sections are listed as well. */
TEST(sections_expected_come_from_the_job_and_from_what_came)
{
    drawn_auto d;

    drawn_specimen_even(&d,
                        "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [2, 2], \"sections\": "
                        "10, \"markers_um\": " DRAWN_MARKS_JSON "}",
                        DENSITY);
    d.panel[2].section_count = 0;
    gsn_auto(gsn_assembly) a = assembled(&d);

    CHECK(a->section_count == 8);
}

TEST(a_panel_whose_bytes_are_gone_stops_the_work)
{
    struct gsn_assembly *assembly = NULL;
    struct gsn_error err = { 0 };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DENSITY);
    d.panel[1].sha256 = "none";
    CHECK(gsn_assembly_make(&d.specimen, &OPTIONS, &assembly, &err) == GSN_E_NOTFOUND);
    CHECK(strstr(err.text, "panel 2 (P02.png): ") == err.text && assembly == NULL);
}

TEST(the_number_of_threads_does_not_matter)
{
    const struct gsn_specimen_options two = { .threads = 2 };
    gsn_auto(gsn_assembly) other = NULL;
    struct gsn_error err = { 0 };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DENSITY);
    gsn_auto(gsn_assembly) a = assembled(&d);

    CHECK_OK(gsn_assembly_make(&d.specimen, &two, &other, &err), err);
    CHECK(memcmp(a->grid->value, other->grid->value,
                 gsn_lattice_count(&a->grid->at) * sizeof *a->grid->value) == 0);
}

static int assemble_once(const struct drawn_specimen *d, struct gsn_error *err)
{
    gsn_auto(gsn_assembly) assembly = NULL;

    return gsn_assembly_make(&d->specimen, &OPTIONS, &assembly, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DENSITY);
    CHECK_MANY_OOM(assemble_once(&d, &err), err, 40, 20);
}

TEST(running_out_of_memory_while_tissue_is_compared_leaks_nothing)
{
    struct gsn_error err = { 0 };
    drawn_auto d;

    drawn_specimen_even(&d, BY_TISSUE_JOB, DENSITY);
    CHECK_MANY_OOM(assemble_once(&d, &err), err, 1, 60);
}

TEST(running_out_of_memory_while_marks_are_looked_for_again_leaks_nothing)
{
    struct drawn_panel panels[3];
    struct gsn_error err = { 0 };
    drawn_auto d;

    lopsided_panels(panels);
    panels[1].section[1].no_marks = 6;
    drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
    CHECK_MANY_OOM(assemble_once(&d, &err), err, 1, 12);
}
