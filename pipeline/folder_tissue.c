/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/folder_parts.h"

#include "pipeline/register/tissue/pose_check.h"

#include <stdio.h>
#include <string.h>

/* Chi-squared of one in a million for each of the 3 degrees of freedom, and then its root. */
static const double DISAGREES = 3.3;

/* Whether the marks are to be relied on. */
static int marks_hold(const struct gsn_section_folder *folder)
{
    size_t with = 0, read = 0;

    for (size_t i = 0; i < folder->stack->count; i++) {
        with += folder->work[i].pose.state == GSN_POSE_OK;
        read += folder->work[i].tissue != NULL;
    }
    return with > 0 && (folder->options->mark || 2 * with >= read);
}

static void state_section(const struct gsn_section_folder *folder, size_t i, int marks,
                          struct gsn_tissue_section *ret_section)
{
    const struct gsn_folder_work *work = &folder->work[i];
    const double px = folder->px_um;
    struct gsn_affine map = work->pose.panel_to_block_um;

    *ret_section = (struct gsn_tissue_section){
        .serial = (unsigned)i,
        .tissue = work->tissue,
        .marked = marks && work->pose.state != GSN_POSE_NONE && !work->pose.gross,
    };
    if (!ret_section->marked || !work->tissue)
        return;
    map.m00 /= px;
    map.m01 /= px;
    map.m10 /= px;
    map.m11 /= px;
    ret_section->to_block = map;
    gsn_pose_error_about(&work->pose.error, gsn_affine_apply(&map, gsn_tissue_centre(work->tissue)),
                         ret_section->covariance);
}

static void say_no_tissue(const struct gsn_folder_work *work, struct gsn_folder_section *section)
{
    if (!work->spots && section->reason[0])
        return;
    (void)snprintf(section->reason, sizeof section->reason,
                   "no marks, and its tissue fits none of the three sections before and after; "
                   "look at the section");
}

/* A pose by tissue: the reference's own picture is the frame, not half a pixel beside it. */
static void tell_tissue(struct gsn_section_folder *folder, size_t i,
                        const struct gsn_tissue_pose *pose, int flipped)
{
    struct gsn_folder_section *section = &folder->stack->section[i];
    const double px = folder->px_um, half = folder->stack->tissue.held > 0 ? 0 : 0.5 * px;
    struct gsn_affine map = pose->to_block;

    section->flags[0] = '\0';
    section->reason[0] = '\0';
    section->state = GSN_POSE_NONE;
    section->by_tissue = pose->laid;
    if (!pose->laid) {
        say_no_tissue(&folder->work[i], section);
        return;
    }
    map.m00 *= px;
    map.m01 *= px;
    map.m10 *= px;
    map.m11 *= px;
    map.m02 -= half;
    map.m12 -= half;
    section->frame_to_px = gsn_folder_frame_to_px(folder, &map);
    section->from = pose->from;
    section->error_px = pose->error / px;
    memset(section->ellipse, 0, sizeof section->ellipse);
    section->rms_px = 0;
    section->flipped = flipped;
    folder->stack->by_tissue++;
    gsn_folder_add_flag(section, "by-tissue");
    if (flipped)
        gsn_folder_add_flag(section, "flipped");
    if (pose->unsure)
        gsn_folder_add_flag(section, "unsure");
}

/* The face that most sections show; with marks it is the marks' that counts. */
static int usual_face(const struct gsn_section_folder *folder, const struct gsn_tissue_pose *poses)
{
    int sum = 0;

    for (size_t i = 0; i < folder->stack->count; i++)
        if (poses[i].laid)
            sum += gsn_affine_det(&poses[i].to_block) > 0 ? 1 : -1;
    return folder->stack->tissue.held > 0 || sum >= 0 ? 1 : -1;
}

static void tell_all(struct gsn_section_folder *folder, const struct gsn_tissue_section *sections,
                     const struct gsn_tissue_finding *findings, const struct gsn_tissue_pose *poses)
{
    const int face = usual_face(folder, poses);

    for (size_t i = 0; i < folder->stack->count; i++) {
        struct gsn_folder_section *section = &folder->stack->section[i];

        if (!sections[i].marked && folder->work[i].spots)
            tell_tissue(folder, i, &poses[i], gsn_affine_det(&poses[i].to_block) * face < 0);
        if (findings[i].contradicted || (sections[i].marked && poses[i].disagrees > DISAGREES))
            gsn_folder_add_flag(section, "tissue-disagrees");
        if (findings[i].contradicted && !poses[i].laid)
            (void)snprintf(section->reason, sizeof section->reason,
                           "what looks like its marks lays it elsewhere than its neighbours' "
                           "tissue does, which alone does not lay it; look at the section");
    }
}

int gsn_folder_lay_by_tissue(struct gsn_section_folder *folder, struct gsn_error *err)
{
    const size_t count = folder->stack->count;
    gsn_auto_mem(struct gsn_tissue_section) sections = gsn_alloc_array(count, sizeof *sections);
    gsn_auto_mem(struct gsn_tissue_finding) findings = gsn_alloc_array(count, sizeof *findings);
    gsn_auto_mem(struct gsn_tissue_pose) poses = gsn_alloc_array(count, sizeof *poses);
    struct gsn_tissue_summary *summary = &folder->stack->tissue;
    const int marks = marks_hold(folder);
    int r;

    if (!sections || !findings || !poses)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the poses of a stack");
    for (size_t i = 0; i < count; i++)
        state_section(folder, i, marks, &sections[i]);
    r = gsn_tissue_check(sections, count, findings, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        sections[i].marked &= !findings[i].contradicted;
    if (r >= 0)
        r = gsn_tissue_register(sections, count, GSN_TISSUE_MIDDLE, poses, summary, err);
    if (r < 0)
        return r;
    summary->usual /= folder->px_um;
    summary->drift /= folder->px_um;
    tell_all(folder, sections, findings, poses);
    return GSN_OK;
}
