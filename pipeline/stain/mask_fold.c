/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Folds: both dyes twice, along a line.
 *
 * Where collagen is dense there is less of the yellow dye, so neither dye alone tells how thick the
 * section is. But over one section the two lie on a line, yellow = a - k red, and the thickness
 * (yellow + k red) / a is 1 on all of it, whatever the tissue: a fold is 2. */
#include "pipeline/stain/mask_cells.h"

#include <math.h>

enum {
    ANGLES = 16,
    REACH = 10, /* steps of a line to either side */
    STEP = 2,   /* cells */
    ROUNDS = 6,
    LEAST_CELLS = 400,
};

/* A line through a fold: midway between once and twice on average, and nowhere near once. */
#define FOLD_MEAN 1.5
#define FOLD_LEAST 1.25
#define MOST_BELOW 3
/* What belongs to a fold beside it. */
#define FOLD_EDGE 1.35
#define FOLD_WIDE_UM 250.0

struct line {
    double a, k;
};

static int counts(const struct gsn_mask_cells *cells, size_t i)
{
    /* A cell full of the dark dye says little of the other two. */
    return cells->tissue[i] && !cells->label[i] && cells->dark->value[i] < 0.3F;
}

/* Fits yellow = a - k red with Tukey's biweight; k is not negative, for that would take a section
 * that is thicker on one side for the rule. Returns 0 when there is too little tissue. */
static int fit_line(const struct gsn_mask_cells *cells, const struct gsn_plane *red,
                    const struct gsn_plane *yellow, struct line *ret_line)
{
    struct line line = { 0, 0 };
    double reach = INFINITY;

    for (int round = 0; round < ROUNDS; round++) {
        double n = 0, x = 0, y = 0, xx = 0, xy = 0, left = 0;

        for (size_t i = 0; i < (size_t)cells->nx * cells->ny; i++) {
            const double u = red->value[i], v = yellow->value[i];
            const double d = (v - line.a + line.k * u) / reach;
            const double w = (1 - d * d) * (1 - d * d);

            if (!counts(cells, i) || fabs(d) >= 1)
                continue;
            n += w;
            x += w * u;
            y += w * v;
            xx += w * u * u;
            xy += w * u * v;
            left += w * d * d;
        }
        if (n < LEAST_CELLS / 2.0)
            return 0;
        const double spread = xx - x * x / n;
        const double slope = spread > 1e-4 * n ? (xy - x * y / n) / spread : 0;

        if (isfinite(reach)) /* towards 4 deviations */
            reach = fmax(0.5 * reach, 4 * reach * sqrt(left / n));
        line.k = fmax(0, -slope);
        line.a = (y + line.k * x) / n;
        if (!isfinite(reach))
            reach = line.a;
    }
    *ret_line = line;
    return line.a > 0.02;
}

/* Whether some line through the cell is thick all along. */
static int on_fold(const struct gsn_plane *thick, const uint8_t *tissue, long x, long y)
{
    for (int angle = 0; angle < ANGLES; angle++) {
        const double c = cos(M_PI * angle / ANGLES), s = sin(M_PI * angle / ANGLES);
        double sum = 0;
        int below = 0;

        for (int j = -REACH; j <= REACH && below <= MOST_BELOW; j++) {
            const long u = x + lround(STEP * j * c), v = y + lround(STEP * j * s);
            float t = 0;

            if (u >= 0 && v >= 0 && u < (long)thick->width && v < (long)thick->height &&
                tissue[(size_t)v * thick->width + (size_t)u])
                t = thick->value[(size_t)v * thick->width + (size_t)u];
            sum += fmin(t, 2.5); /* one grain does not make a line */
            below += t < FOLD_LEAST;
        }
        if (below <= MOST_BELOW && sum > FOLD_MEAN * (2 * REACH + 1))
            return 1;
    }
    return 0;
}

static int measure_thickness(const struct gsn_mask_cells *cells, struct gsn_plane **ret_thick,
                             struct gsn_error *err)
{
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    struct line line;
    int r = gsn_mask_cells_smooth(cells->red, 1, &red, err);

    *ret_thick = NULL;
    if (r >= 0)
        r = gsn_mask_cells_smooth(cells->yellow, 1, &yellow, err);
    if (r < 0 || !fit_line(cells, red, yellow, &line))
        return r;
    for (size_t i = 0; i < (size_t)cells->nx * cells->ny; i++)
        red->value[i] = (float)((yellow->value[i] + line.k * red->value[i]) / line.a);
    *ret_thick = gsn_steal(&red);
    return GSN_OK;
}

int gsn_mask_folds(struct gsn_mask_cells *cells, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto(gsn_plane) thick = NULL;
    gsn_auto_mem(uint8_t) sure = gsn_alloc_array(count, 1);
    gsn_auto_mem(uint8_t) weak = gsn_alloc_array(count, 1);
    int r;

    if (!sure || !weak)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = measure_thickness(cells, &thick, err);
    if (r < 0 || !thick)
        return r;
    for (size_t i = 0; i < count; i++) {
        const int apart = (cells->label[i] & (GSN_DEFECT_INK | GSN_DEFECT_HALO)) != 0;

        weak[i] = cells->tissue[i] && !apart && thick->value[i] > FOLD_EDGE;
        sure[i] = weak[i] && thick->value[i] > FOLD_MEAN &&
                  on_fold(thick, cells->tissue, (long)(i % cells->nx), (long)(i / cells->nx));
    }
    r = gsn_mask_cells_grow(cells, sure, weak, FOLD_WIDE_UM, err);
    if (r >= 0)
        r = gsn_mask_cells_dilate(cells, weak, 1.5 * cells->um, err);
    if (r >= 0)
        gsn_mask_cells_mark(cells, weak, GSN_DEFECT_FOLD);
    return r;
}
