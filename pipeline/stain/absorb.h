/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Optical density, log10(glass / light), only where it is wanted: glass between the sections of a
 * panel is most of it. Brighter than glass is below 0; a sample of 0 is read as half a code. */
#ifndef GSN_STAIN_ABSORB_H
#define GSN_STAIN_ABSORB_H

#include "pipeline/stain/redness.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: R + G + B optical density in one plane, for pictures that were made small. Fails with
 * GSN_E_INPUT when the glass is of another size or the image is grey, GSN_E_NOMEM. */
int gsn_absorb_total(const struct gsn_image *image, const struct gsn_glass *glass,
                     struct gsn_plane **ret_total, struct gsn_error *err);

/* A part of a picture, in its pixels. */
struct gsn_pixel_box {
    int x, y, width, height;
};

/* gives: optical density of every apart-th pixel of every apart-th row, from the first on: single
 * pixels with their own noise, for statistics that a few of them tell as well as all.
 * Fails as gsn_absorb_total(). */
int gsn_absorb_thin(const struct gsn_image *image, const struct gsn_glass *glass, unsigned apart,
                    struct gsn_plane *ret_od[3], struct gsn_error *err);

/* ---- row by row --------------------------------------------------------------------------- */

/* R + G + B optical density from which on a pixel counts as tissue. */
#define GSN_TISSUE_OD 0.05F

/* A picture ready to be read as optical density. One reader serves any number of threads. */
struct gsn_absorber;

/* gives; borrows image and glass. Fails as gsn_absorb_total(). */
int gsn_absorber_new(const struct gsn_image *image, const struct gsn_glass *glass,
                     struct gsn_absorber **ret_absorber, struct gsn_error *err);
void gsn_absorber_free(struct gsn_absorber *absorber);
GSN_DEFINE_AUTO(gsn_absorber);

/* R, G and B of count pixels from (x, y) on. */
void gsn_absorber_row(const struct gsn_absorber *absorber, uint32_t x, uint32_t y, size_t count,
                      float *const od[3]);
/* R alone, of every apart-th of them. */
void gsn_absorber_red(const struct gsn_absorber *absorber, uint32_t x, uint32_t y, uint32_t apart,
                      size_t count, float *to);
/* Whether a sample of these pixels is at either end of its codes, where it only says "or beyond".
 */
int gsn_absorber_at_end(const struct gsn_absorber *absorber, uint32_t x, uint32_t y, size_t count);
/* Whether the light of this pixel is not known: a channel at 0, or one or two at the top; all three
 * at the top are bare glass. */
int gsn_absorber_clipped(const struct gsn_absorber *absorber, uint32_t x, uint32_t y);

/* Collagen-equivalent density; red that is honestly below 0 stays so (rows.h). */
struct gsn_red_reader;

/* gives; borrows absorber. Fails as gsn_unmix(). */
int gsn_red_reader_new(const struct gsn_absorber *absorber, const struct gsn_dyes *dyes,
                       struct gsn_red_reader **ret_reader, struct gsn_error *err);
void gsn_red_reader_free(struct gsn_red_reader *reader);
GSN_DEFINE_AUTO(gsn_red_reader);

/* gives: every apart-th row inside the box, NaN where it is tissue and clipped. The box lies in the
 * picture. Fails with GSN_E_NOMEM. */
int gsn_red_box(const struct gsn_red_reader *reader, const struct gsn_pixel_box *box,
                unsigned apart, struct gsn_plane **ret_density, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
