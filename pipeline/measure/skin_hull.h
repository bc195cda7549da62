/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether the hull of a few knots reaches a tetrahedral cell. */
#ifndef GSN_MEASURE_SKIN_HULL_H
#define GSN_MEASURE_SKIN_HULL_H

#include "pipeline/measure/skin.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Adds one knot to a hull; an empty one has count 0. */
void gsn_skin_hull_add(struct gsn_skin_hull *hull, const double knot[3]);

/* 0 only when a plane was found that has the two on different sides, where touching, and what may
 * be the rounding of touching, counts as different sides; what is lost by that is a layer of about
 * 1e-15 of the coordinates. */
int gsn_skin_hull_reaches(const struct gsn_skin_hull *hull, const struct gsn_tet_cell *cell);

#ifdef __cplusplus
}
#endif
#endif
