/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"

#include <math.h>

/* As gsn_pose_solve() takes them. */
static struct gsn_pose_targets targets_of(const struct gsn_pose_summary *summary,
                                          const struct gsn_pose_options *options)
{
    const struct gsn_point *t = summary->mean_triangle;
    const double rho = summary->rho_um, x = (t[0].x + t[1].x + t[2].x) / GSN_MARKS,
                 y = (t[0].y + t[1].y + t[2].y) / GSN_MARKS;
    const struct gsn_point around[] = {
        { x + rho, y }, { x - rho, y }, { x, y + rho }, { x, y - rho }
    };

    return options->target_count > 0
               ? gsn_pose_targets_of(options->targets_um, options->target_count)
               : gsn_pose_targets_of(around, 4);
}

/* Upright is the job's frame, or else the way most sections lie. */
static struct gsn_point upright_of(const struct gsn_assembly *a, int declared)
{
    struct gsn_point upright = { declared, 0 };

    for (size_t i = 0; i < a->section_count && !declared; i++) {
        struct gsn_point d;

        if (!a->section[i].posed)
            continue;
        d = gsn_candidate_direction(&a->section[i].pose.panel_to_block_um);
        upright.x += d.x;
        upright.y += d.y;
    }
    return upright;
}

/* Lays a section's candidates in the stack that the marks solved. */
static void lay_candidates(const struct gsn_specimen *specimen, const struct gsn_assembly *a,
                           const struct gsn_pose_targets *targets, struct gsn_assembly_section *s)
{
    const double px_um = gsn_assembly_panel(specimen, s->panel)->px_um;
    struct gsn_point onto[GSN_MARKS];

    gsn_axes_at(&a->summary.axes, s->seen.serial, a->summary.mean_triangle, onto);
    gsn_candidates_lay(&s->candidates, px_um, onto);
    gsn_candidates_predict(&s->candidates, px_um, &a->summary, targets);
}

void gsn_assembly_list_candidates(const struct gsn_specimen *specimen,
                                  const struct gsn_pose_options *options, struct gsn_assembly *a)
{
    const struct gsn_pose_targets targets = targets_of(&a->summary, options);
    const struct gsn_point upright = upright_of(a, options->markers_um != NULL);

    for (size_t i = 0; i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];

        if (s->pose.gross && s->pose.state == GSN_POSE_OK)
            gsn_candidates_of_gross(s->seen.mark, &s->pose, &s->candidates);
        else if (s->candidates.count > 0)
            lay_candidates(specimen, a, &targets, s);
        gsn_candidates_say(&s->candidates, upright);
    }
}

void gsn_assembly_offer_marks(const struct gsn_specimen *specimen,
                              const struct gsn_pose_options *options, const struct gsn_assembly *a,
                              struct gsn_assembly_section *s)
{
    const struct gsn_pose_targets targets = targets_of(&a->summary, options);

    gsn_candidates_of_marks(s->seen.mark, s->pose.flipped, &s->candidates);
    lay_candidates(specimen, a, &targets, s);
    gsn_candidates_say(&s->candidates, upright_of(a, options->markers_um != NULL));
}
