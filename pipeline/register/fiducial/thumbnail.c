/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: correlation with a mean picture of the aligned sections, at 40 x 40 cells.
 *
 * Steps. gsn_thumbnail_take() averages the cells of the field. gsn_thumbnail_mean() lays each
 * section's thumbnail on the median cell size by its motion, nearest cell, and averages what at
 * least half of the sections show. gsn_thumbnail_dissimilarity() is 1 - r^2 over the cells that
 * both have; darker than the mean's darkest counts as that, since ink is no tissue.
 *
 * Fails when memory runs out. Cost: 1600 cells a comparison. */
#include "pipeline/register/fiducial/thumbnail.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"

#include <assert.h>
#include <math.h>
#include <string.h>

enum { SIDE = GSN_THUMBNAIL_SIDE, CELLS = SIDE * SIDE };

/* A cell of the mean needs this share of the sections, and a comparison this share of its cells. */
static const double SHARE = 0.5;

static struct gsn_tissue_thumbnail make_empty(void)
{
    struct gsn_tissue_thumbnail map = { 0 };

    for (size_t i = 0; i < CELLS; i++)
        map.value[i] = NAN;
    return map;
}

/* Of step x step cells; rows add up by themselves, so that one need not wait for the other. */
static float mean_of(const float *od, size_t stride, size_t step)
{
    double all = 0;

    for (size_t y = 0; y < step; y++) {
        float sum = 0;

        for (size_t x = 0; x < step; x++)
            sum += od[y * stride + x];
        all += (double)sum;
    }
    return (float)(all / (double)(step * step));
}

void gsn_thumbnail_take(const struct gsn_blob_field *field, struct gsn_tissue_thumbnail *ret_map)
{
    const size_t longer = field->width > field->height ? field->width : field->height;
    const size_t step = (longer + SIDE - 1) / SIDE;
    struct gsn_tissue_thumbnail map = make_empty();

    for (size_t row = 0; step > 0 && row < field->height / step; row++) {
        const float *od = field->od + row * step * field->width;

        for (size_t column = 0; column < field->width / step; column++)
            map.value[row * SIDE + column] = mean_of(od + column * step, field->width, step);
    }
    map.cell = (double)step * field->cell_px;
    map.origin = field->origin_px;
    *ret_map = map;
}

static struct gsn_point centre_of(const struct gsn_tissue_thumbnail *map, size_t cell)
{
    return (struct gsn_point){ map->origin.x + ((double)(cell % SIDE) + 0.5) * map->cell,
                               map->origin.y + ((double)(cell / SIDE) + 0.5) * map->cell };
}

/* From the block, um, to the column and row of a section's map. */
static struct gsn_affine to_map(const struct gsn_fiducial_candidates *section,
                                const struct gsn_rigid *motion, int mirrored)
{
    const struct gsn_tissue_thumbnail *map = &section->map;
    const double cell_um = map->cell * section->px_um, face = mirrored ? -1 : 1;
    const double c = motion->cos / cell_um, s = motion->sin / cell_um;

    return (struct gsn_affine){
        .m00 = face * c,
        .m01 = face * s,
        .m02 = -face * (c * motion->dx + s * motion->dy) - map->origin.x / map->cell,
        .m10 = -s,
        .m11 = c,
        .m12 = s * motion->dx - c * motion->dy - map->origin.y / map->cell
    };
}

/* What a section shows where the cells of a mean's row lie, or NaN. */
static void see_row(const struct gsn_tissue_thumbnail *map, const struct gsn_affine *to_cells,
                    const struct gsn_tissue_thumbnail *mean, size_t row, float seen[SIDE])
{
    const struct gsn_point block = centre_of(mean, row * SIDE);
    const struct gsn_point first = gsn_affine_apply(to_cells, block);
    const double dx = to_cells->m00 * mean->cell, dy = to_cells->m10 * mean->cell;

    for (size_t i = 0; i < SIDE; i++) {
        const double x = first.x + (double)(int)i * dx, y = first.y + (double)(int)i * dy;
        const int is = x >= 0 && y >= 0 && x < SIDE && y < SIDE;

        seen[i] = is ? map->value[(int)y * SIDE + (int)x] : NAN;
    }
}

static int typical_cell(const struct gsn_fiducial_candidates *sections, const int *used,
                        size_t count, double *ret_cell, struct gsn_error *err)
{
    gsn_auto_mem(double) cell = gsn_alloc_array(count, sizeof *cell);
    size_t n = 0;

    if (!cell)
        return gsn_fail(err, GSN_E_NOMEM,
                        "out of memory while learning what the tissue looks like");
    for (size_t i = 0; i < count; i++)
        if (used[i] && sections[i].map.cell > 0)
            cell[n++] = sections[i].map.cell * sections[i].px_um;
    *ret_cell = n > 0 ? gsn_median(cell, n) : 0;
    return GSN_OK;
}

/* Adds what a section shows to each cell of the mean that it shows. */
static void add_section(const struct gsn_fiducial_candidates *section,
                        const struct gsn_rigid *motion, int mirrored,
                        const struct gsn_tissue_thumbnail *mean, double *sum, double *n)
{
    const struct gsn_affine to_cells = to_map(section, motion, mirrored);

    for (size_t row = 0; row < SIDE; row++) {
        float seen[SIDE];

        see_row(&section->map, &to_cells, mean, row, seen);
        for (size_t i = 0; i < SIDE; i++) {
            sum[row * SIDE + i] += isnan(seen[i]) ? 0 : (double)seen[i];
            n[row * SIDE + i] += !isnan(seen[i]);
        }
    }
}

int gsn_thumbnail_mean(const struct gsn_fiducial_candidates *sections,
                       const struct gsn_rigid *motions, const int *mirrored, const int *used,
                       size_t count, struct gsn_point centre_um,
                       struct gsn_tissue_thumbnail *ret_tissue, struct gsn_error *err)
{
    struct gsn_tissue_thumbnail tissue = make_empty();
    double sum[CELLS] = { 0 }, n[CELLS] = { 0 }, all = 0;
    const int r = typical_cell(sections, used, count, &tissue.cell, err);

    assert(ret_tissue);

    if (r < 0)
        return r;
    tissue.origin = (struct gsn_point){ centre_um.x - 0.5 * SIDE * tissue.cell,
                                        centre_um.y - 0.5 * SIDE * tissue.cell };
    for (size_t i = 0; i < count && tissue.cell > 0; i++) {
        if (!used[i] || !(sections[i].map.cell > 0))
            continue;
        add_section(&sections[i], &motions[i], mirrored[i], &tissue, sum, n);
        all += 1;
    }
    for (size_t k = 0; k < CELLS; k++)
        if (n[k] > 0 && n[k] >= SHARE * all)
            tissue.value[k] = (float)(sum[k] / n[k]);
    *ret_tissue = tissue;
    return GSN_OK;
}

static float find_largest(const struct gsn_tissue_thumbnail *map)
{
    float most = 0;

    for (size_t i = 0; i < CELLS; i++)
        most = map->value[i] > most ? map->value[i] : most;
    return most;
}

/* What a correlation coefficient is made of. */
struct moments {
    double n, x, y, xx, xy, yy;
};

static void add_pair(struct moments *m, double x, double y)
{
    m->n += 1;
    m->x += x;
    m->y += y;
    m->xx += x * x;
    m->xy += x * y;
    m->yy += y * y;
}

static double find_dissimilarity(const struct moments *m)
{
    const double xx = m->xx - m->x * m->x / m->n, xy = m->xy - m->x * m->y / m->n;
    const double yy = m->yy - m->y * m->y / m->n;

    return xy > 0 && xx > 0 && yy > 0 ? 1 - fmin(xy * xy / (xx * yy), 1) : 1;
}

double gsn_thumbnail_dissimilarity(const struct gsn_fiducial_candidates *section,
                                   const struct gsn_tissue_thumbnail *tissue,
                                   const struct gsn_rigid *motion, int mirrored)
{
    struct gsn_affine to_cells;
    struct moments both = { 0 };
    double all = 0;
    float most;

    assert(section && tissue && motion);

    if (!(tissue->cell > 0) || !(section->map.cell > 0))
        return 1;
    /* Ink and edges of glass are darker than any tissue, and would speak louder than it. */
    most = find_largest(tissue);
    to_cells = to_map(section, motion, mirrored);
    for (size_t row = 0; row < SIDE; row++) {
        const float *mean = tissue->value + row * SIDE;
        float seen[SIDE];

        see_row(&section->map, &to_cells, tissue, row, seen);
        for (size_t i = 0; i < SIDE; i++) {
            all += !isnan(mean[i]);
            if (!isnan(mean[i]) && !isnan(seen[i]))
                add_pair(&both, (double)mean[i], (double)(seen[i] < most ? seen[i] : most));
        }
    }
    return both.n > SHARE * all ? find_dissimilarity(&both) : 1;
}
