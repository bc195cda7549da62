/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Collagen-equivalent density: how much of the red dye tissue holds, 1 = full, as densities of a
 * picture's boxes, as a share of all dyes, and as an area. */
#ifndef GSN_STAIN_COLLAGEN_DENSITY_H
#define GSN_STAIN_COLLAGEN_DENSITY_H

#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/unmixing.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Collagen-equivalent density; red that is honestly below 0 stays so (collagen_density.c). */
struct gsn_collagen_reader;

/* gives; borrows absorber. Fails as gsn_unmix(). */
int gsn_collagen_reader_new(const struct gsn_od_reader *absorber, const struct gsn_dyes *dyes,
                            struct gsn_collagen_reader **ret_reader, struct gsn_error *err);

void gsn_collagen_reader_free(struct gsn_collagen_reader *reader);

GSN_DEFINE_AUTO(gsn_collagen_reader);

/* gives: every apart-th row inside the box, NaN where it is tissue and clipped. The box lies in the
 * picture. Fails with GSN_E_NOMEM. */
int gsn_collagen_box(const struct gsn_collagen_reader *reader, const struct gsn_pixel_box *box,
                     unsigned apart, struct gsn_plane **ret_density, struct gsn_error *err);

/* ---- rows of densities ------------------------------------------------------------------- */

/* The unmixer in single precision: what each solution takes of R, G and B. Straight from the
 * densities, for a Gram matrix squares the error that similar dyes make of rounding. */
struct gsn_collagen_weights {
    float dye[3][3];
    float all[3][3];     /* amounts where all three dyes are used */
    float pair[3][2][3]; /* where two of them are: (0, 1), (0, 2), (1, 2) */
    float per_red;       /* 1 over the length that counts as density 1 */
};

struct gsn_collagen_weights gsn_collagen_weights_of(const struct gsn_unmixer *mix,
                                                    double full_red_od);
/* Collagen density of count pixels with these optical densities. Amounts may be negative, as far as
 * an error of the vectors makes them so. */
void gsn_collagen_row(const struct gsn_collagen_weights *weights, const float *red,
                      const float *green, const float *blue, size_t count, float *to);

/* gives: red of all three dyes, 0..1; 0 where together they are less than 0.15, too pale to have a
 * hue. The planes as gsn_unmix gives them.
 * Fails with GSN_E_INPUT when the planes differ in size, GSN_E_NOMEM. */
int gsn_red_share(const struct gsn_plane *red, const struct gsn_plane *yellow,
                  const struct gsn_plane *dark, const struct gsn_dyes *dyes,
                  struct gsn_plane **ret_share, struct gsn_error *err);

/* ---- the area that is collagen ----------------------------------------------------------- */

/* The area figure stands beside the concentration: which pixels are collagen, and how well a map of
 * them agrees with another one. Maps are 8-bit grey images, 255 collagen and 0 not. */

struct gsn_collagen {
    double threshold; /* of what was thresholded; a pixel above it is collagen */
    size_t tissue_px, collagen_px;
    double area_fraction; /* collagen of tissue, 0..1 */
    double mean_density;  /* over the tissue */
    double mean_inside;   /* over the collagen; NaN where there is none */
};

/* gives: the map of the pixels of the tissue where `by` lies above the threshold (NaN: Otsu's over
 * the tissue). by: the density itself, or the red share (gsn_red_share), which depends neither on
 * thickness nor on how strongly the slide is stained. tissue: a map of the same size, NULL for all.
 * Borrows all three. Fails with GSN_E_STAIN when there is no tissue, GSN_E_INPUT when sizes differ
 * or a value is not finite, GSN_E_NOMEM. */
int gsn_collagen_map(const struct gsn_plane *by, const struct gsn_plane *density,
                     const struct gsn_image *tissue, double threshold, struct gsn_image **ret_map,
                     struct gsn_collagen *ret_figures, struct gsn_error *err);

/* gives: 255 where value > threshold. Fails with GSN_E_NOMEM. */
int gsn_plane_above(const struct gsn_plane *plane, double threshold, struct gsn_image **ret_map,
                    struct gsn_error *err);

struct gsn_overlap {
    size_t pixels, map_px, reference_px, both_px;
    double dice;           /* 2 both / (map + reference); 1 when both are empty */
    double false_positive; /* of the map's pixels, the share not in the reference; 0 if none */
    double false_negative; /* of the reference's pixels, the share not in the map; 0 if none */
};

/* Compares two maps; a sample of half the highest code or more counts as set (so that a JPEG mask
 * may be used); of an RGB reference the green channel is read.
 * Fails with GSN_E_INPUT when they differ in size. */
int gsn_collagen_compare(const struct gsn_image *map, const struct gsn_image *reference,
                         struct gsn_overlap *ret_overlap, struct gsn_error *err);

#ifdef __cplusplus
}
#endif

#endif
