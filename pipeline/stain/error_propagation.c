/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* First-order propagation of the errors of stain vectors and white (the delta method): var f =
 * g' C g with the slopes g of the figure by the six turns and by the white's three channels.
 *
 * Of a mean density the slopes are differences over turns of half a degree and whites of half a
 * percent, on at most 5000 of its own pixels: smaller than any error they are used for, larger than
 * what floats of densities lose.
 *
 * Of a loss they are exact: the inverse turns against the vectors, each of which takes along what
 * there is of its dye. What the line through the control tissues takes out is subtracted; the rest
 * has a part by how far the region lies off that line and a part by where the line puts density 0.
 * What vectors scatter by from panel to panel is worked back from the scatter of that zero, with as
 * many degrees of freedom as there were panels (Student). Fewer than two control tissues, or all of
 * one density, tell no line: then nothing is known, and the answer says that. */
#include "pipeline/stain/error_propagation.h"

#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/unmixing.h"

#include <math.h>
#include <string.h>

/* Slopes by differences: turns of half a degree, whites of half a percent. Smaller than any error
 * they are used for, larger than what floats of densities lose. */
static const double TURN = 0.5 * M_PI / 180, WHITE_OD = 0.002;

enum { MOST_FOR_SLOPES = 5000 };

static int is_in(struct gsn_plane *const od[3], const struct gsn_image *mask, size_t i)
{
    return (!mask || ((const uint8_t *)mask->samples)[i] != 0) && isfinite(od[0]->value[i]) &&
           isfinite(od[1]->value[i]) && isfinite(od[2]->value[i]);
}

struct total {
    double sum;
    size_t count, seen;
};

/* Over every `stride`-th pixel, the densities raised by `shift`. */
static int sum_red(struct gsn_plane *const od[3], const struct gsn_image *mask,
                   const struct gsn_dyes *dyes, const double shift[3], size_t stride,
                   struct total *ret, struct gsn_error *err)
{
    const size_t count = (size_t)od[0]->width * od[0]->height;
    struct gsn_unmixer mix;
    const int r = gsn_unmixer_init(&mix, dyes, err);

    *ret = (struct total){ 0 };
    for (size_t i = 0; r >= 0 && i < count; i++) {
        double amount[3];

        if (!is_in(od, mask, i) || ret->seen++ % stride != 0)
            continue;
        const double d[3] = { od[0]->value[i] + shift[0], od[1]->value[i] + shift[1],
                              od[2]->value[i] + shift[2] };

        gsn_unmixer_apply(&mix, d, amount);
        ret->sum += amount[0] / dyes->full_red_od;
        ret->count++;
    }
    return r;
}

static int find_slope(struct gsn_plane *const od[3], const struct gsn_image *mask,
                      const struct gsn_dyes dyes[2], const double shift[2][3], size_t stride,
                      double between, double *ret_slope, struct gsn_error *err)
{
    struct total side[2];

    for (int way = 0; way < 2; way++) {
        const int r = sum_red(od, mask, &dyes[way], shift[way], stride, &side[way], err);

        if (r < 0)
            return r;
    }
    *ret_slope =
        (side[1].sum / (double)side[1].count - side[0].sum / (double)side[0].count) / between;
    return GSN_OK;
}

static int find_slopes(struct gsn_plane *const od[3], const struct gsn_image *mask,
                       const struct gsn_dyes *dyes, size_t stride, struct gsn_collagen_mean *red,
                       struct gsn_error *err)
{
    int r = GSN_OK;

    for (int m = 0; m < GSN_DYE_ROTATIONS && r >= 0; m++) {
        static const double none[2][3] = { { 0 } };
        double turn[2][GSN_DYE_ROTATIONS] = { { 0 } };

        turn[0][m] = -TURN;
        turn[1][m] = TURN;

        const struct gsn_dyes turned[2] = { gsn_dyes_rotated(dyes, turn[0]),
                                            gsn_dyes_rotated(dyes, turn[1]) };

        r = find_slope(od, mask, turned, none, stride, 2 * TURN, &red->by_turn[m], err);
    }
    for (int c = 0; c < 3 && r >= 0; c++) {
        const struct gsn_dyes same[2] = { *dyes, *dyes };
        double shift[2][3] = { { 0 } };

        shift[0][c] = -WHITE_OD;
        shift[1][c] = WHITE_OD;
        r = find_slope(od, mask, same, (const double(*)[3])shift, stride, 2 * WHITE_OD,
                       &red->by_white[c], err);
    }
    return r;
}

int gsn_collagen_mean(struct gsn_plane *const od[3], const struct gsn_image *mask,
                      const struct gsn_dyes *dyes, struct gsn_collagen_mean *ret_mean,
                      struct gsn_error *err)
{
    static const double none[3] = { 0 };
    struct gsn_collagen_mean red = { 0 };
    struct total all;
    int r;

    r = gsn_od_check(od, mask, err);
    if (r >= 0)
        r = sum_red(od, mask, dyes, none, 1, &all, err);
    if (r < 0)
        return r;
    if (all.count == 0)
        return gsn_fail(err, GSN_E_STAIN, "there is no tissue to measure");
    red.mean = all.sum / (double)all.count;
    r = find_slopes(od, mask, dyes, all.count / MOST_FOR_SLOPES + 1, &red, err);
    if (r >= 0)
        *ret_mean = red;
    return r;
}

/* a' C b */
static double covariance_of(const double covariance[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS],
                            const double a[GSN_DYE_ROTATIONS], const double b[GSN_DYE_ROTATIONS])
{
    double sum = 0;

    for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
        for (int n = 0; n < GSN_DYE_ROTATIONS; n++)
            sum += a[m] * covariance[m][n] * b[n];
    return sum;
}

double gsn_collagen_mean_error(const struct gsn_collagen_mean *red, const struct gsn_dyes_fit *fit,
                               double white_od)
{
    double variance = covariance_of(fit->covariance, red->by_turn, red->by_turn);

    for (int c = 0; c < 3; c++)
        variance += red->by_white[c] * white_od * red->by_white[c] * white_od;
    return sqrt(variance) / fabs(red->mean);
}

/* ---- what an error of the vectors leaves in a loss --------------------------------------- */

/* Tissues that are more alike tell no line. */
static const double LEAST_APART = 0.05;

int gsn_vector_error_add(struct gsn_vector_error *t, const struct gsn_dyes *dyes,
                         const double od[3], double weight, struct gsn_error *err)
{
    static const double none[GSN_DYE_ROTATIONS] = { 0 };
    const double all = t->weight + weight, share = all > 0 ? weight / all : 0;
    struct gsn_dyes_inverse optics;
    double amount[3] = { 0 };

    if (!gsn_dyes_invert(dyes, none, &optics))
        return gsn_fail(err, GSN_E_STAIN, "the dyes of %s lie in one plane", dyes->name);
    for (int k = 0; k < 3; k++)
        for (int c = 0; c < 3; c++)
            amount[k] += optics.inverse[k][c] * od[c];
    /* The inverse turns against the vectors: each takes along what there is of its dye. */
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++) {
        double leak = 0;

        for (int c = 0; c < 3; c++)
            leak -= optics.inverse[0][c] * optics.slope[m][c];
        t->by_turn[m] += share * (leak * amount[m / 2] / dyes->full_red_od - t->by_turn[m]);
    }
    t->red += share * (amount[0] / dyes->full_red_od - t->red);
    t->weight = all;
    return GSN_OK;
}

/* Means and sums of squares over the tissues that were seen. */
struct line {
    size_t tissues;
    double red, squares;
};

static struct line line_of(const struct gsn_vector_error *tissue, size_t count)
{
    struct line line = { 0 };

    for (size_t k = 0; k < count; k++)
        if (tissue[k].weight > 0) {
            line.tissues++;
            line.red += tissue[k].red;
        }
    line.red /= line.tissues > 0 ? (double)line.tissues : 1;
    for (size_t k = 0; k < count; k++)
        if (tissue[k].weight > 0)
            line.squares += (tissue[k].red - line.red) * (tissue[k].red - line.red);
    return line;
}

/* Of the line through the changes that one turn makes, where it is at a density. */
static double change_at(const struct line *line, const struct gsn_vector_error *tissue,
                        size_t count, int turn, double density)
{
    double sum = 0;

    for (size_t k = 0; k < count; k++)
        if (tissue[k].weight > 0)
            sum += tissue[k].by_turn[turn] *
                   (1 / (double)line->tissues +
                    (tissue[k].red - line->red) * (density - line->red) / line->squares);
    return sum;
}

struct gsn_vector_error_left
gsn_vector_error_left_of(const struct gsn_vector_error *tissue, size_t count,
                         const struct gsn_vector_error *region,
                         const double covariance[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS])
{
    const struct line line = line_of(tissue, count);
    double off[GSN_DYE_ROTATIONS], zero[GSN_DYE_ROTATIONS];

    if (line.tissues < 2 || !(line.squares > LEAST_APART * LEAST_APART) || !(region->weight > 0) ||
        !(region->red > 0))
        return (struct gsn_vector_error_left){ 0 };
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++) {
        off[m] =
            (region->by_turn[m] - change_at(&line, tissue, count, m, region->red)) / region->red;
        zero[m] = change_at(&line, tissue, count, m, 0) / region->red;
    }
    return (struct gsn_vector_error_left){ 1, covariance_of(covariance, off, off),
                                           covariance_of(covariance, zero, zero),
                                           covariance_of(covariance, off, zero) };
}

struct gsn_vector_scatter gsn_vector_scatter_of(const struct gsn_vector_error *tissue, size_t count,
                                                double zero_variance, double freedom)
{
    const struct line line = line_of(tissue, count);
    double squares = 0;

    if (line.tissues < 2 || !(line.squares > LEAST_APART * LEAST_APART))
        return (struct gsn_vector_scatter){ 0 };
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++) {
        const double zero = change_at(&line, tissue, count, m, 0);

        squares += zero * zero;
    }
    if (!(squares > 0))
        return (struct gsn_vector_scatter){ 0 };
    return (struct gsn_vector_scatter){ zero_variance / squares, freedom };
}

struct gsn_vector_scatter gsn_vector_scatter_pool(const struct gsn_vector_scatter *a,
                                                  const struct gsn_vector_scatter *b)
{
    const double freedom = a->freedom + b->freedom;

    if (!(freedom > 0))
        return (struct gsn_vector_scatter){ 0 };
    return (struct gsn_vector_scatter){
        (a->variance * a->freedom + b->variance * b->freedom) / freedom, freedom
    };
}

double gsn_vector_scatter_deviation(const struct gsn_vector_scatter *scatter)
{
    const double free = scatter->freedom;

    return free > 0 ? sqrt(scatter->variance * (free > 3 ? free / (free - 2) : 3)) : 0;
}

double gsn_vector_error_of_loss(const struct gsn_vector_error_left *left, double ratio)
{
    const double lost = 1 - ratio;

    return sqrt(fmax(0, left->off + 2 * lost * left->both + lost * lost * left->zero));
}
