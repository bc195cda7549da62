/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include "pipeline/phantom/warp.h"

enum { SIDE = GSN_PHANTOM_WARP_SIDE };

static struct gsn_phantom_warp draw(uint64_t seed, double rms_um)
{
    const struct gsn_point corner = { 4200, 300 };
    struct gsn_phantom_random random = gsn_phantom_random_make(seed, GSN_PHANTOM_STREAM_WARP, 0, 0);
    struct gsn_phantom_warp warp;

    gsn_phantom_warp_draw(corner, 8000, rms_um, &random, &warp);
    return warp;
}

TEST(the_vectors_have_the_declared_root_mean_square_length)
{
    const struct gsn_phantom_warp warp = draw(1, 10);
    double squares = 0;

    for (int j = 0; j < SIDE; j++)
        for (int i = 0; i < SIDE; i++)
            squares +=
                warp.node[j][i].x * warp.node[j][i].x + warp.node[j][i].y * warp.node[j][i].y;
    CHECK_NEAR(sqrt(squares / (SIDE * SIDE)), 10, 1e-9);
    CHECK_NEAR(warp.pitch_um, 250, 0);
}

/* White noise through a Gaussian of sigma has the correlation exp(-d^2 / (4 sigma^2)); over 400
 * draws the mean product of nodes two apart (500 um) and the mean square give it within 0.02. */
TEST(neighbours_move_alike_as_a_gaussian_of_600_um_demands)
{
    double product = 0, square = 0, edge = 0, middle = 0;

    for (uint64_t seed = 0; seed < 400; seed++) {
        const struct gsn_phantom_warp warp = draw(seed, 1);

        for (int i = 0; i + 2 < SIDE; i++) {
            product += warp.node[16][i].x * warp.node[16][i + 2].x;
            product += warp.node[i][16].y * warp.node[i + 2][16].y;
            square += warp.node[16][i].x * warp.node[16][i].x;
            square += warp.node[i][16].y * warp.node[i][16].y;
        }
        edge += warp.node[0][16].x * warp.node[0][16].x;
        middle += warp.node[16][16].x * warp.node[16][16].x;
    }
    CHECK_NEAR(product / square, exp(-500.0 * 500 / (4 * 600 * 600)), 0.02);
    /* The border is as lively as the middle: each is the mean of 400 squares, 7 % each. */
    CHECK_NEAR(edge / middle, 1, 0.35);
}

TEST(between_nodes_it_is_bilinear_and_outside_the_slot_it_is_held)
{
    const struct gsn_phantom_warp warp = draw(3, 10);
    const struct gsn_point *top = warp.node[7], *low = warp.node[8];
    const struct gsn_point centre = { 4200 + 5.5 * 250, 300 + 7.5 * 250 };
    const struct gsn_point node = { 4200 + 5 * 250, 300 + 7 * 250 }, far = { 0, 99999 };

    CHECK_NEAR(gsn_phantom_warp_at(&warp, node).x, top[5].x, 1e-9);
    CHECK_NEAR(gsn_phantom_warp_at(&warp, node).y, top[5].y, 1e-9);
    CHECK_NEAR(gsn_phantom_warp_at(&warp, centre).x,
               (top[5].x + top[6].x + low[5].x + low[6].x) / 4, 1e-9);
    CHECK_NEAR(gsn_phantom_warp_at(&warp, far).y, warp.node[SIDE - 1][0].y, 1e-9);
}
