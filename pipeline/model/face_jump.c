/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The jump of the gradient across faces as a quadratic form of the control points.
 *
 * Method: on the face, with m = n - 1 and B_g, |g| = m, the Bernstein polynomials of the triangle,
 *
 *     [dn s] = n sum_g B_g ( sum_k dn lambda_k^A c^A_{g + e_k} - sum_k dn lambda_k^B c^B_{g + e_k}
 * ),
 *
 * and the mean of B_g B_h over a triangle is (g+h)!/(g! h!) m!^2 2/(2m+2)!. With that matrix as L
 * L' the rows of a face are L' times those sums, times the root of area * (hA + hB) / 2. Reference:
 * G. Farin, "Triangular Bernstein-Bezier patches", 1986, 10.1016/0167-8396(86)90016-6.
 *
 * Failure: memory. Cost: n (n + 1) / 2 rows a face, of 5, 14 or 30 terms for n = 1, 2, 3. */
#include "pipeline/model/face_jump.h"

#include "pipeline/core/linalg.h"
#include "pipeline/model/barycentric.h"

#include <assert.h>
#include <math.h>
#include <string.h>

enum { MOST_ROWS = 6, MOST_TERMS = 2 * GSN_DMS_MAX_FUNCTIONS };

/* What does not depend on the face: the multi-indices of degree n - 1 on its three vertices, and
 * the factor of their mean products. */
struct face_basis {
    unsigned degree;
    size_t rows;
    uint8_t index[MOST_ROWS][3];
    double factor[MOST_ROWS][MOST_ROWS]; /* L, lower */
};

static double factorial_of(unsigned n)
{
    double product = 1;

    for (unsigned i = 2; i <= n; i++)
        product *= i;
    return product;
}

static double mean_product(const uint8_t g[3], const uint8_t h[3], unsigned m)
{
    double value = 2 * factorial_of(m) * factorial_of(m) / factorial_of(2 * m + 2);

    for (size_t c = 0; c < 3; c++)
        value *= factorial_of((unsigned)g[c] + h[c]) / factorial_of(g[c]) / factorial_of(h[c]);
    return value;
}

static void basis_init(struct face_basis *basis, unsigned degree)
{
    const unsigned m = degree - 1;

    *basis = (struct face_basis){ .degree = degree };
    for (unsigned a = 0; a <= m; a++)
        for (unsigned b = 0; a + b <= m; b++) {
            uint8_t *g = basis->index[basis->rows++];

            g[0] = (uint8_t)(m - a - b);
            g[1] = (uint8_t)b;
            g[2] = (uint8_t)a;
        }
    for (size_t i = 0; i < basis->rows; i++)
        for (size_t j = 0; j < basis->rows; j++)
            basis->factor[i][j] = mean_product(basis->index[i], basis->index[j], m);
    (void)gsn_cholesky(basis->factor[0], basis->rows, MOST_ROWS);
}

/* The coefficients of a face by control point, each point once. */
struct sums {
    size_t count;
    uint32_t control[MOST_TERMS];
    double value[MOST_ROWS][MOST_TERMS];
};

static size_t find_term(struct sums *sums, uint32_t control)
{
    size_t i = 0;

    while (i < sums->count && sums->control[i] != control)
        i++;
    if (i == sums->count) {
        for (size_t r = 0; r < MOST_ROWS; r++)
            sums->value[r][i] = 0;
        sums->control[sums->count++] = control;
    }
    return i;
}

/* A face seen from one of its tetrahedra: where its vertices stand among the corners. */
struct side {
    size_t tet, corner, place[3];
    double slope[4]; /* of lambda_k along the normal */
    double altitude;
};

static size_t function_of(const struct gsn_dms *space, const uint8_t beta[4])
{
    size_t f = 0;

    while (memcmp(gsn_dms_beta(space, f), beta, 4) != 0)
        f++;
    return f;
}

static void add_side(const struct gsn_dms *space, const struct face_basis *basis,
                     const struct side *side, double sign, struct sums *sums)
{
    const uint32_t *id = gsn_dms_control_ids(space, side->tet);

    for (size_t r = 0; r < basis->rows; r++)
        for (size_t k = 0; k < 4; k++) {
            uint8_t beta[4] = { 0 };
            size_t term;

            for (size_t c = 0; c < 3; c++)
                beta[side->place[c]] = basis->index[r][c];
            beta[k]++;
            term = find_term(sums, id[function_of(space, beta)]);
            sums->value[r][term] += sign * basis->degree * side->slope[k];
        }
}

/* Fills in where the vertices stand, and slopes along a unit normal. */
static void side_init(struct side *side, const struct gsn_tets *mesh, size_t tet, size_t corner,
                      const uint32_t vertex[3], const double normal[3])
{
    const uint32_t *v = mesh->tet[tet];
    struct gsn_barycentric frame;
    double sum = 0;

    *side = (struct side){ .tet = tet, .corner = corner };
    for (size_t c = 0; c < 3; c++)
        for (size_t k = 0; k < 4; k++)
            if (v[k] == vertex[c])
                side->place[c] = k;
    gsn_barycentric_init(&frame, mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]],
                         mesh->vertex[v[3]]);
    for (size_t k = 1; k < 4; k++) {
        side->slope[k] = gsn_dot(frame.row[k - 1], normal);
        sum += side->slope[k];
    }
    side->slope[0] = -sum;
    side->altitude = 1 / fabs(side->slope[corner]);
}

static void append_rows(const struct face_basis *basis, const struct sums *sums, double scale,
                        struct gsn_face_jumps *jumps)
{
    size_t at = jumps->first[jumps->rows];

    for (size_t r = 0; r < basis->rows; r++) {
        for (size_t i = 0; i < sums->count; i++) {
            double value = 0;

            for (size_t q = r; q < basis->rows; q++)
                value += basis->factor[q][r] * sums->value[q][i];
            jumps->control[at] = sums->control[i];
            jumps->value[at++] = scale * value;
        }
        jumps->first[++jumps->rows] = at;
    }
}

static void add_face(const struct gsn_dms *space, const struct face_basis *basis, size_t tet,
                     size_t corner, struct gsn_face_jumps *jumps)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const size_t other = (size_t)mesh->neighbour[tet][corner];
    struct sums sums = { .count = 0 };
    struct side near, far;
    double a[3], b[3], normal[3], twice;
    uint32_t vertex[3];
    size_t n = 0, back = 0;

    for (size_t k = 0; k < 4; k++)
        if (k != corner)
            vertex[n++] = mesh->tet[tet][k];
    while (mesh->neighbour[other][back] != (int32_t)tet)
        back++;
    gsn_subtract(mesh->vertex[vertex[1]], mesh->vertex[vertex[0]], a);
    gsn_subtract(mesh->vertex[vertex[2]], mesh->vertex[vertex[0]], b);
    gsn_cross(a, b, normal);
    twice = sqrt(gsn_dot(normal, normal));
    for (size_t c = 0; c < 3; c++)
        normal[c] /= twice;
    side_init(&near, mesh, tet, corner, vertex, normal);
    side_init(&far, mesh, other, back, vertex, normal);
    add_side(space, basis, &near, 1, &sums);
    add_side(space, basis, &far, -1, &sums);
    append_rows(basis, &sums, sqrt(twice / 2 * (near.altitude + far.altitude) / 2), jumps);
}

int gsn_face_jumps_new(const struct gsn_dms *space, struct gsn_face_jumps **ret_jumps,
                       struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const unsigned degree = gsn_dms_degree(space);
    const size_t terms = 2 * gsn_dms_functions(space) - (degree + 1) * (degree + 2) / 2;
    gsn_auto(gsn_face_jumps) jumps = gsn_alloc_array(1, sizeof *jumps);
    struct face_basis basis;
    size_t faces = 0;

    assert(space && ret_jumps && gsn_dms_sharing(space) == GSN_DMS_SHARED);
    basis_init(&basis, degree);
    for (size_t t = 0; t < mesh->tet_count; t++)
        for (size_t k = 0; k < 4; k++)
            faces += mesh->neighbour[t][k] > (int32_t)t;
    if (jumps) {
        jumps->first = gsn_alloc_array(faces * basis.rows + 1, sizeof *jumps->first);
        jumps->control = gsn_alloc_array(faces * basis.rows, terms * sizeof *jumps->control);
        jumps->value = gsn_alloc_array(faces * basis.rows, terms * sizeof *jumps->value);
    }
    if (!jumps || !jumps->first || !jumps->control || !jumps->value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the jumps across %zu faces", faces);
    for (size_t t = 0; t < mesh->tet_count; t++)
        for (size_t k = 0; k < 4; k++)
            if (mesh->neighbour[t][k] > (int32_t)t)
                add_face(space, &basis, t, k, jumps);
    *ret_jumps = gsn_steal(&jumps);
    return GSN_OK;
}

void gsn_face_jumps_free(struct gsn_face_jumps *jumps)
{
    if (!jumps)
        return;
    gsn_free(jumps->first);
    gsn_free(jumps->control);
    gsn_free(jumps->value);
    gsn_free(jumps);
}

static double find_row(const struct gsn_face_jumps *jumps, size_t row, const double *x)
{
    double sum = 0;

    for (size_t i = jumps->first[row]; i < jumps->first[row + 1]; i++)
        sum += jumps->value[i] * x[jumps->control[i]];
    return sum;
}

double gsn_face_jumps_energy(const struct gsn_face_jumps *jumps, const double *control)
{
    double energy = 0;

    for (size_t row = 0; row < jumps->rows; row++) {
        const double jump = find_row(jumps, row, control);

        energy += jump * jump;
    }
    return energy;
}
