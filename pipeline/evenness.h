/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How evenly the panels of a specimen are stained.
 *
 * A bath that dyes one panel a tenth stronger than the next shows as a tenth more collagen. Where
 * neither a stated tissue (pipeline/stain/normalisation.h) nor tissue that is found (stain/normalisation.h)
 * takes that out, it can still be seen: the strongest stained tissue of every panel is the same kind
 * of tissue, so the scatter of its density from panel to panel is what the bath did. The next
 * specimen's panels may be off by as much. */
#ifndef GSN_PIPELINE_EVENNESS_H
#define GSN_PIPELINE_EVENNESS_H

#include "pipeline/core/error.h"
#include "pipeline/core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Density of the strongest stained twentieth of a section's tissue; NaN where it has too little.
 * density: pixels of its box; NaN: masked. Fails with GSN_E_NOMEM. */
int gsn_evenness_of_section(const struct gsn_plane *density, double *ret_strength,
                            struct gsn_error *err);
/* Of a panel: the median of its sections, NaN where none has one; reorders them. */
double gsn_evenness_of_panel(double *strength, size_t count);

/* Every how manieth row of a box tells the strength as well as all of them. */
unsigned gsn_evenness_apart(int width, int height);

struct gsn_evenness {
    size_t panels;  /* with a strength */
    double scatter; /* relative standard deviation from panel to panel; 0 for fewer than 2 */
    double error;   /* relative standard error of a mean density over `inside` panels, wide enough
                       that 1.96 of it hold 95 % though the scatter is known from few panels */
};

/* inside: how many panels the region reaches into, 1 or more. strength: count, NaN where a panel
 * has none. */
struct gsn_evenness gsn_evenness_of(const double *strength, size_t count, size_t inside);

#ifdef __cplusplus
}
#endif
#endif
