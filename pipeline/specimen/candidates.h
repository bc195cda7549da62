/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The poses that a doubtful section may have, for a person to choose from.
 *
 * A candidate is a way to call spots of the section its marks; its pose follows by laying them on
 * the triangle. Those that one panel alone shows come from gsn_fiducials_hypotheses(); a section
 * whose three marks contradict the stack has those that leave one of them out. A person's choice
 * names the spots and not the number, so that it holds for as long as they are there. Marks are in
 * pixels of the upright picture. */
#ifndef GSN_SPECIMEN_CANDIDATES_H
#define GSN_SPECIMEN_CANDIDATES_H

#include "pipeline/register/fiducial/correspondence.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/pose/pose.h"
#include "pipeline/register/pose/tre.h"

enum { GSN_CANDIDATES = GSN_FIDUCIAL_HYPOTHESES, GSN_CANDIDATE_WORDS = 160 };

struct gsn_candidate {
    struct gsn_fiducial mark[GSN_FIDUCIALS]; /* marks 1..3 */
    int mirrored; /* against the triangle by which they were called marks */
    double share; /* how likely, of those listed; NaN: not told */
    int laid;     /* whether the map is known */
    struct gsn_affine panel_to_block_um;
    int flipped, rotated180;
    double
        error_um; /* predicted, root mean square over the targets; NaN: the stack is not solved */
    char differs[GSN_CANDIDATE_WORDS]; /* what it rests on, or is other than in the first */
};

struct gsn_candidates {
    size_t count; /* 0: the section is not in doubt, or has nothing to choose from */
    struct gsn_candidate at[GSN_CANDIDATES];
    unsigned chosen; /* by a person: a number from 1; 0: by nobody */
};

/* What a person chose: where the marks are. */
struct gsn_candidate_choice {
    struct gsn_point px[GSN_FIDUCIALS];
    int found[GSN_FIDUCIALS];
    int mirrored;
};

/* What the panel alone shows. */
void gsn_candidates_of_rivals(const struct gsn_fiducial_hypothesis *rivals, size_t count,
                              struct gsn_candidates *ret_list);
/* Of a section with three marks: each pair of them, that without mark 1 first, then all three. The
 * caller guarantees that all are found. */
void gsn_candidates_of_marks(const struct gsn_fiducial mark[GSN_FIDUCIALS], int mirrored,
                             struct gsn_candidates *ret_list);
/* Of a section whose pose is gross with three marks: as the stack lays them, the likeliest first.
 */
void gsn_candidates_of_gross(const struct gsn_fiducial mark[GSN_FIDUCIALS],
                             const struct gsn_pose *pose, struct gsn_candidates *ret_list);

/* Lays every candidate on the triangle of the marks; one that cannot be laid stays as it is. */
void gsn_candidates_lay(struct gsn_candidates *list, double px_um,
                        const struct gsn_point triangle[GSN_FIDUCIALS]);
/* Predicts the errors of those that are laid, by the marks' localisation error in the whole stack.
 */
void gsn_candidates_predict(struct gsn_candidates *list, double px_um,
                            const struct gsn_pose_summary *summary,
                            const struct gsn_pose_targets *targets);
/* Says of those that are laid whether they are turned by more than 90 degrees against upright, and
 * of each what it differs in. */
void gsn_candidates_say(struct gsn_candidates *list, struct gsn_point upright);

/* Where a section's x points that is laid so, as a unit vector of the block; what is mirrored
 * counts as turned back over. */
struct gsn_point gsn_candidate_direction(const struct gsn_affine *panel_to_block_um);

/* The number of the candidate that a person meant, from 1; 0 when none has its marks there. */
unsigned gsn_candidates_meant(const struct gsn_candidates *list,
                              const struct gsn_candidate_choice *choice);

#endif
