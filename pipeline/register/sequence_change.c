/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include "pipeline/core/robust.h"

#include <math.h>
#include <string.h>

enum { SQUARE = 6, SMOOTHINGS = 3, NOISE_SMOOTHINGS = 4 };

/* Median of the square of a standard normal number. */
static const double MEDIAN_SQUARE = 0.455;
/* Two sections differ by no more than this, in standard deviations of their noise: dirt, tears and
 * debris of one section have no more say than that. */
static const double MOST = 3;
/* Least noise variance of a cell, in squares of the tissue's density. */
static const double LEAST_NOISE2 = 1e-4;
/* What the sections around say of a cell counts by its share beyond this many times their noise. */
static const double BEYOND = 2;
/* Fewer squares of the same weight tell no error. */
static const double FEWEST = 8;

static const float *plane_at(const struct gsn_sequence_tissue *t, size_t place)
{
    return t->value + t->place[place] * t->columns * t->rows;
}

int gsn_sequence_learn_noise(struct gsn_sequence_tissue *t, struct gsn_error *err)
{
    const size_t cells = t->columns * t->rows;
    gsn_auto_mem(struct gsn_sequence_line) line = gsn_alloc_array(t->n, sizeof *line);
    gsn_auto_mem(double) square = gsn_alloc_array(t->n, sizeof *square);

    if (!line || !square)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", t->n);
    for (size_t k = 0; k < t->n; k++)
        line[k] = gsn_sequence_line_at(t->z, t->n, k, k, t->z[k]);
    for (size_t c = 0; c < cells; c++) {
        for (size_t k = 0; k < t->n; k++) {
            double off = (double)t->value[k * cells + c];

            for (size_t i = 0; i < line[k].count; i++)
                off -= line[k].weight[i] * (double)t->value[line[k].at[i] * cells + c];
            square[k] = off * off / (1 + gsn_sequence_line_noise(&line[k]));
        }
        t->noise2[c] = (float)(gsn_median(square, t->n) / MEDIAN_SQUARE);
    }
    gsn_sequence_smooth(t->noise2, t->columns, t->rows, NOISE_SMOOTHINGS);
    for (size_t c = 0; c < cells; c++) {
        t->noise2[c] += (float)LEAST_NOISE2;
        t->deviation[c] = sqrtf(t->noise2[c]);
    }
    return GSN_OK;
}

/* Variance of the difference of two lines over one section's. */
static double noise_between(const struct gsn_sequence_line *a, const struct gsn_sequence_line *b)
{
    double sum = gsn_sequence_line_noise(a) + gsn_sequence_line_noise(b);

    for (size_t i = 0; i < a->count; i++)
        for (size_t j = 0; j < b->count; j++)
            if (a->at[i] == b->at[j])
                sum -= 2 * a->weight[i] * b->weight[j];
    return sum;
}

/* Over the square of cells that begins at x and y. */
static double square_sum(const struct gsn_sequence_tissue *t, const float *cells, size_t x,
                         size_t y)
{
    const size_t width = t->columns - x < SQUARE ? t->columns - x : SQUARE;
    const size_t end = t->rows - y < SQUARE ? t->rows : y + SQUARE;
    float sum[SQUARE] = { 0 }, all = 0;

    for (size_t v = y; v < end; v++)
        for (size_t u = 0; u < width; u++)
            sum[u] += cells[v * t->columns + x + u];
    for (size_t u = 0; u < SQUARE; u++)
        all += sum[u];
    return (double)all;
}

/* The filter, in place of energy. */
static void make_filter(const struct gsn_sequence_tissue *t, const struct gsn_sequence_modes *m,
                        double noise)
{
    const unsigned char *known = m->known[0], *known_too = m->known[1], *told = t->told;
    const float *noise2 = t->noise2, *change = t->change, beyond = (float)(BEYOND * noise);
    float *restrict energy = t->energy;

    for (size_t c = 0; c < t->columns * t->rows; c++) {
        const float share = 1 - beyond * noise2[c] / gsn_sequence_greatest(energy[c], 1e-12f);

        energy[c] = (float)(known[c] & known_too[c] & told[c]) * gsn_sequence_greatest(share, 0) *
                    change[c] / noise2[c];
    }
}

static void multiply(const struct gsn_sequence_tissue *t, const float *filter,
                     float *restrict cells)
{
    const float *deviation = t->deviation, most = (float)MOST * sqrtf(2);

    for (size_t c = 0; c < t->columns * t->rows; c++)
        cells[c] = filter[c] * gsn_sequence_clip(cells[c], most * deviation[c]);
}

/* The products with the filter, square by square. */
static void add_squares(const struct gsn_sequence_tissue *t, const struct gsn_sequence_modes *m,
                        double noise)
{
    const size_t across = (t->columns + SQUARE - 1) / SQUARE;

    make_filter(t, m, noise);
    multiply(t, t->energy, t->off);
    multiply(t, t->energy, t->off_too);
    multiply(t, t->energy, t->change);
    for (size_t i = 0; i < across * ((t->rows + SQUARE - 1) / SQUARE); i++) {
        const size_t x = i % across * SQUARE, y = i / across * SQUARE;

        t->square[i] = (struct gsn_sequence_square){ -square_sum(t, t->off, x, y),
                                                     square_sum(t, t->off_too, x, y),
                                                     square_sum(t, t->change, x, y) };
    }
}

/* What lies about the middle between two places, neither of the two in it. */
static void lay_between(const struct gsn_sequence_tissue *t, size_t i, size_t j)
{
    const size_t middle_place = (i + j) / 2;
    size_t plane[GSN_SEQUENCE_AROUND], count = 0;

    for (size_t d = 0; d < t->n && count < GSN_SEQUENCE_AROUND; d++) {
        if (middle_place >= d && middle_place - d != i && middle_place - d != j)
            plane[count++] = t->place[middle_place - d];
        if (d > 0 && middle_place + d < t->n && count < GSN_SEQUENCE_AROUND &&
            middle_place + d != i && middle_place + d != j)
            plane[count++] = t->place[middle_place + d];
    }
    gsn_sequence_median(t, plane, count, t->onto);
    gsn_sequence_smooth(t->onto, t->columns, t->rows, 1);
}

/* Leaves the change foretold in change, where it is in told, its smooth square in energy, and in
 * off and off_too how the two planes differ from the middle between the places, each without what
 * laying and stain may have to do with it: a section's own laying follows its neighbours and would
 * say that it lies right wherever it is. */
static struct gsn_sequence_modes differ(const struct gsn_sequence_tissue *t, size_t i, size_t j,
                                        double *ret_noise)
{
    const size_t cells = t->columns * t->rows;
    const struct gsn_sequence_line a = gsn_sequence_line_at(t->z, t->n, i, j, t->z[i]),
                                   b = gsn_sequence_line_at(t->z, t->n, j, i, t->z[j]);
    const float *from = plane_at(t, i), *to = plane_at(t, j);
    const struct gsn_sequence_modes modes = {
        t->onto, t->energy, { t->known + t->place[i] * cells, t->known + t->place[j] * cells }
    };

    lay_between(t, i, j);
    memset(t->told, 1, cells);
    gsn_sequence_foretell(t, &a, i, 1, t->off, t->told);
    gsn_sequence_foretell(t, &b, j, 1, t->off_too, t->told);
    for (size_t c = 0; c < cells; c++) {
        const float middle_density = 0.5f * (t->off[c] + t->off_too[c]);

        t->change[c] = t->off_too[c] - t->off[c];
        t->energy[c] = to[c] - from[c];
        t->off[c] = from[c] - middle_density;
        t->off_too[c] = to[c] - middle_density;
    }
    gsn_sequence_take_off(t, &modes, (float *[]){ t->off, t->off_too, t->change },
                          GSN_SEQUENCE_DIFFERENCES);
    for (size_t c = 0; c < cells; c++)
        t->energy[c] = t->change[c] * t->change[c];
    gsn_sequence_smooth(t->energy, t->columns, t->rows, SMOOTHINGS);
    *ret_noise = noise_between(&a, &b);
    return modes;
}

struct gsn_sequence_change gsn_sequence_change_between(const struct gsn_sequence_tissue *t,
                                                       size_t i, size_t j)
{
    const size_t squares = ((t->columns + SQUARE - 1) / SQUARE) * ((t->rows + SQUARE - 1) / SQUARE);
    double first = 0, second = 0, foretold = 0, squared = 0, left = 0, share, noise;
    const struct gsn_sequence_modes modes = differ(t, i, j, &noise);

    add_squares(t, &modes, noise);
    for (size_t k = 0; k < squares; k++) {
        first += t->square[k].first;
        second += t->square[k].second;
        foretold += t->square[k].foretold;
        squared += t->square[k].foretold * t->square[k].foretold;
    }
    if (!(foretold * foretold > FEWEST * squared))
        return (struct gsn_sequence_change){ 0, 0, 0, 0 };
    share = fmin(fmax((first + second) / foretold, -1), 1);
    for (size_t k = 0; k < squares; k++) {
        const struct gsn_sequence_square *s = &t->square[k];

        left += pow(s->first + s->second - share * s->foretold, 2);
    }
    left = sqrt(left);
    return left > 0 ? (struct gsn_sequence_change){ (first + second) / left, foretold / left,
                                                    first / left, second / left }
                    : (struct gsn_sequence_change){ 0, 0, 0, 0 };
}
