/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The stained pixels of panels that were stained together: which of them tell the dyes, how noisy
 * they are, and whether they look like Van Gieson at all. */
#ifndef GSN_STAIN_STAIN_SAMPLE_H
#define GSN_STAIN_STAIN_SAMPLE_H

#include "pipeline/stain/stain_vectors.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_SAMPLE_LEAST = 1000 };

struct gsn_stain_pixel {
    float od[3];
    float noise[3]; /* deviation of od */
};

struct gsn_stain_sample {
    struct gsn_stain_pixel *pixel; /* owned */
    size_t count;
};

/* gives. Fails with GSN_E_NOMEM. */
int gsn_stain_sample_new(struct gsn_stain_sample **ret_sample, struct gsn_error *err);

void gsn_stain_sample_free(struct gsn_stain_sample *sample);

GSN_DEFINE_AUTO(gsn_stain_sample);

/* Adds one panel, thinned evenly. mask: 8-bit grey of the planes' size, 0 leaves a pixel out; NULL
 * takes every stained one. Pixels that are so dark that noise hides their hue are left out, and so
 * are those as pale as glass. borrows all. Fails with GSN_E_INPUT when sizes differ, GSN_E_NOMEM;
 * the sample is then as before. */
int gsn_stain_sample_add(struct gsn_stain_sample *sample, struct gsn_plane *const od[3],
                         const struct gsn_image *mask, const struct gsn_flat_field *glass,
                         struct gsn_error *err);

/* How far the stained pixels lie from every mixture of the dyes: the median angle; 0 for a slide
 * too pale or too empty to tell. Fails with GSN_E_STAIN when the dyes are too alike, GSN_E_NOMEM.
 */
int gsn_stain_apart(const struct gsn_stain_sample *sample, const struct gsn_dyes *dyes,
                    double *ret_apart_deg, struct gsn_error *err);

/* A slide farther off is of another stain. */
#define GSN_STAIN_APART_DEG 8.0

/* The same, and beyond 8 degrees the slide is refused: haematoxylin and eosin come to 11.
 * Fails with GSN_E_STAIN; the sentence gives the figure. GSN_E_NOMEM. */
int gsn_stain_fits(const struct gsn_stain_sample *sample, const struct gsn_dyes *dyes,
                   double *ret_apart_deg, struct gsn_error *err);

/* What the stained pixels absorb, whatever vectors their dyes have. */
struct gsn_stain_look {
    double red;    /* share that absorbs green well above red, as acid fuchsin does */
    double yellow; /* share that absorbs blue far more than green, as picric acid does */
    size_t pixels; /* stained, and not too pale to have a hue */
};

/* Fails with GSN_E_STAIN when the sample holds fewer than 1000 pixels or does not look like Van
 * Gieson: one of the two shares is below 0.02. The sentence gives the figures. */
int gsn_stain_look(const struct gsn_stain_sample *sample, struct gsn_stain_look *ret_look,
                   struct gsn_error *err);

#ifdef __cplusplus
}
#endif

#endif
