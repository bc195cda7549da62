/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Stacks of sections mounted in a known way, for the tests of the pose. */
#ifndef GSN_TESTS_REGISTER_MOUNTED_H
#define GSN_TESTS_REGISTER_MOUNTED_H

#include "pipeline/register/pose/pose.h"

#include "tests/register/draw.h"

/* The phantom's triangle (PHANTOM.md section 3) and its pixel. */
extern const struct gsn_point mounted_marks[GSN_FIDUCIALS];
extern const struct gsn_pose_options mounted_declared;
#define MOUNTED_PX 16.0

/* How a section was mounted: block um -> panel px. */
struct mounted {
    double angle;
    int flipped;
    struct gsn_point centre_px;
    double strain[3]; /* common, x against y, shear, about the point below */
    struct gsn_point about;
};

/* What a stack suffers from. All sd in um per axis; strain as above. */
struct mounted_world {
    const struct gsn_point *marks;
    double angle, flips; /* angles within +-angle; share mounted face down */
    double burn_um;      /* of every mark, unknown to its fit */
    double fit_um;       /* of the typical mark, told by its covariance */
    double unequal;      /* share of marks whose fit is 4 times poorer along a random direction */
    double modest;       /* the fits say this many times too little, where it is more than 1 */
    double erratic;      /* what a fit says is right but for chance, of this sd in its logarithm */
    double strain_sd[3];
    int heavy; /* strain with Student's t, 3 degrees of freedom, same scale */
    struct gsn_point slope[GSN_FIDUCIALS]; /* um per section */
    double missing;                        /* share of sections that have lost one mark */
};

/* Where a point of the block appears, with the section's strain. */
struct gsn_point mounted_px(const struct mounted *m, struct gsn_point um);

struct mounted_stack {
    size_t count;
    struct mounted *mounting;
    struct gsn_pose_input *input;
    struct gsn_pose *pose;
    struct gsn_pose_summary summary;
};

struct mounted_stack mounted_new(size_t count);
void mounted_done(struct mounted_stack *s);
void mounted_draw(struct mounted_stack *s, const struct mounted_world *world,
                  struct draw_chance *chance);
void mounted_solve(struct mounted_stack *s, const struct gsn_pose_options *options);

/* Where the pose puts a point of the block, less where it is. */
struct gsn_point mounted_error(const struct mounted_stack *s, size_t i, struct gsn_point target);

/* The target registration error of three marks alike, FLE^2/3 (1 + r^2 / (2 rho^2)): at a distance
 * r from the centroid of a triangle of that rho. */
double mounted_tre(double fle, double rho, double r);

/* The number of trials a test makes: few, or as many as GIESON_TRIALS says. */
size_t mounted_trials(size_t few);

#endif
