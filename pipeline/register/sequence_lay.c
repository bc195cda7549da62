/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include "pipeline/core/geom.h"

#include "pipeline/register/small.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* Errors of laying reach over several cells, so each plane is moved, not only corrected by its
 * slopes; a few times, as the planes around it have such errors too. */
enum { PASSES = 3, STEPS = 3, MOTION = GSN_SEQUENCE_MOTION, MODES = MOTION + 1 };

/* Warp beyond an affine change is told in squares of cells, over some squares to either side. */
enum { SQUARE = 8, LOCAL = 3, REACH = 4 };

/* Densities of two planes that differ by more than this share of the tissue's are no error of
 * laying. */
static const double GROSS = 0.6;
/* Variance of the noise over that of the modes expected: small beside any edge, large beside
 * none. */
static const double STIFF[LOCAL] = { 4e-4, 4e-4, 4e-3 };
/* Standard deviation of the weights of the squares around one, in squares. */
static const double WIDE = 2;

struct frame {
    size_t columns, rows;
};

static double slope_x(const float *v, struct frame f, size_t x, size_t y)
{
    const size_t c = y * f.columns + x;

    return x > 0 && x + 1 < f.columns ? 0.5 * ((double)v[c + 1] - (double)v[c - 1]) : 0;
}

static double slope_y(const float *v, struct frame f, size_t x, size_t y)
{
    const size_t c = y * f.columns + x;

    return y > 0 && y + 1 < f.rows ? 0.5 * ((double)v[c + f.columns] - (double)v[c - f.columns])
                                   : 0;
}

/* Where a cell is looked up: motion is a shift in cells and its change over half the frame. */
static struct gsn_point moved(const double motion[MOTION], struct frame f, size_t x, size_t y)
{
    const double u = 2 * (double)x / (double)f.columns - 1, v = 2 * (double)y / (double)f.rows - 1;

    return (struct gsn_point){ (double)x + motion[0] + motion[1] * u + motion[2] * v,
                               (double)y + motion[3] + motion[4] * u + motion[5] * v };
}

/* The four cells around a point, and how far it is from the first; beyond the edge the edge. */
static size_t corner(struct frame f, struct gsn_point p, double *ret_u, double *ret_v)
{
    const double x = fmin(fmax(p.x, 0), (double)f.columns - 1.001);
    const double y = fmin(fmax(p.y, 0), (double)f.rows - 1.001);

    *ret_u = x - floor(x);
    *ret_v = y - floor(y);
    return (size_t)y * f.columns + (size_t)x;
}

static double value_at(const float *v, struct frame f, struct gsn_point p)
{
    double s, t;
    const float *at = v + corner(f, p, &s, &t);

    return (1 - t) * ((1 - s) * (double)at[0] + s * (double)at[1]) +
           t * ((1 - s) * (double)at[f.columns] + s * (double)at[f.columns + 1]);
}

static int known_at(const unsigned char *known, struct frame f, struct gsn_point p)
{
    double s, t;
    const unsigned char *at = known + corner(f, p, &s, &t);

    return at[0] && at[1] && at[f.columns] && at[f.columns + 1];
}

/* One Gauss-Newton step of a plane towards what lies around it. */
static void step(const float *plane, const float *onto, struct frame f, double motion[MOTION])
{
    double normal[MODES * MODES] = { 0 }, right[MODES] = { 0 };

    for (size_t y = 0; y < f.rows; y++)
        for (size_t x = y & 1; x < f.columns; x += 2) { /* every other cell says enough */
            const double u = 2 * (double)x / (double)f.columns - 1;
            const double v = 2 * (double)y / (double)f.rows - 1;
            const double sx = slope_x(onto, f, x, y), sy = slope_y(onto, f, x, y);
            const double level = (double)onto[y * f.columns + x];
            const double mode[MODES] = { sx, u * sx, v * sx, sy, u * sy, v * sy, level };
            const double off = level == 0 && sx == 0 && sy == 0
                                   ? GROSS
                                   : level - value_at(plane, f, moved(motion, f, x, y));

            if (!(fabs(off) < GROSS))
                continue;
            for (size_t i = 0; i < MODES; i++) {
                for (size_t j = 0; j <= i; j++)
                    normal[i * MODES + j] += mode[i] * mode[j];
                right[i] += mode[i] * off;
            }
        }
    for (size_t i = 0; i < MODES; i++) {
        normal[i * MODES + i] += 1e-6;
        for (size_t j = 0; j < i; j++)
            normal[j * MODES + i] = normal[i * MODES + j];
    }
    if (gsn_small_solve_spd(normal, right, MODES) < 0)
        return;
    for (size_t i = 0; i < MOTION; i++)
        motion[i] += right[i];
}

void gsn_sequence_median(const struct gsn_sequence_tissue *t, const size_t *plane, size_t count,
                         float *ret_median)
{
    const size_t cells = t->columns * t->rows;

    assert(count > 0 && count <= GSN_SEQUENCE_AROUND);
    for (size_t c = 0; c < cells; c++) {
        float v[GSN_SEQUENCE_AROUND];

        for (size_t k = 0; k < count; k++) {
            const float next = t->value[plane[k] * cells + c];
            size_t q = k;

            for (; q > 0 && v[q - 1] > next; q--)
                v[q] = v[q - 1];
            v[q] = next;
        }
        ret_median[c] = 0.5f * (v[(count - 1) / 2] + v[count / 2]);
    }
}

/* Cell by cell what only one of the planes around a place has does not count. */
static void surroundings(const struct gsn_sequence_tissue *t, size_t place, float *ret_median)
{
    size_t at[GSN_SEQUENCE_AROUND];
    const size_t count = gsn_sequence_around(t->n, place, place, at);

    for (size_t k = 0; k < count; k++)
        at[k] = t->place[at[k]];
    gsn_sequence_median(t, at, count, ret_median);
}

static void move(const struct gsn_sequence_tissue *t, size_t k, const double motion[MOTION],
                 float *ret_value)
{
    const struct frame f = { t->columns, t->rows };
    const float *plane = t->filled + k * f.columns * f.rows;

    for (size_t y = 0; y < f.rows; y++)
        for (size_t x = 0; x < f.columns; x++)
            ret_value[y * f.columns + x] = (float)value_at(plane, f, moved(motion, f, x, y));
}

/* Sums of one square's products: modes with each other, then with the difference. */
struct square {
    double product[LOCAL * (LOCAL + 1) / 2 + LOCAL];
};
enum { PRODUCTS = LOCAL * (LOCAL + 1) / 2 + LOCAL };

static void modes_at(const float *onto, struct frame f, size_t x, size_t y, double ret_mode[LOCAL])
{
    ret_mode[0] = slope_x(onto, f, x, y);
    ret_mode[1] = slope_y(onto, f, x, y);
    ret_mode[2] = (double)onto[y * f.columns + x];
}

static void add_squares(const struct gsn_sequence_tissue *t, const struct gsn_sequence_modes *m,
                        const float *off, struct square *square)
{
    const struct frame f = { t->columns, t->rows };
    const size_t across = (f.columns + SQUARE - 1) / SQUARE;

    for (size_t y = 0; y < f.rows; y++)
        for (size_t x = 0; x < f.columns; x++) {
            const size_t c = y * f.columns + x;
            double mode[LOCAL], *sum = square[y / SQUARE * across + x / SQUARE].product;

            if (!m->known[0][c] || !m->known[1][c] || !(fabsf(m->gross[c]) < (float)GROSS))
                continue;
            modes_at(m->onto, f, x, y, mode);
            for (size_t i = 0; i < LOCAL; i++) {
                for (size_t j = 0; j <= i; j++)
                    *sum++ += mode[i] * mode[j];
                *sum++ += mode[i] * (double)off[c];
            }
        }
}

/* How much of each mode is in the difference about one square. */
static void solve_square(const struct square *square, const double weight_at[REACH + 1],
                         size_t across, size_t down, size_t x, size_t y, double ret_much[LOCAL])
{
    double sum[PRODUCTS] = { 0 }, normal[LOCAL * LOCAL], weights = 0;

    for (size_t v = y > REACH ? y - REACH : 0; v <= y + REACH && v < down; v++)
        for (size_t u = x > REACH ? x - REACH : 0; u <= x + REACH && u < across; u++) {
            const double weight =
                weight_at[u > x ? u - x : x - u] * weight_at[v > y ? v - y : y - v];

            weights += weight * SQUARE * SQUARE;
            for (size_t i = 0; i < PRODUCTS; i++)
                sum[i] += weight * square[v * across + u].product[i];
        }
    for (size_t i = 0, at = 0; i < LOCAL; i++) {
        for (size_t j = 0; j <= i; j++)
            normal[i * LOCAL + j] = normal[j * LOCAL + i] = sum[at++];
        ret_much[i] = sum[at++];
        normal[i * LOCAL + i] += weights * STIFF[i];
    }
    if (gsn_small_solve_spd(normal, ret_much, LOCAL) < 0)
        memset(ret_much, 0, LOCAL * sizeof *ret_much);
}

/* Between the middles of squares what was found there changes evenly. */
static double between(const double (*much)[LOCAL], size_t across, size_t down, size_t mode,
                      size_t x, size_t y)
{
    const double u = fmin(fmax(((double)x + 0.5) / SQUARE - 0.5, 0), (double)across - 1);
    const double v = fmin(fmax(((double)y + 0.5) / SQUARE - 0.5, 0), (double)down - 1);
    const size_t i = (size_t)u, j = (size_t)v, i1 = i + 1 < across ? i + 1 : i,
                 j1 = j + 1 < down ? j + 1 : j;
    const double s = u - (double)i, t = v - (double)j;

    return (1 - t) * ((1 - s) * much[j * across + i][mode] + s * much[j * across + i1][mode]) +
           t * ((1 - s) * much[j1 * across + i][mode] + s * much[j1 * across + i1][mode]);
}

void gsn_sequence_take_off(const struct gsn_sequence_tissue *t, const struct gsn_sequence_modes *m,
                           float *off)
{
    const struct frame f = { t->columns, t->rows };
    const size_t across = (f.columns + SQUARE - 1) / SQUARE, down = (f.rows + SQUARE - 1) / SQUARE;
    struct square *square = t->modes;
    double(*much)[LOCAL] = (double(*)[LOCAL])(void *)(square + across * down);
    double weight[REACH + 1];

    for (int i = 0; i <= REACH; i++)
        weight[i] = exp(-i * i / (2 * WIDE * WIDE));
    memset(square, 0, across * down * sizeof *square);
    add_squares(t, m, off, square);
    for (size_t i = 0; i < across * down; i++)
        solve_square(square, weight, across, down, i % across, i / across, much[i]);
    for (size_t y = 0; y < f.rows; y++)
        for (size_t x = 0; x < f.columns; x++) {
            double mode[LOCAL], sum = 0;

            modes_at(m->onto, f, x, y, mode);
            for (size_t i = 0; i < LOCAL; i++)
                sum += mode[i] * between(much, across, down, i, x, y);
            off[y * f.columns + x] -= (float)sum;
        }
}

size_t gsn_sequence_modes_size(size_t columns, size_t rows)
{
    const size_t squares = ((columns + SQUARE - 1) / SQUARE) * ((rows + SQUARE - 1) / SQUARE);

    return squares * (sizeof(struct square) + LOCAL * sizeof(double));
}

/* Where a plane is known once it is moved. */
static void find_known(const struct gsn_sequence_tissue *t, size_t k)
{
    const struct frame f = { t->columns, t->rows };
    const size_t cells = f.columns * f.rows;

    for (size_t y = 0; y < f.rows; y++)
        for (size_t x = 0; x < f.columns; x++)
            t->known[k * cells + y * f.columns + x] =
                (unsigned char)known_at(t->whole + k * cells, f, moved(t->motion[k], f, x, y));
}

/* Brings one laid plane to what lies around it, by its slopes and its stain. */
static void correct(const struct gsn_sequence_tissue *t, size_t k, const float *onto,
                    float *ret_value)
{
    const size_t cells = t->columns * t->rows;
    const float *plane = t->value + k * cells;
    const unsigned char *known = t->known + k * cells;

    for (size_t c = 0; c < cells; c++)
        t->change[c] = t->energy[c] = plane[c] - onto[c];
    gsn_sequence_take_off(t, &(struct gsn_sequence_modes){ onto, t->energy, { known, known } },
                          t->change);
    for (size_t c = 0; c < cells; c++)
        ret_value[c] = onto[c] + t->change[c];
}

static void move_onto(struct gsn_sequence_tissue *t, size_t k, const float *onto)
{
    const struct frame f = { t->columns, t->rows };

    for (int i = 0; i < STEPS; i++)
        step(t->filled + k * f.columns * f.rows, onto, f, t->motion[k]);
}

static void lay_evenly(struct gsn_sequence_tissue *t)
{
    const size_t cells = t->columns * t->rows;

    memcpy(t->value, t->filled, t->n * cells * sizeof *t->value);
    for (int pass = 0; pass < PASSES; pass++) {
        for (size_t k = 0; k < t->n; k++) {
            surroundings(t, k, t->onto);
            move_onto(t, k, t->onto);
        }
        for (size_t k = 0; k < t->n; k++)
            move(t, k, t->motion[k], t->value + k * cells);
    }
}

int gsn_sequence_lay(struct gsn_sequence_tissue *t, struct gsn_error *err)
{
    const size_t cells = t->columns * t->rows;
    gsn_auto_mem(float) corrected = gsn_alloc_array(t->n * cells, sizeof *corrected);

    if (!corrected)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", t->n);
    lay_evenly(t);
    for (size_t k = 0; k < t->n; k++)
        find_known(t, k);
    /* Apart, as what lies around a plane is not to be corrected before it. */
    for (size_t k = 0; k < t->n; k++) {
        surroundings(t, k, t->onto);
        gsn_sequence_smooth(t->onto, t->columns, t->rows, 1);
        correct(t, k, t->onto, corrected + k * cells);
    }
    memcpy(t->value, corrected, t->n * cells * sizeof *t->value);
    return GSN_OK;
}

void gsn_sequence_lay_again(struct gsn_sequence_tissue *t, size_t place)
{
    const size_t k = t->place[place];
    float *value = t->value + k * t->columns * t->rows;

    surroundings(t, place, t->onto);
    for (int pass = 0; pass < PASSES; pass++)
        move_onto(t, k, t->onto);
    move(t, k, t->motion[k], value);
    find_known(t, k);
    gsn_sequence_smooth(t->onto, t->columns, t->rows, 1);
    correct(t, k, t->onto, value);
}
