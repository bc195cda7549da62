/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Tetrahedra cut by planes: how much lies on one side, and what is left of one inside another. */
#ifndef GSN_MEASURE_TET_CUT_H
#define GSN_MEASURE_TET_CUT_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_tet_cell {
    double corner[4][3];
};

/* > 0, of either orientation; 0 when flat. */
double gsn_tet_cell_volume(const struct gsn_tet_cell *cell);

/* Share, 0..1, of a tetrahedron on which the linear function with these corner values is greater
 * than 0; closed form, relative error of the smaller of both parts about 1e-15. */
double gsn_tet_share_above(const double value[4]);

/* Tetrahedra that fill a body; grows. */
struct gsn_tet_parts {
    size_t count, room;
    struct gsn_tet_cell *cell;
};

/* Adds to parts what two tetrahedra of either orientation have in common, as tetrahedra that do not
 * overlap. Corners of both are kept as they are; new ones are good to a rounding error. Parts of
 * no more than crumb are left out. Fails with GSN_E_NOMEM. */
int gsn_tet_cell_common(const struct gsn_tet_cell *cell, const struct gsn_tet_cell *other,
                        double crumb, struct gsn_tet_parts *parts, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
