/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include <math.h>

enum { SIDE = GSN_SEQUENCE_SIDE };

size_t gsn_sequence_around(size_t n, size_t i, size_t j, size_t ret_at[GSN_SEQUENCE_AROUND])
{
    size_t count = 0;

    for (size_t k = i, found = 0; k-- > 0 && found < SIDE;)
        if (k != j) {
            ret_at[count++] = k;
            found++;
        }
    for (size_t k = i + 1, found = 0; k < n && found < SIDE; k++)
        if (k != j) {
            ret_at[count++] = k;
            found++;
        }
    return count;
}

static struct gsn_sequence_line slope_at(const double *z, size_t n, size_t i, size_t j)
{
    struct gsn_sequence_line line = { .count = gsn_sequence_around(n, i, j, line.at) };
    double mean = 0, square = 0;

    for (size_t k = 0; k < line.count; k++)
        mean += z[line.at[k]] / (double)line.count;
    for (size_t k = 0; k < line.count; k++)
        square += pow(z[line.at[k]] - mean, 2);
    for (size_t k = 0; k < line.count; k++)
        line.weight[k] = (z[line.at[k]] - mean) / square;
    return line;
}

struct gsn_sequence_line gsn_sequence_line_at(const double *z, size_t n, size_t i, size_t j,
                                              double at)
{
    struct gsn_sequence_line line = slope_at(z, n, i, j);
    const double count = (double)line.count;
    double mean = 0;

    for (size_t k = 0; k < line.count; k++)
        mean += z[line.at[k]] / count;
    for (size_t k = 0; k < line.count; k++)
        line.weight[k] = 1 / count + (at - mean) * line.weight[k];
    return line;
}

double gsn_sequence_line_noise(const struct gsn_sequence_line *line)
{
    double sum = 0;

    for (size_t k = 0; k < line->count; k++)
        sum += line->weight[k] * line->weight[k];
    return sum;
}

static double inner(const struct gsn_sequence_stack *s, size_t i, size_t j)
{
    return s->gram[i * s->n + j];
}

double gsn_sequence_line_plane(const struct gsn_sequence_stack *s,
                               const struct gsn_sequence_line *line, size_t plane)
{
    double sum = 0;

    for (size_t k = 0; k < line->count; k++)
        sum += line->weight[k] * inner(s, line->at[k], plane);
    return sum;
}

double gsn_sequence_line_line(const struct gsn_sequence_stack *s, const struct gsn_sequence_line *a,
                              const struct gsn_sequence_line *b)
{
    double sum = 0;

    for (size_t k = 0; k < b->count; k++)
        sum += b->weight[k] * gsn_sequence_line_plane(s, a, b->at[k]);
    return sum;
}

double gsn_sequence_off_line(const struct gsn_sequence_stack *s, size_t k)
{
    const struct gsn_sequence_line line = gsn_sequence_line_at(s->z, s->n, k, k, s->z[k]);
    const double square = inner(s, k, k) - 2 * gsn_sequence_line_plane(s, &line, k) +
                          gsn_sequence_line_line(s, &line, &line);

    return square / (1 + gsn_sequence_line_noise(&line));
}

void gsn_sequence_multiply(const struct gsn_sequence_cells *cells, struct gsn_sequence_stack *s)
{
    const size_t count = cells->columns * cells->rows;

    for (size_t i = 0; i < s->n; i++)
        for (size_t j = 0; j <= i; j++) {
            const float *a = cells->value + i * count, *b = cells->value + j * count;
            double sum = 0;

            for (size_t c = 0; c < count; c++)
                sum += (double)a[c] * (double)b[c];
            s->gram[i * s->n + j] = s->gram[j * s->n + i] = sum;
        }
    for (size_t i = 0; i < s->n; i++)
        s->own[i] = gsn_sequence_off_line(s, i);
}
