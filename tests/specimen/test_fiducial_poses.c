/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/reconstruction.h"

#include "pipeline/core/mem.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/pose/pose.h"
#include "tests/check.h"
#include "tests/register/mounted.h"

#include <math.h>
#include <string.h>

/* PHANTOM.md level 2, with marks that follow the sections to a micrometre. */
static const struct mounted_world STRETCHED = {
    .marks = mounted_marks, .angle = 0.4, .burn_um = 1, .strain_sd = { 0.0085, 0.0028, 0 }
};
static const struct gsn_point TARGET = { 411, 646 };
enum { SECTIONS = 60 };

/* Sections that are all longer by this share than they would be by chance alone: 1.6 standard
 * deviations of what sixty make in the mean. */
static const double LONGER = 0.0018;

static void draw(struct mounted_stack *s)
{
    struct draw_chance chance = { 5 };

    mounted_draw(s, &STRETCHED, &chance);
    for (size_t i = 0; i < s->count; i++) {
        const struct mounted before = s->mounting[i];

        s->mounting[i].strain[0] += LONGER;
        for (int k = 0; k < GSN_FIDUCIALS; k++) {
            const struct gsn_point from = mounted_px(&before, mounted_marks[k]);
            const struct gsn_point to = mounted_px(&s->mounting[i], mounted_marks[k]);

            s->input[i].marks[k].px.x += to.x - from.x;
            s->input[i].marks[k].px.y += to.y - from.y;
        }
    }
}

/* Lays the stack as a specimen whose job says this of strain, and where its sections then have the
 * target in the mean. */
static struct gsn_point mean_place(const struct mounted_stack *s, enum gsn_protocol_strain strain,
                                   int declared, struct gsn_pose_summary *ret_summary)
{
    const struct gsn_panel_section slot = { .serial = 0 };
    const struct gsn_specimen_panel panel = {
        .number = 1, .px_um = MOUNTED_PX, .section_count = 1, .section = &slot
    };
    struct gsn_protocol protocol = { .strain = strain, .has_markers = declared };
    const struct gsn_specimen specimen = { .protocol = &protocol,
                                           .panel_count = 1,
                                           .panel = &panel };
    struct gsn_poses a = { .section_count = s->count };
    struct gsn_error err = { 0 };
    struct gsn_point mean = { 0, 0 };

    memcpy(protocol.markers_um, mounted_marks, sizeof protocol.markers_um);
    a.section = gsn_alloc_array(s->count, sizeof *a.section);
    CHECK(a.section != NULL);
    for (size_t i = 0; i < s->count; i++) {
        a.section[i].panel = 1;
        a.section[i].state = GSN_SECTION_HELD;
        a.section[i].seen.serial = s->input[i].serial;
        a.section[i].seen.sighting = GSN_SIGHT_FOUND;
        memcpy(a.section[i].seen.mark, s->input[i].marks, sizeof s->input[i].marks);
    }
    CHECK_OK(gsn_poses_by_fiducials(&specimen, NULL, &a, &err), err);
    CHECK(a.solved);
    for (size_t i = 0; i < s->count; i++) {
        const struct gsn_point p = gsn_affine_apply(&a.section[i].pose.panel_to_block_um,
                                                    mounted_px(&s->mounting[i], TARGET));

        CHECK(a.section[i].posed);
        mean.x += p.x / (double)s->count;
        mean.y += p.y / (double)s->count;
    }
    *ret_summary = a.summary;
    gsn_poses_done(&a);
    return mean;
}

/* How far off the target then is in the mean. */
static double off_by(enum gsn_protocol_strain strain, int declared,
                     struct gsn_pose_summary *ret_summary)
{
    struct mounted_stack s = mounted_new(SECTIONS);
    struct gsn_point p;

    draw(&s);
    p = mean_place(&s, strain, declared, ret_summary);
    mounted_done(&s);
    print_message("  in the mean %.2f um off\n", hypot(p.x - TARGET.x, p.y - TARGET.y));
    return hypot(p.x - TARGET.x, p.y - TARGET.y);
}

/* Nothing but the marks' micrometre is left: over sixty sections, 0.2 um at the target. */
TEST(what_is_stretched_back_fits_the_declared_marks_in_the_mean)
{
    struct gsn_pose_summary summary;

    CHECK(off_by(GSN_PROTOCOL_STRAIN_CORRECTED, 1, &summary) < 0.8);
    CHECK(summary.stretches && summary.as_declared);
    CHECK(off_by(GSN_PROTOCOL_STRAIN_TISSUE, 1, &summary) < 0.8);
}

/* The centroid of the marks stays, and the target, 1.4 mm from it, goes with what all share. */
TEST(what_stays_rigid_keeps_what_sections_stretch_by_in_the_mean)
{
    struct gsn_pose_summary summary;

    CHECK(off_by(GSN_PROTOCOL_STRAIN_REPORTED, 1, &summary) > 1);
    CHECK(off_by(GSN_PROTOCOL_STRAIN_RIGID, 1, &summary) > 1);
}

TEST(where_no_marks_are_declared_the_mean_triangle_is_the_frame)
{
    struct gsn_pose_summary summary;

    (void)off_by(GSN_PROTOCOL_STRAIN_CORRECTED, 0, &summary);
    CHECK(summary.stretches && !summary.as_declared);
}
