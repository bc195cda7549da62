/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/measure/kuhn.h"

#include <string.h>

#include "tests/measure/draw.h"

double quadric_at(const struct quadric *q, const double u[3])
{
    double value = q->constant;

    for (int a = 0; a < 3; a++)
        value += q->linear[a] * u[a] + q->square[a] * u[a] * u[a];
    return value;
}

/* The polar form with n arguments. */
static double polar(const struct quadric *q, const double (*arg)[3], unsigned n)
{
    double value = q->constant;

    for (int a = 0; a < 3; a++) {
        double sum = 0.0, pairs = 0.0;

        for (unsigned i = 0; i < n; i++) {
            for (unsigned j = 0; j < i; j++)
                pairs += arg[i][a] * arg[j][a];
            sum += arg[i][a];
        }
        value += q->linear[a] * sum / n;
        if (n > 1)
            value += q->square[a] * pairs / (0.5 * n * (n - 1));
    }
    return value;
}

static int make_mesh(const double low[3], const double high[3], const unsigned cells[3],
                     struct gsn_tets **ret_mesh, struct gsn_error *err)
{
    static const unsigned path[6][3] = { { 0, 1, 2 }, { 0, 2, 1 }, { 1, 0, 2 },
                                         { 1, 2, 0 }, { 2, 0, 1 }, { 2, 1, 0 } };
    const size_t side[3] = { cells[0] + 1U, cells[1] + 1U, cells[2] + 1U };
    const size_t vertices = side[0] * side[1] * side[2];
    const size_t tets = (size_t)6 * cells[0] * cells[1] * cells[2];
    gsn_auto_mem(double) vertex = gsn_alloc_array(3 * vertices, sizeof *vertex);
    gsn_auto_mem(uint32_t) tet = gsn_alloc_array(4 * tets, sizeof *tet);
    size_t count = 0;

    if (!vertex || !tet)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a mesh");
    for (size_t v = 0; v < vertices; v++) {
        const size_t at[3] = { v % side[0], v / side[0] % side[1], v / side[0] / side[1] };

        for (int a = 0; a < 3; a++)
            vertex[3 * v + (size_t)a] = low[a] + (high[a] - low[a]) * (double)at[a] / cells[a];
    }
    for (size_t v = 0; v < vertices; v++) {
        const size_t at[3] = { v % side[0], v / side[0] % side[1], v / side[0] / side[1] };

        if (at[0] == cells[0] || at[1] == cells[1] || at[2] == cells[2])
            continue;
        for (int k = 0; k < 6; k++, count++) {
            size_t corner[3] = { at[0], at[1], at[2] };

            for (int step = 0; step < 4; step++) {
                tet[4 * count + (size_t)step] =
                    (uint32_t)((corner[2] * side[1] + corner[1]) * side[0] + corner[0]);
                if (step < 3)
                    corner[path[k][step]]++;
            }
        }
    }
    return gsn_tets_new((const double(*)[3])vertex, vertices, (const uint32_t(*)[4])tet, tets,
                        ret_mesh, err);
}

static void collapse_boundary(const struct gsn_tets *mesh, const double low[3],
                              const double high[3], unsigned degree, double (*knots)[3])
{
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        const double *at = mesh->vertex[v];
        int on_face = 0;

        for (int a = 0; a < 3; a++)
            on_face |= !(at[a] > low[a] && at[a] < high[a]);
        for (unsigned l = 1; on_face && l <= degree; l++)
            memcpy(knots[v * (degree + 1) + l], at, sizeof knots[0]);
    }
}

static int make_space(const double low[3], const double high[3], const unsigned cells[3],
                      unsigned degree, double fraction, int sharp, struct kuhn *kuhn,
                      struct gsn_error *err)
{
    double(*knots)[3] = NULL;
    int r = make_mesh(low, high, cells, &kuhn->mesh, err);

    if (r == GSN_OK)
        r = gsn_dms_clouds(kuhn->mesh, degree, fraction, &knots, err);
    if (r == GSN_OK && sharp)
        collapse_boundary(kuhn->mesh, low, high, degree, knots);
    if (r == GSN_OK)
        r = gsn_dms_new(kuhn->mesh, degree, (const double(*)[3])knots, GSN_DMS_SHARED, &kuhn->space,
                        err);
    gsn_free(knots);
    return r;
}

static double control_value(const struct gsn_dms *space, size_t tet, size_t function,
                            const struct quadric *q)
{
    const unsigned degree = gsn_dms_degree(space);
    const uint8_t *beta = gsn_dms_beta(space, function);
    double arg[GSN_DMS_MAX_DEGREE][3];
    unsigned count = 0;

    for (size_t k = 0; k < 4; k++) {
        for (unsigned l = 0; l < beta[k]; l++) {
            const size_t vertex = gsn_dms_mesh(space)->tet[tet][k];

            memcpy(arg[count++], gsn_dms_knots(space)[vertex * (degree + 1) + l], sizeof arg[0]);
        }
    }
    return polar(q, (const double(*)[3])arg, degree);
}

/* Control values by q, or from the seed when q is NULL. */
static int make_spline(const struct quadric *q, uint64_t seed, struct kuhn *kuhn,
                       struct gsn_error *err)
{
    const size_t controls = gsn_dms_controls(kuhn->space);
    gsn_auto_mem(double) control = gsn_alloc_array(controls, sizeof *control);

    if (!control)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for control values");
    for (size_t i = 0; !q && i < controls; i++)
        control[i] = 2.0 * draw(&seed) - 1.0;
    for (size_t t = 0; q && t < kuhn->mesh->tet_count; t++) {
        for (size_t f = 0; f < gsn_dms_functions(kuhn->space); f++)
            control[gsn_dms_control_ids(kuhn->space, t)[f]] = control_value(kuhn->space, t, f, q);
    }
    return gsn_spline_new(kuhn->space, control, &kuhn->spline, err);
}

static int make(const double low[3], const double high[3], const unsigned cells[3], unsigned degree,
                double fraction, int sharp, const struct quadric *q, uint64_t seed,
                struct kuhn *ret_kuhn, struct gsn_error *err)
{
    struct kuhn kuhn = { NULL, NULL, NULL };
    int r = make_space(low, high, cells, degree, fraction, sharp, &kuhn, err);

    if (r == GSN_OK)
        r = make_spline(q, seed, &kuhn, err);
    if (r < 0) {
        kuhn_done(&kuhn);
        return r;
    }
    *ret_kuhn = kuhn;
    return GSN_OK;
}

int kuhn_new(const double low[3], const double high[3], const unsigned cells[3], unsigned degree,
             double fraction, const struct quadric *q, struct kuhn *ret_kuhn, struct gsn_error *err)
{
    return make(low, high, cells, degree, fraction, 0, q, 0, ret_kuhn, err);
}

int kuhn_sharp(const double low[3], const double high[3], const unsigned cells[3], unsigned degree,
               double fraction, const struct quadric *q, struct kuhn *ret_kuhn,
               struct gsn_error *err)
{
    return make(low, high, cells, degree, fraction, 1, q, 0, ret_kuhn, err);
}

int kuhn_random(const double low[3], const double high[3], const unsigned cells[3], unsigned degree,
                double fraction, uint64_t seed, struct kuhn *ret_kuhn, struct gsn_error *err)
{
    return make(low, high, cells, degree, fraction, 0, NULL, seed, ret_kuhn, err);
}

void kuhn_done(struct kuhn *kuhn)
{
    gsn_spline_free(kuhn->spline);
    gsn_dms_free(kuhn->space);
    gsn_tets_free(kuhn->mesh);
    *kuhn = (struct kuhn){ NULL, NULL, NULL };
}

struct gsn_mask *full_mask(const double corner[3], double step, size_t nx, size_t ny, size_t nz)
{
    const struct gsn_lattice at = {
        .nx = nx,
        .ny = ny,
        .nz = nz,
        .origin_um = { corner[0] + 0.5 * step, corner[1] + 0.5 * step, corner[2] + 0.5 * step },
        .step_um = { step, step, step },
    };
    struct gsn_mask *mask = NULL;

    if (gsn_mask_new(&at, &mask, NULL) == GSN_OK)
        memset(mask->inside, 1, gsn_lattice_count(&at));
    return mask;
}
