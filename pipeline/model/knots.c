/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a spline does when its knots change: derivatives by the knots, and exact insertion.
 *
 * Method: the derivative of a simplex spline by a knot is minus a directional derivative of the
 * spline with that knot twice, divided by its degree (docs/MATH.md, section 3, equation (6)
 * corrected). Insertion of a vertex inside a tetrahedron replaces control values by polar values of
 * its polynomial (docs/MATH.md, section 8), which changes nothing anywhere.
 *
 * Steps of a derivative: the tetrahedra that reach the point, and of each the knots of the V_beta
 * that hold it. Steps of an insertion: check the place and that no X_beta turns over, make four
 * tetrahedra of one, evaluate the polar form at the knots of their new functions.
 *
 * Failure: GSN_E_MESH when knots would fold a tetrahedron over; the spline is never changed.
 * Cost: a derivative a few times a value; an insertion makes the whole space anew. */
#include "pipeline/model/knots.h"

#include "pipeline/model/dms_internal.h"
#include "pipeline/model/orient.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* --- derivatives by the knots --- */

/* The caller's total while the tetrahedra that reach u add their share. */
struct sum {
    const struct gsn_spline *spline;
    const double *u;
    double weight, (*total)[3];
};

static void add_function(struct sum *sum, struct gsn_simplex_at *at, const uint32_t vertex[4],
                         size_t function, double weight)
{
    const struct gsn_simplex_set *set = &at->sets->set[function];
    const unsigned per_cloud = at->sets->degree + 1;

    for (unsigned i = 0; i < set->size; i++) {
        const unsigned t = set->member[i];
        double gradient[3], *total = sum->total[vertex[set->cloud[i]] * per_cloud + t % per_cloud];

        gsn_simplex_knot_gradient(at, function, t, gradient);
        for (int c = 0; c < 3; c++)
            total[c] += weight * gradient[c];
    }
}

static void add_tet(void *context, size_t tet, const double *value, const double (*gradient)[3])
{
    struct sum *sum = context;
    const struct gsn_dms *space = gsn_spline_space(sum->spline);
    const double *control = gsn_spline_controls(sum->spline);
    const uint32_t *id = gsn_dms_control_ids(space, tet);
    double knot[GSN_SIMPLEX_MAX_KNOTS][3];
    uint16_t pick[GSN_SIMPLEX_MAX_LARGE];
    struct gsn_simplex_at at;

    (void)value;
    (void)gradient;
    gsn_dms_gather(space, tet, knot);
    gsn_simplex_pick(space->sets, (const double(*)[3])knot, pick);
    gsn_simplex_at_init(&at, space->sets, (const double(*)[3])knot, pick, sum->u, 0);
    for (size_t f = 0; f < gsn_dms_functions(space); f++)
        add_function(sum, &at, space->mesh->tet[tet], f, sum->weight * control[id[f]]);
}

int gsn_knots_gradient_add(const struct gsn_spline *spline, const double u[3], size_t *hint,
                           double weight, double (*total)[3])
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    struct sum sum = { .spline = spline, .u = u, .weight = weight, .total = total };
    size_t tet;

    assert(hint && total);

    if (gsn_dms_locate(space, u, *hint, &tet) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    *hint = tet;
    gsn_dms_each(space, tet, u, 0, add_tet, &sum);
    return GSN_OK;
}

/* --- insertion of a vertex --- */

static int check_input(const struct gsn_tets *mesh, unsigned degree, size_t tet,
                       const double (*knots)[3], struct gsn_error *err)
{
    if (tet >= mesh->tet_count)
        return gsn_fail(err, GSN_E_INPUT, "tetrahedron %zu of %zu", tet, mesh->tet_count);
    for (unsigned l = 0; l <= degree; l++) {
        if (!isfinite(knots[l][0]) || !isfinite(knots[l][1]) || !isfinite(knots[l][2]))
            return gsn_fail(err, GSN_E_INPUT,
                            "knot %u of the new vertex has a coordinate that is not finite", l);
    }
    for (unsigned k = 0; k < 4; k++) {
        const double *corner[4];

        for (unsigned i = 0; i < 4; i++)
            corner[i] = i == k ? knots[0] : mesh->vertex[mesh->tet[tet][i]];
        if (gsn_orient3d(corner[0], corner[1], corner[2], corner[3]) <= 0)
            return gsn_fail(err, GSN_E_MESH, "the new vertex does not lie inside tetrahedron %zu",
                            tet);
    }
    return GSN_OK;
}

/* gives: the mesh with tet split around p. */
static int split_mesh(const struct gsn_tets *old, size_t tet, const double p[3],
                      struct gsn_tets **ret_mesh, struct gsn_error *err)
{
    gsn_auto_mem(double) vertex = gsn_alloc_array(3 * (old->vertex_count + 1), sizeof *vertex);
    gsn_auto_mem(uint32_t) corner = gsn_alloc_array(4 * (old->tet_count + 3), sizeof *corner);

    if (!vertex || !corner)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", old->tet_count + 3);
    memcpy(vertex, old->vertex, old->vertex_count * sizeof *old->vertex);
    memcpy(&vertex[3 * old->vertex_count], p, 3 * sizeof *p);
    memcpy(corner, old->tet, old->tet_count * sizeof *old->tet);
    for (size_t k = 0; k < 4; k++) {
        uint32_t *made = &corner[4 * (k == 0 ? tet : old->tet_count + k - 1)];

        memcpy(made, old->tet[tet], sizeof *old->tet);
        made[k] = (uint32_t)old->vertex_count;
    }
    return gsn_tets_new((const double(*)[3])vertex, old->vertex_count + 1,
                        (const uint32_t(*)[4])corner, old->tet_count + 3, ret_mesh, err);
}

/* gives: the space over it. */
static int split_space(const struct gsn_dms *old, size_t tet, const double (*knots)[3],
                       struct gsn_dms **ret_space, struct gsn_error *err)
{
    const size_t count = old->mesh->vertex_count * (old->degree + 1);
    gsn_auto(gsn_tets) mesh = NULL;
    gsn_auto_mem(double) all = gsn_alloc_array(3 * (count + old->degree + 1), sizeof *all);
    int r;

    if (!all)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu knots", count + old->degree + 1);
    memcpy(all, old->knot, count * sizeof *old->knot);
    memcpy(&all[3 * count], knots, (old->degree + 1) * sizeof *knots);
    r = split_mesh(old->mesh, tet, knots[0], &mesh, err);
    if (r == GSN_OK)
        r = gsn_dms_new(mesh, old->degree, (const double(*)[3])all, GSN_DMS_OWN, ret_space, err);
    return r;
}

/* Hands the values of gamma, |gamma| = n - r, to those of the four tetrahedra whose corner has no
 * part in gamma: there they belong to gamma with r for that corner. */
static void hand_over(unsigned degree, unsigned r, const double *value,
                      double (*control)[GSN_DMS_MAX_FUNCTIONS])
{
    uint8_t gamma[4] = { (uint8_t)(degree - r), 0, 0, 0 };

    do {
        for (unsigned k = 0; k < 4; k++) {
            uint8_t beta[4] = { gamma[0], gamma[1], gamma[2], gamma[3] };

            if (gamma[k] != 0)
                continue;
            beta[k] = (uint8_t)r;
            control[k][gsn_simplex_place(beta)] = value[gsn_simplex_place(gamma)];
        }
    } while (gsn_simplex_next(gamma));
}

/* One step of the polar form, from |gamma| = level + 1 to level, with argument u. In place: no
 * gamma + e_j comes before gamma. */
static void step_polar(unsigned degree, unsigned level, const double (*knot)[3], const double u[3],
                       double *value)
{
    uint8_t gamma[4] = { (uint8_t)level, 0, 0, 0 };

    do {
        const size_t place = gsn_simplex_place(gamma);
        const double *x[4];
        struct gsn_barycentric frame;
        double lambda[4], sum = 0;

        for (unsigned k = 0; k < 4; k++)
            x[k] = knot[k * (degree + 1) + gamma[k]];
        gsn_barycentric_init(&frame, x[0], x[1], x[2], x[3]);
        gsn_barycentric_at(&frame, u, lambda);
        for (unsigned j = 0; j < 4; j++)
            sum += lambda[j] * value[gsn_simplex_raised[place][j]];
        value[place] = sum;
    } while (gsn_simplex_next(gamma));
}

/* The control values of the four tetrahedra. */
static void split_control(const struct gsn_spline *spline, size_t tet, const double (*knots)[3],
                          double (*ret_control)[GSN_DMS_MAX_FUNCTIONS])
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const uint32_t *id = gsn_dms_control_ids(space, tet);
    double knot[GSN_SIMPLEX_MAX_KNOTS][3], value[GSN_DMS_MAX_FUNCTIONS];

    gsn_dms_gather(space, tet, knot);
    for (size_t f = 0; f < gsn_dms_functions(space); f++)
        value[f] = gsn_spline_controls(spline)[id[f]];
    for (unsigned r = 0; r <= space->degree; r++) {
        hand_over(space->degree, r, value, ret_control);
        if (r < space->degree)
            step_polar(space->degree, space->degree - r - 1, (const double(*)[3])knot, knots[r],
                       value);
    }
}

/* Lays the values of all other tetrahedra, and those of the four, in the order of the new space. */
static void lay_out(const struct gsn_spline *spline, size_t tet, const struct gsn_dms *space,
                    double (*four)[GSN_DMS_MAX_FUNCTIONS], double *ret_control)
{
    const struct gsn_dms *old = gsn_spline_space(spline);
    const size_t tets = gsn_dms_mesh(old)->tet_count;

    for (size_t t = 0; t < tets + 3; t++) {
        const uint32_t *id = gsn_dms_control_ids(space, t);

        for (size_t f = 0; f < gsn_dms_functions(space); f++) {
            if (t == tet || t >= tets)
                ret_control[id[f]] = four[t == tet ? 0 : t - tets + 1][f];
            else
                ret_control[id[f]] = gsn_spline_controls(spline)[gsn_dms_control_ids(old, t)[f]];
        }
    }
}

int gsn_insert_vertex(const struct gsn_spline *spline, size_t tet, const double (*knots)[3],
                      struct gsn_dms **ret_space, double **ret_control, struct gsn_error *err)
{
    const struct gsn_dms *old = gsn_spline_space(spline);
    double four[4][GSN_DMS_MAX_FUNCTIONS];
    gsn_auto(gsn_dms) space = NULL;
    double *control;
    int r;

    assert(knots && ret_space && ret_control);

    r = check_input(gsn_dms_mesh(old), old->degree, tet, knots, err);
    if (r == GSN_OK)
        r = split_space(old, tet, knots, &space, err);
    if (r < 0)
        return r;
    control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
    if (!control)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu control values",
                        gsn_dms_controls(space));
    split_control(spline, tet, knots, four);
    lay_out(spline, tet, space, four, control);
    *ret_space = gsn_steal(&space);
    *ret_control = control;
    return GSN_OK;
}
