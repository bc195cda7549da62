/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Density and loss on the cells of a mesh that all specimens share.
 *
 * Method: a voxel of the region is counted to the cell that its centre lies in; a cell's density is
 * the mean of the spline over its voxels, so that the cells of a region add up to the region. Of
 * two specimens the same cells are compared; errors are those that sections make each by itself, as
 * the section-to-section scatter within the columns of cubes shows it.
 *
 * Steps: (1) a table over the cubes that the region's box meets; (2) the spline on the region's
 * lattice slab by slab (model/resample.h), each voxel added to its cell; (3) cells with voxels, in
 * order. The loss: (4) each treated cell looked up in each control; (5) its loss and its error;
 * (6) quantiles by what collagen the control has in each.
 *
 * Failure: GSN_E_INPUT, GSN_E_LIMIT, GSN_E_WITHHELD, GSN_E_NOMEM. Cost: one value of the spline a
 * voxel; the loss takes the number of cells times its logarithm.
 *
 * References: H. Freudenthal, Ann. Math. 43 (1942); H. W. Kuhn, IBM J. Res. Dev. 4 (1960); T.
 * Gasser, L. Sroka, C. Jennen-Steinmetz, Biometrika 73 (1986). */
#include "pipeline/measure/base_cells.h"

#include "pipeline/measure/stats.h"
#include "pipeline/measure/sum.h"
#include "pipeline/model/resample.h"

#include <math.h>
#include <stdlib.h>

/* Voxels that are resampled at a time, where a plane has no more. */
static const size_t SLAB_VOXELS = (size_t)1 << 22;
static const size_t MOST_CELLS = (size_t)1 << 24;

/* Of a normal distribution, two sides. */
static const double QUANTILE_95 = 1.959964;
static const double EDGE = GSN_BASE_EDGE_UM;

/* ---- cells --------------------------------------------------------------------------------- */

/* Axes in order of falling fraction. */
static const int ORDER[GSN_BASE_TETS][3] = { { 0, 1, 2 }, { 0, 2, 1 }, { 1, 0, 2 },
                                             { 1, 2, 0 }, { 2, 0, 1 }, { 2, 1, 0 } };

struct gsn_base_address gsn_base_find(struct gsn_vec3 point_um)
{
    const double u[3] = { point_um.x / EDGE, point_um.y / EDGE, point_um.z / EDGE };
    struct gsn_base_address ret = { .tet = 0 };
    double f[3];

    for (int a = 0; a < 3; a++) {
        const double cube = floor(u[a]);

        ret.cube[a] = (int32_t)fmax(INT32_MIN, fmin(INT32_MAX, cube));
        f[a] = u[a] - cube;
    }
    while (ret.tet < GSN_BASE_TETS - 1 && (f[ORDER[ret.tet][0]] < f[ORDER[ret.tet][1]] ||
                                           f[ORDER[ret.tet][1]] < f[ORDER[ret.tet][2]]))
        ret.tet++;
    return ret;
}

void gsn_base_corners(struct gsn_base_address address, double ret_corner[4][3])
{
    for (int a = 0; a < 3; a++)
        for (int k = 0; k < 4; k++)
            ret_corner[k][a] = EDGE * address.cube[a];
    for (int k = 1; k < 4; k++)
        for (int later = k; later < 4; later++)
            ret_corner[later][ORDER[address.tet][k - 1]] += EDGE;
}

int gsn_base_compare(struct gsn_base_address a, struct gsn_base_address b)
{
    for (int axis = 2; axis >= 0; axis--)
        if (a.cube[axis] != b.cube[axis])
            return a.cube[axis] < b.cube[axis] ? -1 : 1;
    return (int)a.tet - (int)b.tet;
}

/* The cubes that a region's box meets. */
struct table {
    int32_t first[3];
    size_t n[3], cells;
};

static size_t place_in(const struct table *table, struct gsn_base_address address)
{
    size_t at[3];

    for (int a = 0; a < 3; a++)
        at[a] = (size_t)(address.cube[a] - table->first[a]);
    return ((at[2] * table->n[1] + at[1]) * table->n[0] + at[0]) * GSN_BASE_TETS + address.tet;
}

static int span_region(const struct gsn_mask *region, struct table *ret_table,
                       struct gsn_error *err)
{
    double low[3], high[3], cells = GSN_BASE_TETS;

    gsn_mask_box(region, low, high);
    if (!(low[0] < high[0]))
        return gsn_fail(err, GSN_E_INPUT, "the region of interest is empty");
    for (int a = 0; a < 3; a++) {
        const double first = floor(low[a] / EDGE), n = floor(high[a] / EDGE) - first + 1;

        cells *= n;
        if (!(cells <= (double)MOST_CELLS) || fabs(first) > 1e9)
            return gsn_fail(err, GSN_E_LIMIT,
                            "the region of interest is %.3g um long: more than %zu cells of %d um",
                            high[a] - low[a], MOST_CELLS, GSN_BASE_EDGE_UM);
        ret_table->first[a] = (int32_t)first;
        ret_table->n[a] = (size_t)n;
    }
    ret_table->cells = (size_t)cells;
    return GSN_OK;
}

/* What is gathered of one cell. */
struct gathered {
    struct gsn_sum sum;
    size_t voxels, plane, in_plane; /* in_plane: of the plane that was seen last */
    double squares;                 /* of the planes before, voxels of each squared */
};

static void gather_voxel(struct gathered *g, size_t plane, double value)
{
    if (g->voxels > 0 && g->plane != plane) {
        g->squares += (double)g->in_plane * (double)g->in_plane;
        g->in_plane = 0;
    }
    g->plane = plane;
    g->in_plane++;
    g->voxels++;
    gsn_sum_add(&g->sum, value);
}

/* The planes first .. first + slab->nz of the region, whose values these are. */
static int gather_slab(const struct gsn_mask *region, const struct gsn_lattice *slab, size_t first,
                       const double *value, const struct table *table, struct gathered *gathered,
                       struct gsn_error *err)
{
    for (size_t i = 0; i < gsn_lattice_count(slab); i++) {
        const size_t x = i % slab->nx, y = i / slab->nx % slab->ny, z = i / slab->nx / slab->ny;
        const struct gsn_vec3 centre = gsn_lattice_centre(&region->at, x, y, first + z);

        if (!region->inside[gsn_lattice_index(&region->at, x, y, first + z)])
            continue;
        if (isnan(value[i]))
            return gsn_fail(err, GSN_E_INPUT,
                            "the region's voxel at (%g, %g, %g) um lies outside of the model",
                            centre.x, centre.y, centre.z);
        gather_voxel(&gathered[place_in(table, gsn_base_find(centre))], first + z, value[i]);
    }
    return GSN_OK;
}

static int gather_cells(const struct gsn_spline *spline, const struct gsn_mask *region,
                        unsigned threads, const struct table *table, struct gathered *gathered,
                        struct gsn_error *err)
{
    const struct gsn_lattice *const at = &region->at;
    const size_t plane = at->nx * at->ny;
    const size_t planes = plane < SLAB_VOXELS ? SLAB_VOXELS / plane : 1;
    gsn_auto_mem(double) value = NULL;
    int r = GSN_OK;

    value = gsn_alloc_array(plane * (planes < at->nz ? planes : at->nz), sizeof *value);
    if (!value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu voxels", plane);
    for (size_t first = 0; r >= 0 && first < at->nz; first += planes) {
        struct gsn_lattice slab = *at;

        slab.nz = planes < at->nz - first ? planes : at->nz - first;
        slab.origin_um = gsn_lattice_centre(at, 0, 0, first);
        r = gsn_spline_resample(spline, &slab, threads, value, err);
        if (r >= 0)
            r = gather_slab(region, &slab, first, value, table, gathered, err);
    }
    return r;
}

static struct gsn_base_cell make_cell(const struct table *table, size_t place,
                                      const struct gathered *g, double voxel_um3)
{
    const size_t cube = place / GSN_BASE_TETS, voxels = g->voxels;
    const double last = (double)g->in_plane;

    return (struct gsn_base_cell){
        .address = { .cube = { table->first[0] + (int32_t)(cube % table->n[0]),
                               table->first[1] + (int32_t)(cube / table->n[0] % table->n[1]),
                               table->first[2] + (int32_t)(cube / table->n[0] / table->n[1]) },
                     .tet = (uint8_t)(place % GSN_BASE_TETS) },
        .mean = (g->sum.value + g->sum.rest) / (double)voxels,
        .volume_um3 = (double)voxels * voxel_um3,
        .planes = (double)voxels * (double)voxels / (g->squares + last * last),
    };
}

void gsn_base_cells_free(struct gsn_base_cells *cells)
{
    if (!cells)
        return;
    gsn_free(cells->cell);
    gsn_free(cells);
}

int gsn_base_cells_new(const struct gsn_spline *spline, const struct gsn_mask *region,
                       unsigned threads, struct gsn_base_cells **ret_cells, struct gsn_error *err)
{
    const double voxel_um3 = gsn_lattice_voxel_um3(&region->at);
    gsn_auto(gsn_base_cells) cells = gsn_alloc_array(1, sizeof *cells);
    gsn_auto_mem(struct gathered) gathered = NULL;
    struct table table = { .cells = 0 };
    size_t used = 0;
    int r = span_region(region, &table, err);

    if (r < 0)
        return r;
    gathered = gsn_alloc_array(table.cells, sizeof *gathered);
    if (!cells || !gathered)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", table.cells);
    r = gather_cells(spline, region, threads, &table, gathered, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < table.cells; i++)
        used += gathered[i].voxels > 0;
    cells->cell = gsn_alloc_array(used, sizeof *cells->cell);
    if (!cells->cell)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", used);
    for (size_t i = 0; i < table.cells; i++)
        if (gathered[i].voxels > 0)
            cells->cell[cells->count++] = make_cell(&table, i, &gathered[i], voxel_um3);
    *ret_cells = gsn_steal(&cells);
    return GSN_OK;
}

/* ---- what sections err ---------------------------------------------------------------------- */

/* One column of cubes, plane after plane. */
struct column {
    double sum[3], voxels[3]; /* of this plane, the one before, and the one before that */
};

static void end_plane(struct column *c, double *squares, double *weights)
{
    if (c->voxels[0] > 0 && c->voxels[1] > 0 && c->voxels[2] > 0) {
        const double here = c->sum[0] / c->voxels[0], middle = c->sum[1] / c->voxels[1];
        const double off = middle - 0.5 * (here + c->sum[2] / c->voxels[2]);

        *squares += c->voxels[1] * off * off;
        *weights += c->voxels[1];
    }
    for (int k = 2; k > 0; k--) {
        c->sum[k] = c->sum[k - 1];
        c->voxels[k] = c->voxels[k - 1];
    }
    c->sum[0] = c->voxels[0] = 0;
}

int gsn_base_plane_error(const struct gsn_grid *grid, const struct gsn_mask *region,
                         double *ret_error, struct gsn_error *err)
{
    const struct gsn_lattice *const at = &grid->at;
    const struct gsn_vec3 end = gsn_lattice_centre(at, at->nx - 1, at->ny - 1, 0);
    const struct gsn_base_address first = gsn_base_find(gsn_lattice_centre(at, 0, 0, 0));
    const struct gsn_base_address last = gsn_base_find(end);
    const size_t nx = (size_t)(last.cube[0] - first.cube[0]) + 1;
    const size_t count = nx * ((size_t)(last.cube[1] - first.cube[1]) + 1);
    gsn_auto_mem(struct column) column = gsn_alloc_array(count, sizeof *column);
    double squares = 0, weights = 0;

    if (!column)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu columns", count);
    for (size_t z = 0; z < at->nz; z++) {
        for (size_t i = 0; i < at->nx * at->ny; i++) {
            const struct gsn_vec3 centre = gsn_lattice_centre(at, i % at->nx, i / at->nx, z);
            const double value = (double)grid->value[z * at->nx * at->ny + i];
            const struct gsn_base_address cell = gsn_base_find(centre);
            struct column *const c = &column[(size_t)(cell.cube[1] - first.cube[1]) * nx +
                                             (size_t)(cell.cube[0] - first.cube[0])];

            if (isnan(value) || !gsn_mask_has(region, centre))
                continue;
            c->sum[0] += value;
            c->voxels[0]++;
        }
        for (size_t i = 0; i < count; i++)
            end_plane(&column[i], &squares, &weights);
    }
    *ret_error = weights > 0 ? sqrt(squares / weights / 1.5) : (double)NAN;
    return GSN_OK;
}

/* ---- the loss ------------------------------------------------------------------------------- */

static int compare_cells(const void *a, const void *b)
{
    return gsn_base_compare(((const struct gsn_base_cell *)a)->address,
                            ((const struct gsn_base_cell *)b)->address);
}

static const struct gsn_base_cell *find_cell(const struct gsn_base_cells *cells,
                                             const struct gsn_base_cell *like)
{
    return cells->count ? bsearch(like, cells->cell, cells->count, sizeof *like, compare_cells)
                        : NULL;
}

/* Variance of a cell's mean. */
static double variance_of(const struct gsn_base_side *side, const struct gsn_base_cell *cell)
{
    return side->plane_error * side->plane_error / cell->planes;
}

/* The mean of the controls in one treated cell. Returns how many have it. */
static size_t average_controls(const struct gsn_base_side *control, size_t controls,
                               const struct gsn_base_cell *treated,
                               const struct gsn_loss_scale *scale, struct gsn_loss_cell *ret)
{
    double mean = 0, variance = 0, volume = 0;
    size_t n = 0;

    for (size_t k = 0; k < controls; k++) {
        const struct gsn_base_cell *const cell = find_cell(control[k].cells, treated);

        if (!cell)
            continue;
        mean += cell->mean;
        variance += variance_of(&control[k], cell);
        volume += cell->volume_um3;
        n++;
    }
    if (n == 0)
        return 0;
    ret->control = scale->gain * mean / (double)n + scale->offset;
    ret->control_error = fabs(scale->gain) * sqrt(variance) / (double)n;
    ret->volume_um3 = fmin(treated->volume_um3, volume / (double)n);
    return n;
}

/* What is lost in a cell of both. Returns 0 where the control's density cannot be told from none:
 * there is nothing to lose. */
static int lose(const struct gsn_base_side *treated, const struct gsn_base_cell *cell, double zero,
                struct gsn_loss_cell *c)
{
    const double there = c->control - zero, here = cell->mean - zero;
    double remains;

    if (!(there > 0) || there <= QUANTILE_95 * c->control_error)
        return 0;
    remains = here / there;
    c->address = cell->address;
    c->treated = cell->mean;
    c->treated_error = sqrt(variance_of(treated, cell));
    c->percent = 100 * (1 - remains);
    c->error = 100 / there * hypot(c->treated_error, remains * c->control_error);
    return 1;
}

/* Over the cells, each by what collagen the control has in it. */
static int sum_up(double zero, struct gsn_loss_map *map, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_weighed) sorted = gsn_alloc_array(map->count, sizeof *sorted);
    double weight = 0, squares = 0;

    if (!sorted)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", map->count);
    for (size_t i = 0; i < map->count; i++) {
        const struct gsn_loss_cell *const c = &map->cell[i];

        sorted[i] = (struct gsn_weighed){ c->percent, c->volume_um3 * (c->control - zero) };
        weight += sorted[i].weight;
        squares += sorted[i].weight * c->error * c->error;
    }
    gsn_weighed_sort(sorted, map->count);
    map->low = gsn_weighed_quantile(sorted, map->count, 0.05);
    map->median = gsn_weighed_quantile(sorted, map->count, 0.5);
    map->high = gsn_weighed_quantile(sorted, map->count, 0.95);
    map->noise = sqrt(squares / weight);
    return GSN_OK;
}

void gsn_loss_map_free(struct gsn_loss_map *map)
{
    if (!map)
        return;
    gsn_free(map->cell);
    gsn_free(map);
}

int gsn_loss_map_new(const struct gsn_base_side *control, size_t controls,
                     const struct gsn_base_side *treated, const struct gsn_loss_scale *scale,
                     struct gsn_loss_map **ret_map, struct gsn_error *err)
{
    const struct gsn_base_cells *const cells = treated->cells;
    gsn_auto(gsn_loss_map) map = gsn_alloc_array(1, sizeof *map);
    double volume = 0, shared = 0;
    int r;

    if (map)
        map->cell = gsn_alloc_array(cells->count, sizeof *map->cell);
    if (!map || !map->cell)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", cells->count);
    for (size_t i = 0; i < cells->count; i++) {
        struct gsn_loss_cell *const c = &map->cell[map->count];

        volume += cells->cell[i].volume_um3;
        if (!average_controls(control, controls, &cells->cell[i], scale, c))
            continue;
        shared += c->volume_um3;
        map->count += (size_t)lose(treated, &cells->cell[i], scale->zero, c);
    }
    map->shared = volume > 0 ? shared / volume : 0;
    if (!(shared > 0))
        return gsn_fail(err, GSN_E_WITHHELD,
                        "the two regions have no piece of the block in common");
    if (map->count == 0)
        return gsn_fail(err, GSN_E_WITHHELD,
                        "the baseline's density is nowhere told from none: nothing can be lost");
    r = sum_up(scale->zero, map, err);
    if (r < 0)
        return r;
    *ret_map = gsn_steal(&map);
    return GSN_OK;
}

static int compare_losses(const void *a, const void *b)
{
    return gsn_base_compare(((const struct gsn_loss_cell *)a)->address,
                            ((const struct gsn_loss_cell *)b)->address);
}

double gsn_loss_map_at(const struct gsn_loss_map *map, struct gsn_vec3 point_um)
{
    const struct gsn_loss_cell like = { .address = gsn_base_find(point_um) };
    const struct gsn_loss_cell *const found =
        bsearch(&like, map->cell, map->count, sizeof like, compare_losses);

    return found ? found->percent : (double)NAN;
}
