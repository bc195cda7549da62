/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include <math.h>
#include <string.h>

enum { MODES = 9, PASSES = 3 };

/* The nearest known value of this cell below or above, or their mean. */
static double fill_in(const float *value, size_t n, size_t cells, size_t plane, size_t cell)
{
    double sum = 0;
    int found = 0;

    for (size_t k = plane; k-- > 0 && !found;)
        if (!isnan(value[k * cells + cell])) {
            sum += (double)value[k * cells + cell];
            found = 1;
        }
    for (size_t k = plane + 1, above = 0; k < n && !above; k++)
        if (!isnan(value[k * cells + cell])) {
            sum += (double)value[k * cells + cell];
            found++;
            above = 1;
        }
    return found ? sum / found : 0;
}

void gsn_sequence_gather(const struct gsn_sequence_plane *planes, struct gsn_sequence_cells *a)
{
    const size_t cells = a->columns * a->rows;

    for (size_t i = 0; i < a->n; i++) {
        a->z[i] = planes[i].serial;
        memcpy(a->next + i * cells, planes[i].density, cells * sizeof *a->next);
    }
    for (size_t i = 0; i < a->n; i++) {
        double sum = 0;

        for (size_t c = 0; c < cells; c++) {
            const float own = a->next[i * cells + c];

            a->value[i * cells + c] = isnan(own) ? (float)fill_in(a->next, a->n, cells, i, c) : own;
            sum += (double)a->value[i * cells + c];
        }
        for (size_t c = 0; sum > 0 && c < cells; c++)
            a->value[i * cells + c] *= (float)((double)cells / sum);
    }
}

/* Once along a line of cells by (1 2 1) / 4, ends held. */
static void smooth_line(float *cell, size_t count, size_t stride)
{
    float before = cell[0];

    for (size_t k = 0; k < count; k++) {
        const float own = cell[k * stride];
        const float after = k + 1 < count ? cell[(k + 1) * stride] : own;

        cell[k * stride] = 0.25f * before + 0.5f * own + 0.25f * after;
        before = own;
    }
}

void gsn_sequence_smooth(float *cells, size_t columns, size_t rows, int times)
{
    for (int pass = 0; pass < times; pass++) {
        for (size_t y = 0; y < rows; y++)
            smooth_line(cells + y * columns, columns, 1);
        for (size_t x = 0; x < columns; x++)
            smooth_line(cells + x, rows, columns);
    }
}

/* The modes in which a section differs from its neighbours because of how it was laid and stained:
 * shift, and affine change of the tissue by its own slopes; amount of stain, even and ramped. */
static void modes_at(const double *mean, size_t columns, size_t rows, size_t x, size_t y,
                     double ret_mode[MODES])
{
    const size_t c = y * columns + x;
    const double u = ((double)x + 0.5) / (double)columns - 0.5;
    const double v = ((double)y + 0.5) / (double)rows - 0.5;
    const double sx = x > 0 && x + 1 < columns ? 0.5 * (mean[c + 1] - mean[c - 1]) : 0;
    const double sy = y > 0 && y + 1 < rows ? 0.5 * (mean[c + columns] - mean[c - columns]) : 0;
    const double mode[MODES] = { sx,     sy,      u * sx,      v * sx,     u * sy,
                                 v * sy, mean[c], u * mean[c], v * mean[c] };

    memcpy(ret_mode, mode, sizeof mode);
}

/* Cholesky's solution of the normal equations; modes that say nothing are left at 0. */
static void solve_modes(double a[MODES][MODES], double b[MODES])
{
    for (size_t k = 0; k < MODES; k++) {
        const double pivot = a[k][k];

        if (!(pivot > 0))
            continue;
        for (size_t i = k + 1; i < MODES; i++) {
            const double f = a[i][k] / pivot;

            for (size_t j = k; j < MODES; j++)
                a[i][j] -= f * a[k][j];
            b[i] -= f * b[k];
        }
    }
    for (size_t k = MODES; k-- > 0;) {
        for (size_t j = k + 1; j < MODES; j++)
            b[k] -= a[k][j] * b[j];
        b[k] = a[k][k] > 0 ? b[k] / a[k][k] : 0;
    }
}

/* Takes from one plane what the modes of its surroundings explain of the difference to them. */
static void align_one(const float *value, const double *mean, size_t columns, size_t rows,
                      float *ret_value)
{
    double normal[MODES][MODES] = { 0 }, right[MODES] = { 0 }, mode[MODES];

    for (size_t y = 0; y < rows; y++)
        for (size_t x = 0; x < columns; x++) {
            const size_t c = y * columns + x;
            const double off = (double)value[c] - mean[c];

            modes_at(mean, columns, rows, x, y, mode);
            for (size_t i = 0; i < MODES; i++) {
                for (size_t j = 0; j <= i; j++)
                    normal[i][j] += mode[i] * mode[j];
                right[i] += mode[i] * off;
            }
        }
    for (size_t i = 0; i < MODES; i++) {
        normal[i][i] *= 1 + 1e-9;
        for (size_t j = 0; j < i; j++)
            normal[j][i] = normal[i][j];
    }
    solve_modes(normal, right);
    for (size_t y = 0; y < rows; y++)
        for (size_t x = 0; x < columns; x++) {
            const size_t c = y * columns + x;
            double sum = 0;

            modes_at(mean, columns, rows, x, y, mode);
            for (size_t i = 0; i < MODES; i++)
                sum += right[i] * mode[i];
            ret_value[c] = (float)((double)value[c] - sum);
        }
}

/* The mean of the sections around a place. */
static void surroundings(struct gsn_sequence_cells *a, size_t plane)
{
    const size_t cells = a->columns * a->rows;
    size_t at[GSN_SEQUENCE_AROUND];
    const size_t count = gsn_sequence_around(a->n, plane, plane, at);

    memset(a->mean, 0, cells * sizeof *a->mean);
    for (size_t k = 0; k < count; k++)
        for (size_t c = 0; c < cells; c++)
            a->mean[c] += (double)a->value[at[k] * cells + c] / (double)count;
}

void gsn_sequence_align(struct gsn_sequence_cells *a)
{
    const size_t cells = a->columns * a->rows;

    for (int pass = 0; pass < PASSES; pass++) {
        for (size_t i = 0; i < a->n; i++) {
            surroundings(a, i);
            align_one(a->value + i * cells, a->mean, a->columns, a->rows, a->next + i * cells);
        }
        memcpy(a->value, a->next, a->n * cells * sizeof *a->value);
    }
}
