/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include "pipeline/core/linalg.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* Errors of laying reach over several cells, so each plane is moved, not only corrected by its
 * slopes; a few times, as the planes around it have such errors too. */
enum { PASSES = 3, STEPS = 3, MOTION = GSN_SEQUENCE_MOTION, MODES = MOTION + 1 };

/* Cells of a row that are worked out together. */
enum { STRIP = 128 };

struct frame {
    size_t columns, rows;
};

/* ---- where a moved plane is looked up ------------------------------------------------------- */

/* The first of the four cells around each point, and how far the point is from it; beyond the edge
 * the edge. */
struct spots {
    int at[STRIP];
    float right[STRIP], down[STRIP];
};

/* Of cells x, x + step, ... of row y: motion is a shift in cells and its change over half the
 * frame. */
static void find_spots(const double motion[MOTION], struct frame f, size_t x, size_t y, size_t step,
                       size_t count, struct spots *ret_spots)
{
    const double u = 2 * (double)x / (double)f.columns - 1, v = 2 * (double)y / (double)f.rows - 1;
    const float from_x = (float)((double)x + motion[0] + motion[1] * u + motion[2] * v),
                from_y = (float)((double)y + motion[3] + motion[4] * u + motion[5] * v),
                step_x = (float)((double)step * (1 + 2 * motion[1] / (double)f.columns)),
                step_y = (float)((double)step * 2 * motion[4] / (double)f.columns),
                most_x = (float)f.columns - 1.001f, most_y = (float)f.rows - 1.001f;
    const int columns = (int)f.columns;

    for (int k = 0; k < (int)count; k++) {
        const float at_x = from_x + (float)k * step_x, at_y = from_y + (float)k * step_y;
        const float in_x = at_x > 0 ? at_x : 0, in_y = at_y > 0 ? at_y : 0;
        const float px = in_x < most_x ? in_x : most_x, py = in_y < most_y ? in_y : most_y;
        const int i = (int)px, j = (int)py;

        ret_spots->at[k] = j * columns + i;
        ret_spots->right[k] = px - (float)i;
        ret_spots->down[k] = py - (float)j;
    }
}

static void look_up(const float *plane, struct frame f, const struct spots *spots, size_t count,
                    float *ret_value)
{
    for (size_t k = 0; k < count; k++) {
        const float *at = plane + spots->at[k], *below = at + f.columns;
        const float s = spots->right[k], t = spots->down[k];

        ret_value[k] =
            (1 - t) * ((1 - s) * at[0] + s * at[1]) + t * ((1 - s) * below[0] + s * below[1]);
    }
}

static size_t strip(size_t columns, size_t first)
{
    return columns - first < STRIP ? columns - first : STRIP;
}

/* Plane k moved, and where it is known then. */
static void move(const struct gsn_sequence_tissue *t, size_t k)
{
    const struct frame f = { t->columns, t->rows };
    const size_t first = k * f.columns * f.rows;

    for (size_t y = 0; y < f.rows; y++)
        for (size_t x = 0; x < f.columns; x += STRIP) {
            const size_t own = first + y * f.columns + x, count = strip(f.columns, x);
            struct spots spots;

            find_spots(t->motion[k], f, x, y, 1, count, &spots);
            look_up(t->filled + first, f, &spots, count, t->value + own);
            for (size_t i = 0; i < count; i++) {
                const unsigned char *at = t->whole + first + spots.at[i];

                t->known[own + i] = at[0] & at[1] & at[f.columns] & at[f.columns + 1];
            }
        }
}

/* ---- moving a plane onto what lies around it ------------------------------------------------ */

/* Per cell the slopes of what a plane is laid onto, each alone and times u, and its density; and
 * how it differs. */
enum { BASIS = 5 };
struct cells {
    float basis[BASIS][STRIP], off[STRIP];
};

/* A mode is one of these, or times v. */
static const struct {
    size_t basis;
    int times_v;
} mode_of[MODES] = { { 0, 0 }, { 1, 0 }, { 0, 1 }, { 2, 0 }, { 3, 0 }, { 2, 1 }, { 4, 0 } };

/* Of cells x, x + 2, ... of row y. */
static void take_slopes(const float *onto, struct frame f, size_t x, size_t y, size_t count,
                        float basis[BASIS][STRIP])
{
    const float *at = onto + y * f.columns + x;
    const size_t up = y > 0 && y + 1 < f.rows ? f.columns : 0;
    const size_t inner = x + 2 * count > f.columns ? count - 1 : count;

    basis[0][0] = basis[0][count - 1] = 0;
    for (size_t k = x == 0; k < inner; k++)
        basis[0][k] = 0.5f * (at[2 * k + 1] - at[2 * k - 1]);
    for (size_t k = 0; k < count; k++)
        basis[2][k] = 0.5f * (at[2 * k + up] - *(at + 2 * k - up));
    for (size_t k = 0; k < count; k++)
        basis[4][k] = at[2 * k];
}

/* The same cells; returns how many. Those that do not count are left 0. */
static size_t take_cells(const float *plane, const float *onto, struct frame f,
                         const double motion[MOTION], size_t x, size_t y, struct cells *ret_cells)
{
    const size_t count = (strip(f.columns, x) + 1) / 2;
    const float from = 2 * (float)x / (float)f.columns - 1, per_cell = 4 / (float)f.columns;
    struct spots spots;
    float value[STRIP];

    find_spots(motion, f, x, y, 2, count, &spots);
    look_up(plane, f, &spots, count, value);
    take_slopes(onto, f, x, y, count, ret_cells->basis);
    for (int k = 0; k < (int)count; k++) {
        const float sx = ret_cells->basis[0][k], sy = ret_cells->basis[2][k],
                    level = ret_cells->basis[4][k], off = level - value[k];
        const int empty = (level == 0) & (sx == 0) & (sy == 0);
        const float counts = (fabsf(off) < (float)GSN_SEQUENCE_GROSS) & !empty ? 1 : 0;
        const float u = from + per_cell * (float)k;

        ret_cells->basis[0][k] = counts * sx;
        ret_cells->basis[1][k] = counts * u * sx;
        ret_cells->basis[2][k] = counts * sy;
        ret_cells->basis[3][k] = counts * u * sy;
        ret_cells->basis[4][k] = counts * level;
        ret_cells->off[k] = counts * off;
    }
    return count;
}

static double product(const float *one, const float *other, size_t count)
{
    float sum = 0;

    for (size_t k = 0; k < count; k++)
        sum += one[k] * other[k];
    return (double)sum;
}

static void add_cells(const struct cells *cells, size_t count, double v,
                      double normal[MODES * MODES], double right[MODES])
{
    const double power[3] = { 1, v, v * v };
    double square[BASIS][BASIS], off[BASIS];

    for (size_t i = 0; i < BASIS; i++) {
        for (size_t j = 0; j <= i; j++)
            square[i][j] = square[j][i] = product(cells->basis[i], cells->basis[j], count);
        off[i] = product(cells->basis[i], cells->off, count);
    }
    for (size_t i = 0; i < MODES; i++) {
        for (size_t j = 0; j <= i; j++)
            normal[i * MODES + j] += power[mode_of[i].times_v + mode_of[j].times_v] *
                                     square[mode_of[i].basis][mode_of[j].basis];
        right[i] += power[mode_of[i].times_v] * off[mode_of[i].basis];
    }
}

/* One Gauss-Newton step of a plane towards what lies around it. */
static void step(const float *plane, const float *onto, struct frame f, double motion[MOTION])
{
    double normal[MODES * MODES] = { 0 }, right[MODES] = { 0 };

    for (size_t y = 0; y < f.rows; y++)
        for (size_t x = y & 1; x < f.columns; x += STRIP) { /* every other cell says enough */
            struct cells cells;
            const size_t count = take_cells(plane, onto, f, motion, x, y, &cells);

            add_cells(&cells, count, 2 * (double)y / (double)f.rows - 1, normal, right);
        }
    for (size_t i = 0; i < MODES; i++) {
        normal[i * MODES + i] += 1e-6;
        for (size_t j = 0; j < i; j++)
            normal[j * MODES + i] = normal[i * MODES + j];
    }
    if (gsn_solve_spd(normal, MODES, MODES, right) < 0)
        return;
    for (size_t i = 0; i < MOTION; i++)
        motion[i] += right[i];
}

/* ---- what lies around ------------------------------------------------------------------------ */

/* Puts two rows' cells in order. */
static void order(float *restrict low, float *restrict high)
{
    for (size_t k = 0; k < STRIP; k++) {
        const float a = low[k], b = high[k];

        low[k] = a < b ? a : b;
        high[k] = a > b ? a : b;
    }
}

void gsn_sequence_median(const struct gsn_sequence_tissue *t, const size_t *plane, size_t count,
                         float *ret_median)
{
    const size_t cells = t->columns * t->rows;
    float v[GSN_SEQUENCE_AROUND][STRIP] = { { 0 } };

    assert(count > 0 && count <= GSN_SEQUENCE_AROUND);

    for (size_t first = 0; first < cells; first += STRIP) {
        const size_t width = strip(cells, first);

        for (size_t k = 0; k < count; k++) {
            memcpy(v[k], t->value + plane[k] * cells + first, width * sizeof **v);
            for (size_t q = k; q > 0; q--)
                order(v[q - 1], v[q]);
        }
        for (size_t k = 0; k < width; k++)
            ret_median[first + k] = 0.5f * (v[(count - 1) / 2][k] + v[count / 2][k]);
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
                          &t->change, 1);
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
            move(t, k);
    }
}

int gsn_sequence_lay(struct gsn_sequence_tissue *t, struct gsn_error *err)
{
    const size_t cells = t->columns * t->rows;
    gsn_auto_mem(float) corrected = gsn_alloc_array(t->n * cells, sizeof *corrected);

    if (!corrected)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", t->n);
    lay_evenly(t);
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
    move(t, k);
    gsn_sequence_smooth(t->onto, t->columns, t->rows, 1);
    correct(t, k, t->onto, value);
}
