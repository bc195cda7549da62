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
