/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The ways to ask a spline for its values, so that tests can hold all of them to the same truth:
 * the recurrence itself, and the quick ones on every instruction set of the processor. */
#ifndef GSN_TESTS_MODEL_PATHS_H
#define GSN_TESTS_MODEL_PATHS_H

#include "pipeline/model/spline.h"

enum path {
    PATH_RECURRENCE, /* the sum over gsn_dms_basis() */
    PATH_EVAL,       /* gsn_spline_eval() */
    PATH_MANY,       /* gsn_spline_eval_many(), all points in one call */
    PATH_GRID,       /* gsn_spline_resample() on a lattice of one voxel; no gradient */
    PATH_ROW,        /* gsn_face_correction_row() times the control values; no gradient */
    PATHS
};

const char *path_name(enum path path);
int path_has_slope(enum path path);

/* s at count points by one way, and its gradient if the way has one; NaN where there is no data. */
void path_run(enum path path, const struct gsn_spline *spline, const double (*at)[3], size_t count,
              double *ret_value, double (*ret_slope)[3]);

/* How far the quick ways are from the recurrence at most; inside counts the points with data. */
struct path_gap {
    double value, slope;      /* differences */
    double largest, steepest; /* |s| and |ds/dx_i| */
    size_t inside;
};

/* Runs them all, on every instruction set, and fails unless they agree on where there is data.
 * space is the spline's; it is left with the best kernels. */
struct path_gap path_compare(struct gsn_dms *space, const struct gsn_spline *spline,
                             const double (*at)[3], size_t count);

/* Calls run for each instruction set the processor has, with the space using it, and leaves the
 * space with the best. */
void path_each_isa(struct gsn_dms *space, void (*run)(void *context, const char *name),
                   void *context);

#endif
