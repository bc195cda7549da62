/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/fiducial/wavelet.h"

#include "tests/check.h"
#include "tests/register/draw.h"

#include <string.h>

enum { WIDTH = 83, HEIGHT = 71, CELLS = WIDTH * HEIGHT };

static float cells[CELLS];

static void fill_with_noise(void)
{
    struct draw_chance chance = { 3 };

    for (size_t i = 0; i < CELLS; i++)
        cells[i] = (float)draw_uniform(&chance, 0, 1);
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

/* The largest difference of a wavelet's rows from blurs of whole planes. */
static double worst_of(size_t scales)
{
    static double level[GSN_WAVELET_LEVELS + 1][CELLS];
    struct gsn_wavelet wavelet;
    struct gsn_error err = { 0 };
    double worst = 0;

    for (size_t i = 0; i < CELLS; i++)
        level[0][i] = (double)cells[i];
    for (size_t k = 0; k <= scales; k++)
        blur(level[k], 1 << k, level[k + 1]);
    CHECK_OK(gsn_wavelet_init(&wavelet, cells, WIDTH, HEIGHT, scales, &err), err);
    for (size_t y = 1; y + 1 < HEIGHT; y++) {
        gsn_wavelet_advance(&wavelet, y);
        for (size_t i = 0; i < 3 * scales * WIDTH; i++) {
            const size_t scale = i / (3 * WIDTH), row = y - 1 + i / WIDTH % 3, x = i % WIDTH;
            const double near = level[scale + 1][row * WIDTH + x];
            const double far = level[scale + 2][row * WIDTH + x];

            worst = fmax(worst, fabs(gsn_wavelet_level(&wavelet, scale, row)[x] - near));
            worst = fmax(worst, fabs(gsn_wavelet_level(&wavelet, scale + 1, row)[x] - far));
            worst = fmax(worst, fabs(gsn_wavelet_detail(&wavelet, scale, row)[x] - (near - far)));
        }
    }
    gsn_wavelet_done(&wavelet);
    return worst;
}

TEST(rows_at_hand_are_those_of_blurred_planes)
{
    fill_with_noise();
    for (size_t scales = 1; scales <= GSN_WAVELET_SCALES; scales++)
        CHECK(worst_of(scales) < 1e-6);
}

TEST(each_level_blurs_by_the_variance_it_states)
{
    struct gsn_wavelet wavelet;
    struct gsn_error err = { 0 };
    double sum[GSN_WAVELET_LEVELS] = { 0 }, squares[GSN_WAVELET_LEVELS] = { 0 };

    memset(cells, 0, sizeof cells);
    cells[HEIGHT / 2 * WIDTH + WIDTH / 2] = 1;
    CHECK_OK(gsn_wavelet_init(&wavelet, cells, WIDTH, HEIGHT, GSN_WAVELET_SCALES, &err), err);
    for (size_t y = 1; y + 1 < HEIGHT; y++) {
        gsn_wavelet_advance(&wavelet, y);
        for (size_t i = 0; i < GSN_WAVELET_LEVELS * WIDTH; i++) {
            const double w = gsn_wavelet_level(&wavelet, i / WIDTH, y)[i % WIDTH];

            sum[i / WIDTH] += w;
            squares[i / WIDTH] += w * pow((double)(i % WIDTH) - WIDTH / 2, 2);
        }
    }
    gsn_wavelet_done(&wavelet);
    for (size_t k = 0; k < GSN_WAVELET_LEVELS; k++) {
        CHECK_NEAR(sum[k], 1, 1e-5);
        CHECK_NEAR(squares[k] / sum[k], gsn_wavelet_variance[k], 1e-3);
    }
}

TEST(a_picture_of_one_cell_has_that_cell_in_every_level)
{
    float cell = 0.7f;
    struct gsn_wavelet wavelet;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_wavelet_init(&wavelet, &cell, 1, 1, GSN_WAVELET_SCALES, &err), err);
    gsn_wavelet_advance(&wavelet, 0);
    for (size_t k = 0; k < GSN_WAVELET_LEVELS; k++)
        CHECK_NEAR(gsn_wavelet_level(&wavelet, k, 0)[0], 0.7, 1e-6);
    gsn_wavelet_done(&wavelet);
}

static int transform_once(struct gsn_error *err)
{
    struct gsn_wavelet wavelet;
    const int r = gsn_wavelet_init(&wavelet, cells, WIDTH, HEIGHT, 2, err);

    if (r >= 0)
        gsn_wavelet_done(&wavelet);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(transform_once(&err), err);
}
