/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_edge_fit.h"

#include "pipeline/core/linalg.h"
#include "pipeline/core/robust.h"

#include <math.h>
#include <string.h>

enum { SECTORS = GSN_EDGE_SECTORS, RINGS = GSN_EDGE_RINGS, LOOKS = 8 };
enum { CX = GSN_EDGE_CX, CY = GSN_EDGE_CY, R = GSN_EDGE_R };

/* Edges are looked for between these, in starting radii. */
static const double EDGE_FROM = 0.45, EDGE_TO = 1.7;
/* A burn's outline is round to some per cent of its radius. */
static const double LOBE_FIRST = 0.015;
/* Fewer sectors than this share of the rim that agree are no round edge. */
static const double RIM_LEAST = 0.4;
/* An outline's distance from a circle, in radii and at least in pixels, that is still its own. */
static const double ROUGH = 0.06, ROUGH_PX = 0.75, CLOSELY = 0.5;
/* A sector's edge is seen no better than this at a first look, px. */
static const double EDGE_SD_PX = 0.15;

/* ---- the sharpest fall of each sector -------------------------------------------------------- */

/* Where the sector falls most from inside to outside, or NaN: two rings against the next two. */
static double sharpest(const struct gsn_edge_fit *fit, size_t k)
{
    const struct gsn_edge_ring *ring = fit->ring[k];
    const int from = (int)(EDGE_FROM * fit->radius / fit->width);
    const int to = (int)(EDGE_TO * fit->radius / fit->width);
    double pair[RINGS + 1], best = 0, at = NAN, before = 0;

    for (int b = 0; b < RINGS; b++) {
        const double n = ring[b].n + (b + 1 < RINGS ? ring[b + 1].n : 0);

        pair[b] = n > 0 ? (ring[b].sum + (b + 1 < RINGS ? ring[b + 1].sum : 0)) / n : NAN;
    }
    for (int b = from > 2 ? from : 2; b <= to && b < RINGS; b++) {
        const double fall = pair[b - 2] - pair[b];

        if (fall > best) {
            const double after = b + 1 < RINGS ? pair[b - 1] - pair[b + 1] : NAN;
            const double bend = before - 2 * fall + after;

            best = fall;
            at = (b + (bend < 0 ? 0.5 * (before - after) / bend : 0)) * fit->width;
        }
        before = fall;
    }
    return at;
}

/* Standard deviation of a sector's edge as the first look sees it, from how it lies between its
 * neighbours': lobes and cuts hardly show in that. */
static double jitter(const struct gsn_edge_fit *fit)
{
    double off[SECTORS];
    size_t n = 0;

    for (size_t k = 0; k < fit->sectors; k++) {
        const double second = fit->sector[k].edge - 2 * fit->sector[(k + 1) % fit->sectors].edge +
                              fit->sector[(k + 2) % fit->sectors].edge;

        if (isfinite(second))
            off[n++] = fabs(second) / sqrt(6);
    }
    return n > 0 ? 1.4826 * gsn_median(off, n) : 0;
}

/* ---- a circle through the majority ----------------------------------------------------------- */

struct circle {
    double x, y, radius;
};

/* Where the sectors see their edges; NaN: nowhere. */
struct rim {
    size_t count;
    float x[SECTORS], y[SECTORS];
};

static struct rim rim_of(const struct gsn_edge_fit *fit)
{
    struct rim rim = { .count = fit->sectors };

    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_edge_sector *s = &fit->sector[k];

        rim.x[k] = (float)(s->edge * s->cos[1]);
        rim.y[k] = (float)(s->edge * s->sin[1]);
    }
    return rim;
}

static struct circle circle_through(const struct rim *rim, size_t a, size_t b, size_t c)
{
    const double ax = (double)rim->x[a], ay = (double)rim->y[a];
    const double bx = (double)rim->x[b] - ax, by = (double)rim->y[b] - ay;
    const double cx = (double)rim->x[c] - ax, cy = (double)rim->y[c] - ay;
    const double d = 2 * (bx * cy - by * cx);
    const double bb = bx * bx + by * by, cc = cx * cx + cy * cy;
    const double ux = (cy * bb - by * cc) / d, uy = (bx * cc - cx * bb) / d;

    return (struct circle){ ax + ux, ay + uy, sqrt(ux * ux + uy * uy) };
}

/* How far a sector's edge lies outside of a circle. */
static double beside(const struct gsn_edge_sector *s, const struct circle *circle)
{
    const double x = s->edge * s->cos[1] - circle->x, y = s->edge * s->sin[1] - circle->y;

    return sqrt(x * x + y * y) - circle->radius;
}

/* Sum of squared distances, none counting for more than one beyond tolerance. */
static float misfit(const struct rim *rim, const struct circle *circle, double tolerance)
{
    const float x0 = (float)circle->x, y0 = (float)circle->y, radius = (float)circle->radius;
    const float per_tolerance = (float)(1 / tolerance);
    float sum = 0;

    for (size_t k = 0; k < rim->count; k++) {
        const float x = rim->x[k] - x0, y = rim->y[k] - y0;
        const float off = (sqrtf(x * x + y * y) - radius) * per_tolerance;
        const float square = off * off;

        sum += square < 1 ? square : 1; /* NaN counts as one */
    }
    return sum;
}

static int possible(const struct gsn_edge_fit *fit, const struct circle *circle)
{
    return circle->x * circle->x + circle->y * circle->y <= fit->radius * fit->radius &&
           circle->radius >= EDGE_FROM * fit->radius && circle->radius <= EDGE_TO * fit->radius;
}

/* The circle that most sectors agree on, out of those through three of them a third, a quarter or a
 * sixth of a turn apart: one of these lies in what is whole of a mark that has lost an arc. What it
 * leaves, in sectors, goes to *ret_misfit; infinite when there is none. */
static struct circle majority(const struct gsn_edge_fit *fit, double tolerance, float *ret_misfit)
{
    const size_t n = fit->sectors, apart[3] = { n / 3, n / 4, n / 6 };
    const struct rim rim = rim_of(fit);
    struct circle best = { 0 };

    *ret_misfit = INFINITY;
    for (size_t k = 0; k < 3 * n; k++) {
        const struct circle circle =
            circle_through(&rim, k % n, (k + apart[k / n]) % n, (k + 2 * apart[k / n]) % n);
        float sum;

        if (!possible(fit, &circle))
            continue;
        sum = misfit(&rim, &circle, tolerance);
        if (sum < *ret_misfit) {
            *ret_misfit = sum;
            best = circle;
        }
    }
    return best;
}

/* A round mark that has lost an arc looks nearly as much like a smaller one that has lost nothing
 * and is ragged; so a circle that enough of the rim follows closely goes first. */
static int find_circle(struct gsn_edge_fit *fit)
{
    const float most = (float)((1 - RIM_LEAST) * (double)fit->sectors);
    float left;
    struct circle circle = majority(fit, fit->tolerance * CLOSELY, &left);

    if (left > most)
        circle = majority(fit, fit->tolerance, &left);
    if (!(left < most))
        return 0;
    fit->v[CX] = circle.x;
    fit->v[CY] = circle.y;
    fit->v[R] = circle.radius;
    return 1;
}

/* ---- the outline ----------------------------------------------------------------------------- */

/* Moves the origin to the circle just found, so that sectors are sectors of it. */
static void centre(struct gsn_edge_fit *fit)
{
    const float x = (float)fit->v[CX], y = (float)fit->v[CY];

    for (size_t i = 0; i < fit->count; i++) {
        fit->x[i] -= x;
        fit->y[i] -= y;
    }
    for (size_t k = 0; k < fit->sectors; k++) {
        struct gsn_edge_sector *s = &fit->sector[k];
        const double to_x = fit->v[R] * s->cos[1] + fit->v[CX];
        const double to_y = fit->v[R] * s->sin[1] + fit->v[CY];

        s->edge += fit->v[R] - sqrt(to_x * to_x + to_y * to_y);
    }
    fit->at_x += (double)x;
    fit->at_y += (double)y;
    fit->radius = fit->v[R];
    fit->v[CX] = fit->v[CY] = 0;
}

/* How far a sector's edge lies outside of the outline. */
static double off_outline(const struct gsn_edge_fit *fit, const struct gsn_edge_sector *s)
{
    const struct circle circle = { fit->v[CX], fit->v[CY], fit->v[R] };

    return beside(s, &circle) - gsn_edge_outline(fit, s) + fit->v[R];
}

/* Bends the circle of the majority to the edges that lie beside it, and to those that then do. */
static void bend(struct gsn_edge_fit *fit)
{
    enum { SHAPE = GSN_EDGE_SHAPE };
    const double belief = 1 / pow(LOBE_FIRST * fit->radius, 2);
    const double precision = 1 / pow(fmax(jitter(fit), EDGE_SD_PX), 2);
    const int fitted = 2 * fit->lobes + 1;

    for (int round = 0; round < LOOKS; round++) {
        double h[SHAPE][SHAPE] = { { 0 } }, by[SHAPE] = { 0 };

        for (int i = 0; i < SHAPE; i++)
            h[i][i] = i < 3 ? 1e-9 : i < fitted ? belief : 1;
        for (int i = 3; i < fitted; i++)
            by[i] = -belief * fit->v[i];
        for (size_t k = 0; k < fit->sectors; k++) {
            const double off = off_outline(fit, &fit->sector[k]);
            double slope[GSN_EDGE_UNKNOWNS];

            if (!(fabs(off) < fit->tolerance))
                continue;
            gsn_edge_slopes(fit, &fit->sector[k], slope);
            for (int i = 0; i < fitted; i++) {
                by[i] += precision * off * slope[i];
                for (int j = 0; j <= i; j++)
                    h[i][j] += precision * slope[i] * slope[j];
            }
        }
        if (gsn_solve_spd(&h[0][0], SHAPE, SHAPE, by) < 0)
            return;
        for (int i = 0; i < fitted; i++)
            fit->v[i] += by[i];
    }
}

void gsn_edge_gate(struct gsn_edge_fit *fit)
{
    const size_t n = fit->sectors;
    int off[SECTORS];

    /* What moved an edge does not end at the sector's border. A fit that sees only an edge's foot
     * takes it for nearer, so the first look is asked as well. */
    for (size_t k = 0; k < n; k++) {
        const struct gsn_edge_sector *s = &fit->sector[k];

        off[k] = !(fabs(off_outline(fit, s)) < fit->tolerance) &&
                 !(fabs(s->off) < 3 * sqrt(s->variance));
    }
    for (size_t k = 0; k < n; k++)
        if (off[k] || off[(k + 1) % n] || off[(k + n - 1) % n])
            fit->sector[k].weight = 0;
}

static void set_angles(struct gsn_edge_fit *fit)
{
    for (size_t k = 0; k < fit->sectors; k++) {
        struct gsn_edge_sector *s = &fit->sector[k];
        const double angle = 2 * M_PI * ((double)k + 0.5) / (double)fit->sectors;

        s->cos[0] = 1;
        s->cos[1] = cos(angle);
        s->sin[1] = sin(angle);
        for (int m = 2; m <= GSN_EDGE_LOBES; m++) {
            s->cos[m] = s->cos[m - 1] * s->cos[1] - s->sin[m - 1] * s->sin[1];
            s->sin[m] = s->sin[m - 1] * s->cos[1] + s->cos[m - 1] * s->sin[1];
        }
    }
}

/* Twice, since a look from beside the centre sees some edges aslant. */
int gsn_edge_look(struct gsn_edge_fit *fit)
{
    set_angles(fit);
    for (int i = 0; i < 2; i++) {
        gsn_edge_fill_rings(fit);
        for (size_t k = 0; k < fit->sectors; k++)
            fit->sector[k].edge = sharpest(fit, k);
        fit->tolerance = fmax(fmax(ROUGH * fit->radius, ROUGH_PX), 5 * jitter(fit));
        if (!find_circle(fit))
            return 0;
        centre(fit);
    }
    gsn_edge_sort(fit);
    fit->lobes = fit->radius >= 8 ? GSN_EDGE_LOBES : fit->radius >= 5 ? 2 : 1;
    for (size_t k = 0; k < fit->sectors; k++)
        fit->sector[k].weight = 1;
    bend(fit);
    gsn_edge_gate(fit);
    return 1;
}
