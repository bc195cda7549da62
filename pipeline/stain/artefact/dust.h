/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Dirt of the scanner, not of a slide: what is dark at the same place on every panel.
 *
 * Tissue lies elsewhere on each panel, dust on the scanner's glass or on its sensor does not. A
 * place counts where on every panel it is darker than all that lies around it, in all three
 * channels. Places are pixels of the picture as the scanner gave it, whichever way the panel was
 * turned for the reader. */
#ifndef GSN_STAIN_ARTEFACT_DUST_H
#define GSN_STAIN_ARTEFACT_DUST_H

#include "pipeline/stain/artefact/detection.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How the picture was turned upright: mirrored left to right first, then turned clockwise by so
 * many quarters, 0 to 3. */
struct gsn_dust_turn {
    int mirrored;
    unsigned quarters;
};

struct gsn_dust;

/* gives: nothing seen yet. Fails with GSN_E_NOMEM. */
int gsn_dust_new(struct gsn_dust **ret_dust, struct gsn_error *err);

void gsn_dust_free(struct gsn_dust *dust);

GSN_DEFINE_AUTO(gsn_dust);

/* Adds a panel: upright densities, the box in which there is neither label nor frame, and discs in
 * which darkness has another reason (the laser marks). A panel of another size or pixel is of
 * another scan and is left out. Fails with GSN_E_NOMEM. borrows: all. */
int gsn_dust_add(struct gsn_dust *dust, struct gsn_plane *const od[3], double px_um,
                 struct gsn_dust_turn turn, const struct gsn_pixel_box *box,
                 const struct gsn_artefact_disc *disc, size_t discs, struct gsn_error *err);

/* gives: the spots, from top to bottom, and on how many panels they were seen; none below three
 * panels, for two may agree by chance. Fails with GSN_E_NOMEM. */
int gsn_dust_find(const struct gsn_dust *dust, struct gsn_artefact_disc **ret_spot,
                  size_t *ret_count, unsigned *ret_panels, struct gsn_error *err);

/* Where a spot is on the upright picture of a panel. */
struct gsn_artefact_disc gsn_dust_upright(const struct gsn_dust *dust,
                                          const struct gsn_artefact_disc *spot,
                                          struct gsn_dust_turn turn);

#ifdef __cplusplus
}
#endif

#endif
