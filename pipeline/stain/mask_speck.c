/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What is dark, neutral and sharp: the coverslip's edge, hairs, and grains of dust, enamel, metal.
 *
 * A hair is thinner than a cell, so no cell of it need be darker than a nucleus; but it is dark all
 * along, and that is what is looked for: lines that are darker than both sides of them. */
#include "pipeline/stain/mask_cells.h"

#include <math.h>

enum {
    ANGLES = 16,
    REACH = 7, /* cells of a line to either side */
    ASIDE = 3, /* cells, where its sides are looked at */
    AROUND = 5,
};

/* Dark dye of a line's mean above its sides': nuclei in a crowd (deviation 0.1 of a cell) reach it
 * on 15 cells at 6 deviations. */
#define LINE_OD 0.20
/* No single cell is looked at that is not darker than its surroundings. */
#define CELL_OD 0.10
#define LEAST_LINE_UM 350.0
#define LINE_WIDE_UM 30.0
/* The edge of a coverslip is as good as straight, and longer than any fibre in a section. */
#define EDGE_LENGTH_UM 3000.0
#define EDGE_BREADTH_UM 150.0
/* Mean dark dye over 3 x 3 cells. Nuclei in a crowd stay below half of it. */
#define GRAIN_OD 0.6
#define LEAST_GRAIN 3 /* cells */
#define GRAIN_WIDE_UM 40.0

static double dark_at(const struct gsn_mask_cells *cells, long x, long y)
{
    if (x < 0 || y < 0 || x >= (long)cells->nx || y >= (long)cells->ny)
        return 0;
    return fmin(cells->dark->value[(size_t)y * cells->nx + (size_t)x], 1.0);
}

static int on_line(const struct gsn_mask_cells *cells, long x, long y)
{
    for (int angle = 0; angle < ANGLES; angle++) {
        const double c = cos(M_PI * angle / ANGLES), s = sin(M_PI * angle / ANGLES);
        const long aside_x = lround(-ASIDE * s), aside_y = lround(ASIDE * c);
        double middle = 0, left = 0, right = 0;

        for (int j = -REACH; j <= REACH; j++) {
            const long u = x + lround(j * c), v = y + lround(j * s);

            middle += dark_at(cells, u, v);
            left += dark_at(cells, u + aside_x, v + aside_y);
            right += dark_at(cells, u - aside_x, v - aside_y);
        }
        if (middle - fmax(left, right) > LINE_OD * (2 * REACH + 1))
            return 1;
    }
    return 0;
}

/* Sorts lines into edges and hairs; what is shorter than a line is nothing. */
static int sort_lines(struct gsn_mask_cells *cells, const uint8_t *lines, uint8_t *edges,
                      uint8_t *hairs, struct gsn_error *err)
{
    gsn_auto(gsn_mask_cells_pieces) pieces = NULL;
    const int r = gsn_mask_cells_pieces(cells, lines, &pieces, err);

    for (size_t p = 0; r >= 0 && p < pieces->count; p++) {
        const struct gsn_mask_cells_piece *piece = &pieces->piece[p];
        const int straight = piece->length * cells->um > EDGE_LENGTH_UM &&
                             piece->breadth * cells->um < EDGE_BREADTH_UM;

        for (size_t i = 0; i < piece->count && piece->length * cells->um > LEAST_LINE_UM; i++)
            (straight ? edges : hairs)[pieces->cell[piece->first + i]] = 1;
    }
    return r;
}

static int find_lines(struct gsn_mask_cells *cells, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto(gsn_plane) around = NULL;
    gsn_auto_mem(uint8_t) lines = gsn_alloc_array(count, 1);
    gsn_auto_mem(uint8_t) edges = gsn_alloc_array(count, 1);
    gsn_auto_mem(uint8_t) hairs = gsn_alloc_array(count, 1);
    int r = lines && edges && hairs ? gsn_mask_cells_smooth(cells->dark, AROUND, &around, err)
                                    : gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");

    for (size_t i = 0; r >= 0 && i < count; i++)
        lines[i] = !(cells->label[i] & (GSN_DEFECT_HALO | GSN_DEFECT_INK)) &&
                   cells->dark->value[i] > around->value[i] + CELL_OD &&
                   on_line(cells, (long)(i % cells->nx), (long)(i / cells->nx));
    if (r >= 0)
        r = sort_lines(cells, lines, edges, hairs, err);
    if (r >= 0)
        r = gsn_mask_cells_dilate(cells, edges, LINE_WIDE_UM, err);
    if (r >= 0)
        r = gsn_mask_cells_dilate(cells, hairs, LINE_WIDE_UM, err);
    if (r >= 0)
        gsn_mask_cells_mark(cells, edges, GSN_DEFECT_EDGE);
    if (r >= 0)
        gsn_mask_cells_mark(cells, hairs, GSN_DEFECT_HAIR);
    return r;
}

static int find_grains(struct gsn_mask_cells *cells, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto(gsn_plane) dark = NULL;
    gsn_auto(gsn_mask_cells_pieces) pieces = NULL;
    gsn_auto_mem(uint8_t) grains = gsn_alloc_array(count, 1);
    int r = grains ? gsn_mask_cells_smooth(cells->dark, 1, &dark, err)
                   : gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");

    for (size_t i = 0; r >= 0 && i < count; i++)
        grains[i] = !(cells->label[i] & ~GSN_DEFECT_BUBBLE) && dark->value[i] > GRAIN_OD;
    if (r >= 0)
        r = gsn_mask_cells_pieces(cells, grains, &pieces, err);
    for (size_t p = 0; r >= 0 && p < pieces->count; p++)
        for (size_t i = 0; i < pieces->piece[p].count && pieces->piece[p].count < LEAST_GRAIN; i++)
            grains[pieces->cell[pieces->piece[p].first + i]] = 0;
    if (r >= 0)
        r = gsn_mask_cells_dilate(cells, grains, GRAIN_WIDE_UM, err);
    if (r >= 0)
        gsn_mask_cells_mark(cells, grains, GSN_DEFECT_DEBRIS);
    return r;
}

int gsn_mask_specks(struct gsn_mask_cells *cells, struct gsn_error *err)
{
    const int r = find_lines(cells, err);

    return r < 0 ? r : find_grains(cells, err);
}
