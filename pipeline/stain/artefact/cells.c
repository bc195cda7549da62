/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A section as cells of about 20 um: mean density, unmixed dyes, tissue and outline.
 *
 *   1. Mean optical density of each cell, in one pass over the section's rows.
 *   2. Unmixing; what no mixture of the dyes explains, of cells smoothed over 3 x 3.
 *   3. Tissue: the large connected components of what is not glass and has colour.
 *   4. Outline: tissue closed over clefts of 600 um, its holes filled.
 *
 * And the operations on sets of cells that the detectors share. Fails only without memory or for
 * dyes that are too alike. The pass over the pixels is most of the cost of all masks. */
#include "pipeline/stain/artefact/cells.h"

#include "pipeline/core/mem.h"
#include "pipeline/imaging/components.h"
#include "pipeline/imaging/filter.h"
#include "pipeline/imaging/morphology.h"
#include "pipeline/stain/unmixing.h"

#include <math.h>
#include <string.h>

/* Cells no larger than this resolve a hair and the char of a mark; finer ones only cost time. */
static const double CELL_UM = 21.5;

/* Clefts narrower than twice this are closed when the outline is drawn. */
#define CLEFT_UM 300.0

/* A piece of tissue smaller than this share of the largest one is a scrap or dirt. */
static const double LEAST_PIECE = 0.05;

/* On a square of half a millimetre not even the three marks find room: it is no section. */
static const double LEAST_SECTION_UM2 = 500.0 * 500.0;

/* How much more of one channel than of another a piece must absorb, as a share of the sum of all
 * three: the palest dye mixtures have 0.2, grey has 0. */
static const double LEAST_COLOUR = 0.06;

/* Rounding to codes of 8 bits moves bright light by a deviation of 0.29 codes. */
static const double ROUNDING_OD = 0.0006;

void gsn_artefact_cells_free(struct gsn_artefact_cells *cells)
{
    if (!cells)
        return;
    for (size_t c = 0; c < 3; c++) {
        gsn_plane_free(cells->od[c]);
        gsn_plane_free(cells->even[c]);
    }
    gsn_plane_free(cells->red);
    gsn_plane_free(cells->yellow);
    gsn_plane_free(cells->dark);
    gsn_plane_free(cells->total);
    gsn_plane_free(cells->foreign);
    gsn_free(cells->tissue);
    gsn_free(cells->outline);
    gsn_free(cells->label);
    gsn_free(cells);
}

/* ---- cutting out ------------------------------------------------------------------------- */

static struct gsn_artefact_cells size_cells(const struct gsn_artefact_panel *panel,
                                            const struct gsn_artefact_section *section)
{
    struct gsn_artefact_cells c = { .x0 = section->x, .y0 = section->y };

    c.side = (uint32_t)fmax(1, floor(CELL_UM / panel->px_um));
    c.um = c.side * panel->px_um;
    c.rim = (uint32_t)ceil(CLEFT_UM / c.um) + 2;
    c.nx = ((uint32_t)section->width + c.side - 1) / c.side + 2 * c.rim;
    c.ny = ((uint32_t)section->height + c.side - 1) / c.side + 2 * c.rim;
    c.noise = (float)(hypot(panel->glass->noise_od, ROUNDING_OD) / c.side);
    return c;
}

/* Rows of one section on their way into its cells. */
struct pour {
    const struct gsn_od_reader *absorber;
    const struct gsn_artefact_section *section;
    float *od[3];           /* of one row */
    size_t tissue, clipped; /* pixels */
};

static void add_row(const float *row, size_t width, size_t side, float *cell)
{
    for (size_t x = 0; x < width; cell++) {
        const size_t end = x + side < width ? x + side : width;
        float sum = *cell;

        for (; x < end; x++)
            sum += row[x];
        *cell = sum;
    }
}

static void count_row(struct pour *pour, uint32_t y)
{
    const struct gsn_artefact_section *section = pour->section;
    const uint32_t x0 = (uint32_t)section->x, width = (uint32_t)section->width;
    uint32_t tissue = 0;

    for (uint32_t x = 0; x < width; x++)
        tissue += pour->od[0][x] + pour->od[1][x] + pour->od[2][x] > GSN_TISSUE_OD;
    pour->tissue += tissue;
    if (tissue == 0 || !gsn_od_reader_at_end(pour->absorber, x0, y, width))
        return;
    for (uint32_t x = 0; x < width; x++)
        pour->clipped += pour->od[0][x] + pour->od[1][x] + pour->od[2][x] > GSN_TISSUE_OD &&
                         gsn_od_reader_clipped(pour->absorber, x0 + x, y);
}

/* Sums become means; the rim is clear glass. */
static void divide_sums(const struct gsn_artefact_cells *cells,
                        const struct gsn_artefact_section *section, struct gsn_plane *into)
{
    for (uint32_t y = 0; y * cells->side < (uint32_t)section->height; y++)
        for (uint32_t x = 0; x * cells->side < (uint32_t)section->width; x++) {
            const uint32_t w = (uint32_t)section->width - x * cells->side;
            const uint32_t h = (uint32_t)section->height - y * cells->side;
            const uint32_t n =
                (w < cells->side ? w : cells->side) * (h < cells->side ? h : cells->side);

            into->value[(size_t)(cells->rim + y) * cells->nx + cells->rim + x] /= (float)n;
        }
}

/* Mean density of the pixels of each cell, in one pass over the section. */
static int average_pixels(const struct gsn_od_reader *absorber,
                          const struct gsn_artefact_section *section,
                          struct gsn_artefact_cells *cells, struct gsn_error *err)
{
    const size_t width = (size_t)section->width;
    gsn_auto_mem(float) rows = gsn_alloc_array(3 * width, sizeof *rows);
    struct pour pour = { absorber, section, { rows, rows + width, rows + 2 * width }, 0, 0 };
    int r = rows ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");

    for (int c = 0; c < 3 && r >= 0; c++)
        r = gsn_plane_new(cells->nx, cells->ny, &cells->od[c], err);
    for (uint32_t y = 0; r >= 0 && y < (uint32_t)section->height; y++) {
        const size_t at = (size_t)(cells->rim + y / cells->side) * cells->nx + cells->rim;

        gsn_od_reader_row(absorber, (uint32_t)section->x, (uint32_t)section->y + y, width, pour.od);
        for (int c = 0; c < 3; c++)
            add_row(pour.od[c], width, cells->side, cells->od[c]->value + at);
        count_row(&pour, (uint32_t)section->y + y);
    }
    for (int c = 0; c < 3 && r >= 0; c++)
        divide_sums(cells, section, cells->od[c]);
    cells->clipped = pour.tissue ? (double)pour.clipped / (double)pour.tissue : 0;
    return r;
}

/* What no mixture of the dyes explains, of densities smoothed over 3 x 3 cells: the noise of single
 * pixels lies outside of every mixture. */
static int find_foreign(struct gsn_artefact_cells *cells, struct gsn_plane *const od[3],
                        const struct gsn_dyes *dyes, struct gsn_error *err)
{
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    gsn_auto(gsn_plane) dark = NULL;
    int r = gsn_unmix(od, dyes, 1, &red, &yellow, &dark, err);

    if (r >= 0)
        r = gsn_plane_new(cells->nx, cells->ny, &cells->foreign, err);
    for (size_t i = 0; r >= 0 && i < (size_t)cells->nx * cells->ny; i++) {
        double left = 0;

        for (int c = 0; c < 3; c++) {
            const double d = od[c]->value[i] - red->value[i] * dyes->full_red_od * dyes->red[c] -
                             yellow->value[i] * dyes->yellow[c] - dark->value[i] * dyes->dark[c];

            left += d * d;
        }
        cells->foreign->value[i] = (float)sqrt(left);
    }
    return r;
}

static int explain_colours(struct gsn_artefact_cells *cells, const struct gsn_dyes *dyes,
                           struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    int r = gsn_unmix(cells->od, dyes, 1, &cells->red, &cells->yellow, &cells->dark, err);

    for (size_t i = 0; r >= 0 && i < count; i++)
        cells->red->value[i] *= (float)dyes->full_red_od;
    for (int c = 0; c < 3 && r >= 0; c++)
        r = gsn_box_mean(cells->od[c], 1, &cells->even[c], err);
    if (r >= 0)
        r = find_foreign(cells, cells->even, dyes, err);
    if (r >= 0)
        r = gsn_plane_new(cells->nx, cells->ny, &cells->total, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        cells->total->value[i] =
            cells->even[0]->value[i] + cells->even[1]->value[i] + cells->even[2]->value[i];
    return r;
}

/* ---- tissue and its outline -------------------------------------------------------------- */

/* Whether a piece has colour: stained tissue has dye in it, a smear, a shadow or a line has none.
 */
static int has_colour(const struct gsn_artefact_cells *cells, const struct gsn_components *pieces,
                      const struct gsn_component *piece)
{
    double mean[3] = { 0 };

    for (size_t i = 0; i < piece->area; i++)
        for (int c = 0; c < 3; c++)
            mean[c] += cells->od[c]->value[pieces->pixel[piece->first + i]] / (double)piece->area;

    const double most = fmax(mean[0], fmax(mean[1], mean[2]));
    const double least = fmin(mean[0], fmin(mean[1], mean[2]));

    return most - least > LEAST_COLOUR * (mean[0] + mean[1] + mean[2]);
}

/* Only the large pieces of what is not glass and has colour. */
static int find_tissue(struct gsn_artefact_cells *cells, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto(gsn_components) pieces = NULL;
    size_t largest = 0;
    int r;

    for (size_t i = 0; i < count; i++)
        cells->tissue[i] = cells->total->value[i] > cells->clear;
    r = gsn_components_find(cells->tissue, cells->nx, cells->ny, &pieces, err);
    if (r < 0)
        return r;
    memset(cells->tissue, 0, count);
    for (size_t p = 0; p < pieces->count; p++)
        if (!has_colour(cells, pieces, &pieces->component[p]))
            pieces->component[p].area = 0;
    for (size_t p = 0; p < pieces->count; p++)
        largest = pieces->component[p].area > largest ? pieces->component[p].area : largest;
    if ((double)largest * cells->um * cells->um < LEAST_SECTION_UM2)
        return GSN_OK;
    for (size_t p = 0; p < pieces->count; p++)
        for (size_t i = 0; i < pieces->component[p].area; i++)
            if ((double)pieces->component[p].area >= LEAST_PIECE * (double)largest)
                cells->tissue[pieces->pixel[pieces->component[p].first + i]] = 1;
    return GSN_OK;
}

static int draw_outline(struct gsn_artefact_cells *cells, struct gsn_error *err)
{
    int r;

    memcpy(cells->outline, cells->tissue, (size_t)cells->nx * cells->ny);
    r = gsn_dilate(cells->outline, cells->nx, cells->ny, CLEFT_UM / cells->um, err);
    if (r >= 0)
        r = gsn_erode(cells->outline, cells->nx, cells->ny, CLEFT_UM / cells->um, err);
    return r < 0 ? r : gsn_fill_holes(cells->outline, cells->nx, cells->ny, 8, err);
}

int gsn_artefact_cells_cut(const struct gsn_artefact_panel *panel,
                           const struct gsn_od_reader *absorber,
                           const struct gsn_artefact_section *section, double clear,
                           struct gsn_artefact_cells **ret_cells, struct gsn_error *err)
{
    gsn_auto(gsn_artefact_cells) cells = gsn_alloc_array(1, sizeof *cells);
    size_t count;
    int r;

    if (!cells)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    *cells = size_cells(panel, section);
    cells->clear = (float)clear;
    count = (size_t)cells->nx * cells->ny;
    cells->tissue = gsn_alloc_array(count, 1);
    cells->outline = gsn_alloc_array(count, 1);
    cells->label = gsn_alloc_array(count, sizeof *cells->label);
    if (!cells->tissue || !cells->outline || !cells->label)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = average_pixels(absorber, section, cells, err);
    if (r >= 0)
        r = explain_colours(cells, panel->dyes, err);
    if (r >= 0)
        r = find_tissue(cells, err);
    if (r >= 0)
        r = draw_outline(cells, err);
    if (r < 0)
        return r;
    *ret_cells = gsn_steal(&cells);
    return GSN_OK;
}

/* ---- sets of cells ----------------------------------------------------------------------- */

void gsn_artefact_cells_mark(struct gsn_artefact_cells *cells, const uint8_t *set,
                             enum gsn_defect defect)
{
    for (size_t i = 0; i < (size_t)cells->nx * cells->ny; i++)
        if (set[i])
            cells->label[i] = (uint16_t)(cells->label[i] | defect);
}

int gsn_artefact_cells_grow(const struct gsn_artefact_cells *cells, const uint8_t *sure,
                            uint8_t *weak, double um, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto(gsn_components) pieces = NULL;
    gsn_auto_mem(uint8_t) reach = gsn_memdup(sure, count);
    int r;

    if (!reach)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = gsn_dilate(reach, cells->nx, cells->ny, um / cells->um, err);
    for (size_t i = 0; i < count; i++)
        weak[i] = sure[i] || (weak[i] && reach[i]);
    if (r >= 0)
        r = gsn_components_find(weak, cells->nx, cells->ny, &pieces, err);
    for (size_t p = 0; r >= 0 && p < pieces->count; p++) {
        const uint32_t *cell = pieces->pixel + pieces->component[p].first;
        int held = 0;

        for (size_t i = 0; i < pieces->component[p].area; i++)
            held |= sure[cell[i]];
        for (size_t i = 0; i < pieces->component[p].area; i++)
            weak[cell[i]] = (uint8_t)held;
    }
    return r;
}

int gsn_artefact_cells_broad(const struct gsn_artefact_cells *cells, uint8_t *set, double half_um,
                             struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) core = gsn_memdup(set, (size_t)cells->nx * cells->ny);
    int r;

    if (!core)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = gsn_erode(core, cells->nx, cells->ny, half_um / cells->um, err);
    return r < 0 ? r : gsn_artefact_cells_grow(cells, core, set, 3 * half_um, err);
}
