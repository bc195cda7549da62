/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include "pipeline/core/linalg.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* What laying and stain do is told in squares of cells, over some squares to either side. */
enum { SQUARE = 8, LOCAL = 3, REACH = 4 };

/* Sums of products over a square's cells: modes with each other, then with every difference; and
 * how many cells it has room for. */
enum {
    PAIRS = LOCAL * (LOCAL + 1) / 2,
    AMOUNTS = LOCAL * GSN_SEQUENCE_DIFFERENCES,
    ROOM = PAIRS + AMOUNTS,
    PRODUCTS
};

/* Variance of the noise over that of the modes expected: small beside any edge, large beside
 * none. */
static const double STIFF[LOCAL] = { 4e-4, 4e-4, 4e-3 };
/* Standard deviation of the weights of the squares around one, in squares. */
static const double WIDE = 2;

struct taking {
    size_t columns, rows, across, down, count;
    size_t width;               /* of a row: whole squares, half of one on either side */
    double (*square)[PRODUCTS]; /* across * down; once solved, how much of each mode is there */
    double (*along)[PRODUCTS];  /* as many: summed along x about each */
    float *amount;              /* down * AMOUNTS rows: the same along x, for every cell */
    float *mode;                /* LOCAL rows */
    float *kept;                /* LOCAL rows: of cells that count */
    float *sum;                 /* ROOM rows: of a column of a square; one more: scratch */
    double weight[REACH + 1];
};

static struct taking taking_of(const struct gsn_sequence_tissue *t, size_t count)
{
    struct taking a = { t->columns,
                        t->rows,
                        (t->columns + SQUARE - 1) / SQUARE,
                        (t->rows + SQUARE - 1) / SQUARE,
                        count,
                        .square = t->modes };

    a.width = (a.across + 1) * SQUARE;
    a.along = a.square + a.across * a.down;
    a.amount = (float *)(void *)(a.along + a.across * a.down);
    a.mode = a.amount + a.down * AMOUNTS * a.width;
    a.kept = a.mode + LOCAL * a.width;
    a.sum = a.kept + LOCAL * a.width;
    for (int i = 0; i <= REACH; i++)
        a.weight[i] = exp(-i * i / (2 * WIDE * WIDE));
    return a;
}

size_t gsn_sequence_modes_size(size_t columns, size_t rows)
{
    const size_t across = (columns + SQUARE - 1) / SQUARE, down = (rows + SQUARE - 1) / SQUARE;

    return 2 * across * down * PRODUCTS * sizeof(double) +
           (down * AMOUNTS + 2 * LOCAL + PRODUCTS) * (across + 1) * SQUARE * sizeof(float);
}

static void modes_of_row(const struct taking *a, const float *onto, size_t y)
{
    const float *at = onto + y * a->columns;
    const int inside = y > 0 && y + 1 < a->rows;
    const float *above = inside ? at - a->columns : at, *below = inside ? at + a->columns : at;
    float *along_x = a->mode, *along_y = a->mode + a->width;

    for (size_t x = 1; x + 1 < a->columns; x++)
        along_x[x] = 0.5f * (at[x + 1] - at[x - 1]);
    along_x[0] = along_x[a->columns - 1] = 0;
    for (size_t x = 0; x < a->columns; x++)
        along_y[x] = 0.5f * (below[x] - above[x]);
    memcpy(along_y + a->width, at, a->columns * sizeof *at);
}

static void add_products(float *restrict sum, const float *one, const float *other, size_t count)
{
    for (size_t x = 0; x < count; x++)
        sum[x] += one[x] * other[x];
}

/* The modes of cells that are known in both planes and laid right but for an edge. */
static void keep_row(const struct taking *a, const struct gsn_sequence_modes *m, size_t y)
{
    const size_t first = y * a->columns;
    const unsigned char *known = m->known[0] + first, *known_too = m->known[1] + first;
    const float *gross = m->gross + first;
    float *restrict counts = a->sum + ROOM * a->width;

    for (size_t x = 0; x < a->columns; x++) {
        const float laid = fabsf(gross[x]) < (float)GSN_SEQUENCE_GROSS ? 1 : 0;

        counts[x] = laid * (float)(known[x] & known_too[x]);
    }
    for (size_t i = 0; i < LOCAL; i++) {
        const float *mode = a->mode + i * a->width;
        float *restrict kept = a->kept + i * a->width;

        for (size_t x = 0; x < a->columns; x++)
            kept[x] = counts[x] * mode[x];
    }
}

static void add_row(const struct taking *a, float *const *off, size_t y)
{
    const size_t w = a->width;
    float *sum = a->sum;

    for (size_t i = 0; i < LOCAL; i++)
        for (size_t j = 0; j <= i; j++, sum += w)
            add_products(sum, a->kept + i * w, a->mode + j * w, a->columns);
    for (size_t k = 0; k < a->count; k++)
        for (size_t i = 0; i < LOCAL; i++, sum += w)
            add_products(sum, a->kept + i * w, off[k] + y * a->columns, a->columns);
}

/* The sums of columns, SQUARE by SQUARE; they begin anew. */
static void close_squares(const struct taking *a, double (*ret_square)[PRODUCTS])
{
    for (size_t i = 0; i < ROOM; i++)
        for (size_t x = 0; x < a->across; x++) {
            const float *sum = a->sum + i * a->width + x * SQUARE;
            float all = 0;

            for (size_t k = 0; k < SQUARE; k++)
                all += sum[k];
            ret_square[x][i] = (double)all;
        }
    for (size_t x = 0; x < a->across; x++)
        ret_square[x][ROOM] = SQUARE * SQUARE;
    memset(a->sum, 0, ROOM * a->width * sizeof *a->sum);
}

static void add_squares(const struct taking *a, const struct gsn_sequence_modes *m,
                        float *const *off)
{
    memset(a->sum, 0, ROOM * a->width * sizeof *a->sum);
    for (size_t y = 0; y < a->rows; y++) {
        modes_of_row(a, m->onto, y);
        keep_row(a, m, y);
        add_row(a, off, y);
        if (y % SQUARE == SQUARE - 1 || y + 1 == a->rows)
            close_squares(a, a->square + y / SQUARE * a->across);
    }
}

/* Weighed sums from up to REACH before one to as many behind it, of count that lie step apart. */
static void add_around(const struct taking *a, double (*from)[PRODUCTS], size_t step, size_t count,
                       size_t at, double ret_sum[PRODUCTS])
{
    memset(ret_sum, 0, PRODUCTS * sizeof *ret_sum);
    for (size_t k = at > REACH ? at - REACH : 0; k <= at + REACH && k < count; k++) {
        const double weight = a->weight[k > at ? k - at : at - k];

        for (size_t i = 0; i < PRODUCTS; i++)
            ret_sum[i] += weight * from[k * step][i];
    }
}

/* How much of each mode is in the differences about a square. */
static void solve_square(const struct taking *a, const double sum[PRODUCTS],
                         double ret_much[AMOUNTS])
{
    double normal[LOCAL][LOCAL];
    size_t at = 0;

    for (size_t i = 0; i < LOCAL; i++) {
        for (size_t j = 0; j <= i; j++)
            normal[i][j] = normal[j][i] = sum[at++];
        normal[i][i] += sum[ROOM] * STIFF[i];
    }
    memset(ret_much, 0, AMOUNTS * sizeof *ret_much);
    if (gsn_cholesky(&normal[0][0], LOCAL, LOCAL) < 0)
        return;
    memcpy(ret_much, sum + at, a->count * LOCAL * sizeof *ret_much);
    for (size_t k = 0; k < a->count; k++)
        gsn_cholesky_solve(&normal[0][0], LOCAL, LOCAL, ret_much + k * LOCAL);
}

/* Between the middles of squares what was found there changes evenly, here along x. */
static void spread(const struct taking *a, size_t y, size_t k)
{
    const double(*much)[PRODUCTS] = (const double(*)[PRODUCTS])(a->square + y * a->across);
    float *amount = a->amount + (y * AMOUNTS + k) * a->width;

    for (size_t x = 0; x < SQUARE / 2; x++)
        amount[x] = (float)much[0][k];
    for (size_t i = 0; i < a->across; i++) {
        const float from = (float)much[i][k], to = (float)much[i + 1 < a->across ? i + 1 : i][k];

        for (size_t x = 0; x < SQUARE; x++)
            amount[i * SQUARE + SQUARE / 2 + x] = from + ((float)x + 0.5f) / SQUARE * (to - from);
    }
}

static void solve_squares(const struct taking *a)
{
    for (size_t i = 0; i < a->across * a->down; i++)
        add_around(a, a->square + i / a->across * a->across, 1, a->across, i % a->across,
                   a->along[i]);
    for (size_t i = 0; i < a->across * a->down; i++) {
        double sum[PRODUCTS];

        add_around(a, a->along + i % a->across, a->across, a->down, i / a->across, sum);
        solve_square(a, sum, a->square[i]);
    }
    for (size_t y = 0; y < a->down; y++)
        for (size_t k = 0; k < LOCAL * a->count; k++)
            spread(a, y, k);
}

/* The same along y. */
static void take_row(const struct taking *a, size_t y, const float *amount, float *restrict off)
{
    const size_t w = a->width;
    const size_t at = y < SQUARE / 2 ? 0 : (y - SQUARE / 2) / SQUARE;
    const size_t next = y < SQUARE / 2 || at + 1 == a->down ? at : at + 1;
    const float s = ((float)((y + SQUARE / 2) % SQUARE) + 0.5f) / SQUARE, r = 1 - s;
    const float *one = amount + at * AMOUNTS * w, *other = amount + next * AMOUNTS * w;

    for (size_t i = 0; i < LOCAL; i++)
        for (size_t x = 0; x < a->columns; x++)
            off[x] -= a->mode[i * w + x] * (r * one[i * w + x] + s * other[i * w + x]);
}

void gsn_sequence_take_off(const struct gsn_sequence_tissue *t, const struct gsn_sequence_modes *m,
                           float *const *off, size_t count)
{
    const struct taking a = taking_of(t, count);

    assert(count <= GSN_SEQUENCE_DIFFERENCES);

    add_squares(&a, m, off);
    solve_squares(&a);
    for (size_t y = 0; y < a.rows; y++) {
        modes_of_row(&a, m->onto, y);
        for (size_t k = 0; k < count; k++)
            take_row(&a, y, a.amount + k * LOCAL * a.width, off[k] + y * a.columns);
    }
}
