/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Named stain vectors, and how vectors turn.
 *
 * The named sets are a table, data/stain_vectors.inc: name, source, the three vectors as they were
 * published (they are scaled to length 1 here), the red density that counts as full, and how far a
 * bath's vectors may lie from them.
 *
 * A vector v of length 1 moves on the unit sphere; its tangent basis is v x axis and v x (v x axis)
 * for one fixed axis that no dye is near, so that neighbouring vectors have neighbouring bases and
 * turns of one panel mean the same as those of another. A turn is a step along the basis, then back
 * to length 1; what would be negative is 0, for no dye makes light. The inverse of three vectors
 * (gsn_dyes_inverse) is their colour deconvolution without a constraint (Ruifrok and Johnston
 * 2001). */
#include "pipeline/stain/stain_vectors.h"

#include "pipeline/core/geom.h"

#include <math.h>
#include <string.h>

/* A named set of vectors, and how far a bath's may lie from it. */
struct named {
    struct gsn_dyes dyes;
    double deviation_deg[3];
};

static const struct named NAMED[] = {
#define STAIN_VECTORS(title, source, meaning, red_, yellow_, dark_, full, deg)                     \
    { { .name = title,                                                                             \
        .light = meaning,                                                                          \
        .red = { UNPACK red_ },                                                                    \
        .yellow = { UNPACK yellow_ },                                                              \
        .dark = { UNPACK dark_ },                                                                  \
        .full_red_od = full },                                                                     \
      { UNPACK deg } },
#define UNPACK(...) __VA_ARGS__
#include "pipeline/stain/data/stain_vectors.inc"
#undef UNPACK
#undef STAIN_VECTORS
};

static void normalise_vector(double v[3])
{
    const double length = sqrt(gsn_dot3(v, v));

    for (int c = 0; c < 3; c++)
        v[c] /= length;
}

struct gsn_dyes gsn_dyes_builtin(void)
{
    struct gsn_dyes dyes = NAMED[0].dyes;

    normalise_vector(dyes.red);
    normalise_vector(dyes.yellow);
    normalise_vector(dyes.dark);
    return dyes;
}

struct gsn_dyes_prior gsn_dyes_prior_builtin(enum gsn_light light)
{
    struct gsn_dyes_prior prior = { .dyes = gsn_dyes_builtin() };

    memcpy(prior.deviation_deg, NAMED[0].deviation_deg, sizeof prior.deviation_deg);
    prior.dyes.light = light;
    return prior;
}

/* ---- turns ------------------------------------------------------------------------------- */

void gsn_dyes_tangents(const double v[3], double ret_way[2][3])
{
    /* No dye, absorbing what it may, lies nearer than 45 degrees to this, so neighbouring vectors
     * have neighbouring ways. */
    static const double axis[3] = { M_SQRT1_2, -M_SQRT1_2, 0 };

    gsn_cross3(v, axis, ret_way[0]);
    normalise_vector(ret_way[0]);
    gsn_cross3(v, ret_way[0], ret_way[1]);
}

static void turn_one(const double v[3], const double turn[2], double ret[3])
{
    double way[2][3];

    gsn_dyes_tangents(v, way);
    for (int c = 0; c < 3; c++)
        ret[c] = fmax(v[c] + turn[0] * way[0][c] + turn[1] * way[1][c], 0);
    normalise_vector(ret);
}

struct gsn_dyes gsn_dyes_rotated(const struct gsn_dyes *dyes, const double turn[GSN_DYE_ROTATIONS])
{
    struct gsn_dyes turned = *dyes;

    turn_one(dyes->red, &turn[0], turned.red);
    turn_one(dyes->yellow, &turn[2], turned.yellow);
    turn_one(dyes->dark, &turn[4], turned.dark);
    return turned;
}

int gsn_dyes_invert(const struct gsn_dyes *dyes, const double turn[GSN_DYE_ROTATIONS],
                    struct gsn_dyes_inverse *ret)
{
    const struct gsn_dyes turned = gsn_dyes_rotated(dyes, turn);
    const double *from[3] = { dyes->red, dyes->yellow, dyes->dark };
    const double *v[3] = { turned.red, turned.yellow, turned.dark };
    double det, way[2][3];

    for (int k = 0; k < 3; k++)
        gsn_cross3(v[(k + 1) % 3], v[(k + 2) % 3], ret->inverse[k]);
    det = gsn_dot3(v[0], ret->inverse[0]);
    for (int k = 0; k < 3; k++)
        for (int c = 0; c < 3; c++)
            ret->inverse[k][c] /= det;
    ret->log_det = log(fabs(det));
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++) {
        const int k = m / 2;
        double along;

        gsn_dyes_tangents(from[k], way);
        along = gsn_dot3(way[m % 2], v[k]);
        for (int c = 0; c < 3; c++)
            ret->slope[m][c] = way[m % 2][c] - along * v[k][c];
    }
    return fabs(det) > 1e-3;
}

/* ---- fits -------------------------------------------------------------------------------- */

double gsn_dyes_angle_deg(const double a[3], const double b[3])
{
    return acos(fmin(gsn_dot3(a, b), 1)) / GSN_RADIANS;
}

void gsn_dyes_describe(const struct gsn_dyes_prior *prior, struct gsn_dyes_fit *fit)
{
    const struct gsn_dyes *a = &prior->dyes, *b = &fit->dyes;

    fit->moved_deg[0] = gsn_dyes_angle_deg(a->red, b->red);
    fit->moved_deg[1] = gsn_dyes_angle_deg(a->yellow, b->yellow);
    fit->moved_deg[2] = gsn_dyes_angle_deg(a->dark, b->dark);
    for (int k = 0; k < 3; k++)
        fit->deviation_deg[k] =
            sqrt(fit->covariance[2 * k][2 * k] + fit->covariance[2 * k + 1][2 * k + 1]) /
            GSN_RADIANS;
}

struct gsn_dyes_fit gsn_dyes_as_stated(const struct gsn_dyes_prior *prior)
{
    struct gsn_dyes_fit fit = { .dyes = prior->dyes };

    for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
        fit.covariance[m][m] =
            prior->deviation_deg[m / 2] * GSN_RADIANS * prior->deviation_deg[m / 2] * GSN_RADIANS;
    gsn_dyes_describe(prior, &fit);
    return fit;
}
