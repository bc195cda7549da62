/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How much of each dye the tissue of one section holds on average, how strongly its strongest
 * tissue is stained, and what both say of the bench.
 *
 * Rinsing moves the dyes against each other: alcohol washes the red one out, water the yellow one,
 * so yellow over red tells a bath from another. A knife that cut too thick moves all of them
 * together. Amounts are lengths in optical density.
 *
 * A bath that dyes one panel a tenth stronger than the next shows as a tenth more collagen. Where
 * neither a stated tissue nor tissue that is found takes that out (normalisation.h), it can still
 * be seen: the strongest stained tissue of every panel is the same kind of tissue, so the scatter
 * of its density from panel to panel is what the bath did. The next specimen's panels may be off by
 * as much. */
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

/* ---- the strongest stained tissue ---- */

/* Density of the strongest stained twentieth of a section's tissue; NaN where it has too little.
 * density: pixels of its box; NaN: masked. Fails with GSN_E_NOMEM. */
int gsn_uniformity_of_section(const struct gsn_plane *density, double *ret_strength,
                              struct gsn_error *err);
/* Of a panel: the median of its sections, NaN where none has one; reorders them. */
double gsn_uniformity_of_panel(double *strength, size_t count);

/* Every how manieth row of a box tells the strength as well as all of them. */
unsigned gsn_uniformity_rows_apart(int width, int height);

struct gsn_uniformity {
    size_t panels;  /* with a strength */
    double scatter; /* relative standard deviation from panel to panel; 0 for fewer than 2 */
    double error;   /* relative standard error of a mean density over `inside` panels, wide enough
                       that 1.96 of it hold 95 % though the scatter is known from few panels */
};

/* inside: how many panels the region reaches into, 1 or more. strength: count, NaN where a panel
 * has none. */
struct gsn_uniformity gsn_uniformity_of(const double *strength, size_t count, size_t inside);

#ifdef __cplusplus
}
#endif

#endif
