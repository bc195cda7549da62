/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Bubbles: air under the coverslip bends the light away along its rim, which shows as a dark
 * neutral ring. Every steep place of the dark dye points at the centre of the ring that it may
 * belong to; where many point to one place, the ring itself is looked for around it.
 *
 *   1. Hough votes of steep places, for radii of 250 to 1400 um (Kimme, Ballard and Sklansky 1975).
 *   2. Around the twelve best bins the ring that is seen along most of its way.
 *   3. A ring that is seen along more than 70 % of it, of at least 40 % inside the box, is a
 *      bubble.
 *
 * A rim that shows as no dark ring, as in thin mountant, is not found. */
#include "pipeline/core/mem.h"
#include "pipeline/imaging/filter.h"
#include "pipeline/stain/artefact/cells.h"

#include <math.h>
#include <string.h>

enum {
    BIN = 2, /* cells per bin of the vote, per axis */
    DIRECTIONS = 72,
    TRIES = 12, /* centres looked at */
    WANDER = 4, /* cells that a centre is moved by, to find the best one */
};

#define LEAST_RADIUS_UM 250.0
#define MOST_RADIUS_UM 1400.0

/* Half of the width of a rim, with its blur. */
#define RIM_UM 100.0

/* A rim is darker than both sides of it by this much, dark dye. */
#define RIM_OD 0.12

/* Rise of the dark dye over two cells that makes a vote. */
#define STEEP 0.04

/* A ring is seen along more than this share of its way, and not along a smaller share of it by
 * chance: the rest may lie beneath a fold or outside of the box. */
#define SEEN 0.7
#define LEAST_IN_BOX 0.4

struct ring {
    double x, y, radius; /* cells */
    double seen;         /* share of the directions that show a rim */
};

/* Unit vectors all around. */
struct compass {
    double c[DIRECTIONS], s[DIRECTIONS];
};

static struct compass all_around(void)
{
    struct compass compass;

    for (int i = 0; i < DIRECTIONS; i++) {
        compass.c[i] = cos(2 * M_PI * i / DIRECTIONS);
        compass.s[i] = sin(2 * M_PI * i / DIRECTIONS);
    }
    return compass;
}

static float value_at(const struct gsn_plane *plane, double x, double y)
{
    const long u = (long)floor(x + 0.5), v = (long)floor(y + 0.5);

    if (u < 0 || v < 0 || u >= (long)plane->width || v >= (long)plane->height)
        return NAN;
    return plane->value[(size_t)v * plane->width + (size_t)u];
}

/* How well a rim shows at this radius: the share of the directions inside the box. What cannot
 * become more than `least` any more is 0. */
static double rate_ring(const struct gsn_artefact_cells *cells, const struct gsn_plane *dark,
                        const struct compass *compass, const struct ring *ring, double least)
{
    const double rim = RIM_UM / cells->um;
    int inside = 0, shows = 0;

    for (int i = 0; i < DIRECTIONS; i++) {
        const double c = compass->c[i], s = compass->s[i];
        const double u = ring->x + ring->radius * c, v = ring->y + ring->radius * s;
        const int left = DIRECTIONS - i;
        float here, in, out;

        if (shows + left <= least * (inside + left))
            return 0;
        if (u < cells->rim || v < cells->rim || u >= cells->nx - (double)cells->rim ||
            v >= cells->ny - (double)cells->rim)
            continue;
        here = value_at(dark, u, v);
        in = value_at(dark, u - rim * c, v - rim * s);
        out = value_at(dark, u + rim * c, v + rim * s);
        if (isnan(here) || isnan(in) || isnan(out))
            continue;
        inside++;
        shows += here - in > RIM_OD && here - out > RIM_OD;
    }
    return inside >= LEAST_IN_BOX * DIRECTIONS ? (double)shows / inside : 0;
}

/* The best ring around a place, of those that are seen well enough. */
static struct ring best_ring(const struct gsn_artefact_cells *cells, const struct gsn_plane *dark,
                             const struct compass *compass, double x, double y)
{
    struct ring best = { .seen = SEEN };

    for (int v = -WANDER; v <= WANDER; v += 2)
        for (int u = -WANDER; u <= WANDER; u += 2)
            for (double r = LEAST_RADIUS_UM / cells->um; r <= MOST_RADIUS_UM / cells->um; r++) {
                struct ring ring = { .x = x + u, .y = y + v, .radius = r };

                ring.seen = rate_ring(cells, dark, compass, &ring, best.seen);
                if (ring.seen > best.seen)
                    best = ring;
            }
    return best;
}

static void add_vote(const struct gsn_artefact_cells *cells, double x, double y, uint32_t *votes)
{
    if (x >= 0 && y >= 0 && x < cells->nx && y < cells->ny)
        votes[(size_t)(y / BIN) * (cells->nx / BIN + 1) + (size_t)(x / BIN)]++;
}

/* dx, dy: differences of the dark dye over two cells. */
static void cast_votes(const struct gsn_artefact_cells *cells, const float *dx, const float *dy,
                       uint32_t *votes)
{
    const double least = LEAST_RADIUS_UM / cells->um, most = MOST_RADIUS_UM / cells->um;

    for (uint32_t y = 1; y + 1 < cells->ny; y++)
        for (uint32_t x = 1; x + 1 < cells->nx; x++) {
            const size_t i = (size_t)y * cells->nx + x;
            const double gx = dx[i], gy = dy[i];
            const double g = sqrt(gx * gx + gy * gy);

            if (g < STEEP || cells->label[i])
                continue;
            for (double r = least; r <= most; r += BIN) {
                add_vote(cells, x + r * gx / g, y + r * gy / g, votes);
                add_vote(cells, x - r * gx / g, y - r * gy / g, votes);
            }
        }
}

/* The bin with the most votes, which is then left out together with those around it. */
static size_t take_best(uint32_t *votes, size_t nx, size_t ny)
{
    size_t best = 0;

    for (size_t i = 0; i < nx * ny; i++)
        if (votes[i] > votes[best])
            best = i;
    for (size_t v = best / nx > 2 ? best / nx - 2 : 0; v <= best / nx + 2 && v < ny; v++)
        for (size_t u = best % nx > 2 ? best % nx - 2 : 0; u <= best % nx + 2 && u < nx; u++)
            votes[v * nx + u] = 0;
    return best;
}

static void add_disc(const struct gsn_artefact_cells *cells, const struct ring *ring, uint8_t *set)
{
    const double radius = ring->radius + RIM_UM / cells->um;

    for (uint32_t y = 0; y < cells->ny; y++)
        for (uint32_t x = 0; x < cells->nx; x++)
            if (hypot(x - ring->x, y - ring->y) <= radius)
                set[(size_t)y * cells->nx + x] = 1;
}

int gsn_artefact_bubbles(struct gsn_artefact_cells *cells, struct gsn_error *err)
{
    const size_t nx = cells->nx / BIN + 1, ny = cells->ny / BIN + 1;
    const struct compass compass = all_around();
    gsn_auto(gsn_plane) dark = NULL;
    gsn_auto_mem(uint32_t) votes = gsn_alloc_array(nx * ny, sizeof *votes);
    gsn_auto_mem(uint8_t) set = gsn_alloc_array((size_t)cells->nx * cells->ny, 1);
    gsn_auto_mem(float) slope = gsn_alloc_array(2 * (size_t)cells->nx * cells->ny, sizeof *slope);
    float *const dy = slope ? slope + (size_t)cells->nx * cells->ny : NULL;
    int r;

    if (!votes || !set || !slope)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = gsn_box_mean(cells->dark, 1, &dark, err);
    if (r < 0)
        return r;
    r = gsn_differences(dark->value, cells->nx, cells->ny, 1, slope, dy, err);
    if (r < 0)
        return r;
    cast_votes(cells, slope, dy, votes);
    for (int i = 0; i < TRIES; i++) {
        const size_t best = take_best(votes, nx, ny);
        const struct ring ring = best_ring(cells, dark, &compass, ((double)(best % nx) + 0.5) * BIN,
                                           ((double)(best / nx) + 0.5) * BIN);

        if (ring.seen > SEEN)
            add_disc(cells, &ring, set);
    }
    gsn_artefact_cells_mark(cells, set, GSN_DEFECT_BUBBLE);
    return GSN_OK;
}
