/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the sections around a place predict of it, and whether two sections change the way they do.
 *
 * Steps: (1) a straight line by least squares through up to three sections on either side of a
 * place, cell by cell, gives the place's density; of three sections on one side each is held to
 * their middle one, so that dirt and tears of a single one do not count. (2) The noise of a cell is
 * the median square of what all sections differ from their lines by. (3) The change from one
 * section to another is multiplied, cell by cell, with the change that the lines around both
 * predict, weighed like a Wiener filter: by the share of it that is above its noise, over the
 * noise. (4) Both changes are freed of what registration and stain may have to do with them
 * (align.h). (5) Sums over squares of cells, whose scatter is the error of their total.
 *
 * Nothing is shown where it all rests on a few squares. Fails when memory runs out. */
#include "pipeline/register/order/predict.h"

#include "pipeline/core/robust.h"
#include "pipeline/imaging/smooth.h"

#include <math.h>
#include <string.h>

/* ---- a line through the sections around --------------------------------------------------- */

static struct gsn_sequence_line fit_slope(const double *z, size_t n, size_t i, size_t j)
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
    struct gsn_sequence_line line = fit_slope(z, n, i, j);
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

/* ---- prediction of a place ---------------------------------------------------------------- */

enum { SIDE = GSN_SEQUENCE_SIDE, STRIP = 32 };

/* A section is off the middle one of three on its side, and off another, by no more than this in
 * standard deviations of its noise: dirt, tears and debris have no more say than that. */
static const double MOST = 3;

/* Planes on one side of a place; fewer than three: the last again, with no weight. */
struct side {
    const float *value[SIDE];
    const unsigned char *known[SIDE];
    float much[SIDE];
    size_t count;
};

/* The planes of a line from the first on that lie on its side of a place. */
static struct side take_side(const struct gsn_sequence_tissue *t,
                             const struct gsn_sequence_line *line, size_t first, size_t place)
{
    const size_t cells = t->columns * t->rows;
    struct side s = { .count = 0 };

    for (size_t k = 0; k < SIDE; k++) {
        const size_t i = first + k;
        const int is = i < line->count && (line->at[i] > place) == (line->at[first] > place);
        const size_t plane = t->place[line->at[is ? i : first + s.count - 1]];

        s.value[k] = t->value + plane * cells;
        s.known[k] = t->known + plane * cells;
        s.much[k] = is ? (float)line->weight[i] : 0;
        s.count += (size_t)is;
    }
    return s;
}

/* Cells that are worked out together, and one in so many. */
struct strip {
    size_t first, count, step;
};

static int are_all_known(const struct side *s, struct strip at)
{
    const unsigned char *a = s->known[0] + at.first, *b = s->known[1] + at.first,
                        *d = s->known[2] + at.first;
    unsigned char all = 1;

    for (size_t c = 0; c < (at.count - 1) * at.step + 1; c++)
        all &= a[c] & b[c] & d[c];
    return all;
}

static void copy_strip(const struct side *s, struct strip at, float ret_value[SIDE][STRIP])
{
    for (size_t k = 0; k < SIDE; k++)
        for (size_t c = 0; c < at.count; c++)
            ret_value[k][c] = s->value[k][at.first + c * at.step];
}

/* A cell that some planes do not know is the others' mean there. */
static void fill_unknown_cell(const unsigned char known[SIDE], float value[SIDE][STRIP], size_t c,
                              unsigned char *predictable)
{
    float sum = 0, count = 0;

    for (size_t k = 0; k < SIDE; k++) {
        sum += known[k] ? value[k][c] : 0;
        count += known[k];
    }
    for (size_t k = 0; k < SIDE && count > 0; k++)
        value[k][c] = known[k] ? value[k][c] : sum / count;
    *predictable = count > 0 ? *predictable : 0;
}

static void fill_unknown(const struct side *s, struct strip at, float value[SIDE][STRIP],
                         unsigned char *predictable)
{
    for (size_t c = 0; c < at.count; c++) {
        const size_t i = at.first + c * at.step;
        const unsigned char known[SIDE] = { s->known[0][i], s->known[1][i], s->known[2][i] };

        if (!(known[0] & known[1] & known[2]))
            fill_unknown_cell(known, value, c, &predictable[c]);
    }
}

static void add_side(const struct side *s, const float *const value[SIDE], size_t count,
                     float *restrict sum)
{
    for (size_t k = 0; k < s->count; k++)
        for (size_t c = 0; c < count; c++)
            sum[c] += s->much[k] * value[k][c];
}

/* Three held to their middle. */
static void add_clipped(const struct side *s, const float *const value[SIDE],
                        const float *deviation, size_t count, float *restrict sum)
{
    const float *a = value[0], *b = value[1], *d = value[2];

    for (size_t c = 0; c < count; c++) {
        const float most = (float)MOST * deviation[c];
        const float mid =
            gsn_sequence_greatest(gsn_sequence_least(a[c], b[c]),
                                  gsn_sequence_least(gsn_sequence_greatest(a[c], b[c]), d[c]));

        sum[c] += s->much[0] * (mid + gsn_sequence_clip(a[c] - mid, most)) +
                  s->much[1] * (mid + gsn_sequence_clip(b[c] - mid, most)) +
                  s->much[2] * (mid + gsn_sequence_clip(d[c] - mid, most));
    }
}

static void add_strip(const struct gsn_sequence_tissue *t, const struct side *s, struct strip at,
                      float *sum, unsigned char *predictable)
{
    const int all = are_all_known(s, at);
    const float *value[SIDE];
    float room[SIDE][STRIP];

    if (!all || at.step > 1)
        copy_strip(s, at, room);
    if (!all)
        fill_unknown(s, at, room, predictable);
    for (size_t k = 0; k < SIDE; k++)
        value[k] = !all || at.step > 1 ? room[k] : s->value[k] + at.first;
    if (s->count == SIDE && at.step == 1)
        add_clipped(s, value, t->deviation + at.first, at.count, sum);
    else
        add_side(s, value, at.count, sum);
}

void gsn_sequence_predict(const struct gsn_sequence_tissue *t, const struct gsn_sequence_line *line,
                          size_t place, size_t step, float *ret_value, unsigned char *predictable)
{
    const size_t count = (t->columns * t->rows + step - 1) / step;

    memset(ret_value, 0, count * sizeof *ret_value);
    for (size_t from = 0; from < line->count;) {
        const struct side side = take_side(t, line, from, place);

        for (size_t c = 0; c < count; c += STRIP)
            add_strip(t, &side,
                      (struct strip){ c * step, count - c < STRIP ? count - c : STRIP, step },
                      ret_value + c, predictable + c);
        from += side.count;
    }
}

/* ---- the change between two sections ------------------------------------------------------ */

enum { SQUARE = 6, SMOOTHINGS = 3, NOISE_SMOOTHINGS = 4 };

/* Median of the square of a standard normal number. */
static const double MEDIAN_SQUARE = 0.455;

/* Least noise variance of a cell, in squares of the tissue's density. */
static const double LEAST_NOISE2 = 1e-4;

/* What the sections around say of a cell counts by its share beyond this many times their noise. */
static const double BEYOND = 2;

/* Fewer squares of the same weight tell no error. */
static const double FEWEST = 8;

static const float *get_plane(const struct gsn_sequence_tissue *t, size_t place)
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
    gsn_smooth_binomial(t->noise2, t->columns, t->rows, NOISE_SMOOTHINGS);
    for (size_t c = 0; c < cells; c++) {
        t->noise2[c] += (float)LEAST_NOISE2;
        t->deviation[c] = sqrtf(t->noise2[c]);
    }
    return GSN_OK;
}

/* Variance of the difference of two lines over one section's. */
static double line_noise_between(const struct gsn_sequence_line *a,
                                 const struct gsn_sequence_line *b)
{
    double sum = gsn_sequence_line_noise(a) + gsn_sequence_line_noise(b);

    for (size_t i = 0; i < a->count; i++)
        for (size_t j = 0; j < b->count; j++)
            if (a->at[i] == b->at[j])
                sum -= 2 * a->weight[i] * b->weight[j];
    return sum;
}

/* Over the square of cells that begins at x and y. */
static double sum_square(const struct gsn_sequence_tissue *t, const float *cells, size_t x,
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
    const unsigned char *known = m->known[0], *known_too = m->known[1],
                        *predictable = t->predictable;
    const float *noise2 = t->noise2, *change = t->change, beyond = (float)(BEYOND * noise);
    float *restrict energy = t->energy;

    for (size_t c = 0; c < t->columns * t->rows; c++) {
        const float share = 1 - beyond * noise2[c] / gsn_sequence_greatest(energy[c], 1e-12f);

        energy[c] = (float)(known[c] & known_too[c] & predictable[c]) *
                    gsn_sequence_greatest(share, 0) * change[c] / noise2[c];
    }
}

static void multiply_filter(const struct gsn_sequence_tissue *t, const float *filter,
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
    multiply_filter(t, t->energy, t->off);
    multiply_filter(t, t->energy, t->off_too);
    multiply_filter(t, t->energy, t->change);
    for (size_t i = 0; i < across * ((t->rows + SQUARE - 1) / SQUARE); i++) {
        const size_t x = i % across * SQUARE, y = i / across * SQUARE;

        t->square[i] = (struct gsn_sequence_square){ -sum_square(t, t->off, x, y),
                                                     sum_square(t, t->off_too, x, y),
                                                     sum_square(t, t->change, x, y) };
    }
}

/* What lies about the middle between two places, neither of the two in it. */
static void compute_median_between(const struct gsn_sequence_tissue *t, size_t i, size_t j)
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
    gsn_smooth_binomial(t->onto, t->columns, t->rows, 1);
}

/* Leaves the change predicted in change, where it is predictable, its smooth square in energy, and
 * in off and off_too how the two planes differ from the middle between the places, each without
 * what registration and stain may have to do with it: a section's own registration follows its
 * neighbours and would say that it lies right wherever it is. */
static struct gsn_sequence_modes compute_differences(const struct gsn_sequence_tissue *t, size_t i,
                                                     size_t j, double *ret_noise)
{
    const size_t cells = t->columns * t->rows;
    const struct gsn_sequence_line a = gsn_sequence_line_at(t->z, t->n, i, j, t->z[i]),
                                   b = gsn_sequence_line_at(t->z, t->n, j, i, t->z[j]);
    const float *from = get_plane(t, i), *to = get_plane(t, j);
    const struct gsn_sequence_modes modes = {
        t->onto, t->energy, { t->known + t->place[i] * cells, t->known + t->place[j] * cells }
    };

    compute_median_between(t, i, j);
    memset(t->predictable, 1, cells);
    gsn_sequence_predict(t, &a, i, 1, t->off, t->predictable);
    gsn_sequence_predict(t, &b, j, 1, t->off_too, t->predictable);
    for (size_t c = 0; c < cells; c++) {
        const float middle_density = 0.5f * (t->off[c] + t->off_too[c]);

        t->change[c] = t->off_too[c] - t->off[c];
        t->energy[c] = to[c] - from[c];
        t->off[c] = from[c] - middle_density;
        t->off_too[c] = to[c] - middle_density;
    }
    gsn_sequence_remove_modes(t, &modes, (float *[]){ t->off, t->off_too, t->change },
                              GSN_SEQUENCE_DIFFERENCES);
    for (size_t c = 0; c < cells; c++)
        t->energy[c] = t->change[c] * t->change[c];
    gsn_smooth_binomial(t->energy, t->columns, t->rows, SMOOTHINGS);
    *ret_noise = line_noise_between(&a, &b);
    return modes;
}

struct gsn_sequence_change gsn_sequence_change_between(const struct gsn_sequence_tissue *t,
                                                       size_t i, size_t j)
{
    const size_t squares = ((t->columns + SQUARE - 1) / SQUARE) * ((t->rows + SQUARE - 1) / SQUARE);
    double first = 0, second = 0, predicted = 0, squared = 0, left = 0, share, noise;
    const struct gsn_sequence_modes modes = compute_differences(t, i, j, &noise);

    add_squares(t, &modes, noise);
    for (size_t k = 0; k < squares; k++) {
        first += t->square[k].first;
        second += t->square[k].second;
        predicted += t->square[k].predicted;
        squared += t->square[k].predicted * t->square[k].predicted;
    }
    if (!(predicted * predicted > FEWEST * squared))
        return (struct gsn_sequence_change){ 0, 0, 0, 0 };
    share = fmin(fmax((first + second) / predicted, -1), 1);
    for (size_t k = 0; k < squares; k++) {
        const struct gsn_sequence_square *s = &t->square[k];

        left += pow(s->first + s->second - share * s->predicted, 2);
    }
    left = sqrt(left);
    return left > 0 ? (struct gsn_sequence_change){ (first + second) / left, predicted / left,
                                                    first / left, second / left }
                    : (struct gsn_sequence_change){ 0, 0, 0, 0 };
}
