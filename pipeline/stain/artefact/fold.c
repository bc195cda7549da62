/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Folds, tears and holes: tissue that lies double, and tissue that is not there.
 *
 * Folds are both dyes twice, along a line. Where collagen is dense there is less of the yellow dye,
 * so neither dye alone tells how thick the section is. But over one section the two lie on a line,
 * yellow = a - k red, and the thickness (yellow + k red) / a is 1 on all of it, whatever the
 * tissue: a fold is 2.
 *
 *   1. The line by iteratively reweighted least squares (Tukey's biweight) over smoothed cells.
 *   2. Thickness in units of its median; how much rows of cells differ by grain alone.
 *   3. Straight rows of 21 cells through every thick cell, in 16 directions: one must be thick all
 *      along, beyond what grain makes of such a row by chance.
 *   4. What is thick beside such cells belongs to the fold.
 *
 * With fewer than 200 cells of tissue nothing is found. Tears and holes are glass within the
 * outline of the section, at least 80 um wide. */
#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"
#include "pipeline/imaging/filter.h"
#include "pipeline/imaging/morphology.h"
#include "pipeline/stain/artefact/cells.h"

#include <math.h>

enum {
    ANGLES = 16,
    REACH = 10, /* steps of a line to either side */
    STEP = 2,   /* cells */
    ROUNDS = 6,
    LEAST_CELLS = 400,
    PLACE = 4, /* half width, cells */
};

/* A line through a fold: nearer to twice than to once on average, beyond what the grain of this
 * section makes of such a row by chance, and nowhere near once. */
#define FOLD_MEAN 1.6
#define FOLD_DEVIATIONS 6.0
#define FOLD_LEAST 1.25
#define MOST_BELOW 3

/* What belongs to a fold beside it. */
#define FOLD_EDGE 1.35
#define FOLD_WIDE_UM 130.0

struct line {
    double a, k;
};

static int is_counted(const struct gsn_artefact_cells *cells, size_t i)
{
    /* A cell full of the dark dye says little of the other two. */
    return cells->tissue[i] && !cells->label[i] && cells->dark->value[i] < 0.3F;
}

/* Fits yellow = a - k red with Tukey's biweight; k is not negative, for that would take a section
 * that is thicker on one side for the rule. Returns 0 when there is too little tissue. */
static int fit_line(const struct gsn_artefact_cells *cells, const struct gsn_plane *red,
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

            if (!is_counted(cells, i) || fabs(d) >= 1)
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

/* The cells of lines through a cell, from that cell. */
struct star {
    struct {
        long x, y;
    } arm[ANGLES][2 * REACH + 1];
};

static struct star draw_star(void)
{
    struct star star;

    for (int angle = 0; angle < ANGLES; angle++) {
        const double c = cos(M_PI * angle / ANGLES), s = sin(M_PI * angle / ANGLES);

        for (int j = -REACH; j <= REACH; j++) {
            star.arm[angle][j + REACH].x = lround(STEP * j * c);
            star.arm[angle][j + REACH].y = lround(STEP * j * s);
        }
    }
    return star;
}

/* Whether some line through the cell is thick all along. */
static int on_fold(const struct gsn_plane *thick, const uint8_t *tissue, const struct star *star,
                   double least, long x, long y)
{
    for (int angle = 0; angle < ANGLES; angle++) {
        double sum = 0;
        int below = 0;

        for (int j = 0; j <= 2 * REACH && below <= MOST_BELOW; j++) {
            const long u = x + star->arm[angle][j].x, v = y + star->arm[angle][j].y;
            float t = 0;

            if (u >= 0 && v >= 0 && u < (long)thick->width && v < (long)thick->height &&
                tissue[(size_t)v * thick->width + (size_t)u])
                t = thick->value[(size_t)v * thick->width + (size_t)u];
            sum += (t < 2.2F ? (double)t : 2.2); /* one grain does not make a line */
            below += t < FOLD_LEAST;
        }
        if (below <= MOST_BELOW && sum > least * (2 * REACH + 1))
            return 1;
    }
    return 0;
}

/* The mean of a straight row of cells, in steps as on_fold() takes them; NaN where not all of it is
 * tissue to be counted. */
static double row_mean(const struct gsn_artefact_cells *cells, const struct gsn_plane *thick,
                       size_t i, size_t stride)
{
    double sum = 0;

    for (size_t j = 0; j <= 2 * REACH; j++) {
        const size_t at = i + STEP * stride * j;

        if (at >= (size_t)cells->nx * cells->ny || !is_counted(cells, at))
            return NAN;
        sum += fmin(thick->value[at], 2.2) / (2 * REACH + 1);
    }
    return sum;
}

/* Divides the thickness by its median. How much rows of cells differ by their grain alone is taken
 * from the middle two thirds of them, which folds do not reach. */
static int scale_thickness(const struct gsn_artefact_cells *cells, struct gsn_plane *thick,
                           double *ret_deviation, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto_mem(double) list = gsn_alloc_array(count, sizeof *list);
    size_t n = 0, rows = 0;
    double middle;

    if (!list)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t i = 0; i < count; i++)
        if (is_counted(cells, i))
            list[n++] = thick->value[i];
    middle = gsn_order_pick(list, n, n / 2);
    for (size_t i = 0; i < count; i++)
        thick->value[i] = (float)(thick->value[i] / middle);
    for (size_t i = 0; i < count; i += 3) {
        list[rows] = row_mean(cells, thick, i, i % 2 ? cells->nx : 1);
        rows += isnan(list[rows]) ? 0 : 1;
    }
    *ret_deviation = 0;
    if (rows > 0)
        *ret_deviation = (gsn_order_pick(list, rows, rows - 1 - rows / 6) -
                          gsn_order_pick(list, rows, rows / 6)) /
                         2;
    return GSN_OK;
}

/* The line is that of places, not of single cells: grain in the red dye would flatten it. */
static int fit_places(const struct gsn_artefact_cells *cells, struct line *ret_line,
                      int *ret_fitted, struct gsn_error *err)
{
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    int r = gsn_box_mean(cells->red, PLACE, &red, err);

    if (r >= 0)
        r = gsn_box_mean(cells->yellow, PLACE, &yellow, err);
    if (r >= 0)
        *ret_fitted = fit_line(cells, red, yellow, ret_line);
    return r;
}

/* gives: NULL when there is too little tissue. */
static int measure_thickness(const struct gsn_artefact_cells *cells, struct gsn_plane **ret_thick,
                             double *ret_deviation, struct gsn_error *err)
{
    gsn_auto(gsn_plane) thick = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    struct line line = { 0, 0 };
    int fitted = 0;
    int r = fit_places(cells, &line, &fitted, err);

    if (r < 0 || !fitted)
        return r;
    r = gsn_box_mean(cells->red, 1, &thick, err);
    if (r >= 0)
        r = gsn_box_mean(cells->yellow, 1, &yellow, err);
    for (size_t i = 0; r >= 0 && i < (size_t)cells->nx * cells->ny; i++)
        thick->value[i] = (float)(yellow->value[i] + line.k * thick->value[i]);
    if (r >= 0)
        r = scale_thickness(cells, thick, ret_deviation, err);
    if (r >= 0)
        *ret_thick = gsn_steal(&thick);
    return r;
}

int gsn_artefact_folds(struct gsn_artefact_cells *cells, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto(gsn_plane) thick = NULL;
    gsn_auto_mem(uint8_t) sure = gsn_alloc_array(count, 1);
    gsn_auto_mem(uint8_t) weak = gsn_alloc_array(count, 1);
    const struct star star = draw_star();
    double deviation = 0, least;
    int r;

    if (!sure || !weak)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = measure_thickness(cells, &thick, &deviation, err);
    if (r < 0 || !thick)
        return r;
    least = fmax(FOLD_MEAN, 1 + FOLD_DEVIATIONS * deviation);
    for (size_t i = 0; i < count; i++) {
        const int apart = (cells->label[i] & (GSN_DEFECT_INK | GSN_DEFECT_HALO)) != 0;

        weak[i] = cells->tissue[i] && !apart && thick->value[i] > FOLD_EDGE;
        sure[i] = weak[i] && thick->value[i] > FOLD_MEAN &&
                  on_fold(thick, cells->tissue, &star, least, (long)(i % cells->nx),
                          (long)(i / cells->nx));
    }
    r = gsn_artefact_cells_grow(cells, sure, weak, FOLD_WIDE_UM, err);
    if (r >= 0)
        r = gsn_dilate(weak, cells->nx, cells->ny, 1.5, err);
    if (r >= 0)
        gsn_artefact_cells_mark(cells, weak, GSN_DEFECT_FOLD);
    return r;
}

/* ---- tears and holes --------------------------------------------------------------------- */

/* A void that is smaller may be a vessel or a fat cell, or noise in pale tissue. */
#define LEAST_VOID_UM 80.0

/* What a mark burnt is its halo's. */
int gsn_artefact_voids(struct gsn_artefact_cells *cells, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto_mem(uint8_t) clear = gsn_alloc_array(count, 1);
    gsn_auto_mem(uint8_t) core = NULL;
    int r;

    if (!clear)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t i = 0; i < count; i++)
        clear[i] = cells->outline[i] && !cells->tissue[i] && !cells->label[i];
    core = gsn_memdup(clear, count);
    if (!core)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = gsn_erode(core, cells->nx, cells->ny, LEAST_VOID_UM / 2 / cells->um, err);
    if (r < 0)
        return r;
    r = gsn_artefact_cells_grow(cells, core, clear, 1e9, err);
    if (r < 0)
        return r;
    /* The cells at its border hold glass too. */
    r = gsn_dilate(clear, cells->nx, cells->ny, 1.5, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < count; i++)
        clear[i] &= cells->outline[i];
    gsn_artefact_cells_mark(cells, clear, GSN_DEFECT_VOID);
    return GSN_OK;
}
