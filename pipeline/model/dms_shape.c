/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/dms_internal.h"

#include "pipeline/model/orient.h"

#include <math.h>

/* Determinants between these leave room for the products and quotients of two of them, of sets of
 * knots a hundred thousand times flatter too. Lengths may be from 1e-33 to 1e33. */
#define SMALLEST 1e-100
#define LARGEST 1e100

/* Every X_beta, |beta| <= degree, has the orientation of the tetrahedron itself. */
static int check_folds(unsigned degree, const double (*knot)[3], double whole, double margin,
                       struct gsn_error *err)
{
    for (unsigned r = 0; r <= degree; r++) {
        uint8_t beta[4] = { (uint8_t)r, 0, 0, 0 };

        do {
            const double *x[4];
            double det;

            for (unsigned k = 0; k < 4; k++)
                x[k] = knot[k * (degree + 1) + beta[k]];
            det = gsn_det(x[0], x[1], x[2], x[3]);
            if (!(det > margin * whole))
                return gsn_fail(err, GSN_E_MESH,
                                "the knots of its corners fold over (det X of beta %u %u %u %u is "
                                "%.3g of the tetrahedron's); smaller knot clouds are needed",
                                beta[0], beta[1], beta[2], beta[3], det / whole);
        } while (gsn_simplex_next(beta));
    }
    return GSN_OK;
}

void gsn_dms_measure(unsigned degree, const double (*knot)[3], struct gsn_dms_shape *shape)
{
    for (unsigned k = 0; k < 4; k++)
        shape->low[k] = shape->high[k] = 0;
    for (unsigned i = 0; i < 4 * (degree + 1); i++) {
        double lambda[4];

        gsn_frame_at(&shape->frame, knot[i], lambda);
        for (unsigned k = 0; k < 4; k++) {
            shape->low[k] = fmin(shape->low[k], lambda[k]);
            if (k != i / (degree + 1))
                shape->high[k] = fmax(shape->high[k], lambda[k]);
        }
    }
}

int gsn_dms_shape_init(unsigned degree, const double (*knot)[3], double margin, double widest,
                       struct gsn_dms_shape *ret_shape, struct gsn_error *err)
{
    const double *corner[4];
    double whole, wide;
    int r;

    for (unsigned k = 0; k < 4; k++)
        corner[k] = knot[k * (degree + 1)];
    whole = gsn_det(corner[0], corner[1], corner[2], corner[3]);
    if (!(whole > 0))
        return gsn_fail(err, GSN_E_MESH, "it is too flat for double precision");
    if (!(whole > SMALLEST && whole < LARGEST))
        return gsn_fail(
            err, GSN_E_MESH,
            "its volume, %g, is out of the range of what double precision can work with",
            whole / 6);
    r = check_folds(degree, knot, whole, margin, err);
    if (r < 0)
        return r;
    gsn_frame_init(&ret_shape->frame, corner[0], corner[1], corner[2], corner[3]);
    gsn_dms_measure(degree, knot, ret_shape);
    wide = ret_shape->high[0] + ret_shape->high[1] + ret_shape->high[2] + ret_shape->high[3];
    if (!(wide < widest))
        return gsn_fail(err, GSN_E_MESH,
                        "its knot clouds leave no core (sum of delta is %.3g, less than %.3g is "
                        "needed); smaller knot clouds are needed",
                        wide, widest);
    return GSN_OK;
}

void gsn_dms_shape_of(const struct gsn_dms *space, size_t tet, struct gsn_dms_shape *ret_shape)
{
    const struct gsn_tets *mesh = space->mesh;
    const uint32_t *v = mesh->tet[tet];

    gsn_frame_init(&ret_shape->frame, mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]],
                   mesh->vertex[v[3]]);
    for (int k = 0; k < 4; k++) {
        ret_shape->low[k] = (double)space->reach[tet].low[k];
        ret_shape->high[k] = (double)space->reach[tet].high[k];
    }
}

unsigned gsn_dms_clear(const struct gsn_dms_shape *shape, const double lambda[4])
{
    unsigned clear = 0;

    for (unsigned k = 0; k < 4; k++) {
        if (lambda[k] > shape->high[k] + GSN_DMS_SLACK)
            clear |= 1u << k;
    }
    return clear;
}

int gsn_dms_is_general(const struct gsn_simplex_sets *sets, const double (*knot)[3])
{
    for (size_t s = sets->first[4]; s < sets->first[3]; s++) {
        const uint8_t *m = sets->set[s].member;

        if (gsn_orient3d(knot[m[0]], knot[m[1]], knot[m[2]], knot[m[3]]) == 0)
            return 0;
    }
    return 1;
}
