/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: generalised least squares on the planar rigid motions, by Gauss and Newton's steps from
 * the closed form (rigid.h); best linear unbiased prediction of the strain (Henderson 1975).
 *
 * Steps of gsn_pose_fit(). 1. The marks' covariances are turned with the section, the strain's
 * covariance is added and their sum inverted. 2. The pose's normal equations are solved and the
 * motion is moved, four times; the weights are worked out for the first two. 3. judge_residuals():
 * chi-squared, what of it goes when a mark may lie anywhere, and three white numbers that the test
 * for outliers takes. 4. The strain, shrunk by its noise, and its covariance with the pose's error.
 *
 * Fails as rigid.h does and where a covariance is not positive. */
#include "pipeline/register/pose/weighted_fit.h"

#include "pipeline/core/linalg.h"

#include <assert.h>
#include <math.h>
#include <string.h>

enum { COORDS = 2 * GSN_FIDUCIALS, STEPS = 4 };

void gsn_pose_jacobian(struct gsn_point u, double ret_pose[2][3], double ret_strain[2][3])
{
    const double pose[2][3] = { { 1, 0, -u.y }, { 0, 1, u.x } };
    const double strain[2][3] = { { u.x, u.x, u.y }, { u.y, -u.y, u.x } };

    memcpy(ret_pose, pose, sizeof pose);
    memcpy(ret_strain, strain, sizeof strain);
}

/* The matrices of one section, n coordinates. */
struct system {
    size_t n;
    double j[COORDS][3], k[COORDS][3];
    double own[GSN_FIDUCIALS][3];  /* Omega's diagonal blocks: xx, xy, yy */
    double weight[COORDS][COORDS]; /* Omega^-1 */
    double gain[3][COORDS];        /* pose error = -gain residual */
    double pose[3][3];
};

/* The covariance turned with the section. */
static struct gsn_cov2 turn_covariance(struct gsn_cov2 v, const struct gsn_rigid *m)
{
    const double c = m->cos, s = m->sin;

    return (struct gsn_cov2){ c * c * v.xx - 2 * c * s * v.xy + s * s * v.yy,
                              c * s * (v.xx - v.yy) + (c * c - s * s) * v.xy,
                              s * s * v.xx + 2 * c * s * v.xy + c * c * v.yy };
}

static int find_weights(const struct gsn_pose_fit_input *in, const struct gsn_rigid *motion,
                        struct system *s)
{
    for (size_t a = 0; a < s->n; a++)
        for (size_t b = 0; b < s->n; b++) {
            double sum = 0;

            for (size_t i = 0; i < 3; i++)
                for (size_t l = 0; l < 3; l++)
                    sum += s->k[a][i] * in->strain[i][l] * s->k[b][l];
            s->weight[a][b] = sum;
        }
    for (size_t i = 0; i < in->count; i++) {
        const struct gsn_cov2 v = turn_covariance(in->cov[i], motion);

        s->weight[2 * i][2 * i] += v.xx;
        s->weight[2 * i][2 * i + 1] += v.xy;
        s->weight[2 * i + 1][2 * i] += v.xy;
        s->weight[2 * i + 1][2 * i + 1] += v.yy;
        s->own[i][0] = s->weight[2 * i][2 * i];
        s->own[i][1] = s->weight[2 * i][2 * i + 1];
        s->own[i][2] = s->weight[2 * i + 1][2 * i + 1];
    }
    return gsn_invert_spd(&s->weight[0][0], s->n, COORDS);
}

/* (J' W J)^-1 and (J' W J)^-1 J' W. */
static int solve_pose(struct system *s)
{
    double normal[3][3] = { 0 }, jw[3][COORDS] = { 0 };

    for (size_t i = 0; i < 3; i++)
        for (size_t b = 0; b < s->n; b++)
            for (size_t a = 0; a < s->n; a++)
                jw[i][b] += s->j[a][i] * s->weight[a][b];
    for (size_t i = 0; i < 3; i++)
        for (size_t l = 0; l < 3; l++)
            for (size_t b = 0; b < s->n; b++)
                normal[i][l] += jw[i][b] * s->j[b][l];
    if (gsn_invert_spd(&normal[0][0], 3, 3) < 0)
        return -1;
    for (size_t i = 0; i < 3; i++) {
        for (size_t l = 0; l < 3; l++)
            s->pose[i][l] = normal[i][l];
        for (size_t b = 0; b < s->n; b++) {
            s->gain[i][b] = 0;
            for (size_t l = 0; l < 3; l++)
                s->gain[i][b] += normal[i][l] * jw[l][b];
        }
    }
    return 0;
}

static void find_residuals(const struct gsn_pose_fit_input *in, const struct gsn_rigid *motion,
                           double *ret_y)
{
    for (size_t i = 0; i < in->count; i++) {
        const struct gsn_point p = gsn_rigid_apply(motion, in->from[i]);

        ret_y[2 * i] = p.x - in->onto[i].x;
        ret_y[2 * i + 1] = p.y - in->onto[i].y;
    }
}

/* The motion followed by the small one (shift x, shift y, angle about a point). */
static struct gsn_rigid move_motion(const struct gsn_rigid *m, const double p[3],
                                    struct gsn_point about)
{
    const double c = cos(p[2]), s = sin(p[2]);
    const double dx = m->dx - about.x, dy = m->dy - about.y;

    return (struct gsn_rigid){ .cos = c * m->cos - s * m->sin,
                               .sin = s * m->cos + c * m->sin,
                               .dx = about.x + c * dx - s * dy + p[0],
                               .dy = about.y + s * dx + c * dy + p[1] };
}

/* Gauss and Newton's steps: the residuals are so small beside the triangle that each step gains
 * some five digits. */
static int fit_motion(const struct gsn_pose_fit_input *in, struct system *s,
                      struct gsn_rigid *motion, double *ret_y)
{
    for (int step = 0; step < STEPS; step++) {
        double p[3] = { 0 };

        if (step < 2 && (find_weights(in, motion, s) < 0 || solve_pose(s) < 0))
            return -1;
        find_residuals(in, motion, ret_y);
        for (size_t i = 0; i < 3; i++)
            for (size_t a = 0; a < s->n; a++)
                p[i] -= s->gain[i][a] * ret_y[a];
        *motion = move_motion(motion, p, in->about);
    }
    find_residuals(in, motion, ret_y);
    return 0;
}

/* Q = A' A, where three rows are enough: what a pose leaves of six coordinates has three degrees of
 * freedom. Of covariance Q^-1 as far as it goes, A y is white. Spoils q. */
static void factor_three_rows(double q[COORDS][COORDS], double a[3][COORDS])
{
    for (size_t k = 0; k < 3; k++) {
        size_t p = 0;

        for (size_t i = 1; i < COORDS; i++)
            if (q[i][i] > q[p][p])
                p = i;
        for (size_t i = 0; i < COORDS; i++)
            a[k][i] = q[p][p] > 0 ? q[p][i] / sqrt(q[p][p]) : 0;
        for (size_t i = 0; i < COORDS; i++)
            for (size_t j = 0; j < COORDS; j++)
                q[i][j] -= a[k][i] * a[k][j];
    }
}

/* Spoils q. */
static void whiten_residuals(const struct system *s, double q[COORDS][COORDS], const double *y,
                             struct gsn_pose_fit *fit)
{
    double a[3][COORDS];

    factor_three_rows(q, a);
    for (size_t k = 0; k < 3; k++) {
        fit->left[k] = 0;
        for (size_t i = 0; i < COORDS; i++)
            fit->left[k] += a[k][i] * y[i];
        for (size_t m = 0; m < GSN_FIDUCIALS; m++) {
            const double xx = sqrt(s->own[m][0]), xy = s->own[m][1] / xx;

            fit->off[m][0][k] = a[k][2 * m] * xx + a[k][2 * m + 1] * xy;
            fit->off[m][1][k] = a[k][2 * m + 1] * sqrt(fmax(s->own[m][2] - xy * xy, 0));
        }
    }
}

/* The logarithm of a covariance's determinant. */
static double find_log_det(const double *m, size_t n, size_t stride)
{
    double lower[COORDS][COORDS], sum = 0;

    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++)
            lower[i][j] = m[i * stride + j];
    if (gsn_cholesky(&lower[0][0], n, COORDS) < 0)
        return INFINITY;
    for (size_t i = 0; i < n; i++)
        sum += 2 * log(lower[i][i]);
    return sum;
}

/* W y, and the part of W that is left after the pose: Q = W - W J gain. */
static void judge_residuals(const struct system *s, const double *y, size_t marks,
                            struct gsn_pose_fit *fit)
{
    double wy[COORDS] = { 0 }, q[COORDS][COORDS], wj[COORDS][3] = { 0 };

    fit->chi2 = 0;
    fit->log_det =
        -find_log_det(&s->weight[0][0], s->n, COORDS) - find_log_det(&s->pose[0][0], 3, 3);
    for (size_t a = 0; a < s->n; a++) {
        for (size_t b = 0; b < s->n; b++) {
            wy[a] += s->weight[a][b] * y[b];
            for (size_t i = 0; i < 3; i++)
                wj[a][i] += s->weight[a][b] * s->j[b][i];
        }
        fit->chi2 += y[a] * wy[a];
    }
    for (size_t a = 0; a < s->n; a++)
        for (size_t b = 0; b < s->n; b++) {
            q[a][b] = s->weight[a][b];
            for (size_t i = 0; i < 3; i++)
                q[a][b] -= wj[a][i] * s->gain[i][b];
        }
    for (size_t m = 0; marks == GSN_FIDUCIALS && m < marks; m++) {
        const size_t a = 2 * m, b = a + 1;
        const double det = q[a][a] * q[b][b] - q[a][b] * q[b][a];

        fit->blame[m] = det > 0 ? (q[b][b] * wy[a] * wy[a] - 2 * q[a][b] * wy[a] * wy[b] +
                                   q[a][a] * wy[b] * wy[b]) /
                                      det
                                : 0;
    }
    if (marks == GSN_FIDUCIALS)
        whiten_residuals(s, q, y, fit);
}

/* strain K' W (y), its covariance with the pose's error, and what is left of it: with
 * T = strain K' W,  left = strain - T (I - J gain) K strain. */
static void estimate_strain(const struct gsn_pose_fit_input *in, const struct system *s,
                            const double *y, struct gsn_pose_fit *fit)
{
    double t[3][COORDS] = { 0 }, ks[COORDS][3] = { 0 };
    struct gsn_pose_error *e = &fit->error;

    for (size_t a = 0; a < s->n; a++)
        for (size_t i = 0; i < 3; i++)
            for (size_t l = 0; l < 3; l++)
                ks[a][i] += s->k[a][l] * in->strain[l][i];
    for (size_t i = 0; i < 3; i++)
        for (size_t b = 0; b < s->n; b++)
            for (size_t a = 0; a < s->n; a++)
                t[i][b] += ks[a][i] * s->weight[a][b];
    for (size_t i = 0; i < 3; i++) {
        fit->strain[i] = 0;
        for (size_t a = 0; a < s->n; a++)
            fit->strain[i] += t[i][a] * y[a];
        for (size_t l = 0; l < 3; l++) {
            e->cross[i][l] = 0;
            for (size_t a = 0; a < s->n; a++)
                e->cross[i][l] -= s->gain[i][a] * ks[a][l];
        }
    }
    for (size_t i = 0; i < 3; i++)
        for (size_t l = 0; l < 3; l++) {
            double sum = in->strain[i][l];

            for (size_t a = 0; a < s->n; a++) {
                double rest = ks[a][l];

                for (size_t p = 0; p < 3; p++)
                    rest += s->j[a][p] * e->cross[p][l];
                sum -= t[i][a] * rest;
            }
            e->left[i][l] = sum;
        }
}

int gsn_pose_fit(const struct gsn_pose_fit_input *input, struct gsn_pose_fit *ret_fit,
                 struct gsn_error *err)
{
    struct gsn_pose_fit fit = { .error.about = input->about };
    struct system s = { .n = 2 * input->count };
    double y[COORDS], weight[GSN_FIDUCIALS];
    int r;

    assert(input->count >= 2 && input->count <= GSN_FIDUCIALS && ret_fit);

    for (size_t i = 0; i < input->count; i++) {
        const struct gsn_point u = { input->onto[i].x - input->about.x,
                                     input->onto[i].y - input->about.y };

        gsn_pose_jacobian(u, &s.j[2 * i], &s.k[2 * i]);
        weight[i] = 1 / (input->cov[i].xx + input->cov[i].yy);
        if (!(weight[i] > 0 && isfinite(weight[i])))
            return gsn_fail(err, GSN_E_MARKERS, "the covariance of mark %zu is not positive",
                            i + 1);
    }
    r = gsn_rigid_fit(input->from, input->onto, weight, input->count, &fit.motion, NULL, err);
    if (r < 0)
        return r;
    if (fit_motion(input, &s, &fit.motion, y) < 0)
        return gsn_fail(err, GSN_E_MARKERS, "the covariance of a mark is not positive");
    memcpy(fit.error.pose, s.pose, sizeof s.pose);
    memcpy(fit.error.strain, input->strain, sizeof fit.error.strain);
    judge_residuals(&s, y, input->count, &fit);
    estimate_strain(input, &s, y, &fit);
    *ret_fit = fit;
    return GSN_OK;
}
