/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"

#include "pipeline/evenness.h"

#include <math.h>
#include <string.h>
#include <stdio.h>

/* Panels that have a section in the planes of the grid. */
static size_t panels_inside(const struct gsn_assembly *a, double interval_um)
{
    const struct gsn_lattice *at = &a->grid->at;
    unsigned last = 0;
    size_t count = 0;

    /* Sections are sorted by serial number, so those of one panel follow each other. */
    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_assembly_section *s = &a->section[i];
        const double z = interval_um * (s->seen.serial + 0.5);

        if ((s->state != GSN_SECTION_USED && s->state != GSN_SECTION_DOUBTFUL) ||
            s->panel == last || z < at->origin_um.z - 0.5 * at->step_um.z ||
            z > at->origin_um.z + ((double)at->nz - 0.5) * at->step_um.z)
            continue;
        last = s->panel;
        count++;
    }
    return count;
}

/* What the stain that all panels have in common may be off by, where no tissue was stated. */
static void judge_evenness(const struct gsn_specimen *specimen, struct gsn_assembly *a)
{
    double strength[64];
    struct gsn_evenness evenness;
    size_t count = 0, inside;

    if (!a->grid || a->by_standards || (a->tissue_grid && !a->not_comparable[0]))
        return;
    for (size_t p = 0; p < a->panel_count && count < sizeof strength / sizeof strength[0]; p++)
        if (a->panel[p].opened)
            strength[count++] = a->panel[p].strength;
    /* Panels that were levelled all have a part in the region's scale. */
    inside = a->levelling.done ? count : panels_inside(a, specimen->protocol->interval_um);
    evenness = gsn_evenness_of(strength, count, inside > 0 ? inside : 1);
    a->stain_scatter = evenness.scatter;
    a->common_error = evenness.error;
}

/* Shares of the region's voxels by levelled panel; returns their mean density, 0 where none has
 * data. */
static double share_panels(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                           double share[GSN_GAIN_PANELS])
{
    const struct gsn_lattice *at = &a->grid->at;
    size_t total = 0, i = 0;
    double sum = 0;

    memset(share, 0, GSN_GAIN_PANELS * sizeof *share);
    for (size_t z = 0; z < at->nz; z++) {
        const struct gsn_assembly_panel *panel = gsn_assembly_panel_of_serial(
            a, gsn_assembly_serial_of_plane(at, z, specimen->protocol->interval_um));

        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++)
                if (panel && panel->levelled && !isnan(a->grid->value[i]) &&
                    gsn_mask_has(a->region, gsn_lattice_centre(at, x, y, z))) {
                    share[panel->place]++;
                    sum += a->grid->value[i];
                    total++;
                }
    }
    for (size_t p = 0; p < GSN_GAIN_PANELS && total > 0; p++)
        share[p] /= (double)total;
    return total > 0 ? sum / (double)total : 0;
}

/* What the steps between the panels leave open, relative to the mean. */
static double step_error(const struct gsn_specimen *specimen, struct gsn_assembly *a)
{
    double mean;

    if (!a->levelling.done || !a->grid || !a->region)
        return 0;
    mean = share_panels(specimen, a, a->levelling.share);
    return mean > 0 ? gsn_gain_error(&a->levelling.fit, a->levelling.share, mean) / mean : 0;
}

/* The vectors of all panels lean on one prior, so their errors are taken as common; gains are
 * measured panel by panel. */
void gsn_assembly_sum_errors(const struct gsn_specimen *specimen, struct gsn_assembly *a)
{
    double vectors = 0, gains = 0, panels = 0;

    judge_evenness(specimen, a);
    a->step_error = step_error(specimen, a);
    for (size_t p = 0; p < a->panel_count; p++) {
        const struct gsn_assembly_panel *panel = &a->panel[p];

        if (!panel->opened)
            continue;
        panels++;
        vectors += panel->red_error;
        if (panel->gain.gain > 0)
            gains += panel->gain.error * panel->gain.error / (panel->gain.gain * panel->gain.gain);
    }
    if (panels > 0)
        a->red_error = hypot(hypot(vectors / panels, sqrt(gains) / panels), a->step_error);
}

int gsn_assembly_place_reference(const struct gsn_specimen *specimen, double px_um,
                                 unsigned sections, struct gsn_assembly *a, struct gsn_error *err)
{
    const struct gsn_region *stated = &specimen->protocol->reference_tissue;
    struct gsn_lattice lattice;
    int r;

    if (stated->kind == GSN_REGION_NONE || !a->grid)
        return GSN_OK;
    if (!gsn_assembly_lattice(gsn_assembly_box_of_shape(stated), NULL, px_um,
                              specimen->protocol->interval_um, sections, &lattice))
        return gsn_fail(err, GSN_E_INPUT,
                        "the reference tissue does not lie in this block of %u "
                        "sections",
                        sections);
    r = gsn_region_raster(stated, &lattice, &a->tissue, err);
    return r < 0 ? r : gsn_assembly_empty_grid(&lattice, &a->tissue_grid, err);
}

struct gsn_assembly_panel *gsn_assembly_panel_of_serial(struct gsn_assembly *a, double serial)
{
    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_assembly_section *s = &a->section[i];

        if (s->seen.serial != serial ||
            (s->state != GSN_SECTION_USED && s->state != GSN_SECTION_DOUBTFUL))
            continue;
        for (size_t p = 0; p < a->panel_count; p++)
            if (a->panel[p].opened && a->panel[p].stain.panel == s->panel)
                return &a->panel[p];
    }
    return NULL;
}

double gsn_assembly_serial_of_plane(const struct gsn_lattice *at, size_t z, double interval_um)
{
    return round((at->origin_um.z + (double)z * at->step_um.z) / interval_um - 0.5);
}

/* The reference tissue in the plane z of its grid. scratch: as many values as a plane has. */
static struct gsn_reference_section reference_in(const struct gsn_assembly *a, size_t z,
                                                 double *scratch)
{
    const struct gsn_lattice *at = &a->tissue_grid->at;
    const size_t first = gsn_lattice_index(at, 0, 0, z), plane = at->nx * at->ny;
    size_t n = 0;

    for (size_t i = first; i < first + plane; i++)
        if (a->tissue->inside[i] && !isnan(a->tissue_grid->value[i]))
            scratch[n++] = a->tissue_grid->value[i];
    return (struct gsn_reference_section){ .red = gsn_reference_red(scratch, n), .pixels = n };
}

static int measure_panel_gain(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                              struct gsn_assembly_panel *panel, struct gsn_error *why,
                              struct gsn_error *err)
{
    const struct gsn_lattice *at = &a->tissue_grid->at;
    gsn_auto_mem(struct gsn_reference_section) sections = gsn_alloc_array(at->nz, sizeof *sections);
    gsn_auto_mem(double) scratch = gsn_alloc_array(at->nx * at->ny, sizeof *scratch);
    size_t count = 0;

    if (!sections || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the reference tissue");
    for (size_t z = 0; z < at->nz; z++)
        if (gsn_assembly_panel_of_serial(
                a, gsn_assembly_serial_of_plane(at, z, specimen->protocol->interval_um)) == panel)
            sections[count++] = reference_in(a, z, scratch);
    panel->gain = (struct gsn_stain_gain){ .gain = 1 };
    (void)gsn_stain_reference(sections, count, specimen->protocol->reference_density, &panel->gain,
                              why);
    return GSN_OK;
}

/* A panel without enough of the reference takes what the others say. */
static int fill_gains(struct gsn_assembly *a, const struct gsn_error *why, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_stain_gain) gains = gsn_alloc_array(a->panel_count + 1, sizeof *gains);
    struct gsn_stain_gain others;
    struct gsn_error none = { 0 };
    int told;

    if (!gains)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the reference tissue");
    for (size_t p = 0; p < a->panel_count; p++)
        gains[p] = a->panel[p].gain;
    told = gsn_stain_gain_of_others(gains, a->panel_count, &others, &none) >= 0;
    for (size_t p = 0; p < a->panel_count; p++) {
        if (!a->panel[p].opened || a->panel[p].gain.sections > 0)
            continue;
        if (told)
            a->panel[p].gain = others;
        else if (!a->not_comparable[0])
            (void)snprintf(a->not_comparable, sizeof a->not_comparable,
                           "batches not comparable: panel %u: %s", a->panel[p].stain.panel,
                           why[p].text);
    }
    return GSN_OK;
}

/* Divides each plane by the gain of its panel. */
static void divide(struct gsn_assembly *a, double interval_um)
{
    const struct gsn_lattice *at = &a->grid->at;
    const size_t plane = at->nx * at->ny;

    for (size_t z = 0; z < at->nz; z++) {
        const struct gsn_assembly_panel *panel =
            gsn_assembly_panel_of_serial(a, gsn_assembly_serial_of_plane(at, z, interval_um));

        for (size_t i = z * plane; panel && i < (z + 1) * plane; i++)
            a->grid->value[i] = (float)(a->grid->value[i] / panel->gain.gain);
    }
}

static void divide_by_standards(struct gsn_assembly *a, double interval_um)
{
    for (size_t p = 0; p < a->panel_count; p++)
        if (a->panel[p].opened)
            a->panel[p].gain = a->panel[p].calibrated.gain;
    divide(a, interval_um);
}

int gsn_assembly_normalise(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                           struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_error) why = NULL;
    int r = GSN_OK;

    if (a->by_standards && a->grid)
        divide_by_standards(a, specimen->protocol->interval_um);
    if (!a->tissue_grid)
        return GSN_OK;
    why = gsn_alloc_array(a->panel_count + 1, sizeof *why);
    if (!why)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the reference tissue");
    for (size_t p = 0; p < a->panel_count && r >= 0; p++)
        if (a->panel[p].opened)
            r = measure_panel_gain(specimen, a, &a->panel[p], &why[p], err);
    if (r >= 0)
        r = fill_gains(a, why, err);
    if (r >= 0 && !a->not_comparable[0])
        divide(a, specimen->protocol->interval_um);
    return r;
}
