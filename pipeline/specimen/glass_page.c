/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The page of large sections beside the report.
 *
 * Steps: (1) the pictures and masks that the stack coded as panels passed (aligned_pictures.c); (2)
 * of each section its plane of the density on the common scale, with the region, as codes of a
 * picture; (3) the page (report/html_glass.c), kept as a file of the run.
 *
 * A plane belongs to the section whose slab its voxels' middles lie in. Where there is no analysis
 * there is no density: what is withheld is not shown either.
 *
 * Failure: GSN_E_NOMEM. Cost: the pictures' bytes, once more as base64. */
#include "pipeline/specimen/report_builder.h"

#include "pipeline/decode/png_write.h"

#include <math.h>
#include <stdio.h>

/* The plane of the grid at this depth; -1: none is nearer than half a step. */
static long plane_at(const struct gsn_lattice *at, double z_um)
{
    const double k = (z_um - at->origin_um.z) / at->step_um.z, nearest = rint(k);

    return fabs(k - nearest) < 0.5 && nearest >= 0 && nearest < (double)at->nz ? (long)nearest : -1;
}

static uint8_t code_of(double value, double low, double high)
{
    if (!isfinite(value))
        return 0;
    return (uint8_t)(1 + lrint(254 * fmin(fmax((value - low) / (high - low), 0), 1)));
}

/* gives the bytes of ret_map. */
static int draw_plane(const struct gsn_report_inputs *e, size_t z, struct gsn_report_png *ret_map,
                      struct gsn_error *err)
{
    const struct gsn_grid *grid = e->reconstruction->densities.grid;
    const size_t count = grid->at.nx * grid->at.ny, first = z * count;
    gsn_auto(gsn_image) map = NULL;
    uint8_t *bytes = NULL;
    int r = gsn_image_new((uint32_t)grid->at.nx, (uint32_t)grid->at.ny, 3, 8, &map, err);

    for (size_t i = 0; r >= 0 && i < count; i++) {
        uint8_t *const pixel = (uint8_t *)map->samples + 3 * i;

        pixel[0] = code_of(grid->value[first + i], e->analysis->low, e->analysis->high);
        pixel[1] = e->region->inside[first + i] ? 255 : 0;
    }
    if (r >= 0)
        r = gsn_png_encode(map, &bytes, &ret_map->size, err);
    if (r < 0)
        return r;
    ret_map->bytes = bytes;
    ret_map->width = map->width;
    ret_map->height = map->height;
    return GSN_OK;
}

static int has_densities(const struct gsn_report_inputs *e)
{
    const struct gsn_grid *grid = e->reconstruction->densities.grid;

    return e->analysis && e->region && grid && e->analysis->high > e->analysis->low &&
           e->region->at.nx == grid->at.nx && e->region->at.ny == grid->at.ny &&
           e->region->at.nz == grid->at.nz;
}

static int draw_densities(const struct gsn_report_inputs *e, struct gsn_builder *d,
                          struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && has_densities(e) && i < d->report.section_count; i++) {
        struct gsn_report_section *s = &d->section[i];
        const long z = plane_at(&e->reconstruction->densities.grid->at, s->z_um);

        if (s->glass.size && z >= 0)
            r = draw_plane(e, (size_t)z, &s->density_map, err);
    }
    return r;
}

static void describe_glass(const struct gsn_report_inputs *e, const char *const *reasons,
                           struct gsn_report_glass *glass)
{
    const struct gsn_densities *shown = &e->reconstruction->densities;

    *glass = (struct gsn_report_glass){ .corner_um = shown->aligned_corner,
                                        .um_per_px = shown->glass_um_per_px,
                                        .masked_um_per_px = shown->masked_um_per_px,
                                        .reasons = reasons,
                                        .reason_count = GSN_DEFECTS };
    if (has_densities(e)) {
        const struct gsn_lattice *at = &shown->grid->at;

        glass->density_corner_um = (struct gsn_point){ at->origin_um.x - 0.5 * at->step_um.x,
                                                       at->origin_um.y - 0.5 * at->step_um.y };
        glass->density_um_per_px = (struct gsn_point){ at->step_um.x, at->step_um.y };
        glass->density_low = e->analysis->low;
        glass->density_high = e->analysis->high;
    }
}

static void give_pictures(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    for (size_t i = 0; i < d->report.section_count; i++) {
        const struct gsn_section_density *s = &e->reconstruction->densities.section[i];

        d->section[i].glass =
            (struct gsn_report_png){ s->glass.png, s->glass.size, s->glass.width, s->glass.height };
        d->section[i].masked_map =
            (struct gsn_report_png){ s->masked_map.png, s->masked_map.size, s->masked_map.width,
                                     s->masked_map.height };
    }
}

int gsn_builder_glass(const struct gsn_report_inputs *e, struct gsn_builder *d,
                      struct gsn_specimen_result *result, struct gsn_error *err)
{
    struct gsn_specimen_file *const file = &result->file[result->file_count];
    const char *reasons[GSN_DEFECTS];
    char *page = NULL;
    int r;

    if (!(e->reconstruction->densities.glass_um_per_px > 0))
        return GSN_OK;
    for (unsigned i = 0; i < GSN_DEFECTS; i++)
        reasons[i] = gsn_defect_word(i);
    describe_glass(e, reasons, &d->glass);
    d->report.glass = &d->glass;
    give_pictures(e, d);
    r = draw_densities(e, d, err);
    if (r >= 0)
        r = gsn_report_glass_page(&d->report, &page, &file->size, err);
    for (size_t i = 0; i < d->report.section_count; i++) {
        gsn_free((void *)(uintptr_t)d->section[i].density_map.bytes);
        d->section[i].density_map = (struct gsn_report_png){ .size = 0 };
    }
    d->glass.reasons = NULL;
    d->glass.reason_count = 0;
    if (r < 0)
        return r;
    file->bytes = (uint8_t *)page;
    (void)snprintf(file->name, sizeof file->name, "%s", GSN_REPORT_GLASS_FILE);
    result->file_count++;
    return GSN_OK;
}
