/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/axes.h"

#include <math.h>

void gsn_axes_at(const struct gsn_axes *axes, double serial, const struct gsn_point triangle[3],
                 struct gsn_point ret_onto[3])
{
    const double from = serial - axes->middle;
    const double share = axes->bent ? pow(from / axes->half, 2) : 0;
    const double along = axes->slanted || axes->bent ? from : 0;

    for (int i = 0; i < 3; i++) {
        ret_onto[i].x = triangle[i].x + along * axes->slope[i].x;
        ret_onto[i].y = triangle[i].y + along * axes->slope[i].y;
        if (axes->bent) {
            ret_onto[i].x += share * axes->bend[i].x;
            ret_onto[i].y += share * axes->bend[i].y;
        }
    }
}
