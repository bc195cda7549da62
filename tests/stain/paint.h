/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The forward model: amounts of dye -> light -> codes, as a scanner would see them (PHANTOM.md,
 * section 2). Written apart from the code under test. */
#ifndef GSN_TESTS_STAIN_PAINT_H
#define GSN_TESTS_STAIN_PAINT_H

#include "pipeline/stain/stain_vectors.h"

struct scan {
    enum gsn_light light;
    double white[3]; /* codes 0..255 of the glass where it is brightest */
    double falloff;  /* illumination: 1 - falloff ((x/w - .55)^2 + (y/h - .45)^2) 2 */
    double noise;    /* deviation in codes of 8 bits */
};

/* A generator of our own, so that the pictures are the same everywhere. */
struct dice {
    uint64_t state;
};
double dice_even(struct dice *dice);   /* 0..1 */
double dice_normal(struct dice *dice); /* mean 0, deviation 1 */

/* Share of the full illumination at a pixel. */
double scan_light(const struct scan *scan, const struct gsn_image *image, uint32_t x, uint32_t y);
/* The pixel behind dyes of these amounts (lengths in optical density: red, yellow, dark). */
void paint(struct gsn_image *image, uint32_t x, uint32_t y, const struct scan *scan,
           const struct gsn_dyes *dyes, const double amount[3], struct dice *dice);
/* The optical density that a sample means before this glass; a sample of 0 is half a code. */
double paint_density(const struct gsn_image *image, const struct gsn_flat_field *glass, uint32_t x,
                     uint32_t y, unsigned channel);
/* A picture of bare glass. */
struct gsn_image *paint_glass(uint32_t width, uint32_t height, uint32_t bits,
                              const struct scan *scan, struct dice *dice);

#endif
