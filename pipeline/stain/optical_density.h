/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Optical density, log10(reference white / light), only where it is wanted: glass between the
 * sections of a panel is most of it. Brighter than glass is below 0; a sample of 0 is read as half
 * a code. Densities of dyes add up (Beer and Lambert), colour differences such as R - G do not
 * (docs/MATH.md). Planes have one float per pixel. */
#ifndef GSN_STAIN_OPTICAL_DENSITY_H
#define GSN_STAIN_OPTICAL_DENSITY_H

#include "pipeline/stain/flat_field.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Length of the optical density below which a hue is noise (Macenko's beta). */
#define GSN_PALE_OD 0.15

/* gives: R + G + B optical density in one plane, for pictures that were made small. Fails with
 * GSN_E_INPUT when the glass is of another size or the image is grey, GSN_E_NOMEM. */
int gsn_od_total(const struct gsn_image *image, const struct gsn_flat_field *glass,
                 struct gsn_plane **ret_total, struct gsn_error *err);

/* A part of a picture, in its pixels. */
struct gsn_pixel_box {
    int x, y, width, height;
};

/* gives: optical density of every apart-th pixel of every apart-th row, from the first on: single
 * pixels with their own noise, for statistics that a few of them tell as well as all.
 * Fails as gsn_od_total(). */
int gsn_od_thin(const struct gsn_image *image, const struct gsn_flat_field *glass, unsigned apart,
                struct gsn_plane *ret_od[3], struct gsn_error *err);

/* Whether three planes are of one size, and the mask an 8-bit grey image of that size; mask may be
 * NULL. Fails with GSN_E_INPUT. */
int gsn_od_check(struct gsn_plane *const od[3], const struct gsn_image *mask,
                 struct gsn_error *err);

/* gives: R + G + B optical density (may be below 0 on glass).
 * ret_threshold: what separates tissue from glass, the emptiest place of the histogram between
 * clear glass and Otsu's cut; never below 6 times the glass noise, nor below 0.05. Fails with
 * GSN_E_INPUT when the planes differ in size, GSN_E_NOMEM. */
int gsn_od_tissue(struct gsn_plane *const od[3], const struct gsn_flat_field *glass,
                  struct gsn_plane **ret_total, double *ret_threshold, struct gsn_error *err);

/* ---- row by row -------------------------------------------------------------------------- */

/* R + G + B optical density from which on a pixel counts as tissue. */
#define GSN_TISSUE_OD 0.05F

/* A picture ready to be read as optical density. One reader serves any number of threads. */
struct gsn_od_reader;

/* gives; borrows image and glass. Fails as gsn_od_total(). */
int gsn_od_reader_new(const struct gsn_image *image, const struct gsn_flat_field *glass,
                      struct gsn_od_reader **ret_absorber, struct gsn_error *err);

void gsn_od_reader_free(struct gsn_od_reader *absorber);

GSN_DEFINE_AUTO(gsn_od_reader);

/* R, G and B of count pixels from (x, y) on. */
void gsn_od_reader_row(const struct gsn_od_reader *absorber, uint32_t x, uint32_t y, size_t count,
                       float *const od[3]);

/* R alone, of every apart-th of them. */
void gsn_od_reader_red(const struct gsn_od_reader *absorber, uint32_t x, uint32_t y, uint32_t apart,
                       size_t count, float *to);

/* Whether a sample of these pixels is at either end of its codes, where it only says "or beyond".
 */
int gsn_od_reader_at_end(const struct gsn_od_reader *absorber, uint32_t x, uint32_t y,
                         size_t count);

/* Whether the light of this pixel is not known: a channel at 0, or one or two at the top; all three
 * at the top are bare glass. */
int gsn_od_reader_clipped(const struct gsn_od_reader *absorber, uint32_t x, uint32_t y);

#ifdef __cplusplus
}
#endif

#endif
