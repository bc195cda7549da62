/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: the initial estimate of contour.c: polar resampling, the steepest edge of every sector, a
 * circle by consensus (as RANSAC, Fischler and Bolles 1981, with truncated squared residuals, MSAC,
 * Torr and Zisserman 2000; its samples are fixed, so that the same picture gives the same circle),
 * then its Fourier descriptor by least squares over the sectors that lie near.
 *
 * Steps of gsn_contour_estimate(). 1. Pixels are sorted into sectors and rings about the origin. 2.
 * Each sector's steepest fall from inside to outside. 3. The circle through three sectors, a third,
 * a quarter or a sixth of a turn apart, that most sectors agree on. 4. The origin moves to its
 * centre, and all of that once more, since an edge is seen aslant from beside the centre. 5. The
 * outline is bent to the edges beside it. 6. The gate: sectors off the outline, and their
 * neighbours, are silenced.
 *
 * Finds nothing where too few sectors agree. Cost: a pass over the pixels, twice, and 150 circles
 * over at most 48 sectors. */
#include "pipeline/register/fiducial/contour_internal.h"

#include "pipeline/core/linalg.h"
#include "pipeline/core/robust.h"

#include <math.h>
#include <string.h>

enum { LOOKS = 8 };
/* Edges are looked for between these, in starting radii. */
static const double EDGE_FROM = 0.45, EDGE_TO = 1.7;

/* An outline's distance from a circle, in radii and at least in pixels, that is still its own. */
static const double ROUGH = 0.06, ROUGH_PX = 0.75, CLOSELY = 0.5;

/* A sector's edge is seen no better than this at a first look, px. */
static const double EDGE_SD_PX = 0.15;

/* ---- pixels by sectors and rings ------------------------------------------------------------- */

/* atan2 in turns, 0..1, to 1e-4 of a turn: enough to sort pixels into sectors. */
static inline float turn_of(float y, float x)
{
    const float ax = fabsf(x), ay = fabsf(y);
    const float z = (ax < ay ? ax : ay) / ((ax > ay ? ax : ay) + 1e-12f), zz = z * z;
    float a = z * (0.1591549f - zz * (0.0530516f - zz * (0.0286f - zz * 0.0097f)));

    a = ay > ax ? 0.25f - a : a;
    a = x < 0 ? 0.5f - a : a;
    return y < 0 ? 1 - a : a;
}

/* The cell of every pixel, sectors x RINGS for those beyond the last ring. */
static void find_cells(struct gsn_contour *fit)
{
    const float *restrict x = fit->x, *restrict y = fit->y;
    int *restrict cell = fit->cell;
    const float per_ring = (float)(1 / fit->width), per_sector = (float)fit->sectors;
    const int sectors = (int)fit->sectors;

    for (size_t i = 0; i < fit->count; i++) {
        const int ring = (int)(sqrtf(x[i] * x[i] + y[i] * y[i]) * per_ring);
        int sector = (int)(turn_of(y[i], x[i]) * per_sector);

        sector = sector < sectors ? sector : 0;
        cell[i] = ring < RINGS ? sector * RINGS + ring : sectors * RINGS;
    }
}

/* Sums the pixels of every cell; those beyond the last ring take no part. */
static void fill_rings(struct gsn_contour *fit)
{
    struct gsn_contour_ring *ring = &fit->ring[0][0];
    const int none = (int)fit->sectors * RINGS;

    fit->width = fmax(REACH * fit->radius / (RINGS - 1), 1);
    find_cells(fit);
    memset(fit->ring, 0, fit->sectors * sizeof fit->ring[0]);
    for (size_t i = 0; i < fit->count; i++) {
        struct gsn_contour_ring *to = &ring[fit->cell[i]];
        const double value = (double)fit->value[i];

        if (fit->cell[i] == none)
            continue;
        to->n += 1;
        to->sum += value;
        to->squares += value * value;
    }
}

/* Sorts the pixels by their cells. The origin stays from now on. */
static void sort_pixels(struct gsn_contour *fit)
{
    const size_t cells = fit->sectors * RINGS;
    const struct gsn_contour_ring *ring = &fit->ring[0][0];
    unsigned next[SECTORS * RINGS];

    fill_rings(fit);
    fit->first[0] = 0;
    for (size_t c = 0; c < cells; c++) {
        next[c] = fit->first[c];
        fit->first[c + 1] = fit->first[c] + (unsigned)ring[c].n;
    }
    for (size_t i = 0; i < fit->count; i++) {
        unsigned at;

        if ((size_t)fit->cell[i] == cells)
            continue;
        at = next[fit->cell[i]]++;
        fit->by_x[at] = fit->x[i];
        fit->by_y[at] = fit->y[i];
        fit->by_value[at] = fit->value[i];
    }
}

/* ---- the sharpest fall of each sector -------------------------------------------------------- */

/* Where the sector falls most from inside to outside, or NaN: two rings against the next two. */
static double steepest_fall(const struct gsn_contour *fit, size_t k)
{
    const struct gsn_contour_ring *ring = fit->ring[k];
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
static double find_jitter(const struct gsn_contour *fit)
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

static struct rim find_rim(const struct gsn_contour *fit)
{
    struct rim rim = { .count = fit->sectors };

    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_contour_sector *s = &fit->sector[k];

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
static double distance_outside(const struct gsn_contour_sector *s, const struct circle *circle)
{
    const double x = s->edge * s->cos[1] - circle->x, y = s->edge * s->sin[1] - circle->y;

    return sqrt(x * x + y * y) - circle->radius;
}

/* Sum of squared distances, none counting for more than one beyond tolerance. */
static float find_misfit(const struct rim *rim, const struct circle *circle, double tolerance)
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

static int is_possible(const struct gsn_contour *fit, const struct circle *circle)
{
    return circle->x * circle->x + circle->y * circle->y <= fit->radius * fit->radius &&
           circle->radius >= EDGE_FROM * fit->radius && circle->radius <= EDGE_TO * fit->radius;
}

/* The circle that most sectors agree on, out of those through three of them a third, a quarter or a
 * sixth of a turn apart: one of these lies in what is whole of a mark that has lost an arc. What it
 * leaves, in sectors, goes to *ret_misfit; infinite when there is none. */
static struct circle find_consensus(const struct gsn_contour *fit, double tolerance,
                                    float *ret_misfit)
{
    const size_t n = fit->sectors, apart[3] = { n / 3, n / 4, n / 6 };
    const struct rim rim = find_rim(fit);
    struct circle best = { 0 };

    *ret_misfit = INFINITY;
    for (size_t k = 0; k < 3 * n; k++) {
        const struct circle circle =
            circle_through(&rim, k % n, (k + apart[k / n]) % n, (k + 2 * apart[k / n]) % n);
        float sum;

        if (!is_possible(fit, &circle))
            continue;
        sum = find_misfit(&rim, &circle, tolerance);
        if (sum < *ret_misfit) {
            *ret_misfit = sum;
            best = circle;
        }
    }
    return best;
}

/* A round mark that has lost an arc looks nearly as much like a smaller one that has lost nothing
 * and is ragged; so a circle that enough of the rim follows closely goes first. */
static int find_circle(struct gsn_contour *fit)
{
    const float most = (float)((1 - RIM_MIN) * (double)fit->sectors);
    float left;
    struct circle circle = find_consensus(fit, fit->tolerance * CLOSELY, &left);

    if (left > most)
        circle = find_consensus(fit, fit->tolerance, &left);
    if (!(left < most))
        return 0;
    fit->v[CX] = circle.x;
    fit->v[CY] = circle.y;
    fit->v[R] = circle.radius;
    return 1;
}

/* ---- the outline ----------------------------------------------------------------------------- */

double gsn_contour_radius(const struct gsn_contour *fit, const struct gsn_contour_sector *sector)
{
    double r = fit->v[R];

    for (int m = 2; m <= fit->lobes; m++)
        r += fit->v[2 * m - 1] * sector->cos[m] + fit->v[2 * m] * sector->sin[m];
    return r;
}

void gsn_contour_slopes(const struct gsn_contour *fit, const struct gsn_contour_sector *sector,
                        double ret_slope[UNKNOWNS])
{
    memset(ret_slope, 0, UNKNOWNS * sizeof *ret_slope);
    ret_slope[CX] = ret_slope[V_BX] = sector->cos[1];
    ret_slope[CY] = ret_slope[V_BY] = sector->sin[1];
    ret_slope[R] = ret_slope[V_BLUR] = ret_slope[V_DISC] = ret_slope[V_B0] = 1;
    for (int m = 2; m <= fit->lobes; m++) {
        ret_slope[2 * m - 1] = sector->cos[m];
        ret_slope[2 * m] = sector->sin[m];
    }
}

/* Moves the origin to the circle just found, so that sectors are sectors of it. */
static void move_origin(struct gsn_contour *fit)
{
    const float x = (float)fit->v[CX], y = (float)fit->v[CY];

    for (size_t i = 0; i < fit->count; i++) {
        fit->x[i] -= x;
        fit->y[i] -= y;
    }
    for (size_t k = 0; k < fit->sectors; k++) {
        struct gsn_contour_sector *s = &fit->sector[k];
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
static double distance_off(const struct gsn_contour *fit, const struct gsn_contour_sector *s)
{
    const struct circle circle = { fit->v[CX], fit->v[CY], fit->v[R] };

    return distance_outside(s, &circle) - gsn_contour_radius(fit, s) + fit->v[R];
}

/* Bends the circle of the majority to the edges that lie beside it, and to those that then do. */
static void bend_outline(struct gsn_contour *fit)
{
    const double belief = 1 / pow(DESCRIPTOR_FIRST * fit->radius, 2);
    const double precision = 1 / pow(fmax(find_jitter(fit), EDGE_SD_PX), 2);
    const int fitted = 2 * fit->lobes + 1;

    for (int round = 0; round < LOOKS; round++) {
        double h[SHAPE][SHAPE] = { { 0 } }, by[SHAPE] = { 0 };

        for (int i = 0; i < SHAPE; i++)
            h[i][i] = i < 3 ? 1e-9 : i < fitted ? belief : 1;
        for (int i = 3; i < fitted; i++)
            by[i] = -belief * fit->v[i];
        for (size_t k = 0; k < fit->sectors; k++) {
            const double off = distance_off(fit, &fit->sector[k]);
            double slope[UNKNOWNS];

            if (!(fabs(off) < fit->tolerance))
                continue;
            gsn_contour_slopes(fit, &fit->sector[k], slope);
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

void gsn_contour_gate(struct gsn_contour *fit)
{
    const size_t n = fit->sectors;
    int off[SECTORS];

    /* What moved an edge does not end at the sector's border. A fit that sees only an edge's foot
     * takes it for nearer, so the first look is asked as well. */
    for (size_t k = 0; k < n; k++) {
        const struct gsn_contour_sector *s = &fit->sector[k];

        off[k] = !(fabs(distance_off(fit, s)) < fit->tolerance) &&
                 !(fabs(s->off) < 3 * sqrt(s->variance));
    }
    for (size_t k = 0; k < n; k++)
        if (off[k] || off[(k + 1) % n] || off[(k + n - 1) % n])
            fit->sector[k].weight = 0;
}

static void set_angles(struct gsn_contour *fit)
{
    for (size_t k = 0; k < fit->sectors; k++) {
        struct gsn_contour_sector *s = &fit->sector[k];
        const double angle = 2 * M_PI * ((double)k + 0.5) / (double)fit->sectors;

        s->cos[0] = 1;
        s->cos[1] = cos(angle);
        s->sin[1] = sin(angle);
        for (int m = 2; m <= ORDERS; m++) {
            s->cos[m] = s->cos[m - 1] * s->cos[1] - s->sin[m - 1] * s->sin[1];
            s->sin[m] = s->sin[m - 1] * s->cos[1] + s->cos[m - 1] * s->sin[1];
        }
    }
}

/* Twice, since a look from beside the centre sees some edges aslant. */
int gsn_contour_estimate(struct gsn_contour *fit)
{
    set_angles(fit);
    for (int i = 0; i < 2; i++) {
        fill_rings(fit);
        for (size_t k = 0; k < fit->sectors; k++)
            fit->sector[k].edge = steepest_fall(fit, k);
        fit->tolerance = fmax(fmax(ROUGH * fit->radius, ROUGH_PX), 5 * find_jitter(fit));
        if (!find_circle(fit))
            return 0;
        move_origin(fit);
    }
    sort_pixels(fit);
    fit->lobes = fit->radius >= 5 ? ORDERS : 1;
    for (size_t k = 0; k < fit->sectors; k++)
        fit->sector[k].weight = 1;
    bend_outline(fit);
    gsn_contour_gate(fit);
    return 1;
}
