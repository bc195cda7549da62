/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The dye vectors of a batch of slides, from their own stained pixels, with an honest error.
 *
 * Where tissue holds a pure dye its vector can be read off; where every pixel is a mixture, as in
 * most tissue, the extreme pixels lie inside of the cone that the dyes span and point at vectors
 * that are too alike. So the vectors are not read off but inferred: they are those that make the
 * pixels most probable when amounts of dye are positive, vary by factors rather than by sums (a
 * mixture of log-normal classes, correlated in any way) and are seen through the noise of the scan,
 * and when the vectors lie about where the protocol says. Pixels that fit no class (pigment, ink)
 * count as strays and do not pull. No tissue is truly log-normal, and what that leads astray no
 * number of pixels mends: so they count by how well they fit, and the worse they do, the nearer the
 * vectors and their error stay to the protocol's.
 *
 * A vector has two ways to turn, so three have six: red 0 and 1, yellow 2 and 3, dark 4 and 5, in
 * radians, along the axes that gsn_dyes_turned() defines. */
#ifndef GSN_STAIN_DYES_H
#define GSN_STAIN_DYES_H

#include "pipeline/stain/redness.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_DYE_TURNS = 6 };

/* Stained pixels of the panels that were stained together. Opaque. */
struct gsn_stain_sample;

/* gives. Fails with GSN_E_NOMEM. */
int gsn_stain_sample_new(struct gsn_stain_sample **ret_sample, struct gsn_error *err);
void gsn_stain_sample_free(struct gsn_stain_sample *sample);
GSN_DEFINE_AUTO(gsn_stain_sample);

/* Adds one panel, thinned evenly. mask: 8-bit grey of the planes' size, 0 leaves a pixel out; NULL
 * takes every stained one. Pixels that are so dark that noise hides their hue are left out, and so
 * are those as pale as glass. borrows all. Fails with GSN_E_INPUT when sizes differ, GSN_E_NOMEM;
 * the sample is then as before. */
int gsn_stain_sample_add(struct gsn_stain_sample *sample, struct gsn_plane *const od[3],
                         const struct gsn_image *mask, const struct gsn_glass *glass,
                         struct gsn_error *err);

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
    double covariance[GSN_DYE_TURNS][GSN_DYE_TURNS]; /* rad^2, around dyes */
    double deviation_deg[3]; /* of red, yellow and dark: root of both ways' variances */
    double moved_deg[3];     /* from the prior's vectors */
    size_t pixels, classes;  /* of tissue that the evidence was enough for */
    double apart_deg;        /* half of the pixels lie farther from every mixture; 0: not asked */
    double strays;           /* share of the pixels that no class explains */
    double worth;            /* pixels of a tissue that the classes fit which would tell as much */
};

/* Whether it is this stain at all is gsn_stain_look()'s question, not asked here.
 *
 * Fails with GSN_E_STAIN when the sample holds fewer than 1000 pixels or two dyes come out nearly
 * alike; GSN_E_NOMEM. */
int gsn_dyes_estimate(const struct gsn_stain_sample *sample, const struct gsn_dyes_prior *prior,
                      struct gsn_dyes_fit *ret_fit, struct gsn_error *err);

/* The two ways a vector without negative entries can turn, unit vectors across to it and to each
 * other. Vectors that differ little have ways that differ little, so the turns of one panel and
 * those of another, or of the prior, mean the same. */
void gsn_dyes_ways(const double vector[3], double ret_way[2][3]);

/* The dyes with each vector turned; lengths stay 1, entries that would be negative are 0. */
struct gsn_dyes gsn_dyes_turned(const struct gsn_dyes *dyes, const double turn[GSN_DYE_TURNS]);

/* A fit that says: these vectors, as well known as the prior says. */
struct gsn_dyes_fit gsn_dyes_as_stated(const struct gsn_dyes_prior *prior);

/* How far the stained pixels lie from every mixture of the dyes: the median angle; 0 for a slide
 * too pale or too empty to tell. Fails with GSN_E_STAIN when the dyes are too alike, GSN_E_NOMEM.
 */
int gsn_stain_apart(const struct gsn_stain_sample *sample, const struct gsn_dyes *dyes,
                    double *ret_apart_deg, struct gsn_error *err);

/* The same, and beyond 8 degrees the slide is refused: haematoxylin and eosin come to 11.
 * Fails with GSN_E_STAIN; the sentence gives the figure. GSN_E_NOMEM. */
int gsn_stain_fits(const struct gsn_stain_sample *sample, const struct gsn_dyes *dyes,
                   double *ret_apart_deg, struct gsn_error *err);

/* What the stained pixels absorb, whatever vectors their dyes have. */
struct gsn_stain_look {
    double red;    /* share that absorbs green well above red, as acid fuchsin does */
    double yellow; /* share that absorbs blue far more than green, as picric acid does */
    size_t pixels; /* stained, and not too pale to have a hue */
};

/* Fails with GSN_E_STAIN when the sample holds fewer than 1000 pixels or does not look like Van
 * Gieson: one of the two shares is below 0.02. The sentence gives the figures. */
int gsn_stain_look(const struct gsn_stain_sample *sample, struct gsn_stain_look *ret_look,
                   struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
