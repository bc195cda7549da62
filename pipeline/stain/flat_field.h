/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Samples as linear light, and the flat field: how bright the blank glass of one scan (the
 * reference white) is, everywhere in the picture. Logarithms are to base 10; a picture's pixels are
 * counted from its upper left corner. */
#ifndef GSN_STAIN_FLAT_FIELD_H
#define GSN_STAIN_FLAT_FIELD_H

#include "pipeline/core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What a sample means: a share of full light as it stands, or coded by the sRGB curve. Dye vectors
 * belong to one of these meanings. */
enum gsn_light {
    GSN_LIGHT_CODES_LINEAR,
    GSN_LIGHT_SRGB,
    GSN_LIGHT_PROFILE, /* a share of full light, made so by an ICC profile */
};

/* A sample of 8 or 16 bits as linear light, 0..1 (sRGB: IEC 61966-2-1). */
double gsn_light_of_sample(enum gsn_light light, unsigned sample, unsigned bits);

/* The inverse, as a code 0..1 that is not rounded; light in 0..1. */
double gsn_light_encode(enum gsn_light light, double linear);

/* gives: log10 of linear light of each of the 2^bits samples; 0 is read as half a code.
 * Fails with GSN_E_NOMEM. */
int gsn_light_table(enum gsn_light light, unsigned bits, double **ret_table, struct gsn_error *err);

/* How bright the blank glass of one scan is, everywhere in the picture.
 *
 * log10 of linear light of channel c at pixel (x, y) is
 *     s[0] + s[1] u + s[2] v + s[3] u^2 + s[4] u v + s[5] v^2,  s = surface[c],
 * with u = 2 (x + 0.5) / width - 1 and v the same in y and height. */
struct gsn_flat_field {
    enum gsn_light light;
    uint32_t width, height;
    double surface[3][6];
    double white[3];    /* mean of the surface over the picture, as a code 0..255 */
    double fraction;    /* share of the picture that is blank glass; 0 where it was given */
    double noise_od;    /* robust deviation of one glass pixel, mean of the channels; 0 if given */
    double overexposed; /* share of the glass pixels with a channel at its highest code */
};

/* What the white of a panel is off by, optical density: a tenth of a per cent of its light. */
#define GSN_WHITE_ERROR_OD 0.0005

/* Finds the blank glass by itself and fits the surface to it, robustly: tissue, labels, marks and
 * pen do not pull it. borrows: an RGB image.
 * Fails with GSN_E_STAIN when less than 15 % of the picture is blank glass (the sentence names the
 * share), GSN_E_INPUT when the image is grey or smaller than 16 x 16, GSN_E_NOMEM. */
int gsn_flat_field_estimate(const struct gsn_image *image, enum gsn_light light,
                            struct gsn_flat_field *ret_glass, struct gsn_error *err);

/* An even glass of a known white (codes 0..255, in R, G, B), for tiles that show none.
 * Fails with GSN_E_INPUT on a code outside 1..255. */
int gsn_flat_field_given(uint32_t width, uint32_t height, enum gsn_light light,
                         const double white[3], struct gsn_flat_field *ret_glass,
                         struct gsn_error *err);

/* Linear light of the glass at a pixel. */
double gsn_flat_field_at(const struct gsn_flat_field *glass, uint32_t x, uint32_t y,
                         unsigned channel);

/* log10 of the glass's light along row y is ret[0] + ret[1] u + ret[2] u^2. */
void gsn_flat_field_row(const struct gsn_flat_field *glass, uint32_t y, unsigned channel,
                        double ret[3]);

#ifdef __cplusplus
}
#endif

#endif
