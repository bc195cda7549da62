/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The whole block in coarse cells.
 *
 * A cell of GSN_COARSE_UM holds the mean density and colour of the pixels whose centre lies in it.
 * It is known where half of it was seen, and is tissue where nine tenths of that is no glass.
 *
 * How far each column of cells lies from a region is told by an exact distance transform of the
 * region's shadow on one plane. Fails with GSN_E_NOMEM alone. */
#include "pipeline/specimen/coarse_grid.h"

#include "pipeline/core/distance.h"
#include "pipeline/register/stack/resample.h"
#include "pipeline/stain/optical_density.h"

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
