/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/refine_parts.h"

#include <math.h>

void gsn_refine_basis(const struct gsn_refine_stack *stack, double x, double y, double ret_x[PARTS],
                      double ret_y[PARTS])
{
    const double scale = stack->cell_um / stack->unit_um, half = 0.5 * (double)stack->side - 0.5;
    const double u = scale * (x - half), v = scale * (y - half);
    const double of_x[PARTS] = { 1, 0, -v, u, u, v }, of_y[PARTS] = { 0, 1, u, v, -v, u };

    for (size_t p = 0; p < PARTS; p++) {
        ret_x[p] = of_x[p];
        ret_y[p] = of_y[p];
    }
}

/* Between the four cells around it; NaN where one of them is not known or not there. */
static float value_at(const float *plane, size_t side, double x, double y)
{
    const double last = (double)side - 1;
    size_t i, j;
    float s, t;

    if (!(x >= 0 && y >= 0 && x <= last && y <= last))
        return NAN;
    i = x < last ? (size_t)x : side - 2;
    j = y < last ? (size_t)y : side - 2;
    s = (float)(x - (double)i);
    t = (float)(y - (double)j);

    const float *at = plane + j * side + i;

    return (at[0] * (1 - s) + at[1] * s) * (1 - t) + (at[side] * (1 - s) + at[side + 1] * s) * t;
}

void gsn_refine_lay(const struct gsn_refine_stack *stack, const float *density,
                    const double move[PARTS], float *ret_laid)
{
    for (size_t y = 0; y < stack->side; y++)
        for (size_t x = 0; x < stack->side; x++) {
            double bx[PARTS], by[PARTS], dx = 0, dy = 0;

            gsn_refine_basis(stack, (double)x, (double)y, bx, by);
            for (size_t p = 0; p < PARTS; p++) {
                dx += bx[p] * move[p] / stack->cell_um;
                dy += by[p] * move[p] / stack->cell_um;
            }
            ret_laid[y * stack->side + x] =
                value_at(density, stack->side, (double)x + dx, (double)y + dy);
        }
}

struct gsn_affine gsn_refine_map(const struct gsn_refine_stack *stack, const double move[PARTS])
{
    const double *m = move, unit = stack->unit_um;
    const double xx = (m[3] + m[4]) / unit, xy = (m[5] - m[2]) / unit;
    const double yx = (m[5] + m[2]) / unit, yy = (m[3] - m[4]) / unit;
    const struct gsn_point c = stack->centre;
    const struct gsn_affine shown = { 1 + xx, xy,     m[0] - xx * c.x - xy * c.y,
                                      yx,     1 + yy, m[1] - yx * c.x - yy * c.y };

    return gsn_affine_inverse(&shown);
}

void gsn_refine_line(const struct gsn_refine_stack *stack, const int *there, size_t i,
                     double ret_weight[2 * AROUND + 1])
{
    double sum = 0, first = 0, second = 0, before = 0, after = 0, far[2 * AROUND + 1] = { 0 };

    for (size_t k = 0; k <= 2 * AROUND; k++) {
        const size_t j = i + k - AROUND;
        double d;

        ret_weight[k] = 0;
        if (k == AROUND || i + k < AROUND || j >= stack->count || !there[j])
            continue;
        d = (double)stack->section[j].serial - (double)stack->section[i].serial;
        if (fabs(d) > AROUND)
            continue;
        far[k] = d;
        ret_weight[k] = 1 - fabs(d) / (AROUND + 1);
        sum += ret_weight[k];
        first += ret_weight[k] * d;
        second += ret_weight[k] * d * d;
        before += d < 0;
        after += d > 0;
    }
    for (size_t k = 0; k <= 2 * AROUND; k++)
        ret_weight[k] *= before > 0 && after > 0
                             ? (second - first * far[k]) / (sum * second - first * first)
                             : 0;
}

/* Separable; ends beyond the square count as 0. scratch: as large as the plane. */
void gsn_refine_blur(size_t side, double sigma, float *scratch, float *plane)
{
    const long reach = (long)ceil(3 * sigma), n = (long)side;

    for (int pass = 0; pass < 2; pass++) {
        const float *from = pass ? scratch : plane;
        float *to = pass ? plane : scratch;
        const long along = pass ? n : 1, across = pass ? 1 : n;

        for (long i = 0; i < n; i++)
            for (long k = 0; k < n; k++) {
                double sum = 0, weight = 0;

                for (long d = -reach; d <= reach; d++) {
                    const double w = exp(-0.5 * (double)(d * d) / (sigma * sigma));

                    weight += w;
                    if (k + d >= 0 && k + d < n)
                        sum += w * (double)from[i * across + (k + d) * along];
                }
                to[i * across + k * along] = (float)(sum / weight);
            }
    }
}
