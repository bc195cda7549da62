/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Lists the sections of a specimen, and finds the poses of all of them by their marks.
 *
 * 1. Every slot of every panel that the job expects or that came is a section with a serial number;
 *    one whose panel did not come is missing. Pieces between the slots are the panel's alone.
 * 2. The marks of all sections that may be used go into one solution (register/pose.h): the common
 *    triangle, then a weighted rigid fit a section.
 * 3. What the job says about strain is done with the sections' own stretch: reported, ignored, or
 *    taken out.
 * 4. Sections whose panel leaves open which spots are their marks, and those whose three marks
 *    contradict the stack, get their candidates (candidates.c), laid in the stack.
 *
 * A stack that cannot be solved is a state, with a sentence. */
#include "pipeline/specimen/poses.h"

#include "pipeline/register/panel/slots.h"
#include "pipeline/register/pose/pose.h"
#include "pipeline/register/pose/strain.h"
#include "pipeline/register/pose/tre.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- the sections ---------------------------------------------------------------------------- */

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

void gsn_poses_done(struct gsn_poses *poses)
{
    gsn_free(poses->section);
}

/* ---- their poses by marks -------------------------------------------------------------------- */

/* As gsn_pose_solve() takes them. */
static struct gsn_pose_targets targets_of(const struct gsn_pose_summary *summary,
                                          const struct gsn_pose_options *options)
{
    const struct gsn_point *t = summary->mean_triangle;
    const double rho = summary->rho_um, x = (t[0].x + t[1].x + t[2].x) / GSN_FIDUCIALS,
                 y = (t[0].y + t[1].y + t[2].y) / GSN_FIDUCIALS;
    const struct gsn_point around[] = {
        { x + rho, y }, { x - rho, y }, { x, y + rho }, { x, y - rho }
    };

    return options->target_count > 0
               ? gsn_pose_targets_of(options->targets_um, options->target_count)
               : gsn_pose_targets_of(around, 4);
}

/* Upright is the job's frame, or else the way most sections lie. */
static struct gsn_point upright_of(const struct gsn_poses *poses, int declared)
{
    struct gsn_point upright = { declared, 0 };

    for (size_t i = 0; i < poses->section_count && !declared; i++) {
        struct gsn_point d;

        if (!poses->section[i].posed)
            continue;
        d = gsn_candidate_direction(&poses->section[i].pose.panel_to_block_um);
        upright.x += d.x;
        upright.y += d.y;
    }
    return upright;
}

/* Lays a section's candidates in the stack that the marks solved. */
static void lay_candidates(const struct gsn_specimen *specimen, const struct gsn_poses *poses,
                           const struct gsn_pose_targets *targets, struct gsn_section *s)
{
    const double px_um = gsn_specimen_find_panel(specimen, s->panel)->px_um;
    struct gsn_point onto[GSN_FIDUCIALS];

    gsn_axes_at(&poses->summary.axes, s->seen.serial, poses->summary.mean_triangle, onto);
    gsn_candidates_lay(&s->candidates, px_um, onto);
    gsn_candidates_predict(&s->candidates, px_um, &poses->summary, targets);
}

/* Lays the candidates of every section that has some in the solved stack; sections whose three
 * marks contradict it get theirs. */
static void list_candidates(const struct gsn_specimen *specimen,
                            const struct gsn_pose_options *options, struct gsn_poses *poses)
{
    const struct gsn_pose_targets targets = targets_of(&poses->summary, options);
    const struct gsn_point upright = upright_of(poses, options->markers_um != NULL);

    for (size_t i = 0; i < poses->section_count; i++) {
        struct gsn_section *s = &poses->section[i];

        if (s->pose.gross && s->pose.state == GSN_POSE_OK)
            gsn_candidates_of_gross(s->seen.mark, &s->pose, &s->candidates);
        else if (s->candidates.count > 0)
            lay_candidates(specimen, poses, &targets, s);
        gsn_candidates_say(&s->candidates, upright);
    }
}

void gsn_candidates_offer_marks(const struct gsn_specimen *specimen,
                                const struct gsn_pose_options *options,
                                const struct gsn_poses *poses, struct gsn_section *s)
{
    const struct gsn_pose_targets targets = targets_of(&poses->summary, options);

    gsn_candidates_of_marks(s->seen.mark, s->pose.flipped, &s->candidates);
    lay_candidates(specimen, poses, &targets, s);
    gsn_candidates_say(&s->candidates, upright_of(poses, options->markers_um != NULL));
}

/* What a person chose is used, two marks or not; one that contradicts the stack is still said to be
 * doubtful. */
static enum gsn_section_state state_of(const struct gsn_section *section)
{
    const struct gsn_pose *pose = &section->pose;
    const int pair = pose->state == GSN_POSE_TWO_MARKS;
    const int decided = section->candidates.chosen > 0;

    /* Of two sections that have grown together, the tissue is not parted, whatever their marks say.
     */
    if (!section->posed || section->seen.sighting == GSN_SIGHT_HELD ||
        (pose->gross && !(pair && decided)))
        return GSN_SECTION_HELD;
    return (pair && !decided) || pose->gross ? GSN_SECTION_DOUBTFUL : GSN_SECTION_USED;
}

static void take_pose(struct gsn_section *section, const struct gsn_pose *pose)
{
    struct gsn_fiducial in_order[GSN_FIDUCIALS];

    section->pose = *pose;
    section->posed = pose->state != GSN_POSE_NONE;
    for (size_t i = 0; i < GSN_FIDUCIALS; i++)
        in_order[i] = section->seen.mark[pose->order[i]];
    if (section->posed)
        memcpy(section->seen.mark, in_order, sizeof in_order);
    if (pose->gross)
        gsn_flags_add(&section->flags, GSN_FLAG_RESIDUAL);
    if (pose->flipped)
        gsn_flags_add(&section->flags, GSN_FLAG_FLIPPED);
    if (pose->rotated180)
        gsn_flags_add(&section->flags, GSN_FLAG_TURNED);
    section->state = state_of(section);
}

static enum gsn_strain_mode strain_mode(const struct gsn_protocol *protocol)
{
    static const enum gsn_strain_mode modes[] = {
        [GSN_PROTOCOL_STRAIN_REPORTED] = GSN_STRAIN_REPORTED,
        [GSN_PROTOCOL_STRAIN_RIGID] = GSN_STRAIN_RIGID,
        [GSN_PROTOCOL_STRAIN_CORRECTED] = GSN_STRAIN_CORRECTED,
        [GSN_PROTOCOL_STRAIN_TISSUE] = GSN_STRAIN_TISSUE,
    };

    return modes[protocol->strain];
}

/* Does with the sections' strain what the protocol says. */
static void use_strain(struct gsn_poses *poses, const struct gsn_pose_options *options)
{
    const struct gsn_pose_targets targets =
        gsn_pose_targets_of(options->targets_um, options->target_count);
    struct gsn_affine mean = { 1, 0, 0, 0, 1, 0 };

    if (poses->summary.as_declared)
        mean = gsn_strain_of_mean(poses->summary.mean_triangle, options->markers_um);
    for (size_t i = 0; i < poses->section_count; i++) {
        struct gsn_section *s = &poses->section[i];

        if (!s->posed || !poses->summary.stretches ||
            (poses->strain_mode != GSN_STRAIN_CORRECTED && poses->strain_mode != GSN_STRAIN_TISSUE))
            continue;
        s->pose.panel_to_block_um = gsn_strain_corrected(&s->pose);
        s->pose.panel_to_block_um = gsn_affine_compose(&s->pose.panel_to_block_um, &mean);
        if (targets.count > 0)
            s->pose.tre_um = gsn_pose_tre_rms(&s->pose.error, &targets, 1);
    }
}

int gsn_poses_by_fiducials(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                           struct gsn_poses *poses, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_pose_input) inputs =
        gsn_alloc_array(poses->section_count, sizeof *inputs);
    gsn_auto_mem(struct gsn_pose) solved = gsn_alloc_array(poses->section_count, sizeof *solved);
    gsn_auto_mem(struct gsn_point) targets = NULL;
    struct gsn_pose_options options = { .markers_um = specimen->protocol->has_markers
                                                          ? specimen->protocol->markers_um
                                                          : NULL };
    struct gsn_error why = { 0 };
    size_t count = 0;
    int r;

    poses->strain_mode = GSN_STRAIN_RIGID;
    if (specimen->protocol->registration == GSN_PROTOCOL_TISSUE)
        return GSN_OK;
    if (!inputs || !solved)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for poses");
    r = gsn_region_targets(region, &targets, &options.target_count, err);
    if (r < 0)
        return r;
    options.targets_um = targets;
    for (size_t i = 0; i < poses->section_count; i++)
        if (poses->section[i].state == GSN_SECTION_HELD) {
            inputs[count] = (struct gsn_pose_input){
                .serial = poses->section[i].seen.serial,
                .px_um = gsn_specimen_find_panel(specimen, poses->section[i].panel)->px_um,
                .mirrored = gsn_flags_has(&poses->section[i].seen.flags, GSN_FLAG_MIRRORED)
            };
            memcpy(inputs[count].marks, poses->section[i].seen.mark, sizeof inputs[count].marks);
            count++;
        }
    r = gsn_pose_solve(inputs, count, &options, solved, &poses->summary, &why);
    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    poses->solved = r >= 0;
    if (r < 0)
        (void)snprintf(poses->unsolved, sizeof poses->unsolved, "%s%s", why.text,
                       r == GSN_E_MARKERS ? "; if no marks were burnt, state \"registration\": "
                                            "\"tissue\" in job.json"
                                          : "");
    for (size_t i = 0, p = 0; r >= 0 && i < poses->section_count; i++)
        if (poses->section[i].state == GSN_SECTION_HELD)
            take_pose(&poses->section[i], &solved[p++]);
    if (r < 0)
        return GSN_OK;
    list_candidates(specimen, &options, poses);
    poses->panel_stretch = gsn_strain_of_panel(inputs, solved, count, options.markers_um,
                                               poses->summary.mean_triangle);
    poses->strain_mode = strain_mode(specimen->protocol);
    use_strain(poses, &options);
    return GSN_OK;
}
