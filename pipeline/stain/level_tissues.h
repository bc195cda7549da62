/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The densities of tissues that nobody treated, as the panels that bear the region of interest show
 * them.
 *
 * Only what a tissue's density is off by against the region's counts when two specimens are
 * compared by it. Panels are brought to one scale step by step (stain/level.h), so a tissue on the
 * region's own panels is known well against it, and one that is seen some panels on only as well as
 * the steps between are; those errors are common to all tissues that are seen there. A tissue's
 * sections scatter, and tissue thins or thickens along a block by as much as nobody knows before.
 * Each panel counts as much as these errors leave of it (generalised least squares). */
#ifndef GSN_STAIN_LEVEL_TISSUES_H
#define GSN_STAIN_LEVEL_TISSUES_H

#include "pipeline/stain/level.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_LEVEL_TISSUES = 3 };

/* What one panel says of a tissue. */
struct gsn_level_seen {
    size_t panel; /* place along the block among the levelled panels, 0-based */
    double z_um;  /* mean height of its sections */
    double value; /* median of their densities, levelled */
    size_t sections;
    double square; /* sum of the squares of what they are off their own mean by */
};

/* Where the tissues are to be compared: the region's shares of the panels (they sum to 1), and its
 * mean height in the block. */
struct gsn_level_frame {
    const struct gsn_level_fit *fit;
    const double *share; /* borrowed; one per levelled panel */
    double at_um;
};

struct gsn_level_tissues {
    double value[GSN_LEVEL_TISSUES]; /* NaN: not seen */
    double covariance[GSN_LEVEL_TISSUES][GSN_LEVEL_TISSUES];
};

/* seen: of each tissue its panels (GSN_LEVEL_PANELS at most), count: how many. */
void gsn_level_tissues_at(const struct gsn_level_frame *frame,
                          const struct gsn_level_seen *const seen[GSN_LEVEL_TISSUES],
                          const size_t count[GSN_LEVEL_TISSUES],
                          struct gsn_level_tissues *ret_tissues);

/* Standard error of one tissue's density. */
double gsn_level_tissue_error(const struct gsn_level_tissues *tissues, size_t tissue);

/* How one specimen's densities read in the stain of another: here = gain * there + offset. */
struct gsn_level_link {
    double gain, offset;
    double covariance[3]; /* of gain and offset: 00, 01, 11 */
    size_t tissues;       /* that both show */
    double disagreement;  /* rms of what the tissues are off the line by, in their errors */
};

/* The link by tissues that both specimens have. What animals differ by in tissue that nobody
 * treated (taken as 2 % of its density) counts as error. The link leans towards "no difference", as
 * much as the tissues differ no more than by error and as spread allows: it says what standard
 * deviations of gain and offset the panels' own scatter makes likely between two specimens.
 * Fails with GSN_E_STAIN when they share fewer than two. */
int gsn_level_between(const struct gsn_level_tissues *here, const struct gsn_level_tissues *there,
                      const struct gsn_level *spread, struct gsn_level_link *ret_link,
                      struct gsn_error *err);
/* Standard error of gain * density + offset. */
double gsn_level_link_error(const struct gsn_level_link *link, double density);

#ifdef __cplusplus
}
#endif
#endif
