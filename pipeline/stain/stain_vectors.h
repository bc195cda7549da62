/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Stain vectors: three dyes by their optical density in R, G and B, where they are known from and
 * how well.
 *
 * A vector has two ways to turn, so three have six: red 0 and 1, yellow 2 and 3, dark 4 and 5, in
 * radians, along the tangents that gsn_dyes_tangents() gives. */
#ifndef GSN_STAIN_STAIN_VECTORS_H
#define GSN_STAIN_STAIN_VECTORS_H

#include "pipeline/stain/flat_field.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A degree. */
#define GSN_RADIANS (M_PI / 180)

/* Three dyes by their optical density in R, G and B. Vectors have length 1, no negative entry.
 *
 * They are named data: they belong to a stain batch and to one meaning of the samples. */
struct gsn_dyes {
    char name[48]; /* printed beside every figure, as is the version in it */
    enum gsn_light light;
    double red[3], yellow[3], dark[3];
    double full_red_od; /* length of the red part that counts as density 1; > 0 */
};

/* The vectors the phantom is coloured with ("van-gieson-gvp-1"): linear codes, 0.62 is full. */
struct gsn_dyes gsn_dyes_builtin(void);

enum { GSN_DYE_ROTATIONS = 6 };

/* Where the vectors are expected: those of the protocol, or of the batch's calibration. */
struct gsn_dyes_prior {
    struct gsn_dyes dyes;
    double deviation_deg[3]; /* of red, yellow and dark along each of the two ways; > 0 */
};

/* The built-in vectors, each 5 degrees to either way: what rinsing and another maker's dye were
 * seen to do. */
struct gsn_dyes_prior gsn_dyes_prior_builtin(enum gsn_light light);

struct gsn_dyes_fit {
    struct gsn_dyes dyes;
    double covariance[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS]; /* rad^2, around dyes */
    double deviation_deg[3]; /* of red, yellow and dark: root of both ways' variances */
    double moved_deg[3];     /* from the prior's vectors */
    size_t pixels, classes;  /* of tissue that the evidence was enough for */
    double apart_deg;        /* half of the pixels lie farther from every mixture; 0: not asked */
    double strays;           /* share of the pixels that no class explains */
    double worth;            /* pixels of a tissue that the classes fit which would tell as much */
};

/* A fit that says: these vectors, as well known as the prior says. */
struct gsn_dyes_fit gsn_dyes_as_stated(const struct gsn_dyes_prior *prior);

/* Fills deviation_deg from the covariance and moved_deg from the vectors. */
void gsn_dyes_describe(const struct gsn_dyes_prior *prior, struct gsn_dyes_fit *fit);

/* Vectors of one dye seen twice lie nearer than this. */
#define GSN_DYES_APART_DEG 6.0

/* Degrees between two vectors of length 1. */
double gsn_dyes_angle_deg(const double a[3], const double b[3]);

/* The two ways a vector without negative entries can turn, unit vectors across to it and to each
 * other. Vectors that differ little have ways that differ little, so the turns of one panel and
 * those of another, or of the prior, mean the same. */
void gsn_dyes_tangents(const double vector[3], double ret_way[2][3]);

/* The dyes with each vector turned; lengths stay 1, entries that would be negative are 0. */
struct gsn_dyes gsn_dyes_rotated(const struct gsn_dyes *dyes, const double turn[GSN_DYE_ROTATIONS]);

/* The way from densities to amounts: amount k = inverse[k] . density. */
struct gsn_dyes_inverse {
    double inverse[3][3];
    double log_det;                 /* of the vectors */
    double slope[GSN_DYE_ROTATIONS][3]; /* of the vector that the turn belongs to */
};

/* The vectors at these turns, their inverse, and how they move with each turn. Returns 0 when they
 * lie nearly in one plane. */
int gsn_dyes_invert(const struct gsn_dyes *dyes, const double turn[GSN_DYE_ROTATIONS],
                    struct gsn_dyes_inverse *ret_optics);

#ifdef __cplusplus
}
#endif

#endif
