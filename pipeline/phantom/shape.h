/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where and how large: draws the particulars of a defect whose kind and section are settled. */
#ifndef GSN_PHANTOM_SHAPE_H
#define GSN_PHANTOM_SHAPE_H

#include "pipeline/phantom/plan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A place anywhere in a disc. */
struct gsn_point gsn_phantom_around(struct gsn_phantom_random *random, struct gsn_point centre,
                                    double radius);

/* The middle of a section, um on its panel. */
struct gsn_point gsn_phantom_centre_um(const struct gsn_phantom_plan *plan,
                                       const struct gsn_phantom_section *section);

/* Fills in what its kind needs. Touching moves the section and its right neighbour, which must lie
 * in the same row. */
void gsn_phantom_defect_shape(const struct gsn_phantom_plan *plan,
                              struct gsn_phantom_random *random,
                              struct gsn_phantom_section *section,
                              struct gsn_phantom_defect *defect);

#ifdef __cplusplus
}
#endif
#endif
