/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/spline_hessian.h"

#include "pipeline/model/dms_internal.h"

#include <assert.h>
#include <string.h>

/* The second derivatives while the tetrahedra that reach u add their share. */
struct sum {
    const struct gsn_spline *spline;
    const double *u;
    double hessian[6];
};

static void add_tet(void *context, size_t tet, const double *value, const double (*gradient)[3])
{
    struct sum *sum = context;
    const struct gsn_dms *space = gsn_spline_space(sum->spline);
    const double *control = gsn_spline_controls(sum->spline);
    const uint32_t *id = gsn_dms_control_ids(space, tet);
    double knot[GSN_SIMPLEX_MAX_KNOTS][3], hessian[GSN_DMS_MAX_FUNCTIONS][6];
    uint16_t pick[GSN_SIMPLEX_MAX_LARGE];

    (void)value;
    (void)gradient;
    gsn_dms_gather(space, tet, knot);
    gsn_simplex_pick(space->sets, (const double(*)[3])knot, pick);
    gsn_simplex_basis_hessian(space->sets, (const double(*)[3])knot, pick, sum->u, 0, hessian);
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        for (int i = 0; i < 6; i++)
            sum->hessian[i] += control[id[f]] * hessian[f][i];
    }
}

int gsn_spline_hessian(const struct gsn_spline *spline, const double u[3], size_t *hint,
                       double ret_hessian[6])
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    struct sum sum = { .spline = spline, .u = u };
    size_t tet;

    assert(hint && ret_hessian);

    if (gsn_dms_locate(space, u, *hint, &tet) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    *hint = tet;
    gsn_dms_each(space, tet, u, 0, add_tet, &sum);
    memcpy(ret_hessian, sum.hessian, sizeof sum.hessian);
    return GSN_OK;
}
