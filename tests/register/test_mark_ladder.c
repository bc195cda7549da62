/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_ladder.h"

#include "tests/check.h"
#include "tests/register/draw.h"

#include <string.h>

enum { WIDTH = 83, HEIGHT = 71, CELLS = WIDTH * HEIGHT };

static float cells[CELLS];

static struct gsn_mark_field noisy_field(void)
{
    struct draw_chance chance = { 3 };

    for (size_t i = 0; i < CELLS; i++)
        cells[i] = (float)draw_uniform(&chance, 0, 1);
    return (struct gsn_mark_field){ .width = WIDTH, .height = HEIGHT, .cell_px = 5, .od = cells };
}

static int within(int at, int count)
{
    return at < 0 ? 0 : at < count ? at : count - 1;
}

/* Blurs a whole plane in double precision, both directions at once. */
static void blur(const double *from, int apart, double *onto)
{
    static const double KERNEL[5] = { 1 / 16., 4 / 16., 6 / 16., 4 / 16., 1 / 16. };

    for (int at = 0; at < CELLS; at++) {
        onto[at] = 0;
        for (int k = 0; k < 25; k++)
            onto[at] += KERNEL[k / 5] * KERNEL[k % 5] *
                        from[within(at / WIDTH + (k / 5 - 2) * apart, HEIGHT) * WIDTH +
                             within(at % WIDTH + (k % 5 - 2) * apart, WIDTH)];
    }
}

/* The largest difference of a ladder's rows from blurs of whole planes. */
static double worst_of(const struct gsn_mark_field *field, size_t rungs)
{
    static double level[GSN_LADDER_LEVELS + 1][CELLS];
    struct gsn_mark_ladder ladder;
    struct gsn_error err = { 0 };
    double worst = 0;

    for (size_t i = 0; i < CELLS; i++)
        level[0][i] = (double)cells[i];
    for (size_t k = 0; k <= rungs; k++)
        blur(level[k], 1 << k, level[k + 1]);
    CHECK_OK(gsn_mark_ladder_init(&ladder, field, rungs, &err), err);
    for (size_t y = 1; y + 1 < HEIGHT; y++) {
        gsn_mark_ladder_climb(&ladder, y);
        for (size_t i = 0; i < 3 * rungs * WIDTH; i++) {
            const size_t rung = i / (3 * WIDTH), row = y - 1 + i / WIDTH % 3, x = i % WIDTH;
            const double near = level[rung + 1][row * WIDTH + x];
            const double far = level[rung + 2][row * WIDTH + x];

            worst = fmax(worst, fabs(gsn_mark_ladder_level(&ladder, rung, row)[x] - near));
            worst = fmax(worst, fabs(gsn_mark_ladder_level(&ladder, rung + 1, row)[x] - far));
            worst = fmax(worst, fabs(gsn_mark_ladder_rung(&ladder, rung, row)[x] - (near - far)));
        }
    }
    gsn_mark_ladder_done(&ladder);
    return worst;
}

TEST(rows_at_hand_are_those_of_blurred_planes)
{
    const struct gsn_mark_field field = noisy_field();

    for (size_t rungs = 1; rungs <= GSN_LADDER_RUNGS; rungs++)
        CHECK(worst_of(&field, rungs) < 1e-6);
}

TEST(each_level_blurs_by_the_variance_it_states)
{
    struct gsn_mark_field field = noisy_field();
    struct gsn_mark_ladder ladder;
    struct gsn_error err = { 0 };
    double sum[GSN_LADDER_LEVELS] = { 0 }, squares[GSN_LADDER_LEVELS] = { 0 };

    memset(cells, 0, sizeof cells);
    cells[HEIGHT / 2 * WIDTH + WIDTH / 2] = 1;
    CHECK_OK(gsn_mark_ladder_init(&ladder, &field, GSN_LADDER_RUNGS, &err), err);
    for (size_t y = 1; y + 1 < HEIGHT; y++) {
        gsn_mark_ladder_climb(&ladder, y);
        for (size_t i = 0; i < GSN_LADDER_LEVELS * WIDTH; i++) {
            const double w = gsn_mark_ladder_level(&ladder, i / WIDTH, y)[i % WIDTH];

            sum[i / WIDTH] += w;
            squares[i / WIDTH] += w * pow((double)(i % WIDTH) - WIDTH / 2, 2);
        }
    }
    gsn_mark_ladder_done(&ladder);
    for (size_t k = 0; k < GSN_LADDER_LEVELS; k++) {
        CHECK_NEAR(sum[k], 1, 1e-5);
        CHECK_NEAR(squares[k] / sum[k], gsn_ladder_variance[k], 1e-3);
    }
}

TEST(a_picture_of_one_cell_has_that_cell_in_every_level)
{
    float cell = 0.7f;
    const struct gsn_mark_field field = { .width = 1, .height = 1, .cell_px = 5, .od = &cell };
    struct gsn_mark_ladder ladder;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_mark_ladder_init(&ladder, &field, GSN_LADDER_RUNGS, &err), err);
    gsn_mark_ladder_climb(&ladder, 0);
    for (size_t k = 0; k < GSN_LADDER_LEVELS; k++)
        CHECK_NEAR(gsn_mark_ladder_level(&ladder, k, 0)[0], 0.7, 1e-6);
    gsn_mark_ladder_done(&ladder);
}

TEST(every_instruction_set_gives_the_same_bits)
{
    const struct gsn_mark_field field = noisy_field();
    const float *const rows[5] = { cells + 1, cells + 2 * WIDTH, cells + 3 * WIDTH + 1,
                                   cells + 5 * WIDTH + 2, cells + 9 * WIDTH + 1 };

    /* In steps, so that neighbours are alike at times. */
    for (size_t i = 0; i < CELLS; i++)
        cells[i] = roundf(8 * cells[i]) / 8;
    for (int isa = 0; isa < GSN_MARK_ROWS_ISAS; isa++) {
        const struct gsn_mark_rows *run = gsn_mark_rows_for((enum gsn_mark_rows_isa)isa);
        float onto[2 * WIDTH] = { 0 };
        uint8_t peak[WIDTH] = { 0 };

        if (!run)
            continue;
        run->blend(rows, WIDTH - 3, onto);
        run->less(rows[0], rows[1], WIDTH - 3, onto + WIDTH);
        run->peaks(rows + 1, WIDTH - 3, 0.5f, peak);
        for (size_t x = 0; x < WIDTH - 3; x++) {
            const float ends = rows[0][x] + rows[4][x], sides = rows[1][x] + rows[3][x];
            const float own = rows[2][x];

            CHECK(onto[x] == 0.0625f * ends + 0.25f * sides + 0.375f * own);
            CHECK(onto[WIDTH + x] == rows[0][x] - rows[1][x]);
            CHECK(peak[x] == (own >= 0.5f && own >= rows[1][x] && own >= rows[3][x] &&
                              own >= rows[2][x - 1] && own >= rows[2][x + 1]));
        }
    }
    CHECK(field.width == WIDTH && gsn_mark_rows_best() != NULL);
}

static int climb_once(struct gsn_error *err)
{
    const struct gsn_mark_field field = noisy_field();
    struct gsn_mark_ladder ladder;
    const int r = gsn_mark_ladder_init(&ladder, &field, 2, err);

    if (r >= 0)
        gsn_mark_ladder_done(&ladder);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(climb_once(&err), err);
}
