/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Laser axes that are straight lines, but not parallel: the triangle changes along z.
 *
 * Each section's shape is known only up to a rigid motion, so what can be seen of three axes'
 * slopes is how the triangle changes: three numbers of the six. A slope or a bend that all three
 * axes share, and a common twist about z, look exactly like the way the sections were laid on the
 * glass: no marks can show them, and they remain in the block frame. What is reported is therefore
 * each axis against the three axes' common motion. A shrinkage that grows along z looks the same as
 * axes that converge. */
#ifndef GSN_REGISTER_AXES_H
#define GSN_REGISTER_AXES_H

#include "pipeline/core/geom.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_axes {
    int slanted, bent;         /* beyond the 0.1 % that chance does; only then used in the poses */
    double middle, half;       /* serial numbers: the middle and half the length of the stack */
    struct gsn_point slope[3]; /* um per section, of each axis against the common motion */
    struct gsn_point bend[3];  /* um: the ends of the stack against its middle, likewise */
    double slope_sd;           /* standard deviation per axis and coordinate, root mean square */
    double bend_sd;
};

/* The triangle at a section: as it is in the middle, moved along the axes. */
void gsn_axes_at(const struct gsn_axes *axes, double serial, const struct gsn_point triangle[3],
                 struct gsn_point ret_onto[3]);

#ifdef __cplusplus
}
#endif
#endif
