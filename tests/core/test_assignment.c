/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/assignment.h"

#include "tests/check.h"

#include <math.h>
#include <stdint.h>

enum { ROWS = 5, COLUMNS = 7 };

/* splitmix64, 0 to 1. */
static double next_uniform(uint64_t *state)
{
    uint64_t z = *state += 0x9e3779b97f4a7c15u;

    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

/* All ways, one row after the other. */
static double least_by_trial(const double *cost, int row, unsigned taken)
{
    double least = INFINITY;

    if (row == ROWS)
        return 0;
    for (unsigned c = 0; c < COLUMNS; c++)
        if (!(taken >> c & 1))
            least = fmin(least, cost[row * COLUMNS + (int)c] +
                                    least_by_trial(cost, row + 1, taken | 1u << c));
    return least;
}

TEST(no_other_assignment_costs_less)
{
    uint64_t chance = 3;

    for (int k = 0; k < 100; k++) {
        double cost[ROWS * COLUMNS], sum = 0;
        int column[ROWS];
        unsigned taken = 0;
        struct gsn_error err = { 0 };

        for (int i = 0; i < ROWS * COLUMNS; i++)
            cost[i] = k % 2 ? 2 * next_uniform(&chance) - 1 : floor(4 * next_uniform(&chance));
        CHECK_OK(gsn_assign(cost, ROWS, COLUMNS, column, &err), err);
        for (int i = 0; i < ROWS; i++) {
            CHECK(column[i] >= 0 && column[i] < COLUMNS && !(taken >> column[i] & 1));
            taken |= 1u << column[i];
            sum += cost[i * COLUMNS + column[i]];
        }
        CHECK_NEAR(sum, least_by_trial(cost, 0, 0), 1e-12);
    }
}

static int assign_once(struct gsn_error *err)
{
    const double cost[4] = { 1, 2, 3, 5 };
    int column[2];

    return gsn_assign(cost, 2, 2, column, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(assign_once(&err), err);
}
