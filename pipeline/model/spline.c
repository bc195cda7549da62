/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/spline.h"

#include "pipeline/model/bpatch.h"
#include "pipeline/model/seam_at.h"
#include "pipeline/model/spline_internal.h"

#include <assert.h>
#include <math.h>
#include <string.h>

static void make_bernstein(struct gsn_spline *spline, size_t tet)
{
    const struct gsn_dms *space = spline->space;
    double knot[GSN_SIMPLEX_MAX_KNOTS][3], control[GSN_DMS_MAX_FUNCTIONS];
    const double *corner[4];

    gsn_dms_gather(space, tet, knot);
    gsn_spline_gather(spline, tet, control);
    for (unsigned k = 0; k < 4; k++)
        corner[k] = knot[k * (space->degree + 1)];
    gsn_bpatch_bernstein(space->degree, (const double(*)[3])knot, control, corner,
                         &spline->bernstein[tet * gsn_dms_functions(space)]);
}

int gsn_spline_new(const struct gsn_dms *space, const double *control,
                   struct gsn_spline **ret_spline, struct gsn_error *err)
{
    gsn_auto(gsn_spline) spline = NULL;
    const size_t tets = gsn_dms_mesh(space)->tet_count;

    assert(space && control && ret_spline);

    for (size_t i = 0; i < gsn_dms_controls(space); i++) {
        if (!isfinite(control[i]))
            return gsn_fail(err, GSN_E_INPUT, "control value %zu is not finite", i);
    }
    spline = gsn_alloc_array(1, sizeof *spline);
    if (spline) {
        spline->space = space;
        spline->control = gsn_memdup(control, gsn_dms_controls(space) * sizeof *control);
        spline->bernstein =
            gsn_alloc_array(tets * gsn_dms_functions(space), sizeof *spline->bernstein);
    }
    if (!spline || !spline->control || !spline->bernstein)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a spline of %zu control values",
                        gsn_dms_controls(space));
    for (size_t t = 0; t < tets; t++)
        make_bernstein(spline, t);
    *ret_spline = gsn_steal(&spline);
    return GSN_OK;
}

void gsn_spline_free(struct gsn_spline *spline)
{
    if (!spline)
        return;
    gsn_free(spline->control);
    gsn_free(spline->bernstein);
    gsn_free(spline);
}

size_t gsn_spline_bytes(const struct gsn_spline *spline)
{
    const struct gsn_dms *space = spline->space;

    return sizeof *spline +
           gsn_dms_mesh(space)->tet_count * gsn_dms_functions(space) * sizeof *spline->bernstein;
}

const struct gsn_dms *gsn_spline_space(const struct gsn_spline *spline)
{
    return spline->space;
}

const double *gsn_spline_controls(const struct gsn_spline *spline)
{
    return spline->control;
}

void gsn_spline_bernstein(const struct gsn_spline *spline, size_t tet,
                          double ret_coefficient[GSN_DMS_MAX_FUNCTIONS])
{
    const size_t functions = gsn_dms_functions(spline->space);

    memcpy(ret_coefficient, &spline->bernstein[tet * functions],
           functions * sizeof *ret_coefficient);
}

int gsn_spline_eval(const struct gsn_spline *spline, const double u[3], size_t *hint,
                    double *ret_value, double *ret_gradient)
{
    const struct gsn_dms *space = spline->space;
    double lambda[4], value, gradient[3];
    struct gsn_dms_shape shape;
    size_t tet;

    assert(hint && ret_value);

    if (gsn_dms_locate(space, u, *hint, &tet) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    *hint = tet;
    gsn_dms_shape_of(space, tet, &shape);
    gsn_frame_at(&shape.frame, u, lambda);
    value = gsn_bernstein_at(space->degree, &spline->bernstein[tet * gsn_dms_functions(space)],
                             &shape.frame, lambda, ret_gradient ? gradient : NULL);
    if (gsn_dms_clear(&shape, lambda) != GSN_DMS_ALL)
        gsn_spline_add_seams(spline, tet, u, &value, ret_gradient ? gradient : NULL);
    *ret_value = value;
    if (ret_gradient)
        memcpy(ret_gradient, gradient, sizeof gradient);
    return GSN_OK;
}
