/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence.h"

#include "pipeline/register/median.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { SIDE = 3, AROUND = 2 * SIDE, LEAST = 8, PASSES = 3, SMOOTHINGS = 2 };
/* Eight sweeps of Jacobi's method are beyond what float pixels are worth. */
enum { SWEEPS = 8, MOST_DIRECTIONS = 10 };

/* A proposal must be this much likelier than the order as numbered: e^14 is a million to one, to
 * be divided among some thousand pairs of a stack; e^7 is a thousand to one, for as many neighbours
 * as it has sections. */
static const double SURE = 14, SURE_OF_NEIGHBOURS = 7;
/* Two mounts of one section share most of their texture; neighbours share none. At the ends of the
 * stack the lines reach beyond what they go through, and both share that error. */
static const double SAME = 0.5, SAME_AT_END = 0.8, SAME_DEVIATIONS = 8;
/* A swap that takes less than this off the roughness around both is not worth a person's look; in a
 * stack without grain the smallest difference is evidence. */
static const double LEAST_SMOOTHER = 0.05;
/* Where one section's change is less than its noise, nothing is said of any distance. */
static const double LEAST_CHANGE = 1;
/* A direction counts when its variance is this much above the median one's, which is grain. */
static const double LARGE = 2;
/* Median absolute deviation to standard deviation of normal numbers. */
static const double MAD_TO_SD = 1.4826;

/* The stack as inner products of its planes: every comparison is a sum of a few of them. */
struct stack {
    size_t n;
    double *z;
    double *gram;  /* n * n */
    double *drift; /* scratch: n * n room */
    double noise2; /* squared norm of one section's noise along a direction of change */
    double slope2; /* squared norm of the change from one section to the next */
    double gain;   /* how much of a true change the comparison shows */
    double grain2; /* squared norm of what sets one section apart from all others */
};

/* A straight line through the sections around a place, as weights. */
struct line {
    size_t count, at[AROUND];
    double weight[AROUND];
};

static double inner(const struct stack *s, size_t i, size_t j)
{
    return s->gram[i * s->n + j];
}

/* Up to SIDE sections on either side of place i, those at i and j left out. */
static size_t around(const struct stack *s, size_t i, size_t j, size_t *ret_at)
{
    size_t count = 0;

    for (size_t k = i, found = 0; k-- > 0 && found < SIDE;)
        if (k != j) {
            ret_at[count++] = k;
            found++;
        }
    for (size_t k = i + 1, found = 0; k < s->n && found < SIDE; k++)
        if (k != j) {
            ret_at[count++] = k;
            found++;
        }
    return count;
}

/* Least squares through the sections around place i, taken at z. */
static struct line line_at(const struct stack *s, size_t i, size_t j, double z)
{
    struct line line = { .count = around(s, i, j, line.at) };
    const double n = (double)line.count;
    double mean = 0, square = 0;

    for (size_t k = 0; k < line.count; k++)
        mean += s->z[line.at[k]] / n;
    for (size_t k = 0; k < line.count; k++)
        square += pow(s->z[line.at[k]] - mean, 2);
    for (size_t k = 0; k < line.count; k++)
        line.weight[k] = 1 / n + (z - mean) * (s->z[line.at[k]] - mean) / square;
    return line;
}

static double line_plane(const struct stack *s, const struct line *line, size_t plane)
{
    double sum = 0;

    for (size_t k = 0; k < line->count; k++)
        sum += line->weight[k] * inner(s, line->at[k], plane);
    return sum;
}

static double line_line(const struct stack *s, const struct line *a, const struct line *b)
{
    double sum = 0;

    for (size_t k = 0; k < b->count; k++)
        sum += b->weight[k] * line_plane(s, a, b->at[k]);
    return sum;
}

/* Plane i between places i and j: -1/2 when it lies at its own, 1/2 at the other; and the squared
 * distance between the two places. Neither section is in the lines. */
struct stand {
    double at_i, at_j; /* of planes i and j: -1/2 and 1/2 in order */
    double apart2;
};

static struct stand compare(const struct stack *s, size_t i, size_t j)
{
    const struct line a = line_at(s, i, j, s->z[i]), b = line_at(s, j, i, s->z[j]);
    const double aa = line_line(s, &a, &a), bb = line_line(s, &b, &b);
    const double middle = 0.5 * (bb - aa);
    /* Where noise leaves less than nothing, the places are not told apart. */
    const double apart2 = fmax(aa + bb - 2 * line_line(s, &a, &b), 1e-12 * aa);

    return (struct stand){
        .at_i = (line_plane(s, &b, i) - line_plane(s, &a, i) - middle) / apart2,
        .at_j = (line_plane(s, &b, j) - line_plane(s, &a, j) - middle) / apart2,
        .apart2 = apart2,
    };
}

/* What sets plane i apart from the line through its neighbours, against plane j's, as a
 * correlation: near 1 for the same grain, 0 for two sections. The lines' own noise is off the
 * products already; the section's own belongs into the norm. */
static double likeness(const struct stack *s, size_t i, size_t j)
{
    const struct line a = line_at(s, i, j, s->z[i]), b = line_at(s, j, i, s->z[j]);
    const double ii = inner(s, i, i) - 2 * line_plane(s, &a, i) + line_line(s, &a, &a);
    const double jj = inner(s, j, j) - 2 * line_plane(s, &b, j) + line_line(s, &b, &b);
    const double ij =
        inner(s, i, j) - line_plane(s, &a, j) - line_plane(s, &b, i) + line_line(s, &a, &b);
    const double norm = (fmax(ii, 0) + s->grain2) * (fmax(jj, 0) + s->grain2);

    return norm > 0 ? ij / sqrt(norm) : 0;
}

/* ---- planes -> inner products ------------------------------------------------------------- */

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

/* All planes side by side, holes filled from the neighbours, each scaled to a mean of 1. */
static void gather(const struct gsn_sequence_plane *planes, size_t n, size_t cells, float *raw,
                   float *value)
{
    for (size_t i = 0; i < n; i++)
        memcpy(raw + i * cells, planes[i].density, cells * sizeof *raw);
    for (size_t i = 0; i < n; i++) {
        double sum = 0;

        for (size_t c = 0; c < cells; c++) {
            const float own = raw[i * cells + c];

            value[i * cells + c] = isnan(own) ? (float)fill_in(raw, n, cells, i, c) : own;
            sum += (double)value[i * cells + c];
        }
        for (size_t c = 0; sum > 0 && c < cells; c++)
            value[i * cells + c] *= (float)((double)cells / sum);
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

/* An edge within a cell moves with the laying in a way that no difference of cells describes; once
 * it is spread over some cells, their slope does. */
static void smooth(float *value, size_t columns, size_t rows)
{
    for (int pass = 0; pass < SMOOTHINGS; pass++) {
        for (size_t y = 0; y < rows; y++)
            smooth_line(value + y * columns, columns, 1);
        for (size_t x = 0; x < columns; x++)
            smooth_line(value + x, rows, columns);
    }
}

/* The modes in which a section differs from its neighbours because of how it was laid and stained:
 * shift, and affine change of the tissue by its own slopes; amount of stain, even and ramped. */
enum { MODES = 9 };

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

/* Errors of laying and stain are no change of tissue: each plane is brought to its surroundings in
 * those modes, all at once, a few times, as the surroundings have such errors too. */
static void align(const struct stack *s, size_t columns, size_t rows, double *mean, float *value,
                  float *next)
{
    const size_t cells = columns * rows;

    for (int pass = 0; pass < PASSES; pass++) {
        for (size_t i = 0; i < s->n; i++) {
            size_t at[AROUND];
            const size_t count = around(s, i, i, at);

            memset(mean, 0, cells * sizeof *mean);
            for (size_t k = 0; k < count; k++)
                for (size_t c = 0; c < cells; c++)
                    mean[c] += (double)value[at[k] * cells + c] / (double)count;
            align_one(value + i * cells, mean, columns, rows, next + i * cells);
        }
        memcpy(value, next, s->n * cells * sizeof *value);
    }
}

/* Leaves the smooth part in value and puts the rest, the grain, into ret_grain. */
static void split_grain(float *value, float *ret_grain, size_t n, size_t columns, size_t rows)
{
    const size_t cells = columns * rows;

    memcpy(ret_grain, value, n * cells * sizeof *value);
    for (size_t i = 0; i < n; i++)
        smooth(value + i * cells, columns, rows);
    for (size_t c = 0; c < n * cells; c++)
        ret_grain[c] -= value[c];
}

static void multiply(const float *value, size_t n, size_t cells, double *gram)
{
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j <= i; j++) {
            double sum = 0;

            for (size_t c = 0; c < cells; c++)
                sum += (double)value[i * cells + c] * (double)value[j * cells + c];
            gram[i * n + j] = gram[j * n + i] = sum;
        }
}

static int check(const struct gsn_sequence_plane *planes, size_t count, struct gsn_error *err)
{
    for (size_t i = 1; i < count; i++)
        if (planes[i].serial <= planes[i - 1].serial)
            return gsn_fail(err, GSN_E_INPUT,
                            "section %u comes after section %u: serial numbers must rise",
                            planes[i].serial + 1, planes[i - 1].serial + 1);
    return GSN_OK;
}

/* A plane's product with itself holds the noise of all its cells, which would make every line look
 * longer than it is: that is taken off, as much as the median plane is off its line. */
static void take_off_noise(struct stack *s)
{
    for (size_t i = 0; i < s->n; i++) {
        const struct line line = line_at(s, i, i, s->z[i]);
        double weights = 1;

        for (size_t k = 0; k < line.count; k++)
            weights += line.weight[k] * line.weight[k];
        s->drift[i] =
            (inner(s, i, i) - 2 * line_plane(s, &line, i) + line_line(s, &line, &line)) / weights;
    }
    s->grain2 = gsn_median(s->drift, s->n);
    for (size_t i = 0; i < s->n; i++)
        s->gram[i * s->n + i] -= s->grain2;
}

/* One of Jacobi's turns of a symmetric matrix and its eigenvectors (rows of v). */
static void turn(double *a, double *v, size_t n, size_t p, size_t q)
{
    const double theta = 0.5 * atan2(2 * a[p * n + q], a[p * n + p] - a[q * n + q]);
    const double c = cos(theta), s = sin(theta);

    for (size_t k = 0; k < n; k++) {
        const double x = a[k * n + p], y = a[k * n + q];

        a[k * n + p] = c * x + s * y;
        a[k * n + q] = c * y - s * x;
    }
    for (size_t k = 0; k < n; k++) {
        const double x = a[p * n + k], y = a[q * n + k], u = v[p * n + k], w = v[q * n + k];

        a[p * n + k] = c * x + s * y;
        a[q * n + k] = c * y - s * x;
        v[p * n + k] = c * u + s * w;
        v[q * n + k] = c * w - s * u;
    }
}

static void centre(struct stack *s)
{
    double *mean = s->drift, all = 0;
    const size_t n = s->n;

    for (size_t i = 0; i < n; i++) {
        mean[i] = 0;
        for (size_t j = 0; j < n; j++)
            mean[i] += s->gram[i * n + j] / (double)n;
        all += mean[i] / (double)n;
    }
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++)
            s->gram[i * n + j] += all - mean[i] - mean[j];
}

/* Keeps the few directions in which the stack changes beyond grain (principal components), so that
 * the grain of all the others does not drown it. */
static void reduce(struct stack *s)
{
    const size_t n = s->n;
    double *v = s->drift, *value = s->drift + n * n, *sorted = value + n, floor;

    centre(s);
    memset(v, 0, n * n * sizeof *v);
    for (size_t i = 0; i < n; i++)
        v[i * n + i] = 1;
    for (int sweep = 0; sweep < SWEEPS; sweep++)
        for (size_t p = 0; p < n; p++)
            for (size_t q = p + 1; q < n; q++)
                turn(s->gram, v, n, p, q);
    for (size_t i = 0; i < n; i++)
        value[i] = sorted[i] = s->gram[i * n + i];
    floor = LARGE * gsn_median(sorted, n);
    if (n > MOST_DIRECTIONS)
        floor = fmax(floor, sorted[n - 1 - MOST_DIRECTIONS]);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++) {
            double sum = 0;

            for (size_t k = 0; k < n; k++)
                if (value[k] > floor)
                    sum += value[k] * v[k * n + i] * v[k * n + j];
            s->gram[i * n + j] = sum;
        }
}

/* ---- what is usual in this stack ---------------------------------------------------------- */

/* Noise and change from all neighbours: most of them lie in order, so medians tell. */
static void learn(struct stack *s)
{
    const size_t pairs = s->n - 1;
    double *shown = s->drift, *slope = s->drift + s->n, *off = s->drift + 2 * s->n;

    for (size_t i = 0; i < pairs; i++) {
        const struct stand t = compare(s, i, i + 1);
        const double far = s->z[i + 1] - s->z[i];

        shown[i] = t.at_j - t.at_i;
        slope[i] = t.apart2 / (far * far);
    }
    memcpy(off, shown, pairs * sizeof *off);
    s->gain = gsn_median(off, pairs);
    for (size_t i = 0; i < pairs; i++) {
        const double far = s->z[i + 1] - s->z[i];

        off[i] = fabs(shown[i] - s->gain) * sqrt(slope[i]) * far / sqrt(2);
    }
    s->noise2 = pow(MAD_TO_SD * gsn_median(off, pairs), 2);
    s->slope2 = gsn_median(slope, pairs);
}

/* ---- findings ----------------------------------------------------------------------------- */

static void add(struct gsn_sequence *found, enum gsn_sequence_kind kind, unsigned a, unsigned b,
                double evidence, double smoother)
{
    found->finding[found->count++] =
        (struct gsn_sequence_finding){ kind, a, b, evidence, smoother };
}

/* How much likelier two sections lie in each other's places than in their own. Unless they are
 * neighbours, whose places are hardly apart, each by itself must be nearer to the other's. */
static double swapped(const struct stack *s, size_t i, size_t j)
{
    const struct stand t = compare(s, i, j);

    if (j > i + 1 && (t.at_i <= 0 || t.at_j >= 0))
        return 0;
    return 2 * s->gain * (t.at_i - t.at_j) * t.apart2 / s->noise2;
}

static int is_duplicate(const struct gsn_sequence *found, unsigned a, unsigned b)
{
    for (size_t k = 0; k < found->count; k++)
        if (found->finding[k].kind == GSN_SEQUENCE_DUPLICATE && found->finding[k].a == a &&
            found->finding[k].b == b)
            return 1;
    return 0;
}

/* Exchanges two planes for all that follows. */
static void exchange(struct stack *s, size_t i, size_t j)
{
    for (size_t k = 0; k < s->n; k++) {
        const double swap = s->gram[i * s->n + k];

        s->gram[i * s->n + k] = s->gram[j * s->n + k];
        s->gram[j * s->n + k] = swap;
    }
    for (size_t k = 0; k < s->n; k++) {
        const double swap = s->gram[k * s->n + i];

        s->gram[k * s->n + i] = s->gram[k * s->n + j];
        s->gram[k * s->n + j] = swap;
    }
}

/* How far the sections around two places are off the lines through their neighbours: the roughness
 * along z that a swap of the two could change. */
static double roughness(const struct stack *s, size_t i, size_t j)
{
    double sum = 0;

    for (size_t k = 0; k < s->n; k++) {
        const size_t di = k > i ? k - i : i - k, dj = k > j ? k - j : j - k;
        struct line line;
        double weights = 1;

        if (di > SIDE && dj > SIDE)
            continue;
        line = line_at(s, k, k, s->z[k]);
        for (size_t l = 0; l < line.count; l++)
            weights += line.weight[l] * line.weight[l];
        sum +=
            (inner(s, k, k) - 2 * line_plane(s, &line, k) + line_line(s, &line, &line)) / weights;
    }
    return sum;
}

/* Whether a swap over this distance would give enough evidence to propose it. */
static int is_told(const struct stack *s, double far)
{
    return s->gain > 0 && s->noise2 > 0 && s->slope2 > LEAST_CHANGE * s->noise2 &&
           2 * s->gain * s->gain * far * far * s->slope2 / s->noise2 > SURE;
}

/* What is gained in roughness by swapping two sections; ret_share: of what it is; 0 where neither
 * the tissue of the two nor the roughness asks for it. */
static double smoother(struct stack *s, size_t i, size_t j, double sure, double *ret_share)
{
    double before, after;

    if (!is_told(s, s->z[j] - s->z[i]))
        return 0;
    /* Nothing lies beyond the last two, so nothing says which of them is the last. */
    if (j == i + 1 && (i == 0 || j + 1 == s->n))
        return 0;
    if (swapped(s, i, j) <= sure)
        return 0;
    before = roughness(s, i, j);
    exchange(s, i, j);
    after = roughness(s, i, j);
    exchange(s, i, j);
    if (!(after < (1 - LEAST_SMOOTHER) * before))
        return 0;
    *ret_share = 1 - after / before;
    return before - after;
}

/* The swap that smooths most comes first; the others are looked for as if it were undone, since
 * what lies beside swapped sections looks out of place too. No section is in two proposals. */
static int find_swaps(struct stack *s, const struct gsn_sequence_plane *planes,
                      struct gsn_sequence *found, struct gsn_error *err)
{
    gsn_auto_mem(char) used = gsn_alloc_array(s->n, 1);
    gsn_auto_mem(char) near = gsn_alloc_array(s->n, 1); /* laid beside a wrong neighbour */

    if (!used || !near)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", s->n);
    for (;;) {
        double most = 0, gained = 0;
        size_t a = 0, b = 0;

        for (size_t i = 0; i < s->n; i++)
            for (size_t j = i + 1; j < s->n && !used[i]; j++) {
                const int clean = j == i + 1 && !near[i] && !near[j];
                double share = 0;
                const double gain =
                    used[j] ? 0
                            : smoother(s, i, j, clean && found->told ? SURE_OF_NEIGHBOURS : SURE,
                                       &share);

                if (gain > most) {
                    most = gain;
                    gained = share;
                    a = i;
                    b = j;
                }
            }
        if (a == b)
            return GSN_OK;
        most = swapped(s, a, b);
        used[a] = used[b] = 1;
        for (size_t k = 0; k < s->n; k++)
            near[k] =
                near[k] || (k + SIDE >= a && k <= a + SIDE) || (k + SIDE >= b && k <= b + SIDE);
        exchange(s, a, b);
        if (!is_duplicate(found, planes[a].serial, planes[b].serial))
            add(found, GSN_SEQUENCE_SWAP, planes[a].serial, planes[b].serial, most, gained);
    }
}

static void find_duplicates(const struct stack *s, const struct gsn_sequence_plane *planes,
                            struct gsn_sequence *found)
{
    double *like = s->drift, *sorted = s->drift + s->n * s->n;
    double median, deviation;
    size_t pairs = 0;

    for (size_t i = 0; i < s->n; i++)
        for (size_t j = i + 1; j < s->n; j++)
            like[pairs++] = likeness(s, i, j);
    memcpy(sorted, like, pairs * sizeof *sorted);
    median = gsn_median(sorted, pairs);
    for (size_t k = 0; k < pairs; k++)
        sorted[k] = fabs(like[k] - median);
    deviation = MAD_TO_SD * gsn_median(sorted, pairs);
    pairs = 0;
    for (size_t i = 0; i < s->n; i++)
        for (size_t j = i + 1; j < s->n; j++, pairs++)
            if (like[pairs] > (i < 2 || j + 2 >= s->n ? SAME_AT_END : SAME) &&
                like[pairs] - median > SAME_DEVIATIONS * deviation && found->count < s->n)
                add(found, GSN_SEQUENCE_DUPLICATE, planes[i].serial, planes[j].serial, like[pairs],
                    0);
}

static int order(const void *a, const void *b)
{
    const struct gsn_sequence_finding *f = a, *g = b;

    if (f->kind != g->kind)
        return f->kind < g->kind ? -1 : 1;
    if (f->evidence != g->evidence)
        return f->evidence > g->evidence ? -1 : 1;
    return f->a < g->a ? -1 : f->a > g->a;
}

static int examine(struct stack *s, const struct gsn_sequence_plane *planes, size_t columns,
                   size_t rows, struct gsn_sequence *found, struct gsn_error *err)
{
    const size_t cells = columns * rows;
    gsn_auto_mem(double) mean = gsn_alloc_array(cells, sizeof *mean);
    gsn_auto_mem(float) raw = gsn_alloc_array(s->n * cells, sizeof *raw);
    gsn_auto_mem(float) value = gsn_alloc_array(s->n * cells, sizeof *value);
    int r = GSN_OK;

    if (!mean || !raw || !value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", s->n);
    gather(planes, s->n, cells, raw, value);
    for (size_t i = 0; i < s->n; i++)
        s->z[i] = planes[i].serial;
    align(s, columns, rows, mean, value, raw);
    split_grain(value, raw, s->n, columns, rows);
    multiply(raw, s->n, cells, s->gram);
    take_off_noise(s);
    find_duplicates(s, planes, found);
    align(s, columns, rows, mean, value, raw);
    multiply(value, s->n, cells, s->gram);
    reduce(s);
    take_off_noise(s);
    learn(s);
    found->change = s->noise2 > 0 ? sqrt(s->slope2 / s->noise2) : 0;
    found->told = is_told(s, 1);
    r = find_swaps(s, planes, found, err);
    return r;
}

int gsn_sequence_examine(const struct gsn_sequence_plane *planes, size_t count, size_t columns,
                         size_t rows, struct gsn_sequence **ret_sequence, struct gsn_error *err)
{
    gsn_auto_mem(double) z = gsn_alloc_array(count, sizeof *z);
    gsn_auto_mem(double) gram = gsn_alloc_array(count * count, sizeof *gram);
    gsn_auto_mem(double) scratch = gsn_alloc_array(2 * count * count + 4 * count, sizeof *scratch);
    gsn_auto(gsn_sequence) found = gsn_alloc_array(1, sizeof *found);
    struct stack s = { .n = count, .z = z, .gram = gram, .drift = scratch };
    int r = check(planes, count, err);

    assert(ret_sequence);

    if (r < 0)
        return r;
    if (found)
        found->finding = gsn_alloc_array(3 * count + 1, sizeof *found->finding);
    if (!z || !gram || !scratch || !found || !found->finding)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", count);
    if (count >= LEAST) {
        r = examine(&s, planes, columns, rows, found, err);
        if (r < 0)
            return r;
    }
    qsort(found->finding, found->count, sizeof *found->finding, order);
    *ret_sequence = gsn_steal(&found);
    return GSN_OK;
}

void gsn_sequence_free(struct gsn_sequence *sequence)
{
    if (!sequence)
        return;
    gsn_free(sequence->finding);
    gsn_free(sequence);
}
