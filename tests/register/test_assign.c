/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/assign.h"

#include "tests/check.h"
#include "tests/register/draw.h"

enum { ROWS = 5, COLUMNS = 7 };

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
    struct draw_chance chance = { 3 };

    for (int k = 0; k < 100; k++) {
        double cost[ROWS * COLUMNS], sum = 0;
        int column[ROWS];
        unsigned taken = 0;
        struct gsn_error err = { 0 };

        for (int i = 0; i < ROWS * COLUMNS; i++)
            cost[i] = k % 2 ? draw_uniform(&chance, -1, 1) : floor(draw_uniform(&chance, 0, 4));
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
