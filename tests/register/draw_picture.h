/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A section as a picture of three channels, with a known truth: tissue of two dyes that change from
 * place to place, on pale glass, with burnt discs. Pixels, centres at +0.5. */
#ifndef GSN_TESTS_REGISTER_DRAW_PICTURE_H
#define GSN_TESTS_REGISTER_DRAW_PICTURE_H

#include "pipeline/core/image.h"
#include "tests/register/draw.h"

struct draw_spot {
    struct gsn_point centre;
    double radius, alpha; /* how much of the tissue it hides */
    double lobe[2][2];    /* cosine and sine of twice and four times the angle, in radii */
    double cut; /* angle towards which a segment beyond 0.45 radii is missing; NAN: none */
};

/* value is width x height x 3; inside reach of the middle there is tissue. */
void draw_tissue_picture(float *value, uint32_t width, uint32_t height, double reach,
                         struct draw_chance *chance);
void draw_spot_on(float *value, uint32_t width, uint32_t height, const struct draw_spot *spot);
/* Adds noise of sd codes and rounds. image: 3 channels, 8 or 16 bits, of the same size. */
void draw_codes(const float *value, struct gsn_image *image, double sd, struct draw_chance *chance);

#endif
