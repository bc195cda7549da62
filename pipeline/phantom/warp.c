/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A smooth random displacement: white noise on the nodes and a rim around them, through a separable
 * Gaussian, scaled to the root mean square that is asked for; between nodes bilinear. Failure:
 * none. Cost: 49 x 49 nodes once, four nodes a place. */
#include "pipeline/phantom/warp.h"

#include <math.h>

/* The noise goes on for REACH nodes beyond the slot, so that the border is as lively as the
 * middle: 8 nodes of 250 um are 3.3 sigma. */
enum { SIDE = GSN_PHANTOM_WARP_SIDE, REACH = 8, WIDE = SIDE + 2 * REACH };

static const double SIGMA_UM = 600;

static void make_kernel(double pitch_um, double kernel[2 * REACH + 1])
{
    for (int i = -REACH; i <= REACH; i++) {
        const double t = i * pitch_um / SIGMA_UM;

        kernel[i + REACH] = exp(-t * t / 2);
    }
}

static struct gsn_point weigh_nodes(const struct gsn_point *first, int stride,
                                    const double kernel[2 * REACH + 1])
{
    struct gsn_point sum = { 0 };

    for (int i = 0; i <= 2 * REACH; i++) {
        sum.x += kernel[i] * first[i * stride].x;
        sum.y += kernel[i] * first[i * stride].y;
    }
    return sum;
}

static void scale_warp(struct gsn_phantom_warp *warp, double rms_um)
{
    struct gsn_point *node = &warp->node[0][0];
    double squares = 0, factor;

    for (int i = 0; i < SIDE * SIDE; i++)
        squares += node[i].x * node[i].x + node[i].y * node[i].y;
    factor = rms_um / sqrt(squares / (SIDE * SIDE));
    for (int i = 0; i < SIDE * SIDE; i++) {
        node[i].x *= factor;
        node[i].y *= factor;
    }
}

void gsn_phantom_warp_draw(struct gsn_point corner_um, double side_um, double rms_um,
                           struct gsn_phantom_random *random, struct gsn_phantom_warp *ret_warp)
{
    struct gsn_phantom_warp warp = { .corner_um = corner_um, .pitch_um = side_um / (SIDE - 1) };
    struct gsn_point noise[WIDE][WIDE], rows[WIDE][SIDE];
    double kernel[2 * REACH + 1];

    make_kernel(warp.pitch_um, kernel);
    for (int j = 0; j < WIDE; j++)
        for (int i = 0; i < WIDE; i++) {
            double pair[2];

            gsn_phantom_normals(random, pair);
            noise[j][i] = (struct gsn_point){ pair[0], pair[1] };
        }
    for (int j = 0; j < WIDE; j++)
        for (int i = 0; i < SIDE; i++)
            rows[j][i] = weigh_nodes(&noise[j][i], 1, kernel);
    for (int j = 0; j < SIDE; j++)
        for (int i = 0; i < SIDE; i++)
            warp.node[j][i] = weigh_nodes(&rows[j][i], SIDE, kernel);
    scale_warp(&warp, rms_um);
    *ret_warp = warp;
}

/* Which node lies before a place along one axis, and how far beyond it the place is, 0..1. */
static int find_node(double place, double *ret_beyond)
{
    const double held = fmin(fmax(place, 0), SIDE - 1);
    const int node = (int)fmin(floor(held), SIDE - 2);

    *ret_beyond = held - node;
    return node;
}

struct gsn_point gsn_phantom_warp_at(const struct gsn_phantom_warp *warp, struct gsn_point panel_um)
{
    double u, v;
    const int i = find_node((panel_um.x - warp->corner_um.x) / warp->pitch_um, &u);
    const int j = find_node((panel_um.y - warp->corner_um.y) / warp->pitch_um, &v);
    const struct gsn_point *top = &warp->node[j][i], *low = &warp->node[j + 1][i];
    const struct gsn_point n = {
        (1 - v) * ((1 - u) * top[0].x + u * top[1].x) + v * ((1 - u) * low[0].x + u * low[1].x),
        (1 - v) * ((1 - u) * top[0].y + u * top[1].y) + v * ((1 - u) * low[0].y + u * low[1].y),
    };
    return n;
}
