/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/stack/gap_interpolation.h"

#include "tests/check.h"

#include <stdbool.h>
#include <stdlib.h>

enum { NX = 9, NY = 7, NZ = 24, PLANE = NX * NY };
static const struct gsn_lattice LATTICE = { NX, NY, NZ, { 0, 0, 12 }, { 16, 16, 24 } };

struct stack {
    struct gsn_grid *grid;
    struct gsn_mask *region;
};

static void stack_done(struct stack *stack)
{
    gsn_grid_free(stack->grid);
    gsn_mask_free(stack->region);
}
#define stack_auto __attribute__((cleanup(stack_done))) struct stack

/* The region is everything but the two outermost planes. */
static void make(struct stack *stack, double (*density)(double x, double z))
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new(&LATTICE, &stack->grid, &err), err);
    CHECK_OK(gsn_mask_new(&LATTICE, &stack->region, &err), err);
    for (size_t i = 0; i < (size_t)NZ * PLANE; i++) {
        const size_t z = i / PLANE;

        stack->grid->value[i] = (float)density((double)(i % NX), (double)z);
        stack->region->inside[i] = z > 0 && z + 1 < NZ;
    }
}

static void lose(struct gsn_grid *grid, size_t plane)
{
    for (size_t i = 0; i < PLANE; i++)
        grid->value[plane * PLANE + i] = NAN;
}

static double mean_of(const struct stack *stack)
{
    double sum = 0, count = 0;

    for (size_t i = 0; i < (size_t)NZ * PLANE; i++)
        if (stack->region->inside[i] && isfinite(stack->grid->value[i])) {
            sum += (double)stack->grid->value[i];
            count++;
        }
    return sum / count;
}

static double ramp(double x, double z)
{
    return 0.2 + 0.01 * x + 0.02 * z;
}

static double wave(double x, double z)
{
    return 0.5 + 0.2 * cos(2 * M_PI * z / 11) + 0.01 * x;
}

/* Case 29. Closed up, or left out, the mean of a ramp would be wrong by a tenth. */
TEST(gaps_in_a_straight_ramp_are_bridged_exactly_and_at_their_own_z)
{
    stack_auto stack;
    struct gsn_gap_interpolation bridge;
    struct gsn_error err = { 0 };
    double truth;

    make(&stack, ramp);
    truth = mean_of(&stack);
    lose(stack.grid, 4);
    lose(stack.grid, 9);
    lose(stack.grid, 10);
    CHECK_OK(gsn_gap_interpolate(stack.grid, stack.region, &bridge, &err), err);
    CHECK(bridge.region == (NZ - 2) * PLANE && bridge.measured == (NZ - 5) * PLANE);
    CHECK(bridge.bridged == 3 * PLANE && bridge.planes == 3);
    CHECK_NEAR(mean_of(&stack), truth, 1e-6);
    CHECK_NEAR(stack.grid->value[9 * PLANE + 3], ramp(3, 9), 1e-6);
    CHECK_NEAR(bridge.error, 0, 1e-6);
}

/* Over every single plane that may be lost, the error that is told is the error that is made. */
TEST(the_error_that_is_told_is_the_one_that_is_made)
{
    double told = 0, made = 0;
    struct gsn_error err = { 0 };

    for (size_t lost = 1; lost + 1 < NZ; lost++) {
        stack_auto stack;
        struct gsn_gap_interpolation bridge;
        double truth;

        make(&stack, wave);
        truth = mean_of(&stack);
        lose(stack.grid, lost);
        CHECK_OK(gsn_gap_interpolate(stack.grid, stack.region, &bridge, &err), err);
        told += bridge.error * bridge.error;
        made += pow(mean_of(&stack) - truth, 2);
    }
    CHECK(made > 0);
    CHECK_NEAR(sqrt(told / made), 1, 0.1);
}

TEST(a_gap_that_is_too_long_or_at_an_end_stays_one)
{
    stack_auto stack;
    struct gsn_gap_interpolation bridge;
    struct gsn_error err = { 0 };

    make(&stack, wave);
    for (size_t plane = 5; plane < 5 + GSN_GAP_LONGEST + 1; plane++)
        lose(stack.grid, plane);
    lose(stack.grid, 0);
    lose(stack.grid, 1);
    CHECK_OK(gsn_gap_interpolate(stack.grid, stack.region, &bridge, &err), err);
    CHECK(bridge.bridged == 0 && bridge.planes == 0 && bridge.error == 0);
    CHECK(isnan(stack.grid->value[1 * PLANE]) && isnan(stack.grid->value[6 * PLANE]));
}

/* Case 37. A tear is a gap of its columns alone; their neighbours keep what was measured. */
TEST(a_hole_in_one_section_is_bridged_from_the_sections_beside_it)
{
    stack_auto stack;
    struct gsn_gap_interpolation bridge;
    struct gsn_error err = { 0 };

    make(&stack, ramp);
    for (size_t i = 0; i < 5; i++)
        stack.grid->value[7 * PLANE + i] = NAN;
    CHECK_OK(gsn_gap_interpolate(stack.grid, stack.region, &bridge, &err), err);
    CHECK(bridge.bridged == 5 && bridge.planes == 1);
    CHECK_NEAR(stack.grid->value[7 * PLANE + 2], ramp(2, 7), 1e-6);
    CHECK(stack.grid->value[7 * PLANE + 8] == (float)ramp(8, 7));
}

TEST(where_nothing_can_be_left_out_no_error_is_told)
{
    stack_auto stack;
    struct gsn_gap_interpolation bridge;
    struct gsn_error err = { 0 };

    make(&stack, ramp);
    for (size_t plane = 0; plane < NZ; plane++)
        if (plane % 2 == 1)
            lose(stack.grid, plane);
    CHECK_OK(gsn_gap_interpolate(stack.grid, stack.region, &bridge, &err), err);
    CHECK(bridge.bridged > 0 && isnan(bridge.error));
}

TEST(running_out_of_memory_leaves_the_gaps)
{
    stack_auto stack;
    struct gsn_gap_interpolation bridge = { .planes = 77 };
    struct gsn_error err = { 0 };

    make(&stack, ramp);
    lose(stack.grid, 4);
    gsn_check_fail_allocation(2);
    CHECK(gsn_gap_interpolate(stack.grid, stack.region, &bridge, &err) == GSN_E_NOMEM);
    gsn_check_fail_allocation(0);
    CHECK(isnan(stack.grid->value[4 * PLANE]) && bridge.planes == 77);
    CHECK_EVERY_OOM(gsn_gap_interpolate(stack.grid, stack.region, &bridge, &err), err);
}
