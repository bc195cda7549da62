/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/folder_parts.h"
#include "pipeline/register/pose/strain.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { TARGETS = 21 };

static size_t make_targets(const struct gsn_section_folder *folder, struct gsn_point *targets)
{
    const double radius = folder->options->radius * folder->unit;
    size_t n = 0;

    for (int k = 0; k < TARGETS * TARGETS; k++) {
        const struct gsn_point at = { radius * (k % TARGETS - TARGETS / 2) / (TARGETS / 2),
                                      radius * (k / TARGETS - TARGETS / 2) / (TARGETS / 2) };

        if (at.x * at.x + at.y * at.y <= radius * radius)
            targets[n++] = at;
    }
    return radius > 0 ? n : 0;
}

void gsn_folder_add_flag(struct gsn_folder_section *section, const char *word)
{
    const size_t used = strlen(section->flags);

    (void)snprintf(section->flags + used, sizeof section->flags - used, "%s%s", used ? " " : "",
                   word);
}

static void say_why(const struct gsn_folder_work *work, struct gsn_folder_section *section)
{
    if (section->reason[0])
        return;
    if (section->score > 0 && 20 * section->runner_up > section->score)
        (void)snprintf(section->reason, sizeof section->reason,
                       "the marks could be others: the best three spots score %.2g, the next %.2g; "
                       "look at the section",
                       section->score, section->runner_up);
    else
        (void)snprintf(section->reason, sizeof section->reason,
                       "no three marks: %zu dark spot%s, none of them in the triangle's places; "
                       "look at the section",
                       work->spots->candidates.count,
                       work->spots->candidates.count == 1 ? "" : "s");
}

struct gsn_affine gsn_folder_frame_to_px(const struct gsn_section_folder *folder,
                                         const struct gsn_affine *to_block)
{
    struct gsn_affine map = gsn_affine_inverse(to_block);

    map.m00 *= folder->unit;
    map.m01 *= folder->unit;
    map.m10 *= folder->unit;
    map.m11 *= folder->unit;
    map.m02 -= 0.5;
    map.m12 -= 0.5;
    return map;
}

static void flag(struct gsn_folder_section *section, const struct gsn_pose *pose)
{
    if (pose->flipped)
        gsn_folder_add_flag(section, "flipped");
    if (pose->rotated180)
        gsn_folder_add_flag(section, "rotated180");
    if (pose->state == GSN_POSE_TWO_MARKS)
        gsn_folder_add_flag(section, "two-marks");
    if (pose->gross)
        gsn_folder_add_flag(section, "gross");
}

/* Where a mark may be wrong, the ellipses grow as the whole error does. */
static void tell_ellipses(const struct gsn_section_folder *folder, const struct gsn_pose *pose,
                          double growth, struct gsn_folder_section *section)
{
    static const int towards[GSN_FOLDER_ELLIPSES][2] = {
        { 0, 0 }, { 1, 0 }, { 0, 1 }, { -1, 0 }, { 0, -1 }
    };
    const double radius = folder->options->radius > 0
                              ? folder->options->radius
                              : folder->stack->summary.rho_um / folder->unit;
    const double px = growth / folder->px_um;

    for (size_t i = 0; i < GSN_FOLDER_ELLIPSES; i++) {
        const struct gsn_point at = { radius * towards[i][0], radius * towards[i][1] };
        const struct gsn_point um = { at.x * folder->unit, at.y * folder->unit };
        const struct gsn_ellipse e =
            gsn_pose_ellipse_at(&pose->error, um, folder->stack->summary.stretches, 0.95);

        section->ellipse[i] =
            (struct gsn_folder_ellipse){ at, { e.major * px, e.minor * px, e.angle } };
    }
}

/* The pose with the section's own size, where the stack's differ by more than their marks'
 * errors: the knife and the water bath change a section's size by some per cent, which a
 * rigid pose leaves as an error that grows with the distance from the marks' middle. Marks that are
 * stated are where the frame has them, whatever the sections' mean size. ret_error_um: over the
 * same targets as before. */
static struct gsn_affine fit_size(const struct gsn_section_folder *folder,
                                  const struct gsn_pose *pose,
                                  const struct gsn_pose_options *options, double *ret_error_um)
{
    const struct gsn_pose_summary *summary = &folder->stack->summary;
    const struct gsn_pose_targets targets =
        gsn_pose_targets_of(options->targets_um, options->target_count);
    const struct gsn_affine own = gsn_strain_corrected(pose);
    struct gsn_affine mean;

    if (targets.count > 0)
        *ret_error_um = gsn_pose_tre_rms(&pose->error, &targets, 1);
    if (!options->markers_um)
        return own;
    mean = gsn_strain_of_mean(summary->mean_triangle, options->markers_um);
    return gsn_affine_compose(&own, &mean);
}

static void tell(const struct gsn_section_folder *folder, size_t i, const struct gsn_pose *pose,
                 const struct gsn_pose_options *options)
{
    struct gsn_folder_section *section = &folder->stack->section[i];
    struct gsn_affine px_to_frame = pose->panel_to_block_um;
    double error_um = pose->tre_um, growth = 1;

    section->state = pose->state;
    folder->work[i].pose = *pose;
    if (pose->state == GSN_POSE_NONE) {
        say_why(&folder->work[i], section);
        return;
    }
    /* A mark that lies wrong would drag the others along. */
    if (pose->gross && pose->state == GSN_POSE_OK)
        gsn_pose_likeliest(pose, options->targets_um, options->target_count, &px_to_frame,
                           &error_um);
    else if (pose->gross)
        error_um = hypot(pose->tre_um, pose->rms_um);
    else if (folder->stack->summary.stretches)
        px_to_frame = fit_size(folder, pose, options, &error_um);
    if (pose->gross)
        growth = error_um / pose->tre_um;
    folder->work[i].pose.panel_to_block_um = px_to_frame;
    section->frame_to_px = gsn_folder_frame_to_px(folder, &px_to_frame);
    section->error_px = error_um / folder->px_um;
    tell_ellipses(folder, pose, growth, section);
    section->rms_px = pose->rms_um / folder->px_um;
    section->flipped = pose->flipped;
    flag(section, pose);
}

int gsn_folder_solve(struct gsn_section_folder *folder, struct gsn_error *err)
{
    const size_t count = folder->stack->count;
    gsn_auto_mem(struct gsn_pose_input) inputs = gsn_alloc_array(count, sizeof *inputs);
    gsn_auto_mem(struct gsn_pose) poses = gsn_alloc_array(count, sizeof *poses);
    struct gsn_point targets[TARGETS * TARGETS], marks[GSN_MARKS];
    struct gsn_pose_options options = { .targets_um = targets, .sizes = 1 };
    int r;

    if (!inputs || !poses)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the poses of a stack");
    for (size_t i = 0; i < count; i++) {
        inputs[i] = (struct gsn_pose_input){ .serial = (unsigned)i,
                                             .px_um = folder->px_um,
                                             .mirrored = folder->work[i].mirrored };
        memcpy(inputs[i].marks, folder->work[i].marks, sizeof inputs[i].marks);
    }
    if (folder->options->mark) {
        gsn_folder_stated_marks(folder, marks);
        options.markers_um = marks;
    }
    options.target_count = make_targets(folder, targets);
    r = gsn_pose_solve(inputs, count, &options, poses, &folder->stack->summary, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < count; i++)
        tell(folder, i, &poses[i], &options);
    folder->stack->fle_px = folder->stack->summary.fle_um / folder->px_um;
    return GSN_OK;
}
