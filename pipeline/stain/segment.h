/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The area figure that stands beside the concentration: which pixels are collagen, and how well a
 * map of them agrees with another one. Maps are 8-bit grey images, 255 collagen and 0 not. */
#ifndef GSN_STAIN_SEGMENT_H
#define GSN_STAIN_SEGMENT_H

#include "pipeline/core/image.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

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
int gsn_mask_compare(const struct gsn_image *map, const struct gsn_image *reference,
                     struct gsn_overlap *ret_overlap, struct gsn_error *err);

/* The value that splits the histogram of `values` (sorted or not) into two classes of least
 * variance (Otsu 1979), in 512 steps between the smallest and the largest; NaN when count is 0. */
double gsn_otsu(const float *values, size_t count);

#ifdef __cplusplus
}
#endif
#endif
