/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/section_planes.h"

#include "pipeline/core/robust.h"

#include <assert.h>
#include <math.h>

/* A cell of which less than this share was seen is not known. */
static const double SEEN = 0.5;
/* What is masked counts as this little seen: the cell is in the section's box, so it is no glass.
 */
static const float HIDDEN = 1e-6f;
/* Of one plane: larger specimens are seen in larger cells. */
static const double MOST_CELLS = 80000;

static int is_laid(const struct gsn_assembly_section *s)
{
    return s->posed && (s->state == GSN_SECTION_USED || s->state == GSN_SECTION_DOUBTFUL) &&
           s->seen.width > 0 && s->seen.height > 0;
}

size_t gsn_section_planes_list(const struct gsn_assembly *a, size_t *ret_section)
{
    size_t count = 0;

    for (size_t i = 0; i < a->section_count; i++)
        if (is_laid(&a->section[i]) &&
            (count == 0 ||
             a->section[ret_section[count - 1]].seen.serial != a->section[i].seen.serial))
            ret_section[count++] = i;
    return count;
}

/* One end of a section's box in the block. */
static double end_of(const struct gsn_assembly_section *s, int along_y, double sign)
{
    double most = -INFINITY;

    for (int corner = 0; corner < 4; corner++) {
        const struct gsn_point at = { s->seen.x + (corner & 1 ? s->seen.width : 0),
                                      s->seen.y + (corner & 2 ? s->seen.height : 0) };
        const struct gsn_point p = gsn_affine_apply(&s->pose.panel_to_block_um, at);

        most = fmax(most, sign * (along_y ? p.y : p.x));
    }
    return sign * most;
}

/* The median section's end: a box that holds two sections, or a scrap, does not widen it. */
static double usual_end(const struct gsn_section_planes *planes, const struct gsn_assembly *a,
                        int along_y, double sign, double *room)
{
    for (size_t k = 0; k < planes->count; k++)
        room[k] = end_of(&a->section[planes->section[k]], along_y, sign);
    return gsn_median(room, planes->count);
}

/* Cells no narrower than the coarsest pixel, and no more than are allowed. */
static double wide_enough(const struct gsn_section_planes *planes, const struct gsn_assembly *a,
                          struct gsn_point end)
{
    const double area = (end.x - planes->origin.x) * (end.y - planes->origin.y);
    double wide = fmax(planes->cell_um, sqrt(fmax(area, 0) / MOST_CELLS));

    for (size_t k = 0; k < planes->count; k++) {
        const struct gsn_pose *pose = &a->section[planes->section[k]].pose;

        wide = fmax(wide, sqrt(fabs(gsn_affine_det(&pose->panel_to_block_um))));
    }
    return wide;
}

static void place_cells(struct gsn_section_planes *planes, const struct gsn_assembly *a,
                        double *room)
{
    struct gsn_point end;

    planes->origin =
        (struct gsn_point){ usual_end(planes, a, 0, -1, room), usual_end(planes, a, 1, -1, room) };
    end = (struct gsn_point){ usual_end(planes, a, 0, 1, room), usual_end(planes, a, 1, 1, room) };
    planes->cell_um = wide_enough(planes, a, end);
    planes->columns = (size_t)fmax((end.x - planes->origin.x) / planes->cell_um, 1) + 1;
    planes->rows = (size_t)fmax((end.y - planes->origin.y) / planes->cell_um, 1) + 1;
}

int gsn_section_planes_new(const struct gsn_assembly *a, double cell_um,
                           struct gsn_section_planes **ret_planes, struct gsn_error *err)
{
    gsn_auto(gsn_section_planes) planes = gsn_alloc_array(1, sizeof *planes);
    gsn_auto_mem(double) room = gsn_alloc_array(a->section_count, sizeof *room);

    assert(ret_planes);

    if (planes) {
        planes->cell_um = cell_um;
        planes->section = gsn_alloc_array(a->section_count, sizeof *planes->section);
        planes->held = gsn_alloc_array(a->section_count, sizeof *planes->held);
    }
    if (!planes || !room || !planes->section || !planes->held)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the planes of the sections");
    planes->count = gsn_section_planes_list(a, planes->section);
    if (planes->count == 0) {
        *ret_planes = NULL;
        return GSN_OK;
    }
    place_cells(planes, a, room);
    planes->density =
        gsn_alloc_array(planes->count * planes->rows, planes->columns * sizeof(float));
    planes->seen = gsn_alloc_array(planes->count * planes->rows, planes->columns * sizeof(float));
    if (!planes->density || !planes->seen)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the planes of the sections");
    *ret_planes = gsn_steal(&planes);
    return GSN_OK;
}

void gsn_section_planes_free(struct gsn_section_planes *planes)
{
    if (!planes)
        return;
    for (size_t k = 0; k < planes->held_count; k++)
        gsn_free(planes->held[k].density);
    gsn_free(planes->held);
    gsn_free(planes->section);
    gsn_free(planes->density);
    gsn_free(planes->seen);
    gsn_free(planes);
}

static void gather(struct gsn_section_planes *planes, size_t plane,
                   const struct gsn_assembly_section *s, const struct gsn_plane *density,
                   unsigned apart)
{
    const struct gsn_affine *map = &s->pose.panel_to_block_um;
    const float area = (float)(apart * fabs(gsn_affine_det(map)));
    float *sum = planes->density + plane * planes->columns * planes->rows;
    float *seen = planes->seen + plane * planes->columns * planes->rows;

    for (size_t y = 0; y < density->height; y++)
        for (size_t x = 0; x < density->width; x++) {
            const float value = density->value[y * density->width + x];
            const struct gsn_point at = { s->seen.x + (double)x + 0.5,
                                          s->seen.y + (double)(y * apart) + 0.5 };
            const struct gsn_point p = gsn_affine_apply(map, at);
            const double u = (p.x - planes->origin.x) / planes->cell_um;
            const double v = (p.y - planes->origin.y) / planes->cell_um;

            if (!(u >= 0 && v >= 0 && u < (double)planes->columns && v < (double)planes->rows))
                continue;
            sum[(size_t)v * planes->columns + (size_t)u] += isnan(value) ? 0 : area * value;
            seen[(size_t)v * planes->columns + (size_t)u] += isnan(value) ? HIDDEN * area : area;
        }
}

void gsn_section_planes_add(struct gsn_section_planes *planes, const struct gsn_assembly *a,
                            size_t i, const struct gsn_plane *density, unsigned apart)
{
    for (size_t k = 0; planes && k < planes->count; k++)
        if (planes->section[k] == i)
            gather(planes, k, &a->section[i], density, apart);
}

/* known, seen: samples of each cell, scratch. */
static void gather_apart(struct gsn_section_apart *s, const struct gsn_plane *density,
                         unsigned apart, double px_um, float *known, float *seen)
{
    for (size_t y = 0; y < density->height; y++)
        for (size_t x = 0; x < density->width; x++) {
            const float value = density->value[y * density->width + x];
            const size_t u = (size_t)(((double)x + 0.5) * px_um / s->cell_um);
            const size_t v = (size_t)(((double)(y * apart) + 0.5) * px_um / s->cell_um);
            const size_t cell = v * s->columns + u;

            s->density[cell] += isnan(value) ? 0 : value;
            known[cell] += isnan(value) ? 0.0f : 1.0f;
            seen[cell]++;
        }
    for (size_t c = 0; c < s->columns * s->rows; c++)
        s->density[c] = known[c] > 0 && (double)known[c] >= SEEN * (double)seen[c]
                            ? s->density[c] / known[c]
                        : seen[c] > 0 ? NAN
                                      : 0;
}

int gsn_section_planes_hold(struct gsn_section_planes *planes, size_t i,
                            const struct gsn_plane *density, unsigned apart, double px_um,
                            struct gsn_error *err)
{
    struct gsn_section_apart s = { .section = i };

    if (!planes)
        return GSN_OK;
    s.cell_um = fmax(planes->cell_um / 2, apart * px_um);
    s.columns = (size_t)(density->width * px_um / s.cell_um) + 1;
    s.rows = (size_t)(density->height * apart * px_um / s.cell_um) + 1;

    gsn_auto_mem(float) cells = gsn_alloc_array(s.columns * s.rows, sizeof *cells);
    gsn_auto_mem(float) room = gsn_alloc_array(2 * s.columns * s.rows, sizeof *room);

    if (!cells || !room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the planes of the sections");
    s.density = cells;
    gather_apart(&s, density, apart, px_um, room, room + s.columns * s.rows);
    s.density = gsn_steal(&cells);
    planes->held[planes->held_count++] = s;
    return GSN_OK;
}

static float mean_of(double sum, double seen, double cell_um)
{
    if (seen >= SEEN * cell_um * cell_um)
        return (float)(sum / seen);
    return seen > 0 ? NAN : 0;
}

void gsn_section_planes_settle(struct gsn_section_planes *planes)
{
    const size_t total = planes->count * planes->columns * planes->rows;

    for (size_t i = 0; i < total; i++)
        planes->density[i] =
            mean_of((double)planes->density[i], (double)planes->seen[i], planes->cell_um);
}
