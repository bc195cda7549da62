/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* n(p): how the tissue of one section was stretched out of shape on the glass.
 *
 * A smooth random displacement, micrometres in the block's x and y, known on 33 x 33 nodes that
 * span the section's slot and bilinear between them; outside the slot it is held. */
#ifndef GSN_PHANTOM_WARP_H
#define GSN_PHANTOM_WARP_H

#include "pipeline/core/geom.h"
#include "pipeline/phantom/random.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_PHANTOM_WARP_SIDE = 33 };

struct gsn_phantom_warp {
    struct gsn_point corner_um; /* of the slot, on the panel: where node [0][0] lies */
    double pitch_um;            /* between nodes */
    struct gsn_point node[GSN_PHANTOM_WARP_SIDE][GSN_PHANTOM_WARP_SIDE]; /* by row, by column */
};

/* White noise through a Gaussian of 600 um, scaled so that the root mean square length of the
 * vectors over the nodes is rms_um. */
void gsn_phantom_warp_draw(struct gsn_point corner_um, double side_um, double rms_um,
                           struct gsn_phantom_random *random, struct gsn_phantom_warp *ret_warp);

/* n at a place on the panel. */
struct gsn_point gsn_phantom_warp_at(const struct gsn_phantom_warp *warp,
                                     struct gsn_point panel_um);

#ifdef __cplusplus
}
#endif
#endif
