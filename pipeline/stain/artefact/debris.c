/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What is dark, neutral and sharp: the coverslip's edge, hairs, and grains of dust, enamel, metal.
 *
 * A hair is thinner than a cell, so no cell of it need be darker than a nucleus; but it is dark all
 * along, and that is what is looked for: lines that are darker than both sides of them. JPEG gives
 * a thin line the hue of what lies around it, so lines are looked for in red light, which the dyes
 * let pass.
 *
 *   1. Rows of 15 cells in 16 directions, darker all along than both sides of them, are lines.
 *   2. Connected lines: longer than 3 mm and straight, an edge of the coverslip; longer than 350
 * um, a hair; shorter, nothing.
 *   3. Dark neutral cells, three and more together, are grains.
 *
 * A hair that lies across a fold or ink is theirs. */
#include "pipeline/core/mem.h"
#include "pipeline/imaging/components.h"
#include "pipeline/imaging/filter.h"
#include "pipeline/imaging/morphology.h"
#include "pipeline/stain/artefact/cells.h"

#include <math.h>

enum {
    ANGLES = 16,
    REACH = 7, /* cells of a line to either side */
    ASIDE = 4, /* cells, where its sides are looked at */
    AROUND = 5,
};

/* Red light's density of a line's mean above its sides', and of most of it above the darker side at
 * each place. The grain of tissue and nuclei in a crowd have a deviation of about 0.06 per cell and
 * are alike over two or three of them, so 15 cells reach it at 5 deviations. */
#define LINE_OD 0.12
#define PLACE_OD 0.03
#define MOST_BELOW 3

/* No single cell is looked at that is not darker than its surroundings. */
#define CELL_OD 0.06

#define LEAST_LINE_UM 350.0
#define LINE_WIDE_UM 30.0

/* The edge of a coverslip is as good as straight, and longer than any fibre in a section. */
#define EDGE_LENGTH_UM 3000.0
#define EDGE_BREADTH_UM 150.0

/* Mean dark dye over 3 x 3 cells. Nuclei in a crowd stay below half of it. */
#define GRAIN_OD 0.6
#define LEAST_GRAIN 3 /* cells */
#define GRAIN_WIDE_UM 40.0

/* The darkest of three cells across the line: a hair bends away from a straight row of cells. */
static float red_light_at(const struct gsn_artefact_cells *cells, long x, long y, long dx, long dy)
{
    float most = 0;

    for (int j = -1; j <= 1; j++) {
        const long u = x + j * dx, v = y + j * dy;

        if (u >= 0 && v >= 0 && u < (long)cells->nx && v < (long)cells->ny) {
            const float here = cells->od[0]->value[(size_t)v * cells->nx + (size_t)u];

            most = here > most ? here : most;
        }
    }
    return most;
}

/* The cells of lines through a cell, from that cell. */
struct star {
    struct arm {
        long x[2 * REACH + 1], y[2 * REACH + 1];
        long aside_x, aside_y;
        long dx, dy; /* the step across */
    } arm[ANGLES];
};

static struct star draw_star(void)
{
    struct star star;

    for (int angle = 0; angle < ANGLES; angle++) {
        const double c = cos(M_PI * angle / ANGLES), s = sin(M_PI * angle / ANGLES);
        struct arm *arm = &star.arm[angle];

        arm->aside_x = lround(-ASIDE * s);
        arm->aside_y = lround(ASIDE * c);
        arm->dx = fabs(s) > fabs(c);
        arm->dy = !arm->dx;
        for (int j = -REACH; j <= REACH; j++) {
            arm->x[j + REACH] = lround(j * c);
            arm->y[j + REACH] = lround(j * s);
        }
    }
    return star;
}

static int on_line(const struct gsn_artefact_cells *cells, const struct star *star, long x, long y)
{
    for (int angle = 0; angle < ANGLES; angle++) {
        const struct arm *arm = &star->arm[angle];
        double middle = 0, left = 0, right = 0;
        int below = 0;

        for (int j = 0; j <= 2 * REACH && below <= MOST_BELOW; j++) {
            const long u = x + arm->x[j], v = y + arm->y[j];
            const double m = red_light_at(cells, u, v, arm->dx, arm->dy),
                         l = red_light_at(cells, u + arm->aside_x, v + arm->aside_y, arm->dx,
                                          arm->dy),
                         r = red_light_at(cells, u - arm->aside_x, v - arm->aside_y, arm->dx,
                                          arm->dy);

            middle += m;
            left += l;
            right += r;
            below += m < (l > r ? l : r) + PLACE_OD;
        }
        if (below <= MOST_BELOW && middle - fmax(left, right) > LINE_OD * (2 * REACH + 1))
            return 1;
    }
    return 0;
}

/* Sorts lines into edges and hairs; what is shorter than a line is nothing. */
static int sort_lines(struct gsn_artefact_cells *cells, const uint8_t *lines, uint8_t *edges,
                      uint8_t *hairs, struct gsn_error *err)
{
    gsn_auto(gsn_components) pieces = NULL;
    const int r = gsn_components_find(lines, cells->nx, cells->ny, &pieces, err);

    for (size_t p = 0; r >= 0 && p < pieces->count; p++) {
        const struct gsn_component *piece = &pieces->component[p];
        const int straight = piece->length * cells->um > EDGE_LENGTH_UM &&
                             piece->breadth * cells->um < EDGE_BREADTH_UM;

        for (size_t i = 0; i < piece->area && piece->length * cells->um > LEAST_LINE_UM; i++)
            (straight ? edges : hairs)[pieces->pixel[piece->first + i]] = 1;
    }
    return r;
}

static int find_lines(struct gsn_artefact_cells *cells, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto(gsn_plane) around = NULL;
    gsn_auto_mem(uint8_t) lines = gsn_alloc_array(count, 1);
    gsn_auto_mem(uint8_t) edges = gsn_alloc_array(count, 1);
    gsn_auto_mem(uint8_t) hairs = gsn_alloc_array(count, 1);
    const struct star star = draw_star();
    int r = lines && edges && hairs ? gsn_box_mean(cells->od[0], AROUND, &around, err)
                                    : gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");

    for (size_t i = 0; r >= 0 && i < count; i++)
        lines[i] = !(cells->label[i] & (GSN_DEFECT_HALO | GSN_DEFECT_INK | GSN_DEFECT_FOLD)) &&
                   cells->od[0]->value[i] > around->value[i] + CELL_OD &&
                   on_line(cells, &star, (long)(i % cells->nx), (long)(i / cells->nx));
    if (r >= 0)
        r = sort_lines(cells, lines, edges, hairs, err);
    if (r >= 0)
        r = gsn_dilate(edges, cells->nx, cells->ny, LINE_WIDE_UM / cells->um, err);
    if (r >= 0)
        r = gsn_dilate(hairs, cells->nx, cells->ny, LINE_WIDE_UM / cells->um, err);
    if (r >= 0)
        gsn_artefact_cells_mark(cells, edges, GSN_DEFECT_EDGE);
    if (r >= 0)
        gsn_artefact_cells_mark(cells, hairs, GSN_DEFECT_HAIR);
    return r;
}

static int find_grains(struct gsn_artefact_cells *cells, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto(gsn_plane) dark = NULL;
    gsn_auto(gsn_components) pieces = NULL;
    gsn_auto_mem(uint8_t) grains = gsn_alloc_array(count, 1);
    int r = grains ? gsn_box_mean(cells->dark, 1, &dark, err)
                   : gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");

    for (size_t i = 0; r >= 0 && i < count; i++)
        grains[i] = !(cells->label[i] & ~GSN_DEFECT_BUBBLE) && dark->value[i] > GRAIN_OD;
    if (r >= 0)
        r = gsn_components_find(grains, cells->nx, cells->ny, &pieces, err);
    for (size_t p = 0; r >= 0 && p < pieces->count; p++)
        for (size_t i = 0; i < pieces->component[p].area && pieces->component[p].area < LEAST_GRAIN;
             i++)
            grains[pieces->pixel[pieces->component[p].first + i]] = 0;
    if (r >= 0)
        r = gsn_dilate(grains, cells->nx, cells->ny, GRAIN_WIDE_UM / cells->um, err);
    if (r >= 0)
        gsn_artefact_cells_mark(cells, grains, GSN_DEFECT_DEBRIS);
    return r;
}

int gsn_artefact_debris(struct gsn_artefact_cells *cells, struct gsn_error *err)
{
    const int r = find_lines(cells, err);

    return r < 0 ? r : find_grains(cells, err);
}
