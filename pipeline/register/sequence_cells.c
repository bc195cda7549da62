/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include <math.h>
#include <string.h>

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

/* Cells that are worked out together. */
enum { STRIP = 64 };

/* Once by (1 2 1) / 4 along a row, ends held. */
static void smooth_row(float *cell, size_t count)
{
    float old[STRIP + 2], before = cell[0];

    for (size_t first = 0; first < count; first += STRIP) {
        const size_t width = count - first < STRIP ? count - first : STRIP;

        old[0] = before;
        memcpy(old + 1, cell + first, width * sizeof *old);
        old[width + 1] = first + width < count ? cell[first + width] : old[width];
        before = old[width];
        for (size_t k = 0; k < width; k++)
            cell[first + k] = 0.25f * old[k] + 0.5f * old[k + 1] + 0.25f * old[k + 2];
    }
}

/* The same along some columns side by side. */
static void smooth_columns(float *cell, size_t width, size_t columns, size_t rows)
{
    float before[STRIP];

    memcpy(before, cell, width * sizeof *before);
    for (size_t y = 0; y < rows; y++) {
        float *row = cell + y * columns;
        const float *after = y + 1 < rows ? row + columns : row;

        for (size_t k = 0; k < width; k++) {
            const float own = row[k];

            row[k] = 0.25f * before[k] + 0.5f * own + 0.25f * after[k];
            before[k] = own;
        }
    }
}

void gsn_sequence_smooth(float *cells, size_t columns, size_t rows, int times)
{
    for (int pass = 0; pass < times; pass++) {
        for (size_t y = 0; y < rows; y++)
            smooth_row(cells + y * columns, columns);
        for (size_t x = 0; x < columns; x += STRIP)
            smooth_columns(cells + x, columns - x < STRIP ? columns - x : STRIP, columns, rows);
    }
}
