/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: generalised Procrustes analysis of the three marks (Gower, Psychometrika 40, 33, 1975)
 * with robust noise, a prior of the sections' shapes and a test for outliers.
 *
 * Steps of gsn_pose_solve(). 1. Observations are added and checked. 2. procrustes.c finds the mean
 * triangle, the numbering of every section and the localisation error. 3. The block's frame is laid
 * on the protocol's marks, or taken from the triangle itself. 4. shape_prior.c learns what the
 * sections' shapes have in common: strain, and axes that are not parallel. 5. Each section is
 * fitted with its whole covariance (weighted_fit.h); marks that contradict the stack by more than
 * 0.1 % of good sections do (outlier.h) make it gross, and it gets three candidates of two marks
 * each. 6. The summary.
 *
 * Fails when no section has three marks, when the triangle is degenerate or too nearly equilateral
 * to tell which mark is which, and when memory runs out.
 */
#include "pipeline/register/pose/pose.h"

#include "pipeline/core/mem.h"
#include "pipeline/register/pose/outlier.h"
#include "pipeline/register/pose/procrustes_internal.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* Without a protocol's triangle, up is what most sections say. */
static void turn_to_majority(struct gsn_procrustes *s)
{
    size_t mirrored = 0;

    for (size_t i = 0; i < s->count; i++)
        mirrored += s->member[i].marks == GSN_FIDUCIALS && s->member[i].mirrored;
    if (2 * mirrored <= s->with_three)
        return;
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        s->triangle[i].x = -s->triangle[i].x;
    gsn_procrustes_fit(s);
}

/* The block frame: on the protocol's marks, or else from the triangle itself. */
static int set_frame(struct gsn_procrustes *s, struct gsn_error *err)
{
    const struct gsn_point c = gsn_triangle_centroid(s->triangle);
    const double length = gsn_triangle_side(s->triangle, 0);
    struct gsn_rigid motion;
    int r;

    if (s->declared) {
        r = gsn_rigid_fit(s->triangle, s->declared, NULL, GSN_FIDUCIALS, &motion, NULL, err);
        if (r < 0)
            return r;
    } else {
        motion.cos = (s->triangle[1].x - s->triangle[0].x) / length;
        motion.sin = -(s->triangle[1].y - s->triangle[0].y) / length;
        motion.dx = -(motion.cos * c.x - motion.sin * c.y);
        motion.dy = -(motion.sin * c.x + motion.cos * c.y);
    }
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        s->triangle[i] = gsn_rigid_apply(&motion, s->triangle[i]);
    gsn_procrustes_align(s, gsn_procrustes_acceptable(s));
    return GSN_OK;
}

/* Laid on two of its marks. */
static struct gsn_pose_candidate fit_without(const struct gsn_procrustes *s,
                                             const struct gsn_procrustes_member *m,
                                             const struct gsn_pose_fit_input *marks, size_t mark,
                                             const struct gsn_pose_targets *targets)
{
    struct gsn_pose_candidate candidate = { .chi2 = 0 };
    struct gsn_pose_fit_input two = *marks;
    struct gsn_pose_fit fit;

    two.count = 2;
    for (size_t i = mark; i < 2; i++) {
        two.from[i] = marks->from[i + 1];
        two.onto[i] = marks->onto[i + 1];
        two.cov[i] = marks->cov[i + 1];
    }
    if (gsn_pose_fit(&two, &fit, NULL) < 0)
        return candidate;
    fit.error.freedom = s->freedom;
    candidate.panel_to_block_um = gsn_rigid_to_affine(&fit.motion, m->input->px_um, m->mirrored);
    candidate.tre_um = gsn_pose_tre_rms(&fit.error, targets, 0);
    candidate.chi2 = fit.chi2;
    return candidate;
}

/* The likelihood of each mark being the wrong one, as exp(blame / 2). */
static void list_candidates(const struct gsn_procrustes *s, const struct gsn_procrustes_member *m,
                            const struct gsn_pose_fit_input *marks, const struct gsn_pose_fit *fit,
                            const struct gsn_pose_targets *targets, struct gsn_pose *pose)
{
    const double most = fmax(fmax(fit->blame[0], fit->blame[1]), fit->blame[2]);
    double sum = 0;

    for (size_t i = 0; i < GSN_FIDUCIALS; i++) {
        pose->candidate[i] = fit_without(s, m, marks, i, targets);
        pose->candidate[i].share = exp(0.5 * (fit->blame[i] - most));
        sum += pose->candidate[i].share;
    }
    for (size_t i = 0; i < GSN_FIDUCIALS; i++)
        pose->candidate[i].share /= sum;
}

static void note_residuals(const struct gsn_procrustes_member *m,
                           const struct gsn_pose_fit_input *marks, const struct gsn_rigid *motion,
                           struct gsn_pose *pose)
{
    double sum = 0;

    for (size_t i = 0, k = 0; i < GSN_FIDUCIALS; i++) {
        if (!m->input->marks[m->order[i]].found)
            continue;
        const struct gsn_point laid = gsn_rigid_apply(motion, marks->from[k]);

        pose->onto_um[i] = marks->onto[k];
        pose->off_um[i] =
            (struct gsn_point){ laid.x - marks->onto[k].x, laid.y - marks->onto[k].y };
        pose->residual_um[i] = hypot(pose->off_um[i].x, pose->off_um[i].y);
        sum += pose->residual_um[i] * pose->residual_um[i];
        k++;
    }
    pose->rms_um = sqrt(sum / (double)marks->count);
}

/* Whether the marks contradict the stack by more than 0.1 % of good sections do, none of them
 * trusted beyond the finest. */
static int contradicts_stack(const struct gsn_procrustes *s, const struct gsn_pose_fit_input *marks,
                             const struct gsn_pose_fit *fit)
{
    const double coarser = fmax(s->finest - s->mark_um2, 0);
    struct gsn_pose_fit_input blunt = *marks;
    struct gsn_pose_fit again = *fit;

    /* The surface on which two sections contradict as much is convex, so that all of it lies on one
     * side of the plane at its nearest point: no section that is nearer than the limit of a single
     * side is beyond that of all three. */
    if (fit->chi2 <= s->side_limit)
        return 0;
    for (size_t i = 0; i < marks->count; i++) {
        blunt.cov[i].xx += coarser;
        blunt.cov[i].yy += coarser;
    }
    if (coarser > 0 && gsn_pose_fit(&blunt, &again, NULL) < 0)
        return 1;
    if (marks->count < GSN_FIDUCIALS || again.chi2 <= s->side_limit)
        return again.chi2 > s->side_limit;
    return gsn_outlier_false_alarm(again.left, (const double(*)[2][3])again.off, s->spread_freedom,
                                   s->widening) < GSN_POSE_ALPHA;
}

static struct gsn_pose pose_of(const struct gsn_procrustes *s, struct gsn_procrustes_member *m,
                               const struct gsn_pose_targets *targets)
{
    struct gsn_pose pose = { .state = GSN_POSE_NONE, .order = { 0, 1, 2 } };
    struct gsn_pose_fit_input marks;
    struct gsn_pose_fit fit;

    if (m->marks < 2 || !isfinite(m->squares))
        return pose;
    (void)gsn_procrustes_observation(s, m, &marks);
    if (gsn_pose_fit(&marks, &fit, NULL) < 0)
        return pose;
    m->motion = fit.motion;
    pose.state = marks.count == GSN_FIDUCIALS ? GSN_POSE_OK : GSN_POSE_TWO_MARKS;
    pose.flipped = m->mirrored;
    memcpy(pose.order, m->order, sizeof pose.order);
    pose.panel_to_block_um = gsn_rigid_to_affine(&fit.motion, m->input->px_um, m->mirrored);
    note_residuals(m, &marks, &fit.motion, &pose);
    pose.error = fit.error;
    pose.error.freedom = s->freedom;
    memcpy(pose.strain, fit.strain, sizeof pose.strain);
    pose.tre_um = gsn_pose_tre_rms(&pose.error, targets, 0);
    pose.chi2 = fit.chi2;
    pose.gross = contradicts_stack(s, &marks, &fit);
    if (pose.gross && marks.count == GSN_FIDUCIALS)
        list_candidates(s, m, &marks, &fit, targets, &pose);
    return pose;
}

/* Upright is the block frame itself when the protocol gives it, otherwise the way most sections
 * lie. */
static void mark_rotated(const struct gsn_procrustes *s, int declared, struct gsn_pose *poses)
{
    double x = 1, y = 0;

    if (!declared) {
        x = y = 0;
        for (size_t i = 0; i < s->count; i++) {
            if (poses[i].state != GSN_POSE_NONE) {
                x += s->member[i].motion.cos;
                y += s->member[i].motion.sin;
            }
        }
    }
    for (size_t i = 0; i < s->count; i++) {
        const struct gsn_rigid *motion = &s->member[i].motion;

        poses[i].rotated180 =
            poses[i].state != GSN_POSE_NONE && motion->cos * x + motion->sin * y < 0;
    }
}

static struct gsn_pose_summary summarise_stack(const struct gsn_procrustes *s,
                                               const struct gsn_pose *poses,
                                               const struct gsn_point *declared)
{
    struct gsn_pose_summary sum = { .fle_um = sqrt(2 * s->mark_um2),
                                    .rho_um = gsn_triangle_rho(s->triangle),
                                    .freedom = s->freedom,
                                    .stretches = s->stretches,
                                    .as_declared = s->as_declared,
                                    .axes = s->axes,
                                    .scale_vs_declared = 1,
                                    .side_ratio = { 1, 1, 1 },
                                    .isosceles_sigma = s->scalene_sigma,
                                    .flips_told = s->flips_told };
    size_t mirrored = 0;

    memcpy(sum.mean_triangle, s->triangle, sizeof sum.mean_triangle);
    for (size_t i = 0; i < s->count; i++) {
        sum.with_three += poses[i].state == GSN_POSE_OK;
        sum.with_two += poses[i].state == GSN_POSE_TWO_MARKS;
        sum.without += poses[i].state == GSN_POSE_NONE;
        sum.flipped += poses[i].flipped != 0;
        mirrored += poses[i].state == GSN_POSE_OK && poses[i].flipped;
    }
    sum.chirality = declared && 2 * mirrored > sum.with_three ? -1 : 1;
    for (int i = 0; i < 3; i++)
        sum.strain_sd[i] = sqrt(fmax(s->strain[i][i], 0));
    for (int i = 0; declared && i < GSN_FIDUCIALS; i++)
        sum.side_ratio[i] = gsn_triangle_side(s->triangle, i) / gsn_triangle_side(declared, i);
    if (declared)
        sum.scale_vs_declared = sum.rho_um / gsn_triangle_rho(declared);
    return sum;
}

static int check_inputs(const struct gsn_pose_input *inputs, size_t count,
                        const struct gsn_pose_options *options, struct gsn_error *err)
{
    const struct gsn_point *declared = options->markers_um;

    for (size_t i = 0; i < count; i++) {
        if (!(inputs[i].px_um > 0 && isfinite(inputs[i].px_um)))
            return gsn_fail(err, GSN_E_INPUT, "section %u: a pixel of %g um", inputs[i].serial + 1,
                            inputs[i].px_um);
        for (int k = 0; k < GSN_FIDUCIALS; k++) {
            const struct gsn_fiducial *mark = &inputs[i].marks[k];

            if (mark->found && !(isfinite(mark->px.x) && isfinite(mark->px.y)))
                return gsn_fail(err, GSN_E_INPUT, "section %u: the place of mark %d is not finite",
                                inputs[i].serial + 1, k + 1);
        }
    }
    for (int k = 0; declared && k < GSN_FIDUCIALS; k++) {
        if (!isfinite(declared[k].x) || !isfinite(declared[k].y))
            return gsn_fail(err, GSN_E_INPUT, "markers_um: the place of mark %d is not finite",
                            k + 1);
        if (gsn_triangle_side(declared, k) <= 1e-9 * gsn_triangle_rho(declared) ||
            gsn_triangle_rho(declared) == 0)
            return gsn_fail(err, GSN_E_MARKERS, "markers_um: marks %d and %d coincide", k + 1,
                            (k + 1) % GSN_FIDUCIALS + 1);
    }
    return GSN_OK;
}

/* With three sides alike, the sections could be turned by a third and nobody would see. */
static int check_shape(const struct gsn_procrustes *s, struct gsn_error *err)
{
    const double a = gsn_triangle_side(s->triangle, 0), b = gsn_triangle_side(s->triangle, 1),
                 c = gsn_triangle_side(s->triangle, 2);
    const double sigma = sqrt(fmax(s->mark_um2, s->finest));

    if (fmin(fmin(a, b), c) < GSN_POSE_SCALENE * sigma)
        return gsn_fail(err, GSN_E_MARKERS, "two of the three marks coincide in most sections");
    if (fmax(fmax(a, b), c) - fmin(fmin(a, b), c) < GSN_POSE_SCALENE * sigma)
        return gsn_fail(err, GSN_E_MARKERS,
                        "the marks' triangle has sides of %.0f, %.0f and %.0f um, too nearly "
                        "equal to tell which mark is which",
                        a, b, c);
    return GSN_OK;
}

/* Where no targets are given, two points on either side at the distance rho from the centroid. */
static struct gsn_pose_targets find_targets(const struct gsn_procrustes *s,
                                            const struct gsn_pose_options *options)
{
    const struct gsn_point c = gsn_triangle_centroid(s->triangle);
    const double rho = gsn_triangle_rho(s->triangle);
    const struct gsn_point around[] = {
        { c.x + rho, c.y }, { c.x - rho, c.y }, { c.x, c.y + rho }, { c.x, c.y - rho }
    };

    return options->target_count > 0
               ? gsn_pose_targets_of(options->targets_um, options->target_count)
               : gsn_pose_targets_of(around, 4);
}

static int solve_stack(struct gsn_procrustes *s, struct gsn_error *err)
{
    int r;

    if (s->declared)
        memcpy(s->triangle, s->declared, sizeof s->triangle);
    else
        gsn_procrustes_initialise(s);
    gsn_procrustes_fit(s);
    if (!s->declared)
        turn_to_majority(s);
    r = check_shape(s, err);
    if (r >= 0)
        r = set_frame(s, err);
    if (r >= 0)
        r = gsn_shape_prior_learn(s, err);
    if (r >= 0 && (s->axes.slanted || s->axes.bent || (s->sizes && s->stretches)))
        gsn_procrustes_align(s, gsn_procrustes_acceptable(s));
    if (r >= 0)
        gsn_procrustes_learn_alike(s);
    return r;
}

int gsn_pose_solve(const struct gsn_pose_input *inputs, size_t count,
                   const struct gsn_pose_options *options, struct gsn_pose *ret_poses,
                   struct gsn_pose_summary *ret_summary, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_procrustes_member) member = gsn_alloc_array(count, sizeof *member);
    gsn_auto_mem(double) scratch = gsn_alloc_array(count * GSN_FIDUCIALS, sizeof *scratch);
    struct gsn_procrustes s = { .member = member,
                                .count = count,
                                .scratch = scratch,
                                .declared = options->markers_um,
                                .sizes = options->sizes };
    struct gsn_pose_targets targets;
    int r;

    assert((inputs || count == 0) && options && ret_poses && ret_summary);

    if (!member || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the poses of %zu sections", count);
    r = check_inputs(inputs, count, options, err);
    if (r < 0)
        return r;
    gsn_procrustes_add_observations(&s, inputs);
    if (s.with_three == 0)
        return gsn_fail(err, GSN_E_MARKERS, "none of %zu sections has three marks", count);
    r = solve_stack(&s, err);
    if (r < 0)
        return r;

    targets = find_targets(&s, options);
    for (size_t i = 0; i < count; i++)
        ret_poses[i] = pose_of(&s, &member[i], &targets);
    mark_rotated(&s, options->markers_um != NULL, ret_poses);
    *ret_summary = summarise_stack(&s, ret_poses, options->markers_um);
    return GSN_OK;
}

/* Whether two marks could be laid at all. */
static int is_laid(const struct gsn_pose_candidate *candidate)
{
    return gsn_affine_det(&candidate->panel_to_block_um) != 0;
}

/* Mean square distance over the targets of where two poses put what lies there by the second. */
static double mean_square_apart(const struct gsn_affine *a, const struct gsn_affine *b,
                                const struct gsn_point *targets, size_t count)
{
    const struct gsn_affine to_px = gsn_affine_inverse(b);
    double sum = 0;

    for (size_t i = 0; i < count; i++) {
        const struct gsn_point p = gsn_affine_apply(a, gsn_affine_apply(&to_px, targets[i]));

        sum += pow(p.x - targets[i].x, 2) + pow(p.y - targets[i].y, 2);
    }
    return count > 0 ? sum / (double)count : 0;
}

void gsn_pose_likeliest(const struct gsn_pose *pose, const struct gsn_point *targets, size_t count,
                        struct gsn_affine *ret_panel_to_block_um, double *ret_error_um)
{
    const struct gsn_pose_candidate *c = pose->candidate;
    double square = 0;
    int best = 0;

    assert(pose->gross && pose->state == GSN_POSE_OK);

    for (int i = 1; i < GSN_FIDUCIALS; i++)
        if (c[i].share > c[best].share)
            best = i;
    if (!is_laid(&c[best])) {
        *ret_panel_to_block_um = pose->panel_to_block_um;
        *ret_error_um = hypot(pose->tre_um, pose->rms_um);
        return;
    }
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        if (is_laid(&c[i]))
            square += c[i].share * (c[i].tre_um * c[i].tre_um +
                                    mean_square_apart(&c[best].panel_to_block_um,
                                                      &c[i].panel_to_block_um, targets, count));
    *ret_panel_to_block_um = c[best].panel_to_block_um;
    *ret_error_um = sqrt(square);
}
