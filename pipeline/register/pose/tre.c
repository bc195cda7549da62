/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: the covariance of the target registration error as a quadratic field (Fitzpatrick, West
 * and Maurer, IEEE Trans. Med. Imaging 17, 694, 1998; with anisotropic localisation errors, Wiles
 * et al. 2008, and with strain).
 *
 * Steps. gsn_pose_tre_at() carries the covariances of pose and strain to a point by the rows J and
 * G of the header. gsn_pose_targets_of() replaces any number of targets by four points of the same
 * mean and covariance, over which the mean of a quadratic is the same. The ellipse's size is from
 * twice Fisher's F, as the localisation error is itself estimated.
 *
 * Cannot fail. Cost: nothing. */
#include "pipeline/register/pose/tre.h"

#include <assert.h>
#include <math.h>

/* p' M q */
static double bilinear_form(const double p[3], const double m[3][3], const double q[3])
{
    double sum = 0;

    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++)
            sum += p[i] * m[i][j] * q[j];
    return sum;
}

struct gsn_cov2 gsn_pose_tre_at(const struct gsn_pose_error *error, struct gsn_point block_um,
                                int corrected)
{
    const double x = block_um.x - error->about.x, y = block_um.y - error->about.y;
    const double j[2][3] = { { 1, 0, -y }, { 0, 1, x } };
    const double g[2][3] = { { x, x, y }, { y, -y, x } };
    double c[2][2];

    for (size_t a = 0; a < 2; a++)
        for (size_t b = 0; b < 2; b++)
            c[a][b] = bilinear_form(j[a], error->pose, j[b]) +
                      bilinear_form(j[a], error->cross, g[b]) +
                      bilinear_form(j[b], error->cross, g[a]) +
                      bilinear_form(g[a], corrected ? error->left : error->strain, g[b]);
    return (struct gsn_cov2){ c[0][0], 0.5 * (c[0][1] + c[1][0]), c[1][1] };
}

/* Four points with the targets' first two moments: the mean of any quadratic over them is the mean
 * over the targets. */
struct gsn_pose_targets gsn_pose_targets_of(const struct gsn_point *targets, size_t count)
{
    const double n = (double)count;
    struct gsn_point mean = { 0, 0 };
    double xx = 0, xy = 0, yy = 0, a, b, c;

    if (count == 0)
        return (struct gsn_pose_targets){ .count = 0 };
    for (size_t i = 0; i < count; i++) {
        mean.x += targets[i].x / n;
        mean.y += targets[i].y / n;
    }
    for (size_t i = 0; i < count; i++) {
        const double x = targets[i].x - mean.x, y = targets[i].y - mean.y;

        xx += x * x / n;
        xy += x * y / n;
        yy += y * y / n;
    }
    /* sqrt 2 times the Cholesky factor's columns, in both directions. */
    a = sqrt(2 * xx);
    b = a > 0 ? 2 * xy / a : 0;
    c = sqrt(fmax(2 * yy - b * b, 0));
    return (struct gsn_pose_targets){ { { mean.x + a, mean.y + b },
                                        { mean.x - a, mean.y - b },
                                        { mean.x, mean.y + c },
                                        { mean.x, mean.y - c } },
                                      4 };
}

double gsn_pose_tre_rms(const struct gsn_pose_error *error, const struct gsn_pose_targets *targets,
                        int corrected)
{
    double sum = 0;

    assert(targets->count == 4);

    for (size_t i = 0; i < 4; i++) {
        const struct gsn_cov2 c = gsn_pose_tre_at(error, targets->at[i], corrected);

        sum += c.xx + c.yy;
    }
    return sqrt(fmax(sum / 4, 0));
}

/* Twice Fisher's F with 2 and n degrees of freedom exceeds k^2 by the chance (1 + k^2/n)^(-n/2). */
double gsn_pose_ellipse(double freedom, double share)
{
    assert(freedom > 0 && share > 0 && share < 1);

    if (isinf(freedom))
        return sqrt(-2 * log(1 - share));
    return sqrt(freedom * (pow(1 - share, -2 / freedom) - 1));
}

struct gsn_ellipse gsn_pose_ellipse_at(const struct gsn_pose_error *error,
                                       struct gsn_point block_um, int corrected, double share)
{
    const struct gsn_cov2 c = gsn_pose_tre_at(error, block_um, corrected);
    const double mean = 0.5 * (c.xx + c.yy), apart = hypot(0.5 * (c.xx - c.yy), c.xy);
    const double k = gsn_pose_ellipse(error->freedom, share);

    return (struct gsn_ellipse){ k * sqrt(fmax(mean + apart, 0)), k * sqrt(fmax(mean - apart, 0)),
                                 0.5 * atan2(2 * c.xy, c.xx - c.yy) };
}

void gsn_pose_error_about(const struct gsn_pose_error *error, struct gsn_point at,
                          double ret_covariance[3][3])
{
    const double x = at.x - error->about.x, y = at.y - error->about.y;
    const double j[3][3] = { { 1, 0, -y }, { 0, 1, x }, { 0, 0, 1 } };

    for (size_t p = 0; p < 3; p++)
        for (size_t q = 0; q < 3; q++) {
            ret_covariance[p][q] = 0;
            for (size_t k = 0; k < 3; k++)
                for (size_t l = 0; l < 3; l++)
                    ret_covariance[p][q] += j[p][k] * error->pose[k][l] * j[q][l];
        }
}
