/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The colours of a specimen's tissue, panel by panel on the panels' common scale, and the mean
 * colour of its region: what tells later, beside another specimen's, where tissue without collagen
 * lies (stain/hue_distribution.h).
 *
 * A cell counts where it and the cells beside it are tissue, so that none is cut by an edge. What
 * levelling took off a panel's density, or a reference tissue divided it by, is taken off the red
 * of its cells. */
#include "pipeline/assembly_parts.h"

#include <math.h>

/* What brings a panel's density to the common scale: (density - offset) / gain. */
static struct gsn_gain_offset level_of(const struct gsn_assembly *a,
                                       const struct gsn_assembly_panel *panel)
{
    if (panel->levelled)
        return panel->level;
    return (struct gsn_gain_offset){
        a->by_standards || (a->tissue_grid && !a->not_comparable[0]) ? panel->gain.gain : 1, 0
    };
}

/* Density by the panel's own vectors, and what is to be added to it. */
static void cell_od(const struct gsn_assembly *a, const struct gsn_assembly_panel *panel, size_t i,
                    double ret_od[3])
{
    const struct gsn_gain_offset level = level_of(a, panel);
    const struct gsn_dyes *dyes = &panel->stain.fit.dyes;
    const double seen = (double)a->columns->density->value[i];
    /* Levelled columns hold the common scale already. */
    const double common = panel->levelled ? seen : (seen - level.offset) / level.gain;
    const double own = panel->levelled ? level.gain * seen + level.offset : seen;

    for (int c = 0; c < 3; c++)
        ret_od[c] =
            (double)a->columns->od[c]->value[i] + (common - own) * dyes->full_red_od * dyes->red[c];
}

static int is_tissue(const struct gsn_columns *columns, size_t i)
{
    return !isnan(columns->density->value[i]);
}

static int is_inside(const struct gsn_columns *columns, size_t x, size_t y, size_t i)
{
    const struct gsn_lattice *at = &columns->density->at;

    return x > 0 && y > 0 && x + 1 < at->nx && y + 1 < at->ny && is_tissue(columns, i) &&
           is_tissue(columns, i - 1) && is_tissue(columns, i + 1) &&
           is_tissue(columns, i - at->nx) && is_tissue(columns, i + at->nx);
}

/* Variance of a cell by the noise of its pixels. */
static double noise_of(const struct gsn_assembly_panel *panel)
{
    const double px_um = panel->given->px_um, side = GSN_COLUMN_UM / px_um;
    const double apart = fmax(1, floor(side / 2));

    return panel->glass.noise_od * panel->glass.noise_od / fmax(1, side * side / apart);
}

/* Sums of R, G and B, and how many cells. */
struct sum {
    double od[3], cells;
};

static void add_cell(const double od[3], struct sum *sum)
{
    for (int c = 0; c < 3; c++)
        sum->od[c] += od[c];
    sum->cells++;
}

static void mean_of(const struct sum *sum, double ret_od[3])
{
    for (int c = 0; c < 3; c++)
        ret_od[c] = sum->cells > 0 ? sum->od[c] / sum->cells : (double)NAN;
}

/* One panel's planes; sums up the cells of the region, and of tissue that is stated to hold no
 * collagen (NULL: none is), on the way. */
static void add_plane(const struct gsn_assembly *a, const struct gsn_assembly_panel *panel,
                      const struct gsn_mask *without, size_t z, struct gsn_cloud_tally *tally,
                      struct sum *region, struct sum *ret_free)
{
    const struct gsn_lattice *at = &a->columns->density->at;

    for (size_t y = 0; y < at->ny; y++)
        for (size_t x = 0; x < at->nx; x++) {
            const size_t i = gsn_lattice_index(at, x, y, z);
            double od[3];

            if (!is_tissue(a->columns, i))
                continue;
            cell_od(a, panel, i, od);
            if (is_inside(a->columns, x, y, i))
                gsn_cloud_tally_add(tally, od, 1);
            if (gsn_mask_has(a->region, gsn_lattice_centre(at, x, y, z)))
                add_cell(od, region);
            if (without && without->inside[i])
                add_cell(od, ret_free);
        }
}

int gsn_assembly_count_colours(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                               struct gsn_error *err)
{
    gsn_auto(gsn_cloud_tally) tally = NULL;
    gsn_auto(gsn_mask) without = NULL;
    struct sum region = { .cells = 0 }, none = { .cells = 0 };
    int r;

    mean_of(&region, a->region_od);
    mean_of(&none, a->free_od);
    if (!a->columns || !a->region)
        return GSN_OK;
    r = gsn_cloud_new(a->panel_count, &a->cloud, err);
    if (r >= 0)
        r = gsn_cloud_tally_new(&tally, err);
    if (r >= 0 && specimen->protocol->collagen_free.kind != GSN_REGION_NONE)
        r = gsn_region_raster(&specimen->protocol->collagen_free, &a->columns->density->at,
                              &without, err);
    for (size_t p = 0; p < a->panel_count && r >= 0; p++) {
        const struct gsn_lattice *at = &a->columns->density->at;

        if (!a->panel[p].opened)
            continue;
        a->cloud->panel[p].panel = a->panel[p].stain.panel;
        a->cloud->panel[p].noise = noise_of(&a->panel[p]);
        a->cloud->panel[p].lossy = a->panel[p].lossy;
        for (size_t z = 0; z < at->nz; z++)
            if (gsn_assembly_panel_of_serial(
                    a, gsn_assembly_serial_of_plane(at, z, specimen->protocol->interval_um)) ==
                &a->panel[p])
                add_plane(a, &a->panel[p], without, z, tally, &region, &none);
        r = gsn_cloud_tally_take(tally, &a->cloud->panel[p], err);
    }
    mean_of(&region, a->region_od);
    mean_of(&none, a->free_od);
    return r;
}
