/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The whole block in coarse cells, and the colours of its tissue.
 *
 * A cell of GSN_COARSE_UM holds the mean density and colour of the pixels whose centre lies in it.
 * It is known where half of it was seen, and is tissue where nine tenths of that is no glass.
 *
 * The colours of tissue, panel by panel on the panels' common scale, and the mean colour of the
 * region tell later, beside another specimen's, where tissue without collagen lies
 * (stain/hue_distribution.h). A cell counts where it and its four neighbours are tissue, so that
 * none is cut by an edge. What normalisation took off a panel's density is taken off the red of its
 * cells. */
#include "pipeline/specimen/coarse_grid.h"

#include "pipeline/core/distance.h"
#include "pipeline/register/stack/resample.h"
#include "pipeline/specimen/normalisation.h"
#include "pipeline/stain/hue_distribution.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/stain_vectors.h"

#include <math.h>

/* R, G and B together: paler is glass, fat or an empty vessel. */
static const double LEAST_TISSUE_OD = 0.15;

/* A cell is tissue where next to no glass is in it, and seen where next to nothing is masked. */
static const double LEAST_TISSUE = 0.9, LEAST_SEEN = 0.5;

/* Sums over one plane of cells. */
struct tally {
    float sum, tissue, seen, od[3];
};

int gsn_coarse_grid_new(const struct gsn_lattice *at, struct gsn_coarse_grid **ret_columns,
                        struct gsn_error *err)
{
    gsn_auto(gsn_coarse_grid) c = gsn_alloc_array(1, sizeof *c);
    int r = c ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for the cells of a block");

    if (r >= 0)
        r = gsn_grid_new(at, &c->density, err);
    if (r >= 0)
        r = gsn_grid_new(at, &c->tissue, err);
    for (int k = 0; k < 3 && r >= 0; k++)
        r = gsn_grid_new(at, &c->od[k], err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < gsn_lattice_count(at); i++)
        c->density->value[i] = c->tissue->value[i] = c->od[0]->value[i] = c->od[1]->value[i] =
            c->od[2]->value[i] = NAN;
    *ret_columns = gsn_steal(&c);
    return GSN_OK;
}

void gsn_coarse_grid_free(struct gsn_coarse_grid *columns)
{
    if (!columns)
        return;
    gsn_grid_free(columns->density);
    gsn_grid_free(columns->tissue);
    for (int k = 0; k < 3; k++)
        gsn_grid_free(columns->od[k]);
    gsn_free(columns);
}

/* One row of pixels, each into the cell its centre lies in. od: R, G and B of them. */
static void tally_row(const struct gsn_stack_section *s, int y, const float *density,
                      float *const od[3], const struct gsn_lattice *at, struct tally *tally)
{
    for (int x = 0; x < s->width; x++) {
        const struct gsn_point um = gsn_affine_apply(
            &s->panel_to_block_um, (struct gsn_point){ s->x + x + 0.5, s->y + y + 0.5 });
        const double cx = floor((um.x - at->origin_um.x) / at->step_um.x + 0.5);
        const double cy = floor((um.y - at->origin_um.y) / at->step_um.y + 0.5);

        if (isnan(density[x]) || !(cx >= 0 && cx < (double)at->nx && cy >= 0) ||
            cy >= (double)at->ny)
            continue;

        struct tally *t = &tally[(size_t)cy * at->nx + (size_t)cx];

        t->seen++;
        if (od[0][x] + od[1][x] + od[2][x] <= (float)LEAST_TISSUE_OD)
            continue;
        t->tissue++;
        t->sum += density[x];
        for (int k = 0; k < 3; k++)
            t->od[k] += od[k][x];
    }
}

static int tally_section(const struct gsn_stack_section *s, unsigned apart,
                         const struct gsn_od_reader *absorber, const struct gsn_lattice *at,
                         struct tally *tally, struct gsn_error *err)
{
    const size_t width = (size_t)s->width;
    gsn_auto_mem(float) row = gsn_alloc_array(3 * width, sizeof *row);
    float *const od[3] = { row, row + width, row + 2 * width };

    if (!row)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the cells of a section");
    for (uint32_t k = 0; k < s->density->height; k++) {
        const int y = (int)(k * apart);

        gsn_od_reader_row(absorber, (uint32_t)s->x, (uint32_t)(s->y + y), width, od);
        tally_row(s, y, s->density->value + (size_t)k * width, od, at, tally);
    }
    return GSN_OK;
}

/* first: the plane's first cell. */
static void keep_cells(const struct tally *tally, double pixels, size_t plane, size_t first,
                       struct gsn_coarse_grid *c)
{
    for (size_t i = 0; i < plane; i++) {
        const struct tally *t = &tally[i];

        if (!(t->seen > 0) || t->seen < LEAST_SEEN * pixels)
            continue;
        c->tissue->value[first + i] = t->tissue / t->seen;
        if (c->tissue->value[first + i] < LEAST_TISSUE)
            continue;
        c->density->value[first + i] = t->sum / t->tissue;
        for (int k = 0; k < 3; k++)
            c->od[k]->value[first + i] = t->od[k] / t->tissue;
    }
}

int gsn_coarse_grid_add(struct gsn_coarse_grid *columns, const struct gsn_stack_section *section,
                        unsigned apart, const struct gsn_od_reader *absorber, double interval_um,
                        struct gsn_error *err)
{
    const struct gsn_lattice *at = &columns->density->at;
    const size_t plane = at->nx * at->ny;
    const double z = interval_um * (section->serial + 0.5);
    const double k = round((z - at->origin_um.z) / at->step_um.z);
    const double px_um2 = apart * fabs(gsn_affine_det(&section->panel_to_block_um));
    gsn_auto_mem(struct tally) tally = NULL;
    int r;

    if (!(k >= 0 && k < (double)at->nz))
        return GSN_OK;
    tally = gsn_alloc_array(plane, sizeof *tally);
    if (!tally)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the cells of a section");
    r = tally_section(section, apart, absorber, at, tally, err);
    if (r < 0)
        return r;
    keep_cells(tally, at->step_um.x * at->step_um.y / px_um2, plane, (size_t)k * plane, columns);
    return GSN_OK;
}

static void project_region(const struct gsn_mask *region, const struct gsn_lattice *at,
                           uint8_t *set)
{
    for (size_t i = 0, z = 0; z < region->at.nz; z++)
        for (size_t y = 0; y < region->at.ny; y++)
            for (size_t x = 0; x < region->at.nx; x++, i++) {
                const struct gsn_vec3 u = gsn_lattice_centre(&region->at, x, y, z);
                const double cx = floor((u.x - at->origin_um.x) / at->step_um.x + 0.5);
                const double cy = floor((u.y - at->origin_um.y) / at->step_um.y + 0.5);

                if (region->inside[i] && cx >= 0 && cx < (double)at->nx && cy >= 0 &&
                    cy < (double)at->ny)
                    set[(size_t)cy * at->nx + (size_t)cx] = 1;
            }
}

int gsn_coarse_grid_away(const struct gsn_mask *region, const struct gsn_lattice *at,
                         struct gsn_grid **ret_um, struct gsn_error *err)
{
    struct gsn_lattice flat = *at;
    gsn_auto(gsn_mask) below = NULL;
    gsn_auto(gsn_grid) um = NULL;
    int r;

    flat.nz = 1;
    r = gsn_mask_new(&flat, &below, err);
    if (r >= 0)
        r = gsn_grid_new(&flat, &um, err);
    if (r >= 0) {
        const struct gsn_distance_box box = { flat.nx,        flat.ny,        1,
                                              flat.step_um.x, flat.step_um.y, flat.step_um.z };

        project_region(region, &flat, below->inside);
        r = gsn_distance_squared(below->inside, &box, 1, um->value, err);
    }
    if (r < 0)
        return r;
    for (size_t i = 0; i < flat.nx * flat.ny; i++)
        um->value[i] = sqrtf(um->value[i]);
    *ret_um = gsn_steal(&um);
    return GSN_OK;
}

int gsn_coarse_grid_footprint(const struct gsn_mask *region, const struct gsn_lattice *at,
                              double margin_um, struct gsn_mask **ret_footprint,
                              struct gsn_error *err)
{
    gsn_auto(gsn_grid) away = NULL;
    gsn_auto(gsn_mask) footprint = NULL;
    int r = gsn_coarse_grid_away(region, at, &away, err);

    if (r >= 0)
        r = gsn_mask_new(&away->at, &footprint, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < gsn_lattice_count(&away->at); i++)
        footprint->inside[i] = away->value[i] <= (float)margin_um;
    *ret_footprint = gsn_steal(&footprint);
    return GSN_OK;
}

/* ---- the colours of its tissue ----------------------------------------------------------------
 */

/* What brings a panel's density to the common scale: (density - offset) / gain. */
static struct gsn_gain_offset level_of(const struct gsn_densities *d, const struct gsn_scale *scale,
                                 const struct gsn_panel_scale *panel)
{
    if (panel->levelled)
        return panel->level;
    return (struct gsn_gain_offset){ scale->by_standards || (d->tissue_grid && !scale->not_comparable[0])
                                   ? panel->gain.gain
                                   : 1,
                               0 };
}

/* Density by the panel's own vectors, and what is to be added to it. */
static void cell_od(const struct gsn_densities *d, const struct gsn_scale *scale, size_t p,
                    size_t i, double ret_od[3])
{
    const struct gsn_panel_scale *panel = &scale->panel[p];
    const struct gsn_gain_offset level = level_of(d, scale, panel);
    const struct gsn_dyes *dyes = &d->panel[p].stain.fit.dyes;
    const double seen = (double)d->coarse->density->value[i];
    /* Levelled columns hold the common scale already. */
    const double common = panel->levelled ? seen : (seen - level.offset) / level.gain;
    const double own = panel->levelled ? level.gain * seen + level.offset : seen;

    for (int c = 0; c < 3; c++)
        ret_od[c] =
            (double)d->coarse->od[c]->value[i] + (common - own) * dyes->full_red_od * dyes->red[c];
}

static int is_tissue(const struct gsn_coarse_grid *columns, size_t i)
{
    return !isnan(columns->density->value[i]);
}

static int is_inside(const struct gsn_coarse_grid *columns, size_t x, size_t y, size_t i)
{
    const struct gsn_lattice *at = &columns->density->at;

    return x > 0 && y > 0 && x + 1 < at->nx && y + 1 < at->ny && is_tissue(columns, i) &&
           is_tissue(columns, i - 1) && is_tissue(columns, i + 1) &&
           is_tissue(columns, i - at->nx) && is_tissue(columns, i + at->nx);
}

/* Variance of a cell by the noise of its pixels. */
static double noise_of(const struct gsn_stack_panel *panel)
{
    const double px_um = panel->given->px_um, side = GSN_COARSE_UM / px_um;
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
static void add_plane(const struct gsn_mask *region, const struct gsn_densities *d,
                      const struct gsn_scale *scale, size_t p, const struct gsn_mask *without,
                      size_t z, struct gsn_cloud_tally *tally, struct sum *ret_region,
                      struct sum *ret_free)
{
    const struct gsn_lattice *at = &d->coarse->density->at;

    for (size_t y = 0; y < at->ny; y++)
        for (size_t x = 0; x < at->nx; x++) {
            const size_t i = gsn_lattice_index(at, x, y, z);
            double od[3];

            if (!is_tissue(d->coarse, i))
                continue;
            cell_od(d, scale, p, i, od);
            if (is_inside(d->coarse, x, y, i))
                gsn_cloud_tally_add(tally, od, 1);
            if (gsn_mask_has(region, gsn_lattice_centre(at, x, y, z)))
                add_cell(od, ret_region);
            if (without && without->inside[i])
                add_cell(od, ret_free);
        }
}

int gsn_scale_count_colours(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                            const struct gsn_poses *poses, const struct gsn_densities *d,
                            struct gsn_scale *scale, struct gsn_error *err)
{
    gsn_auto(gsn_cloud_tally) tally = NULL;
    gsn_auto(gsn_mask) without = NULL;
    struct sum inside = { .cells = 0 }, none = { .cells = 0 };
    double before, squares = 0;
    int r;

    mean_of(&inside, scale->region_od);
    mean_of(&none, scale->free_od);
    if (!d->coarse || !region)
        return GSN_OK;
    r = gsn_cloud_new(d->panel_count, &scale->cloud, err);
    if (r >= 0)
        r = gsn_cloud_tally_new(&tally, err);
    if (r >= 0 && specimen->protocol->collagen_free.kind != GSN_REGION_NONE)
        r = gsn_region_raster(&specimen->protocol->collagen_free, &d->coarse->density->at, &without,
                              err);
    for (size_t p = 0; p < d->panel_count && r >= 0; p++) {
        const struct gsn_lattice *at = &d->coarse->density->at;

        if (!d->panel[p].opened)
            continue;
        scale->cloud->panel[p].panel = d->panel[p].stain.panel;
        scale->cloud->panel[p].noise = noise_of(&d->panel[p]);
        scale->cloud->panel[p].lossy = d->panel[p].lossy;
        before = none.cells;
        for (size_t z = 0; z < at->nz; z++)
            if (gsn_panel_of_plane(poses, d, at, z, specimen->protocol->interval_um) == (int)p)
                add_plane(region, d, scale, p, without, z, tally, &inside, &none);
        squares += (none.cells - before) * (none.cells - before);
        r = gsn_cloud_tally_take(tally, &scale->cloud->panel[p], err);
    }
    mean_of(&inside, scale->region_od);
    mean_of(&none, scale->free_od);
    scale->free_panels = squares > 0 ? none.cells * none.cells / squares : 0;
    return r;
}
