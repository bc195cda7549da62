/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Free knots: where they lie is fitted, too.
 *
 * The least squares of a fit depend on the knots. At its minimum over the control points their
 * derivative by a knot is that with the control points held (variable projection: Golub and Pereyra
 * 1973), and that is equation (6) of knots.h. First inner vertices move with their clouds, so that
 * tetrahedra gather where the field bends, then single knots of the clouds. The domain stays what
 * it is: vertices of its boundary do not move. */
#ifndef GSN_MODEL_FREE_KNOTS_H
#define GSN_MODEL_FREE_KNOTS_H

#include "pipeline/model/dms.h"
#include "pipeline/model/fit.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_free_knots_options {
    struct gsn_fit_options fit; /* with folds every step chooses its own weight of the jumps */
    unsigned vertex_steps, cloud_steps; /* at most */
};

struct gsn_free_knots_report {
    double rms_fixed, rms_vertices;     /* where the knots were, and when the vertices had moved */
    unsigned vertex_steps, cloud_steps; /* that were taken */
    struct gsn_fit_report fit;          /* of the result */
};

/* gives: a space of the same tetrahedra with moved knots, and the spline on it, which keeps it:
 * free the spline first. borrows: space, samples. Every step that is taken lowers the rms residual;
 * steps end where tetrahedra would become flat or clouds fold.
 * Fails as gsn_fit() does, and with GSN_E_NOMEM. */
int gsn_free_knots(const struct gsn_dms *space, const struct gsn_samples *samples,
                   const struct gsn_free_knots_options *options, struct gsn_dms **ret_space,
                   struct gsn_spline **ret_spline, struct gsn_free_knots_report *ret_report,
                   struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
