/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/glass_parts.h"

#include <math.h>
#include <string.h>

#include "pipeline/core/linalg.h"
#include "pipeline/core/robust.h"

/* Lengths below are optical densities. */
#define LAST_REACH 0.004 /* quantisation of 8 bits stays within it */
#define EVEN_HANDED 0.02 /* until the reach is this short, */
#define DARKER 0.1       /* darker cells weigh less: glass is the brightest there is */
#define RIDGE 1e-4       /* keeps the surface flat where no glass was seen */

enum { ROUNDS = 24 };

static void basis(const struct gsn_glass_cells *all, size_t i, double ret[GSN_GLASS_TERMS])
{
    const double x = ((double)(i % all->nx) + 0.5) * (double)all->side;
    const double y = ((double)(i / all->nx) + 0.5) * (double)all->side;
    const double u = 2 * x / all->width - 1, v = 2 * y / all->height - 1;

    ret[0] = 1;
    ret[1] = u;
    ret[2] = v;
    ret[3] = u * u;
    ret[4] = u * v;
    ret[5] = v * v;
}

static double evaluate(const double s[GSN_GLASS_TERMS], const double b[GSN_GLASS_TERMS])
{
    double sum = 0;

    for (int k = 0; k < GSN_GLASS_TERMS; k++)
        sum += s[k] * b[k];
    return sum;
}

static int fit_surface(const struct gsn_glass_cells *all, struct gsn_glass_surface *surface)
{
    double a[GSN_GLASS_TERMS][GSN_GLASS_TERMS] = { { 0 } }, b[3][GSN_GLASS_TERMS] = { { 0 } },
           sum = 0;

    for (size_t i = 0; i < all->nx * all->ny; i++) {
        const struct gsn_glass_cell *cell = &all->cell[i];
        double t[GSN_GLASS_TERMS];

        if (!(cell->weight > 0))
            continue;
        sum += cell->weight;
        basis(all, i, t);
        for (int j = 0; j < GSN_GLASS_TERMS; j++) {
            for (int k = 0; k <= j; k++)
                a[j][k] += cell->weight * t[j] * t[k];
            for (int c = 0; c < 3; c++)
                b[c][j] += cell->weight * t[j] * cell->light[c];
        }
    }
    if (!(sum > 0))
        return 0;
    for (int j = 1; j < GSN_GLASS_TERMS; j++)
        a[j][j] += RIDGE * sum;
    if (gsn_cholesky(&a[0][0], GSN_GLASS_TERMS, GSN_GLASS_TERMS) < 0)
        return 0; /* the ridge keeps it definite */
    memcpy(surface->s, b, sizeof b);
    for (int c = 0; c < 3; c++)
        gsn_cholesky_solve(&a[0][0], GSN_GLASS_TERMS, GSN_GLASS_TERMS, surface->s[c]);
    return 1;
}

/* The largest of the three residuals; negative where the cell is darker than the surface. */
static double deviation(const struct gsn_glass_cells *all, size_t i,
                        const struct gsn_glass_surface *surface)
{
    double t[GSN_GLASS_TERMS], most = 0, sum = 0;

    basis(all, i, t);
    for (int c = 0; c < 3; c++) {
        const double d = all->cell[i].light[c] - evaluate(surface->s[c], t);

        most = fmax(most, fabs(d));
        sum += d;
    }
    return sum < 0 ? -most : most;
}

static void weigh(const struct gsn_glass_cells *all, const struct gsn_glass_surface *surface)
{
    for (size_t i = 0; i < all->nx * all->ny; i++) {
        const double d = deviation(all, i, surface) / surface->reach;
        const double biweight = (1 - d * d) * (1 - d * d);
        const int takes_part = fabs(d) < 1;

        all->cell[i].weight = !takes_part                             ? 0
                              : d < 0 && surface->reach > EVEN_HANDED ? DARKER * biweight
                                                                      : biweight;
    }
}

/* Narrows the reach towards what the noise of smooth cells deserves. The spread of the residuals
 * must not decide it: pale tissue would widen it and stay. */
static void narrow(const struct gsn_glass_cells *all, struct gsn_glass_surface *surface)
{
    size_t near = 0;
    double rough;

    for (size_t i = 0; i < all->nx * all->ny; i++)
        if (all->cell[i].weight > 0)
            all->scratch[near++] = all->cell[i].rough;
    if (near == 0)
        return;
    rough = gsn_order_pick(all->scratch, near, near / 4);
    surface->reach = fmax(LAST_REACH + 5 * rough / (double)all->taps, 0.85 * surface->reach);
}

double gsn_glass_grow(const struct gsn_glass_cells *all, struct gsn_glass_surface *surface)
{
    const size_t count = all->nx * all->ny;
    size_t on = 0;

    weigh(all, surface);
    for (int round = 0; round < ROUNDS; round++) {
        if (!fit_surface(all, surface))
            return 0;
        narrow(all, surface);
        weigh(all, surface);
    }
    for (size_t i = 0; i < count; i++)
        on += all->cell[i].weight > 0;
    return (double)on / (double)count;
}
