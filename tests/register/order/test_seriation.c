/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/order/seriation.h"

#include "tests/check.h"

#include <math.h>
#include <string.h>

/* Waves of one length, each further on than the last by an angle: over whole waves the correlation
 * of two is the cosine of the angle between them. */
enum { SECTIONS = 24, WAVES = 4, COLUMNS = 48 * WAVES, ROWS = 12 };

static float density[SECTIONS][ROWS * COLUMNS];
static struct gsn_sequence_plane planes[SECTIONS];

static void draw(const double angle[SECTIONS])
{
    for (unsigned k = 0; k < SECTIONS; k++) {
        for (int i = 0; i < ROWS * COLUMNS; i++)
            density[k][i] = (float)(0.5 + 0.3 * (k + 1) / SECTIONS *
                                              cos(2 * M_PI * (i % COLUMNS) / 48.0 + angle[k]));
        planes[k] = (struct gsn_sequence_plane){ k, density[k] };
    }
}

static struct gsn_seriation *path_of(const double angle[SECTIONS])
{
    struct gsn_seriation *path = NULL;
    struct gsn_error err = { 0 };

    draw(angle);
    CHECK_OK(gsn_seriation_new(planes, SECTIONS, COLUMNS, ROWS, &path, &err), err);
    return path;
}

/* Steps that are not quite alike, so that their error is known. */
static void angles(double ret_angle[SECTIONS])
{
    ret_angle[0] = 0;
    for (int k = 1; k < SECTIONS; k++)
        ret_angle[k] = ret_angle[k - 1] + 0.04 + 0.01 * (k * k * 3 % 7);
}

/* Rows of four, every second one from the right. */
static void snake_of(size_t ret_order[SECTIONS])
{
    for (size_t k = 0; k < SECTIONS; k++)
        ret_order[k] = k / 4 % 2 ? 4 * (k / 4) + 3 - k % 4 : k;
}

/* However strongly each is stained. */
TEST(two_sections_differ_by_one_less_their_correlation)
{
    double angle[SECTIONS];

    angles(angle);
    gsn_auto(gsn_seriation) path = path_of(angle);

    for (size_t i = 0; i < SECTIONS; i++)
        for (size_t j = 0; j < SECTIONS; j++)
            CHECK_NEAR(gsn_seriation_distance(path, i, j), 1 - cos(angle[i] - angle[j]), 1e-5);
    density[3][17] = NAN; /* one cell of 36 that nobody saw */
    gsn_seriation_free(gsn_steal(&path));
    path = path_of(angle);
    CHECK_NEAR(gsn_seriation_distance(path, 3, 4), 1 - cos(angle[3] - angle[4]), 1e-5);
}

TEST(the_way_in_order_is_shorter_by_what_the_two_orders_do_not_share)
{
    size_t same[SECTIONS], back[SECTIONS], snake[SECTIONS];
    double angle[SECTIONS], mixed[SECTIONS];

    angles(angle);
    snake_of(snake);
    for (size_t k = 0; k < SECTIONS; k++) {
        same[k] = k;
        back[k] = SECTIONS - 1 - k;
        mixed[k] = angle[snake[k]];
    }
    gsn_auto(gsn_seriation) right = path_of(angle);
    gsn_auto(gsn_seriation) wrong = path_of(mixed);

    CHECK(gsn_seriation_gain(right, same) == 0 && gsn_seriation_gain(right, back) == 0);
    /* The snake is its own inverse: what one way gains the other loses. */
    CHECK_NEAR(gsn_seriation_gain(wrong, snake), -gsn_seriation_gain(right, snake),
               1e-3 * gsn_seriation_gain(wrong, snake));
    CHECK(gsn_seriation_gain(wrong, snake) > 6);
}

/* In steps of one angle the differences are closed forms: section i at the place of j meets the
 * neighbours of j. */
TEST(two_exchanged_sections_fit_better_where_the_other_lies)
{
    double angle[SECTIONS], swapped[SECTIONS];

    angles(angle);
    memcpy(swapped, angle, sizeof swapped);
    swapped[3] = angle[7];
    swapped[7] = angle[3];
    gsn_auto(gsn_seriation) right = path_of(angle);
    gsn_auto(gsn_seriation) wrong = path_of(swapped);

    for (size_t i = 0; i < SECTIONS; i++)
        for (size_t j = i + 1; j < SECTIONS; j++) {
            CHECK(gsn_seriation_exchange_gain(right, i, j) <= 0);
            CHECK(gsn_seriation_exchange_gain(wrong, i, j) <=
                  gsn_seriation_exchange_gain(wrong, 3, 7));
        }
    print_message("  %.1f swapped, %.1f in order\n", gsn_seriation_exchange_gain(wrong, 3, 7),
                  gsn_seriation_exchange_gain(right, 3, 7));
    CHECK(gsn_seriation_exchange_gain(wrong, 3, 7) > 0);
    CHECK(gsn_seriation_exchange_gain(right, 3, 7) < -6);
    CHECK(gsn_seriation_exchange_gain(right, 0, 1) == 0);
    CHECK(gsn_seriation_exchange_gain(right, SECTIONS - 2, SECTIONS - 1) == 0);
}

TEST(sections_that_do_not_differ_and_too_few_tell_nothing)
{
    const double still[SECTIONS] = { 0 };
    size_t snake[SECTIONS], other[SECTIONS];
    gsn_auto(gsn_seriation) path = path_of(still);
    gsn_auto(gsn_seriation) few = NULL;
    struct gsn_error err = { 0 };

    snake_of(snake);
    CHECK(fabs(gsn_seriation_gain(path, snake)) < 6);
    for (size_t k = 0; k < SECTIONS - 1; k++)
        other[k] = k == 1 ? 2 : k == 2 ? 1 : k;
    CHECK_OK(gsn_seriation_new(planes, SECTIONS - 1, COLUMNS, ROWS, &few, &err), err);
    CHECK(gsn_seriation_gain(few, other) == 0);
}

static int once(struct gsn_error *err)
{
    gsn_auto(gsn_seriation) path = NULL;

    return gsn_seriation_new(planes, SECTIONS, COLUMNS, ROWS, &path, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    double angle[SECTIONS];

    angles(angle);
    draw(angle);
    CHECK_EVERY_OOM(once(&err), err);
}
