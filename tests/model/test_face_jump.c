/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The jump of the gradient across faces against closed forms. */
#include "pipeline/model/face_jump.h"

#include "pipeline/model/barycentric.h"
#include "pipeline/model/spline.h"
#include "tests/check.h"
#include "tests/model/test_domain_shapes.h"

/* Two tetrahedra on one face. */
static const double VERTEX[5][3] = {
    { 0, 0, 0 }, { 10, 0, 1 }, { 2, 10, 0 }, { 1, 2, 10 }, { 11, 10, 9 }
};
static const uint32_t CORNER[2][4] = { { 0, 1, 2, 3 }, { 1, 2, 3, 4 } };

static struct gsn_dms *pair_space(unsigned degree)
{
    gsn_auto(gsn_tets) mesh = NULL;
    double(*knots)[3] = NULL;
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tets_new(VERTEX, 5, CORNER, 2, &mesh, &err), err);
    CHECK_OK(gsn_dms_clouds(mesh, degree, 0.01, &knots, &err), err);
    CHECK_OK(gsn_dms_new(mesh, degree, (const double(*)[3])knots, GSN_DMS_SHARED, &space, &err),
             err);
    gsn_free(knots);
    return space;
}

/* Bernstein coefficients of (a . u)^degree: its polar form is the product of a . u over the
 * corners. */
static double polar(const struct gsn_dms *space, size_t tet, size_t function)
{
    static const double A[3] = { 0.03, -0.08, 0.05 };
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    double value = 1;

    for (size_t k = 0; k < 4; k++)
        for (unsigned i = 0; i < gsn_dms_beta(space, function)[k]; i++)
            value *= gsn_dot(A, mesh->vertex[mesh->tet[tet][k]]);
    return value;
}

static double energy_of(const struct gsn_dms *space, const double *control)
{
    gsn_auto(gsn_face_jumps) jumps = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_face_jumps_new(space, &jumps, &err), err);
    return gsn_face_jumps_energy(jumps, control);
}

TEST(a_polynomial_has_no_jumps)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = pair_space(degree);
        double control[64] = { 0 };

        for (size_t t = 0; t < 2; t++)
            for (size_t f = 0; f < gsn_dms_functions(space); f++)
                control[gsn_dms_control_ids(space, t)[f]] = polar(space, t, f);
        CHECK_NEAR(energy_of(space, control), 0, 1e-26);
    }
}

/* d^degree beyond the plane of the face and 0 before it, d the distance from that: the jump is 1
 * for degree 1 and none for more. And |d|: 2 times 1. */
static double power_of_distance(const struct gsn_dms *space, size_t tet, size_t function,
                                const double normal[3], double power)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    double sum = 0, product = 1;

    for (size_t k = 0; k < 4; k++)
        for (unsigned i = 0; i < gsn_dms_beta(space, function)[k]; i++) {
            double d[3];

            gsn_subtract(mesh->vertex[mesh->tet[tet][k]], VERTEX[1], d);
            sum += gsn_dot(normal, d) / gsn_dms_degree(space);
            product *= gsn_dot(normal, d);
        }
    return power == 1 ? sum : product;
}

TEST(a_kink_costs_its_square_times_the_face_and_its_altitudes)
{
    double a[3], b[3], normal[3], d[3], area, near, far;

    gsn_subtract(VERTEX[2], VERTEX[1], a);
    gsn_subtract(VERTEX[3], VERTEX[1], b);
    gsn_cross(a, b, normal);
    area = sqrt(gsn_dot(normal, normal)) / 2;
    for (size_t c = 0; c < 3; c++)
        normal[c] /= 2 * area;
    gsn_subtract(VERTEX[0], VERTEX[1], d);
    near = fabs(gsn_dot(normal, d));
    gsn_subtract(VERTEX[4], VERTEX[1], d);
    far = fabs(gsn_dot(normal, d));
    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = pair_space(degree);
        double kink[64] = { 0 }, smooth[64] = { 0 };

        for (size_t f = 0; f < gsn_dms_functions(space); f++) {
            kink[gsn_dms_control_ids(space, 1)[f]] = power_of_distance(space, 1, f, normal, 1);
            smooth[gsn_dms_control_ids(space, 1)[f]] =
                power_of_distance(space, 1, f, normal, degree);
        }
        CHECK_NEAR(energy_of(space, kink) / (area * (near + far) / 2), 1, 1e-12);
        if (degree > 1)
            CHECK_NEAR(energy_of(space, smooth), 0, 1e-20);
    }
}

/* On a mesh of many tetrahedra: the integrals of the squared jumps by a quadrature of the gradients
 * of two polynomials, each from its own side. */
static double gradient_at(const struct gsn_spline *spline, size_t tet, const double u[3],
                          const double normal[3])
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const unsigned n = gsn_dms_degree(space);
    const uint32_t *id = gsn_dms_control_ids(space, tet), *v = mesh->tet[tet];
    struct gsn_barycentric frame;
    double lambda[4], slope[4], sum = 0;

    gsn_barycentric_init(&frame, mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]],
                         mesh->vertex[v[3]]);
    gsn_barycentric_at(&frame, u, lambda);
    slope[0] = 0;
    for (size_t k = 1; k < 4; k++) {
        slope[k] = gsn_dot(frame.row[k - 1], normal);
        slope[0] -= slope[k];
    }
    for (size_t f = 0; f < gsn_dms_functions(space); f++)
        for (size_t k = 0; k < 4; k++) {
            const uint8_t *beta = gsn_dms_beta(space, f);
            double term = n;

            if (beta[k] == 0)
                continue;
            /* d/d lambda_k of n!/beta! lambda^beta */
            for (unsigned i = 2; i < n; i++)
                term *= i;
            for (size_t c = 0; c < 4; c++)
                for (unsigned i = 0; i < beta[c] - (unsigned)(c == k); i++)
                    term *= lambda[c] / (i + 1);
            sum += slope[k] * term * gsn_spline_controls(spline)[id[f]];
        }
    return sum;
}

TEST(many_faces_cost_what_a_quadrature_says)
{
    /* exact for polynomials of degree 4: Dunavant 1985, 10.1002/nme.1620210612 */
    static const double RULE[6][4] = {
        { 0.108103018168070, 0.445948490915965, 0.445948490915965, 0.223381589678011 },
        { 0.445948490915965, 0.108103018168070, 0.445948490915965, 0.223381589678011 },
        { 0.445948490915965, 0.445948490915965, 0.108103018168070, 0.223381589678011 },
        { 0.816847572980459, 0.091576213509771, 0.091576213509771, 0.109951743655322 },
        { 0.091576213509771, 0.816847572980459, 0.091576213509771, 0.109951743655322 },
        { 0.091576213509771, 0.091576213509771, 0.816847572980459, 0.109951743655322 }
    };

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = shape_space(degree, 0.02, 60000);
        const struct gsn_tets *mesh = gsn_dms_mesh(space);
        gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
        gsn_auto(gsn_spline) spline = NULL;
        struct gsn_error err = { 0 };
        uint64_t dice = 11;
        double total = 0;

        CHECK(control);
        for (size_t i = 0; i < gsn_dms_controls(space); i++)
            control[i] = shape_normal(&dice);
        CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
        for (size_t t = 0; t < mesh->tet_count; t++)
            for (size_t k = 0; k < 4; k++) {
                const int32_t other = mesh->neighbour[t][k];
                const double *v[3];
                double a[3], b[3], normal[3], area;
                size_t n = 0;

                if (other <= (int32_t)t)
                    continue;
                for (size_t c = 0; c < 4; c++)
                    if (c != k)
                        v[n++] = mesh->vertex[mesh->tet[t][c]];
                gsn_subtract(v[1], v[0], a);
                gsn_subtract(v[2], v[0], b);
                gsn_cross(a, b, normal);
                area = sqrt(gsn_dot(normal, normal)) / 2;
                for (size_t c = 0; c < 3; c++)
                    normal[c] /= 2 * area;
                for (size_t q = 0; q < 6; q++) {
                    double u[3], jump;

                    for (size_t c = 0; c < 3; c++)
                        u[c] = RULE[q][0] * v[0][c] + RULE[q][1] * v[1][c] + RULE[q][2] * v[2][c];
                    jump = gradient_at(spline, t, u, normal) -
                           gradient_at(spline, (size_t)other, u, normal);
                    /* altitude: three volumes over the face */
                    total += RULE[q][3] * area * jump * jump * 1.5 *
                             (gsn_tets_volume(mesh, t) + gsn_tets_volume(mesh, (size_t)other)) /
                             area;
                }
            }
        CHECK_NEAR(energy_of(space, control) / total, 1, 1e-10);
    }
}
