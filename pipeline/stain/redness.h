/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From scanned colour to the amount of collagen dye.
 *
 * Light that went through stained tissue is compared with the blank glass of the same scan; the
 * logarithm of the ratio (optical density, log10) is a sum over the dyes, so three channels give
 * three dyes. Colour differences such as R - G saturate and depend on everything else
 * (docs/MATH.md); concentrations do not. Planes have the size of the picture, one float per pixel.
 */
#ifndef GSN_STAIN_REDNESS_H
#define GSN_STAIN_REDNESS_H

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

/* A sample of 8 or 16 bits as linear light, 0..1 (sRGB: IEC 61966-2-1). */
double gsn_light_of_sample(enum gsn_light light, unsigned sample, unsigned bits);
/* The inverse, as a code 0..1 that is not rounded; light in 0..1. */
double gsn_light_encode(enum gsn_light light, double linear);

/* How bright the blank glass of one scan is, everywhere in the picture.
 *
 * log10 of linear light of channel c at pixel (x, y) is
 *     s[0] + s[1] u + s[2] v + s[3] u^2 + s[4] u v + s[5] v^2,  s = surface[c],
 * with u = 2 (x + 0.5) / width - 1 and v the same in y and height. */
struct gsn_glass {
    enum gsn_light light;
    uint32_t width, height;
    double surface[3][6];
    double white[3];    /* mean of the surface over the picture, as a code 0..255 */
    double fraction;    /* share of the picture that is blank glass; 0 where it was given */
    double noise_od;    /* robust deviation of one glass pixel, mean of the channels; 0 if given */
    double overexposed; /* share of the glass pixels with a channel at its highest code */
};

/* Finds the blank glass by itself and fits the surface to it, robustly: tissue, labels, marks and
 * pen do not pull it. borrows: an RGB image.
 * Fails with GSN_E_STAIN when less than 15 % of the picture is blank glass (the sentence names the
 * share), GSN_E_INPUT when the image is grey or smaller than 16 x 16, GSN_E_NOMEM. */
int gsn_glass_estimate(const struct gsn_image *image, enum gsn_light light,
                       struct gsn_glass *ret_glass, struct gsn_error *err);

/* An even glass of a known white (codes 0..255, in R, G, B), for tiles that show none.
 * Fails with GSN_E_INPUT on a code outside 1..255. */
int gsn_glass_given(uint32_t width, uint32_t height, enum gsn_light light, const double white[3],
                    struct gsn_glass *ret_glass, struct gsn_error *err);

/* Linear light of the glass at a pixel. */
double gsn_glass_at(const struct gsn_glass *glass, uint32_t x, uint32_t y, unsigned channel);

/* gives: the amounts of the three dyes that explain the densities best in least squares, none
 * below 0. Red is divided by full_red_od: it is the collagen-equivalent density, 1 = full; yellow
 * and dark are lengths in optical density. ret_yellow and ret_dark may be NULL.
 * Fails with GSN_E_STAIN when two dyes are too alike (or a vector is not of length 1),
 * GSN_E_INPUT when the planes differ in size, GSN_E_NOMEM. */
int gsn_unmix(struct gsn_plane *const od[3], const struct gsn_dyes *dyes, unsigned threads,
              struct gsn_plane **ret_red, struct gsn_plane **ret_yellow,
              struct gsn_plane **ret_dark, struct gsn_error *err);

/* gsn_unmix() for one pixel: amounts of red, yellow and dark as lengths in optical density. */
int gsn_unmix_one(const double od[3], const struct gsn_dyes *dyes, double ret_amount[3],
                  struct gsn_error *err);

/* gives: red of all three dyes, 0..1; 0 where together they are less than 0.15, too pale to have a
 * hue. The planes as gsn_unmix gives them.
 * Fails with GSN_E_INPUT when the planes differ in size, GSN_E_NOMEM. */
int gsn_red_share(const struct gsn_plane *red, const struct gsn_plane *yellow,
                  const struct gsn_plane *dark, const struct gsn_dyes *dyes,
                  struct gsn_plane **ret_share, struct gsn_error *err);

/* gives: R + G + B optical density (may be below 0 on glass).
 * ret_threshold: what separates tissue from glass, the emptiest place of the histogram between
 * clear glass and Otsu's cut; never below 6 times the glass noise, nor below 0.05. Fails with
 * GSN_E_INPUT when the planes differ in size, GSN_E_NOMEM. */
int gsn_tissue_plane(struct gsn_plane *const od[3], const struct gsn_glass *glass,
                     struct gsn_plane **ret_total, double *ret_threshold, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
