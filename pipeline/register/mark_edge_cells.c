/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_edge_fit.h"

#include <math.h>
#include <string.h>

enum { RINGS = GSN_EDGE_RINGS, BANDS = 4 };

/* Beyond this from an edge all is tissue, but for a very blurred one. */
static const double OVER_PX = 3;
/* Standard errors of the sum of squares that chance alone is given. */
static const double SIGMAS = 1;

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
static void find_cells(struct gsn_edge_fit *fit)
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

void gsn_edge_fill_rings(struct gsn_edge_fit *fit)
{
    struct gsn_edge_ring *ring = &fit->ring[0][0];
    const int none = (int)fit->sectors * RINGS;

    fit->width = fmax(GSN_EDGE_REACH * fit->radius / (RINGS - 1), 1);
    find_cells(fit);
    memset(fit->ring, 0, fit->sectors * sizeof fit->ring[0]);
    for (size_t i = 0; i < fit->count; i++) {
        struct gsn_edge_ring *to = &ring[fit->cell[i]];
        const double value = (double)fit->value[i];

        if (fit->cell[i] == none)
            continue;
        to->n += 1;
        to->sum += value;
        to->squares += value * value;
    }
}

void gsn_edge_sort(struct gsn_edge_fit *fit)
{
    const size_t cells = fit->sectors * RINGS;
    const struct gsn_edge_ring *ring = &fit->ring[0][0];
    unsigned next[GSN_EDGE_SECTORS * RINGS];

    gsn_edge_fill_rings(fit);
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

struct gsn_edge_ring gsn_edge_rings(const struct gsn_edge_fit *fit, size_t sector, int from, int to)
{
    struct gsn_edge_ring all = { 0 };

    for (int b = from < 0 ? 0 : from; b < to && b < RINGS; b++) {
        const struct gsn_edge_ring *ring = &fit->ring[sector][b];

        all.n += ring->n;
        all.sum += ring->sum;
        all.squares += ring->squares;
    }
    return all;
}

/* Squares of a sector's pixels about their cells' means, and of bands of rings about the next. */
struct changes {
    double grain, grain_n, squares, per_pixel, bands;
};

static void add_bands(struct changes *c, struct gsn_edge_ring a, struct gsn_edge_ring b)
{
    if (!(a.n > 0 && b.n > 0))
        return;
    c->squares += pow(a.sum / a.n - b.sum / b.n, 2);
    c->per_pixel += 1 / a.n + 1 / b.n;
    c->bands += 1;
}

static void add_sector(const struct gsn_edge_fit *fit, size_t k, int from, int band,
                       struct changes *c)
{
    for (int b = from; b < RINGS - 1; b++) {
        const struct gsn_edge_ring *ring = &fit->ring[k][b];

        if (ring->n > 1) {
            c->grain += ring->squares - ring->sum * ring->sum / ring->n;
            c->grain_n += ring->n - 1;
        }
    }
    for (int b = from; b + 2 * band < RINGS; b += band)
        add_bands(c, gsn_edge_rings(fit, k, b, b + band),
                  gsn_edge_rings(fit, k, b + band, b + 2 * band));
}

/* Neighbouring bands of width w of a level that walks by v per pixel differ by 2/3 v w in square.
 * Only what chance does not make of grain counts: on even tissue, all of it is heard. */
void gsn_edge_learn_tissue(struct gsn_edge_fit *fit)
{
    const int from = (int)ceil((fit->v[GSN_EDGE_R] + OVER_PX) / fit->width);
    const int room = RINGS - 1 - from, band = room >= 4 * BANDS ? room / BANDS : 1;
    struct changes c = { 0 };
    double chance;

    for (size_t k = 0; k < fit->sectors; k++)
        if (fit->sector[k].weight > 0)
            add_sector(fit, k, from, band, &c);
    fit->grain = c.grain / fmax(c.grain_n, 1);
    chance = fit->grain * c.per_pixel * (1 + SIGMAS * sqrt(2 / fmax(c.bands, 1)));
    fit->walk = fmax(c.squares - chance, 0) / fmax(c.bands, 1) * 1.5 / (band * fit->width);
}
