/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/turned.h"

#include "pipeline/stain/dyes_parts.h"

#include <math.h>

/* Tissues that are more alike tell no line. */
static const double LEAST_APART = 0.05;

int gsn_turned_add(struct gsn_turned *t, const struct gsn_dyes *dyes, const double od[3],
                   double weight, struct gsn_error *err)
{
    static const double none[GSN_DYE_TURNS] = { 0 };
    const double all = t->weight + weight, share = all > 0 ? weight / all : 0;
    struct gsn_optics optics;
    double amount[3] = { 0 };

    if (!gsn_dyes_look_through(dyes, none, &optics))
        return gsn_fail(err, GSN_E_STAIN, "the dyes of %s lie in one plane", dyes->name);
    for (int k = 0; k < 3; k++)
        for (int c = 0; c < 3; c++)
            amount[k] += optics.inverse[k][c] * od[c];
    /* The inverse turns against the vectors: each takes along what there is of its dye. */
    for (int m = 0; m < GSN_DYE_TURNS; m++) {
        double leak = 0;

        for (int c = 0; c < 3; c++)
            leak -= optics.inverse[0][c] * optics.slope[m][c];
        t->by_turn[m] += share * (leak * amount[m / 2] / dyes->full_red_od - t->by_turn[m]);
    }
    t->red += share * (amount[0] / dyes->full_red_od - t->red);
    t->weight = all;
    return GSN_OK;
}

/* a' C b */
static double through(const double covariance[GSN_DYE_TURNS][GSN_DYE_TURNS],
                      const double a[GSN_DYE_TURNS], const double b[GSN_DYE_TURNS])
{
    double sum = 0;

    for (int m = 0; m < GSN_DYE_TURNS; m++)
        for (int n = 0; n < GSN_DYE_TURNS; n++)
            sum += a[m] * covariance[m][n] * b[n];
    return sum;
}

/* Means and sums of squares over the tissues that were seen. */
struct line {
    size_t tissues;
    double red, squares;
};

static struct line line_of(const struct gsn_turned *tissue, size_t count)
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
static double change_at(const struct line *line, const struct gsn_turned *tissue, size_t count,
                        int turn, double density)
{
    double sum = 0;

    for (size_t k = 0; k < count; k++)
        if (tissue[k].weight > 0)
            sum += tissue[k].by_turn[turn] *
                   (1 / (double)line->tissues +
                    (tissue[k].red - line->red) * (density - line->red) / line->squares);
    return sum;
}

struct gsn_turned_left gsn_turned_left_of(const struct gsn_turned *tissue, size_t count,
                                          const struct gsn_turned *region,
                                          const double covariance[GSN_DYE_TURNS][GSN_DYE_TURNS])
{
    const struct line line = line_of(tissue, count);
    double off[GSN_DYE_TURNS], zero[GSN_DYE_TURNS];

    if (line.tissues < 2 || !(line.squares > LEAST_APART * LEAST_APART) || !(region->weight > 0) ||
        !(region->red > 0))
        return (struct gsn_turned_left){ 0 };
    for (int m = 0; m < GSN_DYE_TURNS; m++) {
        off[m] =
            (region->by_turn[m] - change_at(&line, tissue, count, m, region->red)) / region->red;
        zero[m] = change_at(&line, tissue, count, m, 0) / region->red;
    }
    return (struct gsn_turned_left){ 1, through(covariance, off, off),
                                     through(covariance, zero, zero),
                                     through(covariance, off, zero) };
}

struct gsn_turned_scatter gsn_turned_scatter_of(const struct gsn_turned *tissue, size_t count,
                                                double zero_variance, double freedom)
{
    const struct line line = line_of(tissue, count);
    double squares = 0;

    if (line.tissues < 2 || !(line.squares > LEAST_APART * LEAST_APART))
        return (struct gsn_turned_scatter){ 0 };
    for (int m = 0; m < GSN_DYE_TURNS; m++) {
        const double zero = change_at(&line, tissue, count, m, 0);

        squares += zero * zero;
    }
    if (!(squares > 0))
        return (struct gsn_turned_scatter){ 0 };
    return (struct gsn_turned_scatter){ zero_variance / squares, freedom };
}

struct gsn_turned_scatter gsn_turned_together(const struct gsn_turned_scatter *a,
                                              const struct gsn_turned_scatter *b)
{
    const double freedom = a->freedom + b->freedom;

    if (!(freedom > 0))
        return (struct gsn_turned_scatter){ 0 };
    return (struct gsn_turned_scatter){
        (a->variance * a->freedom + b->variance * b->freedom) / freedom, freedom
    };
}

double gsn_turned_wide(const struct gsn_turned_scatter *scatter)
{
    const double free = scatter->freedom;

    return free > 0 ? sqrt(scatter->variance * (free > 3 ? free / (free - 2) : 3)) : 0;
}

double gsn_turned_error(const struct gsn_turned_left *left, double ratio)
{
    const double lost = 1 - ratio;

    return sqrt(fmax(0, left->off + 2 * lost * left->both + lost * lost * left->zero));
}
