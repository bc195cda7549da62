/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Lists the sections of a specimen and finds the pose of each.
 *
 * 1. Every slot of every panel that the job expects or that came is a section with a serial number;
 *    one whose panel did not come is missing. Pieces between the slots are the panel's alone.
 * 2. Poses by marks (fiducial_poses.c), all sections together.
 * 3. Poses by the tissue of neighbours where marks place none (tissue_poses.c).
 * 4. The extent of what is posed, on which later lattices of the whole block rest.
 * 5. Refinement by tissue, where the job asks for it (tissue_refinement.c).
 *
 * What cannot be placed is a state with a reason. Steps 3 and 5 read the panels again. */
#include "pipeline/specimen/poses.h"

#include "pipeline/register/panel/slots.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

const char *gsn_section_state_name(enum gsn_section_state state)
{
    static const char *const names[] = { "used", "doubtful", "held", "missing", "empty" };

    return names[state];
}

static int by_serial(const void *a, const void *b)
{
    const struct gsn_section *s = a, *t = b;

    if (s->seen.serial != t->seen.serial)
        return s->seen.serial < t->seen.serial ? -1 : 1;
    return s->panel < t->panel ? -1 : s->panel > t->panel;
}

static struct gsn_section section_of(const struct gsn_panel_section *seen, unsigned panel)
{
    static const enum gsn_section_state states[] = {
        [GSN_SIGHT_FOUND] = GSN_SECTION_HELD,      [GSN_SIGHT_NEEDS_EYE] = GSN_SECTION_HELD,
        [GSN_SIGHT_MISSING] = GSN_SECTION_MISSING, [GSN_SIGHT_EMPTY] = GSN_SECTION_EMPTY,
        [GSN_SIGHT_HELD] = GSN_SECTION_HELD,
    };
    struct gsn_section section = { .panel = panel,
                                   .seen = *seen,
                                   .state = states[seen->sighting],
                                   .flags = seen->flags,
                                   .candidates = seen->candidates };

    /* How the panel alone lays them is no place in the block. */
    for (size_t i = 0; i < section.candidates.count; i++)
        section.candidates.at[i].laid = 0;
    return section;
}

const struct gsn_specimen_panel *gsn_specimen_find_panel(const struct gsn_specimen *specimen,
                                                         unsigned number)
{
    for (size_t i = 0; i < specimen->panel_count; i++)
        if (specimen->panel[i].number == number && specimen->panel[i].section_count > 0)
            return &specimen->panel[i];
    return NULL;
}

/* Every slot of every panel that the job expects or that came; each has a number, and pieces
 * between the slots are the panel's alone. */
int gsn_poses_list(const struct gsn_specimen *specimen, struct gsn_poses *poses,
                   struct gsn_error *err)
{
    const struct gsn_layout layout = gsn_protocol_layout(specimen->protocol);
    const unsigned slots = layout.rows * layout.columns;
    const unsigned expected = gsn_protocol_sections(specimen->protocol);
    unsigned panels = specimen->protocol->panels;

    for (size_t i = 0; i < specimen->panel_count; i++)
        if (specimen->panel[i].section_count > 0 && specimen->panel[i].number > panels)
            panels = specimen->panel[i].number;
    poses->section = gsn_alloc_array((size_t)panels * slots, sizeof *poses->section);
    if (!poses->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the sections of a specimen");
    for (unsigned number = 1; number <= panels; number++) {
        const struct gsn_specimen_panel *panel = gsn_specimen_find_panel(specimen, number);

        for (unsigned slot = 0; slot < slots; slot++) {
            const unsigned serial = gsn_panel_serial(number, slot, &layout);
            const struct gsn_panel_section none = { .serial = serial,
                                                    .slot = slot,
                                                    .sighting = expected && serial >= expected
                                                                    ? GSN_SIGHT_EMPTY
                                                                    : GSN_SIGHT_MISSING };
            struct gsn_section *section = &poses->section[poses->section_count++];

            if (panel && slot < panel->section_count) {
                *section = section_of(&panel->section[slot], number);
            } else {
                *section = section_of(&none, number);
                gsn_flags_add(&section->flags, GSN_FLAG_NO_PANEL);
            }
        }
    }
    qsort(poses->section, poses->section_count, sizeof *poses->section, by_serial);
    return GSN_OK;
}

unsigned gsn_poses_length(const struct gsn_poses *poses)
{
    return poses->section_count ? poses->section[poses->section_count - 1].seen.serial + 1 : 0;
}

int gsn_poses_marks(const struct gsn_poses *poses, struct gsn_section_marks **ret_marks,
                    struct gsn_error *err)
{
    struct gsn_section_marks *marks = gsn_alloc_array(poses->section_count, sizeof *marks);

    if (!marks)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a specimen");
    for (size_t i = 0; i < poses->section_count; i++)
        memcpy(marks[i].mark, poses->section[i].seen.mark, sizeof marks[i].mark);
    *ret_marks = marks;
    return GSN_OK;
}

/* The boxes of all posed sections in the block. */
static struct gsn_block_box find_extent(const struct gsn_poses *poses, double interval_um)
{
    struct gsn_block_box box = { { INFINITY, INFINITY, INFINITY },
                                 { -INFINITY, -INFINITY, -INFINITY } };

    for (size_t i = 0; i < poses->section_count; i++) {
        const struct gsn_section *s = &poses->section[i];

        for (int corner = 0; s->posed && corner < 4; corner++) {
            const struct gsn_point px = { s->seen.x + (corner & 1 ? s->seen.width : 0),
                                          s->seen.y + (corner & 2 ? s->seen.height : 0) };
            const struct gsn_point um = gsn_affine_apply(&s->pose.panel_to_block_um, px);

            box.low = gsn_vec3_make(fmin(box.low.x, um.x), fmin(box.low.y, um.y),
                                    fmin(box.low.z, interval_um * s->seen.serial));
            box.high = gsn_vec3_make(fmax(box.high.x, um.x), fmax(box.high.y, um.y),
                                     fmax(box.high.z, interval_um * (s->seen.serial + 1)));
        }
    }
    return box;
}

int gsn_poses_find(const struct gsn_specimen *specimen, const struct gsn_specimen_options *options,
                   const struct gsn_mask *region, struct gsn_calibrations *calibrations,
                   struct gsn_poses *poses, struct gsn_error *err)
{
    int r = gsn_poses_by_fiducials(specimen, region, poses, err);

    if (r >= 0)
        r = gsn_poses_by_tissue(specimen, options, region, poses, err);
    if (r < 0)
        return r;
    poses->extent = find_extent(poses, specimen->protocol->interval_um);
    return gsn_poses_refine(specimen, options, region, calibrations, poses, err);
}

void gsn_poses_done(struct gsn_poses *poses)
{
    gsn_free(poses->section);
}
