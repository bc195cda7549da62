/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Part of a tetrahedral cell, all inside one tetrahedron of the mesh, and how much of it is above a
 * threshold: at least and at most. */
#ifndef GSN_MEASURE_CELL_PART_H
#define GSN_MEASURE_CELL_PART_H

#include "pipeline/measure/skin.h"

#ifdef __cplusplus
extern "C" {
#endif

/* borrows skin. Volumes in um^3. */
struct gsn_cell_part {
    struct gsn_tet_cell at;
    const struct gsn_skin *skin;
    double coefficient[GSN_DMS_MAX_FUNCTIONS]; /* of the polynomial, over this part */
    double volume, lower, upper;
    uint8_t level, edge[2]; /* how often halved, and the edge to halve next */
};

void gsn_cell_part_make(const struct gsn_skin *skin, const struct gsn_tet_cell *at,
                        double threshold, struct gsn_cell_part *ret_part);
/* The half that keeps the end 0 or 1 of the part's edge. */
void gsn_cell_part_halve(const struct gsn_cell_part *part, double threshold, int end,
                         struct gsn_cell_part *ret_half);

#ifdef __cplusplus
}
#endif
#endif
