/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method. 1. Every plane is averaged over squares of six cells (200 um), which is coarser than
 * sections are laid wrong by. 2. Two planes differ by 1 - r, r the correlation of their densities
 * over the squares that both know: what a panel's bath multiplies or adds makes no difference. 3.
 * An order's way is the sum of the differences of planes that are one and two apart in it. Two
 * orders have most of these steps in common; the others are compared, as many of the one as of the
 * other. 4. A section that is folded or torn differs more from all others, and takes part in as
 * many steps of either order; so a step's error is told from what is left when the sections' own
 * shares cancel: d(i, i+1) + d(i+2, i+3) - d(i, i+2) - d(i+1, i+3), in the median about the median,
 * along both orders; the smaller counts, as a wrong order's long steps are among its own.
 *
 * Fails when memory runs out. Cost: n^2 / 2 correlations of some 1000 squares: a twentieth of a
 * second for 120 sections. Reference: W. S. Robinson, A method for chronologically ordering
 * archaeological deposits, American Antiquity 16 (1951). */
#include "pipeline/register/order/seriation.h"

#include "pipeline/core/robust.h"

#include <float.h>
#include <math.h>

/* From fewer than 24 planes a step's error is itself uncertain by more than a quarter: the median
 * deviation of n values scatters by 1.17 / sqrt(n) of itself (Rousseeuw and Croux, 1993). */
enum { SQUARE = 6, LEAST = 24, STEPS = 2 };

const double gsn_seriation_shorter = 6;

struct gsn_seriation {
    size_t count;
    double *unlike; /* count * count */
    double error;   /* of one step in the order as given; 0: not told */
    size_t *place;  /* count: scratch */
    double *room;   /* count: scratch */
};

void gsn_seriation_free(struct gsn_seriation *path)
{
    if (!path)
        return;
    gsn_free(path->unlike);
    gsn_free(path->place);
    gsn_free(path->room);
    gsn_free(path);
}

/* The mean of a square's known cells; NaN where none is. */
static void average_squares(const float *density, size_t columns, size_t rows, float *ret_value)
{
    for (size_t y = 0; y + SQUARE <= rows; y += SQUARE)
        for (size_t x = 0; x + SQUARE <= columns; x += SQUARE) {
            double sum = 0;
            int known = 0;

            for (size_t k = 0; k < (size_t)SQUARE * SQUARE; k++) {
                const float cell = density[(y + k / SQUARE) * columns + x + k % SQUARE];

                sum += isnan(cell) ? 0 : (double)cell;
                known += !isnan(cell);
            }
            *ret_value++ = known ? (float)(sum / known) : NAN;
        }
}

static double measure_unlike(const float *a, const float *b, size_t squares)
{
    double n = 0, sa = 0, sb = 0, aa = 0, bb = 0, ab = 0, scale;

    for (size_t i = 0; i < squares; i++) {
        const double u = (double)a[i], v = (double)b[i];

        if (isnan(u) || isnan(v))
            continue;
        n++;
        sa += u;
        sb += v;
        aa += u * u;
        bb += v * v;
        ab += u * v;
    }
    scale = n > 1 ? sqrt(fmax(aa - sa * sa / n, 0) * fmax(bb - sb * sb / n, 0)) : 0;
    return scale > 0 ? 1 - (ab - sa * sb / n) / scale : 1;
}

static double unlike_along(const struct gsn_seriation *path, const size_t *order, size_t i,
                           size_t j)
{
    return order ? gsn_seriation_distance(path, order[i], order[j])
                 : gsn_seriation_distance(path, i, j);
}

/* Along an order, NULL: as given. Four differences of one error each are in a sum; the median of a
 * normal error is 0.6745 of it. room: of as many numbers as planes. */
static double estimate_step_error(const struct gsn_seriation *path, const size_t *order,
                                  double *room)
{
    const size_t n = path->count;
    size_t count = 0;
    double middle;

    if (n < LEAST)
        return 0;
    for (size_t i = 0; i + 3 < n; i++)
        room[count++] =
            unlike_along(path, order, i, i + 1) + unlike_along(path, order, i + 2, i + 3) -
            unlike_along(path, order, i, i + 2) - unlike_along(path, order, i + 1, i + 3);
    middle = gsn_median(room, count);
    for (size_t i = 0; i < count; i++)
        room[i] = fabs(room[i] - middle);
    /* Densities are floats: a correlation is known no better. */
    return fmax(gsn_median(room, count) / (2 * 0.6745), (double)FLT_EPSILON);
}

int gsn_seriation_new(const struct gsn_sequence_plane *planes, size_t count, size_t columns,
                      size_t rows, struct gsn_seriation **ret_path, struct gsn_error *err)
{
    const size_t squares = columns / SQUARE * (rows / SQUARE);
    gsn_auto(gsn_seriation) path = gsn_alloc_array(1, sizeof *path);
    gsn_auto_mem(float) value = gsn_alloc_array(count * squares + 1, sizeof *value);

    if (path) {
        path->unlike = gsn_alloc_array(count * count + 1, sizeof *path->unlike);
        path->place = gsn_alloc_array(count + 1, sizeof *path->place);
        path->room = gsn_alloc_array(count + 1, sizeof *path->room);
    }
    if (!path || !path->unlike || !path->place || !path->room || !value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", count);
    path->count = count;
    for (size_t i = 0; i < count; i++)
        average_squares(planes[i].density, columns, rows, value + i * squares);
    for (size_t i = 0; i < count; i++)
        for (size_t j = 0; j < i; j++)
            path->unlike[i * count + j] = path->unlike[j * count + i] =
                measure_unlike(value + i * squares, value + j * squares, squares);
    path->error = estimate_step_error(path, NULL, path->room);
    *ret_path = gsn_steal(&path);
    return GSN_OK;
}

double gsn_seriation_distance(const struct gsn_seriation *path, size_t i, size_t j)
{
    return path->unlike[i * path->count + j];
}

/* Whether two places are a step of an order. */
static int is_step(size_t a, size_t b)
{
    return a != b && (a > b ? a - b : b - a) <= STEPS;
}

double gsn_seriation_gain(struct gsn_seriation *path, const size_t *order)
{
    const size_t n = path->count;
    size_t *place = path->place;
    double shorter = 0, error;
    size_t steps = 0;

    for (size_t i = 0; i < n; i++)
        place[order[i]] = i;
    for (size_t i = 0; i < n; i++)
        for (size_t j = i + 1; j < n && j <= i + STEPS; j++) {
            if (!is_step(place[i], place[j])) {
                shorter += gsn_seriation_distance(path, i, j);
                steps++;
            }
            if (!is_step(order[i], order[j])) {
                shorter -= gsn_seriation_distance(path, order[i], order[j]);
                steps++;
            }
        }
    error = fmin(path->error, estimate_step_error(path, order, path->room));
    return steps > 0 && error > 0 ? shorter / (error * sqrt((double)steps)) : 0;
}

/* By how much a plane that lies elsewhere is nearer than the one at a place to those up to so many
 * steps around it, in the mean; those that lie around both have no say. ret_count: of how many. */
static double measure_nearer(const struct gsn_seriation *path, size_t place, size_t other,
                             size_t steps, size_t *ret_count)
{
    const size_t first = place > steps ? place - steps : 0;
    double sum = 0;
    size_t count = 0;

    for (size_t k = first; k <= place + steps && k < path->count; k++) {
        if (k == place || k == other || (k > other ? k - other : other - k) <= steps)
            continue;
        sum += gsn_seriation_distance(path, place, k) - gsn_seriation_distance(path, other, k);
        count++;
    }
    *ret_count = count;
    return count ? sum / (double)count : 0;
}

static int is_part(size_t first, size_t i)
{
    return i >= first && i < first + 4;
}

/* The error of a step as the rest of the stack has it, by its standard deviation: of many folds
 * some look like swaps. */
static double estimate_error_of_others(const struct gsn_seriation *path, size_t i, size_t j)
{
    double sum = 0, squares = 0, count = 0;

    for (size_t k = 0; k + 3 < path->count; k++) {
        const double left =
            gsn_seriation_distance(path, k, k + 1) + gsn_seriation_distance(path, k + 2, k + 3) -
            gsn_seriation_distance(path, k, k + 2) - gsn_seriation_distance(path, k + 1, k + 3);

        if (is_part(k, i) || is_part(k, j))
            continue;
        sum += left;
        squares += left * left;
        count++;
    }
    return count > 0 ? fmax(path->error, sqrt(fmax(squares - sum * sum / count, 0) / count) / 2)
                     : 0;
}

/* At both places the other must be nearer, so the lesser of the two counts twice: one section that
 * is folded is far from those around itself, too, and anyone is nearer to them. */
static double measure_exchange(const struct gsn_seriation *path, size_t i, size_t j, size_t steps)
{
    size_t here, there;
    const double error = path->error > 0 ? estimate_error_of_others(path, i, j) : 0;
    const double nearer = 2 * fmin(measure_nearer(path, i, j, steps, &here),
                                   measure_nearer(path, j, i, steps, &there));

    return here > 0 && there > 0 && error > 0
               ? nearer / (error * sqrt(2 / (double)here + 2 / (double)there))
               : 0;
}

double gsn_seriation_exchange_gain(const struct gsn_seriation *path, size_t i, size_t j)
{
    double least = INFINITY;

    if (j == i + 1 && (i == 0 || j + 1 == path->count))
        return 0;
    for (size_t steps = 1; steps <= STEPS; steps++)
        least = fmin(least, measure_exchange(path, i, j, steps));
    return least;
}

static void exchange_numbers(double *a, double *b)
{
    const double kept = *a;

    *a = *b;
    *b = kept;
}

void gsn_seriation_exchange(struct gsn_seriation *path, size_t i, size_t j)
{
    const size_t n = path->count;

    for (size_t k = 0; k < n; k++)
        exchange_numbers(&path->unlike[i * n + k], &path->unlike[j * n + k]);
    for (size_t k = 0; k < n; k++)
        exchange_numbers(&path->unlike[k * n + i], &path->unlike[k * n + j]);
}
