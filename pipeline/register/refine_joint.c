/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/linalg.h"
#include "pipeline/register/refine_parts.h"

#include <math.h>
#include <string.h>

/* Two sections are in one equation when a third lies within AROUND of both. */
enum { BAND = PARTS * (2 * AROUND + 1), ROUNDS = 4 };

/* A section whose comparison is off by more than so many times its error is worth less. */
static const double MOST_OFF2 = 4;
/* What stacks can show of their own errors. */
static const double MOST_PRIOR = 9, MOST_COMPARISON = 9;

typedef double matrix[PARTS][PARTS];

struct joint {
    const struct gsn_refine_stack *stack;
    const int *there;
    const struct gsn_refine_equation *equation;
    double (*move)[PARTS];
    double (*line)[2 * AROUND + 1];
    matrix *prior, *spread; /* inverses of the priors and of the information */
    double *worth;          /* of a section's comparison */
    size_t wide;            /* of the band: BAND, or size where that is less */
    double *band;           /* column i: a[i .. i + wide - 1][i], then its Cholesky factor */
    double *step, *column;  /* unknowns */
    double (*covariance)[PARTS][PARTS];
    double prior_factor, comparison_factor;
    size_t size;
};

static void joint_done(struct joint *j)
{
    gsn_free(j->line);
    gsn_free(j->prior);
    gsn_free(j->spread);
    gsn_free(j->worth);
    gsn_free(j->band);
    gsn_free(j->step);
    gsn_free(j->column);
}

static int is_compared(const struct gsn_refine_equation *e)
{
    return e->information[0][0] > 0;
}

static int joint_init(struct joint *j, struct gsn_error *err)
{
    const size_t count = j->stack->count;

    j->size = count * PARTS;
    j->wide = BAND < j->size ? BAND : j->size;
    j->line = gsn_alloc_array(count, sizeof *j->line);
    j->prior = gsn_alloc_array(count, sizeof *j->prior);
    j->spread = gsn_alloc_array(count, sizeof *j->spread);
    j->worth = gsn_alloc_array(count, sizeof *j->worth);
    j->band = gsn_alloc_array(j->size, j->wide * sizeof *j->band);
    j->step = gsn_alloc_array(j->size, sizeof *j->step);
    j->column = gsn_alloc_array(j->size, sizeof *j->column);
    if (!j->line || !j->prior || !j->spread || !j->worth || !j->band || !j->step || !j->column)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to lay sections by their tissue");
    for (size_t k = 0; k < count; k++) {
        memcpy(j->prior[k], j->stack->section[k].prior, sizeof j->prior[k]);
        if (gsn_invert_spd(&j->prior[k][0][0], PARTS, PARTS) < 0)
            return gsn_fail(err, GSN_E_INPUT,
                            "what is known of section %u beforehand is no "
                            "covariance",
                            j->stack->section[k].serial + 1);
        memcpy(j->spread[k], j->equation[k].information, sizeof j->spread[k]);
        if (is_compared(&j->equation[k]) && gsn_invert_spd(&j->spread[k][0][0], PARTS, PARTS) >= 0) {
            gsn_refine_line(j->stack, j->there, k, j->line[k]);
            j->worth[k] = 1;
        }
    }
    return GSN_OK;
}

/* How section `other` enters the k-th comparison: the move itself, minus the line's. */
static double part_of(const struct joint *j, size_t k, size_t offset)
{
    return (offset == AROUND ? 1 : 0) - j->line[k][offset];
}

static double *at(struct joint *j, size_t row, size_t column)
{
    return &j->band[column * j->wide + (row - column)];
}

static void add_block(struct joint *j, size_t k, size_t l, double times, const matrix block)
{
    for (size_t p = 0; p < PARTS; p++)
        for (size_t q = 0; q < PARTS; q++)
            if (k * PARTS + p >= l * PARTS + q)
                *at(j, k * PARTS + p, l * PARTS + q) += times * block[p][q];
}

static void add_comparison(struct joint *j, size_t k)
{
    const struct gsn_refine_equation *e = &j->equation[k];
    const double worth = j->worth[k] / j->comparison_factor;

    for (size_t a = 0; a <= 2 * AROUND; a++) {
        const double pa = part_of(j, k, a);

        if (pa == 0)
            continue;
        for (size_t p = 0; p < PARTS; p++)
            j->step[(k + a - AROUND) * PARTS + p] += worth * pa * e->right[p];
        for (size_t b = 0; b <= a; b++)
            if (part_of(j, k, b) != 0)
                add_block(j, k + a - AROUND, k + b - AROUND, worth * pa * part_of(j, k, b),
                          e->information);
    }
}

/* Normal equations: the right side goes to step. */
static void set_up(struct joint *j)
{
    memset(j->band, 0, j->size * j->wide * sizeof *j->band);
    memset(j->step, 0, j->size * sizeof *j->step);
    for (size_t k = 0; k < j->stack->count; k++) {
        add_block(j, k, k, 1 / j->prior_factor, j->prior[k]);
        for (size_t p = 0; p < PARTS; p++)
            for (size_t q = 0; q < PARTS; q++)
                j->step[k * PARTS + p] -= j->prior[k][p][q] * j->move[k][q] / j->prior_factor;
        if (j->worth[k] > 0)
            add_comparison(j, k);
    }
}

static void fill_covariances(struct joint *j)
{
    for (size_t k = 0; k < j->stack->count; k++)
        for (size_t p = 0; p < PARTS; p++) {
            memset(j->column, 0, j->size * sizeof *j->column);
            j->column[k * PARTS + p] = 1;
            gsn_band_solve(j->band, j->size, j->wide, j->column);
            memcpy(j->covariance[k][p], j->column + k * PARTS, sizeof j->covariance[k][p]);
        }
}

static double quadratic(const matrix m, const double v[PARTS])
{
    double sum = 0;

    for (size_t p = 0; p < PARTS; p++)
        for (size_t q = 0; q < PARTS; q++)
            sum += v[p] * m[p][q] * v[q];
    return sum;
}

/* What a comparison still differs by, over its variance. */
static double left_of(const struct joint *j, size_t k)
{
    double left[PARTS];

    for (size_t p = 0; p < PARTS; p++) {
        left[p] = 0;
        for (size_t q = 0; q < PARTS; q++)
            left[p] += j->spread[k][p][q] * j->equation[k].right[q];
        for (size_t a = 0; a <= 2 * AROUND; a++)
            if (part_of(j, k, a) != 0)
                left[p] -= part_of(j, k, a) * j->step[(k + a - AROUND) * PARTS + p];
    }
    return quadratic(j->equation[k].information, left);
}

/* Variances from what priors and comparisons are left with, over the degrees of freedom that each
 * has of its own (MacKay 1992). */
static void learn(struct joint *j)
{
    double of_priors = 0, of_comparisons = 0, free = 0, told = 0;

    for (size_t k = 0; k < j->stack->count; k++) {
        double moved[PARTS], left;

        for (size_t p = 0; p < PARTS; p++) {
            moved[p] = j->move[k][p] + j->step[k * PARTS + p];
            told += 1;
            for (size_t q = 0; q < PARTS; q++)
                told -= j->prior[k][p][q] * j->covariance[k][q][p] / j->prior_factor;
        }
        of_priors += quadratic(j->prior[k], moved);
        if (!(j->worth[k] > 0))
            continue;
        left = left_of(j, k);
        of_comparisons += j->worth[k] * left;
        free += PARTS;
        j->worth[k] = fmin(1, MOST_OFF2 * PARTS * j->comparison_factor / left);
    }
    if (!(told > 1) || !(free - told > 1))
        return;
    j->prior_factor = fmin(fmax(of_priors / told, 1), MOST_PRIOR);
    j->comparison_factor = fmin(fmax(of_comparisons / (free - told), 1), MOST_COMPARISON);
}

static int iterate(struct joint *j, struct gsn_error *err)
{
    for (int round = 0;; round++) {
        set_up(j);
        if (gsn_band_cholesky(j->band, j->size, j->wide) < 0)
            return gsn_fail(err, GSN_E_FIT, "the sections' moves cannot be solved");
        gsn_band_solve(j->band, j->size, j->wide, j->step);
        fill_covariances(j);
        if (round == ROUNDS)
            return GSN_OK;
        learn(j);
    }
}

int gsn_refine_joint(const struct gsn_refine_stack *stack, const int *there,
                     const struct gsn_refine_equation *equation, double (*move)[PARTS],
                     double (*covariance)[PARTS][PARTS], struct gsn_refine_summary *summary,
                     struct gsn_error *err)
{
    struct joint j = { .stack = stack,
                       .there = there,
                       .equation = equation,
                       .move = move,
                       .covariance = covariance,
                       .prior_factor = 1,
                       .comparison_factor = 1 };
    int r = joint_init(&j, err);

    if (r >= 0)
        r = iterate(&j, err);
    for (size_t k = 0; r >= 0 && k < stack->count; k++)
        for (size_t p = 0; p < PARTS; p++)
            move[k][p] += j.step[k * PARTS + p];
    if (r >= 0) {
        summary->prior_factor = j.prior_factor;
        summary->comparison_factor = j.comparison_factor;
    }
    joint_done(&j);
    return r;
}
