/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How much collagen was lost, against a baseline that has a name.
 *
 * Relative per cent and points are different things and both are given: a density that falls from
 * 0.40 to 0.30 is a loss of 25 per cent and of 10 points. A loss may be negative.
 *
 * Regions are comparable that one rule laid on each animal's own anatomy, of whatever size; by
 * different rules, or where a rule is not known, only of one volume. */
#ifndef GSN_MEASURE_LOSS_H
#define GSN_MEASURE_LOSS_H

#include "pipeline/core/error.h"

#ifdef __cplusplus
extern "C" {
#endif

/* One side of the comparison. The texts are borrowed and only compared and quoted. */
struct gsn_loss_side {
    const char *name;       /* specimen or group, as the report calls it */
    const char *definition; /* name and version of the density definition; must agree */
    const char *dyes;       /* name of the set of dye vectors; must agree */
    double mean;            /* density over the region */
    const char *region;     /* the rule that laid the region, in words; "" or NULL: not known */
    double volume_um3;      /* of the region */
    double standard_error;  /* of the mean; 0: not known */
    double freedom;         /* degrees of freedom of that error; 0: known variance */
};

/* Whether two volumes are one but for rounding (0.1 %). */
int gsn_loss_is_one_volume(double a_um3, double b_um3);

struct gsn_loss {
    double percent; /* 100 (1 - treated / baseline) */
    double points;  /* 100 (baseline - treated) */
    /* Fieller interval of percent; has_interval is 0 when a side carries no standard error. */
    int has_interval;
    double percent_low, percent_high;
};

/* confidence of the interval, e.g. 0.95, in (0, 1).
 *
 * Fails with GSN_E_INPUT when the definitions, the dyes or the regions differ ("the regions differ:
 * ..."), or a figure is not finite; with GSN_E_WITHHELD when the baseline is too near zero to
 * divide by (at most 1e-6, or within its own interval of zero). */
int gsn_loss(const struct gsn_loss_side *baseline, const struct gsn_loss_side *treated,
             double confidence, struct gsn_loss *ret_loss, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
