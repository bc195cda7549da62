/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/fit_smooth.h"

#include "pipeline/model/frame.h"

static double factorial(unsigned n)
{
    double product = 1;

    for (unsigned i = 2; i <= n; i++)
        product *= i;
    return product;
}

/* (1/V) integral of B_a B_b, B_a = m!/a! lambda^a:  m!/a! m!/b! (a+b)! 3!/(2m+3)!  */
static double mean_product(const uint8_t *beta, unsigned k, const uint8_t *gamma, unsigned l)
{
    double value = 6;
    unsigned m = 0;

    if (beta[k] == 0 || gamma[l] == 0)
        return 0;
    for (unsigned c = 0; c < 4; c++) {
        const unsigned a = beta[c] - (unsigned)(c == k), b = gamma[c] - (unsigned)(c == l);

        value *= factorial(a + b) / factorial(a) / factorial(b);
        m += a;
    }
    return value * factorial(m) * factorial(m) / factorial(2 * m + 3);
}

void gsn_fit_smooth_init(struct gsn_fit_smooth *smooth, const struct gsn_dms *space)
{
    smooth->degree = gsn_dms_degree(space);
    smooth->functions = gsn_dms_functions(space);
    for (size_t f = 0; f < smooth->functions; f++)
        for (size_t g = 0; g < smooth->functions; g++)
            for (unsigned k = 0; k < 4; k++)
                for (unsigned l = 0; l < 4; l++)
                    smooth->mass[f][k][g][l] =
                        mean_product(gsn_dms_beta(space, f), k, gsn_dms_beta(space, g), l);
}

/* dot[k][l] = grad lambda_k . grad lambda_l. */
static void gradients(const struct gsn_tets *mesh, size_t tet, double dot[4][4])
{
    const uint32_t *v = mesh->tet[tet];
    double gradient[4][3];
    struct gsn_frame frame;

    gsn_frame_init(&frame, mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]],
                   mesh->vertex[v[3]]);
    for (size_t c = 0; c < 3; c++) {
        gradient[0][c] = -(frame.row[0][c] + frame.row[1][c] + frame.row[2][c]);
        for (size_t k = 1; k < 4; k++)
            gradient[k][c] = frame.row[k - 1][c];
    }
    for (size_t k = 0; k < 4; k++)
        for (size_t l = 0; l < 4; l++)
            dot[k][l] = gsn_dot(gradient[k], gradient[l]);
}

void gsn_fit_smooth_add(const struct gsn_fit_smooth *smooth, const struct gsn_tets *mesh,
                        size_t tet, double weight, double *block)
{
    const double n = smooth->degree;
    const double scale = weight * n * n * gsn_tets_volume(mesh, tet);
    double dot[4][4];

    gradients(mesh, tet, dot);
    for (size_t f = 0; f < smooth->functions; f++)
        for (size_t g = f; g < smooth->functions; g++) {
            double sum = 0;

            for (size_t k = 0; k < 4; k++)
                for (size_t l = 0; l < 4; l++)
                    sum += dot[k][l] * smooth->mass[f][k][g][l];
            *block++ += scale * sum;
        }
}
