/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which material each pixel of one slot shows, and where each point of the material is seen: pose,
 * warp, and the tear, fold or lost piece of the section. */
#ifndef GSN_PHANTOM_SIGHT_H
#define GSN_PHANTOM_SIGHT_H

#include "pipeline/phantom/plan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* keeps: plan. */
struct gsn_phantom_sight {
    const struct gsn_phantom_plan *plan;
    const struct gsn_phantom_section *section;
    const struct gsn_phantom_defect *rent; /* the defect that moves material, or NULL */
    double cut_z_um;                       /* where the mounted section was cut */
    struct gsn_phantom_warp warp;
};

/* The slot of section k. */
void gsn_phantom_sight_make(const struct gsn_phantom_plan *plan, int k,
                            struct gsn_phantom_sight *ret_sight);

/* X(p), with the warp and without the rent. */
struct gsn_point gsn_phantom_sight_block(const struct gsn_phantom_sight *sight, struct gsn_point p);
/* Its inverse, by fixed-point iteration far below 1e-3 px. */
struct gsn_point gsn_phantom_sight_panel(const struct gsn_phantom_sight *sight,
                                         struct gsn_point block);

struct gsn_phantom_reading gsn_phantom_sight_read(const struct gsn_phantom_sight *sight,
                                                  struct gsn_point p);
/* What hides a mark: "" when it is seen, else "empty_slot", "missing" or the name of a defect. When
 * the material is seen nowhere ret_p is where it would be, were there no rent. */
const char *gsn_phantom_sight_mark(const struct gsn_phantom_sight *sight, int mark,
                                   struct gsn_point *ret_p);

/* How much of the section's part of the region of interest a defect keeps from being seen as one
 * clean layer, 0..1; 0 for sections without such a part. */
double gsn_phantom_sight_hidden(const struct gsn_phantom_sight *sight,
                                const struct gsn_phantom_defect *defect);

/* The defect as a polygon in panel pixels, at most POLYGON points. */
enum { GSN_PHANTOM_POLYGON = 2 * GSN_PHANTOM_STROKE + 2 };
size_t gsn_phantom_sight_polygon(const struct gsn_phantom_sight *sight,
                                 const struct gsn_phantom_defect *defect,
                                 struct gsn_point ret_p[GSN_PHANTOM_POLYGON]);

#ifdef __cplusplus
}
#endif
#endif
