/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Aligns the sections of a stack by their tissue, in cells of 33 um, so that what remains between
 * two of them is growth and not the way they were registered.
 *
 * Steps: (1) each plane is compared with the cell-by-cell median of up to three planes on either
 * side, which one torn section cannot spoil. (2) An affine motion (six parameters, and one for the
 * stain) brings it there by Gauss-Newton on the differences of densities (Lucas and Kanade 1981);
 * PASSES times over all planes, for those around a plane have errors too. (3) What is left along
 * the slopes of the median, and in proportion to its density, is taken off: amounts that change
 * slowly over the frame, solved in squares of cells with a prior variance each (ridge regression)
 * and interpolated between their middles. What grows or shrinks within less than some squares
 * stays.
 *
 * Cells that differ by more than GSN_SEQUENCE_GROSS of the tissue's density have no say. A plane
 * whose normal equations are singular stays where it is. Fails when memory runs out. Loops go over
 * strips of cells, so that a compiler makes vectors of them. */
#include "pipeline/register/order/align.h"

#include "pipeline/core/linalg.h"
#include "pipeline/imaging/smooth.h"

#include <assert.h>
#include <math.h>
#include <string.h>

size_t gsn_sequence_around(size_t n, size_t i, size_t j, size_t ret_at[GSN_SEQUENCE_AROUND])
{
    size_t count = 0;

    for (size_t k = i, found = 0; k-- > 0 && found < GSN_SEQUENCE_SIDE;)
        if (k != j) {
            ret_at[count++] = k;
            found++;
        }
    for (size_t k = i + 1, found = 0; k < n && found < GSN_SEQUENCE_SIDE; k++)
        if (k != j) {
            ret_at[count++] = k;
            found++;
        }
    return count;
}

/* Cells of a row that are worked out together. */
enum { STRIP = 128 };

/* ---- what registration and stain explain -------------------------------------------------- */

/* What registration and stain do is told in squares of cells, over some squares to either side. */
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

struct mode_fit {
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

static struct mode_fit plan_fit(const struct gsn_sequence_tissue *t, size_t count)
{
    struct mode_fit a = { t->columns,
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

static void compute_row_modes(const struct mode_fit *a, const float *onto, size_t y)
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

/* The modes of cells that are known in both planes and registered right but for an edge. */
static void mask_row_modes(const struct mode_fit *a, const struct gsn_sequence_modes *m, size_t y)
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

static void add_row(const struct mode_fit *a, float *const *off, size_t y)
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
static void close_squares(const struct mode_fit *a, double (*ret_square)[PRODUCTS])
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

static void add_squares(const struct mode_fit *a, const struct gsn_sequence_modes *m,
                        float *const *off)
{
    memset(a->sum, 0, ROOM * a->width * sizeof *a->sum);
    for (size_t y = 0; y < a->rows; y++) {
        compute_row_modes(a, m->onto, y);
        mask_row_modes(a, m, y);
        add_row(a, off, y);
        if (y % SQUARE == SQUARE - 1 || y + 1 == a->rows)
            close_squares(a, a->square + y / SQUARE * a->across);
    }
}

/* Weighed sums from up to REACH before one to as many behind it, of count that lie step apart. */
static void add_around(const struct mode_fit *a, double (*from)[PRODUCTS], size_t step,
                       size_t count, size_t at, double ret_sum[PRODUCTS])
{
    memset(ret_sum, 0, PRODUCTS * sizeof *ret_sum);
    for (size_t k = at > REACH ? at - REACH : 0; k <= at + REACH && k < count; k++) {
        const double weight = a->weight[k > at ? k - at : at - k];

        for (size_t i = 0; i < PRODUCTS; i++)
            ret_sum[i] += weight * from[k * step][i];
    }
}

/* How much of each mode is in the differences about a square. */
static void solve_square(const struct mode_fit *a, const double sum[PRODUCTS],
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
static void interpolate_row(const struct mode_fit *a, size_t y, size_t k)
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

static void solve_squares(const struct mode_fit *a)
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
            interpolate_row(a, y, k);
}

/* The same along y. */
static void subtract_row(const struct mode_fit *a, size_t y, const float *amount,
                         float *restrict off)
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

void gsn_sequence_remove_modes(const struct gsn_sequence_tissue *t,
                               const struct gsn_sequence_modes *m, float *const *off, size_t count)
{
    const struct mode_fit a = plan_fit(t, count);

    assert(count <= GSN_SEQUENCE_DIFFERENCES);

    add_squares(&a, m, off);
    solve_squares(&a);
    for (size_t y = 0; y < a.rows; y++) {
        compute_row_modes(&a, m->onto, y);
        for (size_t k = 0; k < count; k++)
            subtract_row(&a, y, a.amount + k * LOCAL * a.width, off[k] + y * a.columns);
    }
}

/* Errors of registration reach over several cells, so each plane is moved, not only corrected by
 * its slopes; a few times, as the planes around it have such errors too. */
enum { PASSES = 3, STEPS = 3, MOTION = GSN_SEQUENCE_MOTION, MODES = MOTION + 1 };

struct frame {
    size_t columns, rows;
};

/* ---- where a moved plane is looked up ----------------------------------------------------- */

/* The first of the four cells around each point, and how far the point is from it; beyond the edge
 * the edge. */
struct samples {
    int at[STRIP];
    float right[STRIP], down[STRIP];
};

/* Of cells x, x + step, ... of row y: motion is a shift in cells and its change over half the
 * frame. */
static void locate_samples(const double motion[MOTION], struct frame f, size_t x, size_t y,
                           size_t step, size_t count, struct samples *ret_samples)
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

        ret_samples->at[k] = j * columns + i;
        ret_samples->right[k] = px - (float)i;
        ret_samples->down[k] = py - (float)j;
    }
}

static void interpolate_samples(const float *plane, struct frame f, const struct samples *samples,
                                size_t count, float *ret_value)
{
    for (size_t k = 0; k < count; k++) {
        const float *at = plane + samples->at[k], *below = at + f.columns;
        const float s = samples->right[k], t = samples->down[k];

        ret_value[k] =
            (1 - t) * ((1 - s) * at[0] + s * at[1]) + t * ((1 - s) * below[0] + s * below[1]);
    }
}

static size_t strip_width(size_t columns, size_t first)
{
    return columns - first < STRIP ? columns - first : STRIP;
}

/* Plane k moved, and where it is known then. */
static void resample_plane(const struct gsn_sequence_tissue *t, size_t k)
{
    const struct frame f = { t->columns, t->rows };
    const size_t first = k * f.columns * f.rows;

    for (size_t y = 0; y < f.rows; y++)
        for (size_t x = 0; x < f.columns; x += STRIP) {
            const size_t own = first + y * f.columns + x, count = strip_width(f.columns, x);
            struct samples samples;

            locate_samples(t->motion[k], f, x, y, 1, count, &samples);
            interpolate_samples(t->filled + first, f, &samples, count, t->value + own);
            for (size_t i = 0; i < count; i++) {
                const unsigned char *at = t->whole + first + samples.at[i];

                t->known[own + i] = at[0] & at[1] & at[f.columns] & at[f.columns + 1];
            }
        }
}

/* ---- moving a plane onto what lies around it ---------------------------------------------- */

/* Per cell the slopes of what a plane is registered onto, each alone and times u, and its density;
 * and how it differs. */
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
static void compute_slopes(const float *onto, struct frame f, size_t x, size_t y, size_t count,
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
static size_t gather_cells(const float *plane, const float *onto, struct frame f,
                           const double motion[MOTION], size_t x, size_t y, struct cells *ret_cells)
{
    const size_t count = (strip_width(f.columns, x) + 1) / 2;
    const float from = 2 * (float)x / (float)f.columns - 1, per_cell = 4 / (float)f.columns;
    struct samples samples;
    float value[STRIP];

    locate_samples(motion, f, x, y, 2, count, &samples);
    interpolate_samples(plane, f, &samples, count, value);
    compute_slopes(onto, f, x, y, count, ret_cells->basis);
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

static double sum_products(const float *one, const float *other, size_t count)
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
            square[i][j] = square[j][i] = sum_products(cells->basis[i], cells->basis[j], count);
        off[i] = sum_products(cells->basis[i], cells->off, count);
    }
    for (size_t i = 0; i < MODES; i++) {
        for (size_t j = 0; j <= i; j++)
            normal[i * MODES + j] += power[mode_of[i].times_v + mode_of[j].times_v] *
                                     square[mode_of[i].basis][mode_of[j].basis];
        right[i] += power[mode_of[i].times_v] * off[mode_of[i].basis];
    }
}

/* One Gauss-Newton step of a plane towards what lies around it. */
static void step_motion(const float *plane, const float *onto, struct frame f,
                        double motion[MOTION])
{
    double normal[MODES * MODES] = { 0 }, right[MODES] = { 0 };

    for (size_t y = 0; y < f.rows; y++)
        for (size_t x = y & 1; x < f.columns; x += STRIP) { /* every other cell says enough */
            struct cells cells;
            const size_t count = gather_cells(plane, onto, f, motion, x, y, &cells);

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

/* ---- what lies around --------------------------------------------------------------------- */

/* Puts two rows' cells in order. */
static void sort_rows(float *restrict low, float *restrict high)
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
        const size_t width = strip_width(cells, first);

        for (size_t k = 0; k < count; k++) {
            memcpy(v[k], t->value + plane[k] * cells + first, width * sizeof **v);
            for (size_t q = k; q > 0; q--)
                sort_rows(v[q - 1], v[q]);
        }
        for (size_t k = 0; k < width; k++)
            ret_median[first + k] = 0.5f * (v[(count - 1) / 2][k] + v[count / 2][k]);
    }
}

/* Cell by cell what only one of the planes around a place has does not count. */
static void compute_surroundings(const struct gsn_sequence_tissue *t, size_t place,
                                 float *ret_median)
{
    size_t at[GSN_SEQUENCE_AROUND];
    const size_t count = gsn_sequence_around(t->n, place, place, at);

    for (size_t k = 0; k < count; k++)
        at[k] = t->place[at[k]];
    gsn_sequence_median(t, at, count, ret_median);
}

/* Brings one registered plane to what lies around it, by its slopes and its stain. */
static void remove_residual(const struct gsn_sequence_tissue *t, size_t k, const float *onto,
                            float *ret_value)
{
    const size_t cells = t->columns * t->rows;
    const float *plane = t->value + k * cells;
    const unsigned char *known = t->known + k * cells;

    for (size_t c = 0; c < cells; c++)
        t->change[c] = t->energy[c] = plane[c] - onto[c];
    gsn_sequence_remove_modes(t, &(struct gsn_sequence_modes){ onto, t->energy, { known, known } },
                              &t->change, 1);
    for (size_t c = 0; c < cells; c++)
        ret_value[c] = onto[c] + t->change[c];
}

static void register_onto(struct gsn_sequence_tissue *t, size_t k, const float *onto)
{
    const struct frame f = { t->columns, t->rows };

    for (int i = 0; i < STEPS; i++)
        step_motion(t->filled + k * f.columns * f.rows, onto, f, t->motion[k]);
}

static void register_all(struct gsn_sequence_tissue *t)
{
    const size_t cells = t->columns * t->rows;

    memcpy(t->value, t->filled, t->n * cells * sizeof *t->value);
    for (int pass = 0; pass < PASSES; pass++) {
        for (size_t k = 0; k < t->n; k++) {
            compute_surroundings(t, k, t->onto);
            register_onto(t, k, t->onto);
        }
        for (size_t k = 0; k < t->n; k++)
            resample_plane(t, k);
    }
}

int gsn_sequence_register(struct gsn_sequence_tissue *t, struct gsn_error *err)
{
    const size_t cells = t->columns * t->rows;
    gsn_auto_mem(float) corrected = gsn_alloc_array(t->n * cells, sizeof *corrected);

    if (!corrected)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", t->n);
    register_all(t);
    /* Apart, as what lies around a plane is not to be corrected before it. */
    for (size_t k = 0; k < t->n; k++) {
        compute_surroundings(t, k, t->onto);
        gsn_smooth_binomial(t->onto, t->columns, t->rows, 1);
        remove_residual(t, k, t->onto, corrected + k * cells);
    }
    memcpy(t->value, corrected, t->n * cells * sizeof *t->value);
    return GSN_OK;
}

void gsn_sequence_register_again(struct gsn_sequence_tissue *t, size_t place)
{
    const size_t k = t->place[place];
    float *value = t->value + k * t->columns * t->rows;

    compute_surroundings(t, place, t->onto);
    for (int pass = 0; pass < PASSES; pass++)
        register_onto(t, k, t->onto);
    resample_plane(t, k);
    gsn_smooth_binomial(t->onto, t->columns, t->rows, 1);
    remove_residual(t, k, t->onto, value);
}
