/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A box cut into cubes of six tetrahedra each, and splines on it whose values are known: control
 * points are polar values, which reproduces polynomials exactly. */
#ifndef GSN_TESTS_KUHN_H
#define GSN_TESTS_KUHN_H

#include "pipeline/core/grid.h"
#include "pipeline/model/spline.h"

/* q(u) = constant + linear . u + u' diag(square) u */
struct quadric {
    double constant, linear[3], square[3];
};

double quadric_at(const struct quadric *q, const double u[3]);

/* A mesh, a space of this degree and a spline on them. */
struct kuhn {
    struct gsn_tets *mesh;
    struct gsn_dms *space;
    struct gsn_spline *spline;
};

/* cells cubes along each axis of the box low..high; clouds of this fraction. The spline is q (for
 * degree 1 its linear part). Returns an error code. */
int kuhn_new(const double low[3], const double high[3], const unsigned cells[3], unsigned degree,
             double fraction, const struct quadric *q, struct kuhn *ret_kuhn,
             struct gsn_error *err);
/* The same with control values drawn from [-1, 1). */
int kuhn_random(const double low[3], const double high[3], const unsigned cells[3], unsigned degree,
                double fraction, uint64_t seed, struct kuhn *ret_kuhn, struct gsn_error *err);
/* kuhn_new() with the clouds of boundary vertices drawn into them: s ends sharply at the faces of
 * the box, so that integrals over it have closed forms. */
int kuhn_sharp(const double low[3], const double high[3], const unsigned cells[3], unsigned degree,
               double fraction, const struct quadric *q, struct kuhn *ret_kuhn,
               struct gsn_error *err);
void kuhn_done(struct kuhn *kuhn);

/* A mask of n voxels of this step, the outer corner of the first at corner; all inside. */
struct gsn_mask *full_mask(const double corner[3], double step, size_t nx, size_t ny, size_t nz);

#endif
