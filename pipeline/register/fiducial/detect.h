/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Detection of fiducials in a slot of a panel: candidates, the likeliest first.
 *
 * Candidates are told from a few pixels of each cell of 25 um, and only around a blob are all of
 * them read, so that most of a panel never becomes density. Lengths are panel pixels, centres at
 * +0.5. */
#ifndef GSN_REGISTER_FIDUCIAL_DETECT_H
#define GSN_REGISTER_FIDUCIAL_DETECT_H

#include "pipeline/core/error.h"
#include "pipeline/register/fiducial/blob.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/panel/slots.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Optical density of the red channel, of width x height pixels, where it is asked for: row() puts
 * every apart-th pixel of row y from x on, count of them, to where it is told. NaN: masked. */
struct gsn_density_source {
    uint32_t width, height;
    const void *context;
    void (*row)(const void *context, uint32_t x, uint32_t y, uint32_t apart, size_t count,
                float *to);
};

/* borrows: red_od. Blobs are told from some of the slot's pixels. Finding nothing is no error.
 * Fails with GSN_E_INPUT when px_um is not positive, too coarse for a mark of 100 um, or the slot
 * is empty or reaches outside the panel; GSN_E_NOMEM. */
int gsn_fiducials_detect(const struct gsn_density_source *red_od, const struct gsn_slot *slot,
                         double px_um, struct gsn_fiducial_candidates *ret_candidates,
                         struct gsn_error *err);

/* The same for another kind of burn than the ordinary, of gsn_burns. */
int gsn_fiducials_detect_burn(const struct gsn_density_source *red_od, const struct gsn_slot *slot,
                              double px_um, unsigned burn,
                              struct gsn_fiducial_candidates *ret_candidates,
                              struct gsn_error *err);

/* The same, once it is learnt what marks look like: blobs like that are measured, where without it
 * the darkest are, and ink has more of those than there is room for. Before anything is learnt it
 * does the same as gsn_fiducials_detect(), and it fails as that does. */
int gsn_fiducials_detect_like(const struct gsn_density_source *red_od, const struct gsn_slot *slot,
                              double px_um, const struct gsn_triangle_prior *prior,
                              struct gsn_fiducial_candidates *ret_candidates,
                              struct gsn_error *err);

/* Averages some pixels of each step x step to a cell of the field, whose first begins at the slot's
 * corner; masked pixels take no part. Fails with GSN_E_NOMEM. */
int gsn_density_reduce(const struct gsn_density_source *density, const struct gsn_slot *slot,
                       size_t step, struct gsn_blob_field *field, struct gsn_error *err);

/* The same with holes filled that a dark rim encloses (gsn_fill_dark_rims): all pixels are read,
 * and rims are kept closed where they are as narrow as a third of a cell. */
int gsn_density_reduce_filled(const struct gsn_density_source *density, const struct gsn_slot *slot,
                              size_t step, struct gsn_blob_field *field, struct gsn_error *err);

/* gsn_fiducial_localise() with the pixels of the slot around start; holes: filled first. */
int gsn_density_localise(const struct gsn_density_source *density, const struct gsn_slot *slot,
                         struct gsn_point start, double radius_px, int holes,
                         struct gsn_fiducial *ret_mark, struct gsn_error *err);

/* Makes a hole with a dark rim into a dark disc: a laser that burns through leaves light inside a
 * charred rim.
 *
 * Every value is raised to the lowest level over which a way leads from it to the plane's edge:
 * morphological reconstruction by erosion (Vincent, IEEE Trans. Image Process. 2, 176, 1993), with
 * ways along rows and columns. It is done between the two halves of a closing with 3 x 3 cells, so
 * that a rim of less than a cell holds, and one with a gap of two.
 *
 * In place. Ways lead through NaN, which stays. Fails with GSN_E_NOMEM. */
int gsn_fill_dark_rims(float *value, size_t width, size_t height, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
