/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Sums over the region of interest, and the check values an implementation must meet.
 *
 * Midpoint sums over the cylinder that encloses the region; the numbers do not depend on the
 * number of threads. */
#ifndef GSN_PHANTOM_CHECK_H
#define GSN_PHANTOM_CHECK_H

#include "pipeline/core/error.h"
#include "pipeline/phantom/geometry.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_PHANTOM_DEPTHS = 4, GSN_PHANTOM_THRESHOLDS = 3, GSN_PHANTOM_CHECKS = 18 };

/* All in mm3, except that intact and lost are integrals of a density over mm3. */
struct gsn_phantom_sums {
    double volume;
    double intact, lost; /* I(A) = intact - A lost, of bone of the ordinary density */
    double bone;         /* the bone's share of intact */
    double above[GSN_PHANTOM_DEPTHS][GSN_PHANTOM_THRESHOLDS];
};

/* The thresholds .3, .5, .7 of the volumes. */
extern const double gsn_phantom_thresholds[GSN_PHANTOM_THRESHOLDS];

/* Sums at steps of about step_um (rounded so that the region's height is a whole number of them),
 * volumes above the thresholds for each of the depths A in bone gain times as dense as ordinary.
 * Fails with GSN_E_NOMEM. borrows: g, depth. */
int gsn_phantom_sum(const struct gsn_phantom_geometry *g, double step_um,
                    const double depth[GSN_PHANTOM_DEPTHS], double gain, unsigned threads,
                    struct gsn_phantom_sums *ret_sums, struct gsn_error *err);

/* 100 (1 - I(A)/I(0)). */
double gsn_phantom_loss_percent(const struct gsn_phantom_sums *sums, double depth);

struct gsn_phantom_check {
    char name[64];
    double value, demanded, tolerance;
    int met;
};

/* The table of the specification: losses to 0.02 points, the rest to 0.1 %. */
int gsn_phantom_check_all(double step_um, unsigned threads,
                          struct gsn_phantom_check ret_check[GSN_PHANTOM_CHECKS],
                          struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
