/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/level.h"

#include <math.h>

/* Of a slope over its error, when it counts: with four panels, and so two degrees of freedom, 6 %
 * of slopes that are none come to that. */
static const double TOLD_SLOPE = 4;
/* Three panels leave one degree of freedom: any line fits. */
enum { LEAST_PANELS = 4 };
/* What another panel would say, where there is none. */
static const double ONE_PANEL = 0.05;

struct sums {
    double z, value; /* means */
    double zz, zv, vv;
};

static struct sums sum_up(const struct gsn_level_seen *panel, size_t panels)
{
    struct sums s = { 0 };

    for (size_t i = 0; i < panels; i++) {
        s.z += panel[i].z_um / (double)panels;
        s.value += panel[i].value / (double)panels;
    }
    for (size_t i = 0; i < panels; i++) {
        const double z = panel[i].z_um - s.z, value = panel[i].value - s.value;

        s.zz += z * z;
        s.zv += z * value;
        s.vv += value * value;
    }
    return s;
}

struct gsn_level_tissue gsn_level_tissue_at(const struct gsn_level_seen *panel, size_t panels,
                                            double at_um)
{
    const struct sums s = sum_up(panel, panels);
    const double n = (double)panels, slope = s.zz > 0 ? s.zv / s.zz : 0;
    const double off = fmax(0, s.vv - slope * s.zv), beyond = at_um - s.z;

    if (panels == 0)
        return (struct gsn_level_tissue){ NAN, NAN };
    if (panels == 1)
        return (struct gsn_level_tissue){ s.value, ONE_PANEL * s.value };
    if (panels >= LEAST_PANELS && slope * slope * s.zz > TOLD_SLOPE * TOLD_SLOPE * off / (n - 2))
        return (struct gsn_level_tissue){ s.value + slope * beyond,
                                          sqrt(off / (n - 2) * (1 / n + beyond * beyond / s.zz)) };
    return (struct gsn_level_tissue){ s.value, sqrt(s.vv / (n - 1) / n) };
}
