/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/refine.h"

#include "pipeline/register/refine_parts.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* The moves are tens of um at most and the structures compared at least a hundred, so Gauss and
 * Newton are there in three. */
enum { ROUNDS = 3, LEAST_SIDE = 16 };

static int check(const struct gsn_refine_stack *stack, struct gsn_error *err)
{
    if (stack->side < LEAST_SIDE)
        return gsn_fail(err, GSN_E_INPUT, "%zu cells a side are too few to compare tissue in",
                        stack->side);
    if (!(stack->cell_um > 0) || !(stack->unit_um > 0) || !isfinite(stack->cell_um) ||
        !isfinite(stack->unit_um))
        return gsn_fail(err, GSN_E_INPUT, "cells of %g um about %g um are no square",
                        stack->cell_um, stack->unit_um);
    if (!(stack->bent_um2 >= 0) || !isfinite(stack->bent_um2))
        return gsn_fail(err, GSN_E_INPUT, "sections bent by %g um2 are none", stack->bent_um2);
    for (size_t k = 1; k < stack->count; k++)
        if (stack->section[k].serial <= stack->section[k - 1].serial)
            return gsn_fail(err, GSN_E_INPUT, "section %u comes after section %u",
                            stack->section[k].serial + 1, stack->section[k - 1].serial + 1);
    return GSN_OK;
}

int gsn_refine_solve(const struct gsn_refine_stack *stack, unsigned threads,
                     struct gsn_refined *ret_refined, struct gsn_refine_summary *ret_summary,
                     struct gsn_error *err)
{
    gsn_auto(gsn_refine_compare) compare = NULL;
    gsn_auto_mem(struct gsn_refine_equation) equation = NULL;
    gsn_auto_mem(int) there = NULL;
    double(*move)[PARTS] __attribute__((cleanup(gsn_auto_release))) = NULL;
    double(*covariance)[PARTS][PARTS] __attribute__((cleanup(gsn_auto_release))) = NULL;
    struct gsn_refine_summary summary = { 0 };
    int r;

    assert(stack && ret_refined && ret_summary && (stack->section || stack->count == 0));

    r = check(stack, err);
    if (r >= 0)
        r = gsn_refine_compare_new(stack, &compare, err);
    if (r < 0)
        return r;
    equation = gsn_alloc_array(stack->count + 1, sizeof *equation);
    there = gsn_alloc_array(stack->count + 1, sizeof *there);
    move = gsn_alloc_array(stack->count + 1, sizeof *move);
    covariance = gsn_alloc_array(stack->count + 1, sizeof *covariance);
    if (!equation || !there || !move || !covariance)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to lay sections by their tissue");
    for (int round = 0; r >= 0 && round < ROUNDS; round++) {
        r = gsn_refine_compare_all(compare, (const double(*)[PARTS])move, threads, there, equation,
                                   &summary.finest_um, err);
        if (r >= 0)
            r = gsn_refine_joint(stack, there, equation, move, covariance, &summary, err);
    }
    if (r < 0)
        return r;
    for (size_t k = 0; k < stack->count; k++) {
        ret_refined[k].compared = equation[k].information[0][0] > 0;
        memcpy(ret_refined[k].move, move[k], sizeof move[k]);
        memcpy(ret_refined[k].covariance, covariance[k], sizeof covariance[k]);
        summary.compared += (size_t)ret_refined[k].compared;
    }
    *ret_summary = summary;
    return GSN_OK;
}
