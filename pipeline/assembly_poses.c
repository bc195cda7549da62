/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { MOST_TARGETS = 4096 };

int gsn_assembly_targets(const struct gsn_mask *region, struct gsn_point **ret_points,
                         size_t *ret_count, struct gsn_error *err)
{
    const size_t total = region ? gsn_mask_count(region) : 0;
    const size_t every = total / MOST_TARGETS + 1;
    gsn_auto_mem(struct gsn_point) points = gsn_alloc_array(total / every + 1, sizeof *points);
    size_t seen = 0, count = 0;

    if (!points)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for target points");
    for (size_t i = 0; total && i < gsn_lattice_count(&region->at); i++) {
        const size_t x = i % region->at.nx, y = i / region->at.nx % region->at.ny;
        struct gsn_vec3 u;

        if (!region->inside[i] || seen++ % every != 0)
            continue;
        u = gsn_lattice_centre(&region->at, x, y, 0);
        points[count++] = (struct gsn_point){ .x = u.x, .y = u.y };
    }
    *ret_points = gsn_steal(&points);
    *ret_count = count;
    return GSN_OK;
}

/* What a person chose is used, two marks or not; one that contradicts the stack is still said to be
 * doubtful. */
static enum gsn_assembly_state state_of(const struct gsn_assembly_section *section)
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

static void take_pose(struct gsn_assembly_section *section, const struct gsn_pose *pose)
{
    struct gsn_mark in_order[GSN_MARKS];

    section->pose = *pose;
    section->posed = pose->state != GSN_POSE_NONE;
    for (size_t i = 0; i < GSN_MARKS; i++)
        in_order[i] = section->seen.mark[pose->order[i]];
    if (section->posed)
        memcpy(section->seen.mark, in_order, sizeof in_order);
    if (pose->gross)
        gsn_assembly_flag(section, "residual-too-large");
    if (pose->flipped)
        gsn_assembly_flag(section, "flipped");
    if (pose->rotated180)
        gsn_assembly_flag(section, "turned");
    section->state = state_of(section);
}

static enum gsn_strain_mode strain_mode(const struct gsn_protocol *protocol)
{
    static const enum gsn_strain_mode modes[] = {
        [GSN_STATED_STRAIN_REPORTED] = GSN_STRAIN_REPORTED,
        [GSN_STATED_STRAIN_RIGID] = GSN_STRAIN_RIGID,
        [GSN_STATED_STRAIN_CORRECTED] = GSN_STRAIN_CORRECTED,
        [GSN_STATED_STRAIN_TISSUE] = GSN_STRAIN_TISSUE,
    };

    return modes[protocol->strain];
}

/* Does with the sections' strain what the protocol says. */
static void use_strain(struct gsn_assembly *a, const struct gsn_pose_options *options)
{
    const struct gsn_pose_targets targets =
        gsn_pose_targets_of(options->targets_um, options->target_count);
    struct gsn_affine mean = { 1, 0, 0, 0, 1, 0 };

    if (a->summary.as_declared)
        mean = gsn_strain_of_mean(a->summary.mean_triangle, options->markers_um);
    for (size_t i = 0; i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];

        if (!s->posed || !a->summary.stretches ||
            (a->strain_mode != GSN_STRAIN_CORRECTED && a->strain_mode != GSN_STRAIN_TISSUE))
            continue;
        s->pose.panel_to_block_um = gsn_strain_corrected(&s->pose);
        s->pose.panel_to_block_um = gsn_affine_compose(&s->pose.panel_to_block_um, &mean);
        if (targets.count > 0)
            s->pose.tre_um = gsn_pose_tre_rms(&s->pose.error, &targets, 1);
    }
}

int gsn_assembly_solve(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                       struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_pose_input) inputs = gsn_alloc_array(a->section_count, sizeof *inputs);
    gsn_auto_mem(struct gsn_pose) poses = gsn_alloc_array(a->section_count, sizeof *poses);
    gsn_auto_mem(struct gsn_point) targets = NULL;
    struct gsn_pose_options options = { .markers_um = specimen->protocol->has_markers
                                                          ? specimen->protocol->markers_um
                                                          : NULL };
    struct gsn_error why = { 0 };
    size_t count = 0;
    int r;

    a->strain_mode = GSN_STRAIN_RIGID;
    if (specimen->protocol->registration == GSN_STATED_TISSUE)
        return GSN_OK;
    if (!inputs || !poses)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for poses");
    r = gsn_assembly_targets(a->region, &targets, &options.target_count, err);
    if (r < 0)
        return r;
    options.targets_um = targets;
    for (size_t i = 0; i < a->section_count; i++)
        if (a->section[i].state == GSN_SECTION_HELD) {
            inputs[count] = (struct gsn_pose_input){
                .serial = a->section[i].seen.serial,
                .px_um = gsn_assembly_panel(specimen, a->section[i].panel)->px_um,
                .mirrored = strstr(a->section[i].seen.flags, "mirrored") != NULL
            };
            memcpy(inputs[count].marks, a->section[i].seen.mark, sizeof inputs[count].marks);
            count++;
        }
    r = gsn_pose_solve(inputs, count, &options, poses, &a->summary, &why);
    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    a->solved = r >= 0;
    if (r < 0)
        (void)snprintf(a->unsolved, sizeof a->unsolved, "%s%s", why.text,
                       r == GSN_E_MARKERS ? "; if no marks were burnt, state \"registration\": "
                                            "\"tissue\" in job.json"
                                          : "");
    for (size_t i = 0, p = 0; r >= 0 && i < a->section_count; i++)
        if (a->section[i].state == GSN_SECTION_HELD)
            take_pose(&a->section[i], &poses[p++]);
    if (r < 0)
        return GSN_OK;
    gsn_assembly_list_candidates(specimen, &options, a);
    a->panel_stretch =
        gsn_strain_of_panel(inputs, poses, count, options.markers_um, a->summary.mean_triangle);
    a->strain_mode = strain_mode(specimen->protocol);
    use_strain(a, &options);
    return GSN_OK;
}
