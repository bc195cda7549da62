/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How much of each dye the tissue of one section holds on average, and what that says of the bench.
 *
 * Rinsing moves the dyes against each other: alcohol washes the red one out, water the yellow one,
 * so yellow over red tells a bath from another. A knife that cut too thick moves all of them
 * together. Amounts are lengths in optical density. */
#ifndef GSN_STAIN_STAINING_UNIFORMITY_H
#define GSN_STAIN_STAINING_UNIFORMITY_H

#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/stain_vectors.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_stain_amounts {
    double amount[3]; /* red, yellow, dark: mean over the tissue looked at */
    size_t pixels;    /* of tissue looked at */
};

/* The tone within a box of the panel. Pixels whose density is NaN were masked and do not count.
 * Fails with GSN_E_STAIN as gsn_unmix() does. borrows: all. */
int gsn_stain_amounts_of(struct gsn_plane *const od[3], const struct gsn_plane *density,
                         const struct gsn_dyes *dyes, const struct gsn_pixel_box *box,
                         struct gsn_stain_amounts *ret_tone, struct gsn_error *err);

/* Both together, weighed by their pixels. */
struct gsn_stain_amounts gsn_stain_amounts_sum(const struct gsn_stain_amounts *a,
                                               const struct gsn_stain_amounts *b);

/* Yellow over red; NaN where there is too little tissue or no red. */
double gsn_stain_amounts_yellow_to_red(const struct gsn_stain_amounts *tone);

/* How thick a section probably is against others of the same bath: all of its dyes are this many
 * times theirs. 1 where the dyes do not agree, where the others scatter as much, or where there are
 * fewer than five with enough tissue. which: its place among the tones. */
double gsn_stain_amounts_thickness(const struct gsn_stain_amounts *tone, size_t count,
                                   size_t which);

#ifdef __cplusplus
}
#endif

#endif
