/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_map.h"

#include "pipeline/core/mem.h"
#include "pipeline/register/median.h"

#include <assert.h>
#include <math.h>
#include <string.h>

enum { SIDE = GSN_MARK_MAP, CELLS = SIDE * SIDE };

/* A cell of the mean needs this share of the sections, and a comparison this share of its cells. */
static const double SHARE = 0.5;

static struct gsn_mark_map empty(void)
{
    struct gsn_mark_map map = { 0 };

    for (size_t i = 0; i < CELLS; i++)
        map.value[i] = NAN;
    return map;
}

void gsn_mark_map_take(const struct gsn_mark_field *field, struct gsn_mark_map *ret_map)
{
    const size_t longer = field->width > field->height ? field->width : field->height;
    const size_t step = (longer + SIDE - 1) / SIDE;
    struct gsn_mark_map map = empty();

    for (size_t i = 0; i < CELLS && step > 0; i++) {
        const size_t x0 = i % SIDE * step, y0 = i / SIDE * step;
        double sum = 0;

        if (x0 + step > field->width || y0 + step > field->height)
            continue;
        for (size_t y = y0; y < y0 + step; y++)
            for (size_t x = x0; x < x0 + step; x++)
                sum += (double)field->od[y * field->width + x];
        map.value[i] = (float)(sum / (double)(step * step));
    }
    map.cell = (double)step * field->cell_px;
    map.origin = field->origin_px;
    *ret_map = map;
}

/* The value of the cell at a point, or NaN. */
static float value_at(const struct gsn_mark_map *map, double x, double y)
{
    const double column = (x - map->origin.x) / map->cell, row = (y - map->origin.y) / map->cell;

    if (!(column >= 0 && row >= 0 && column < SIDE && row < SIDE))
        return NAN;
    return map->value[(size_t)row * SIDE + (size_t)column];
}

static struct gsn_point centre_of(const struct gsn_mark_map *map, size_t cell)
{
    return (struct gsn_point){ map->origin.x + ((double)(cell % SIDE) + 0.5) * map->cell,
                               map->origin.y + ((double)(cell / SIDE) + 0.5) * map->cell };
}

/* What a section shows where a point of the block lies. */
static float seen_at(const struct gsn_mark_candidates *section, const struct gsn_rigid *motion,
                     int mirrored, struct gsn_point block)
{
    const double dx = block.x - motion->dx, dy = block.y - motion->dy;
    const double x = motion->cos * dx + motion->sin * dy, y = motion->cos * dy - motion->sin * dx;

    return value_at(&section->map, (mirrored ? -x : x) / section->px_um, y / section->px_um);
}

static int typical_cell(const struct gsn_mark_candidates *sections, const int *used, size_t count,
                        double *ret_cell, struct gsn_error *err)
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

int gsn_mark_map_mean(const struct gsn_mark_candidates *sections, const struct gsn_rigid *motions,
                      const int *mirrored, const int *used, size_t count,
                      struct gsn_point centre_um, struct gsn_mark_map *ret_tissue,
                      struct gsn_error *err)
{
    struct gsn_mark_map tissue = empty();
    const int r = typical_cell(sections, used, count, &tissue.cell, err);

    assert(ret_tissue);

    if (r < 0)
        return r;
    tissue.origin = (struct gsn_point){ centre_um.x - 0.5 * SIDE * tissue.cell,
                                        centre_um.y - 0.5 * SIDE * tissue.cell };
    for (size_t k = 0; k < CELLS && tissue.cell > 0; k++) {
        const struct gsn_point at = centre_of(&tissue, k);
        double sum = 0, n = 0, all = 0;

        for (size_t i = 0; i < count; i++) {
            const float value = used[i] && sections[i].map.cell > 0
                                    ? seen_at(&sections[i], &motions[i], mirrored[i], at)
                                    : NAN;

            all += used[i] && sections[i].map.cell > 0;
            sum += isnan(value) ? 0 : (double)value;
            n += !isnan(value);
        }
        if (n > 0 && n >= SHARE * all)
            tissue.value[k] = (float)(sum / n);
    }
    *ret_tissue = tissue;
    return GSN_OK;
}

static float largest(const struct gsn_mark_map *map)
{
    float most = 0;

    for (size_t i = 0; i < CELLS; i++)
        most = map->value[i] > most ? map->value[i] : most;
    return most;
}

double gsn_mark_map_unlike(const struct gsn_mark_candidates *section,
                           const struct gsn_mark_map *tissue, const struct gsn_rigid *motion,
                           int mirrored)
{
    double n = 0, all = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0;
    float most;

    assert(section && tissue && motion);

    if (!(tissue->cell > 0) || !(section->map.cell > 0))
        return 1;
    /* Ink and edges of glass are darker than any tissue, and would speak louder than it. */
    most = largest(tissue);
    for (size_t k = 0; k < CELLS; k++) {
        float seen;

        if (isnan(tissue->value[k]))
            continue;
        all += 1;
        seen = seen_at(section, motion, mirrored, centre_of(tissue, k));
        if (isnan(seen))
            continue;
        seen = fminf(seen, most);
        n += 1;
        x += (double)tissue->value[k];
        y += (double)seen;
        xx += (double)tissue->value[k] * (double)tissue->value[k];
        xy += (double)tissue->value[k] * (double)seen;
        yy += (double)seen * (double)seen;
    }
    if (!(n > SHARE * all))
        return 1;
    xx -= x * x / n;
    xy -= x * y / n;
    yy -= y * y / n;
    return xy > 0 && xx > 0 && yy > 0 ? 1 - fmin(xy * xy / (xx * yy), 1) : 1;
}
