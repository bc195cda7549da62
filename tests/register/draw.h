/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures with a known truth for the tests of this folder, and the chance they are made with.
 * Lengths in pixels, pixel centres at +0.5, sampled at the centres (no antialiasing). */
#ifndef GSN_TESTS_REGISTER_DRAW_H
#define GSN_TESTS_REGISTER_DRAW_H

#include "pipeline/core/geom.h"
#include "pipeline/core/image.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/fiducial/detect.h"

#include <stdint.h>

/* splitmix64: the same numbers everywhere. */
struct draw_chance {
    uint64_t state;
};

double draw_uniform(struct draw_chance *chance, double from, double to);
double draw_normal(struct draw_chance *chance);

void draw_fill(struct gsn_plane *plane, double value);
void draw_noise(struct gsn_plane *plane, struct draw_chance *chance, double sd);
/* Adds value inside an ellipse turned by angle. */
void draw_ellipse(struct gsn_plane *plane, struct gsn_point centre, double a, double b,
                  double angle, double value);
/* Sets a rectangle to value. */
void draw_box(struct gsn_plane *plane, int x, int y, int width, int height, double value);

/* The burnt disc of PHANTOM.md section 3: OD := OD (1 - bleach h)(1 - a) + depth a. */
struct draw_mark {
    struct gsn_point centre;
    double radius, edge; /* half width of the edge */
    double ring, bleach; /* outer radius of the pale ring */
    double depth;
};

/* The phantom's mark: 75 um, edge 14, ring 115, bleached by 0.65, red density 0.573. */
struct draw_mark draw_phantom_mark(struct gsn_point centre, double px_um);
void draw_burn(struct gsn_plane *plane, const struct draw_mark *mark);

/* A plane as what markers are looked for in. borrows; keeps: plane. */
struct gsn_density_source draw_density(const struct gsn_plane *plane);

#endif
