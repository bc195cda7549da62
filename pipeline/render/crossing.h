/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A spline over a finer mesh: its height above a level at every point, and where along edges it
 * passes the level. All points of a stage are evaluated together (batch.h), which is many times
 * quicker than one after the other. */
#ifndef GSN_RENDER_CROSSING_H
#define GSN_RENDER_CROSSING_H

#include "pipeline/model/spline.h"
#include "pipeline/render/subdivide.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A spline, the level that counts as zero, and the finer mesh. borrows. */
struct gsn_level {
    const struct gsn_spline *spline;
    double level;
    const struct gsn_fine *fine;
};

/* s - level at the fine mesh's points. The half-open rule puts the points of some boundary faces
 * outside; there it is the limit from inside. threads 0: all; the same bytes on any number. Fails
 * with GSN_E_NOMEM. */
int gsn_level_heights(const struct gsn_level *level, unsigned threads, double *ret_height,
                      struct gsn_error *err);

/* Where s is at the level on edges that go from a point whose height is >= 0 to one where it is <
 * 0, to 1e-12 of the edge or of the heights' difference; and the normals of length 1 there, against
 * the gradient, along the edge where there is none. threads and failures as above. */
int gsn_level_crossings(const struct gsn_level *level, const double *height,
                        const uint32_t (*edge)[2], size_t count, unsigned threads,
                        double (*ret_at)[3], float (*ret_normal)[3], struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
