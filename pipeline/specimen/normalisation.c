/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Brings the densities of all panels to one scale, and sums up what the stain leaves open.
 *
 * By what there is, in this order:
 * 1. standards on calibration panels: each panel's density is divided by the gain they give;
 * 2. a stated reference tissue: each panel is divided by what that tissue reads on it over what it
 * is taken to be (stain/normalisation.h); a panel without it takes the mean of the others;
 * 3. tissue outside of the region: where two panels meet, cells of 128 um on three sections a side
 *    give a line of one panel's density on the other's (stain/normalisation.h); the lines are
 * chained to one gain and offset a panel, regularised by the same comparison within panels.
 *
 * The standard error of a mean density: dye vectors and white, gains, steps between panels; and,
 * where no tissue was stated, the scatter of each panel's strongest stained tissue
 * (stain/staining_uniformity.h).
 *
 * The colours of tissue, panel by panel on that scale, and the mean colour of the region tell
 * later, beside another specimen's, where tissue without collagen lies (stain/hue_distribution.h).
 * A cell of the coarse grid counts where it and its four neighbours are tissue, so that none is cut
 * by an edge. What was taken off a panel's density is taken off the red of its cells.
 *
 * That the scale cannot be had is a state, with a sentence. */
#include "pipeline/specimen/normalisation.h"

#include "pipeline/core/robust.h"
#include "pipeline/stain/hue_distribution.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/stain_vectors.h"
#include "pipeline/stain/staining_uniformity.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* ---- what the stain leaves open ---------------------------------------------------------------
 */

/* Panels that have a section in the planes of the grid. */
static size_t panels_inside(const struct gsn_poses *poses, const struct gsn_densities *d,
                            double interval_um)
{
    const struct gsn_lattice *at = &d->grid->at;
    unsigned last = 0;
    size_t count = 0;

    /* Sections are sorted by serial number, so those of one panel follow each other. */
    for (size_t i = 0; i < poses->section_count; i++) {
        const struct gsn_section *s = &poses->section[i];
        const enum gsn_section_state state = d->section[i].state;
        const double z = interval_um * (s->seen.serial + 0.5);

        if ((state != GSN_SECTION_USED && state != GSN_SECTION_DOUBTFUL) || s->panel == last ||
            z < at->origin_um.z - 0.5 * at->step_um.z ||
            z > at->origin_um.z + ((double)at->nz - 0.5) * at->step_um.z)
            continue;
        last = s->panel;
        count++;
    }
    return count;
}

/* What the stain that all panels have in common may be off by, where no tissue was stated. */
static void judge_uniformity(const struct gsn_specimen *specimen, const struct gsn_poses *poses,
                             const struct gsn_densities *d, struct gsn_scale *scale)
{
    double strength[64];
    struct gsn_uniformity uniformity;
    size_t count = 0, inside;

    if (!d->grid || scale->by_standards || (d->tissue_grid && !scale->not_comparable[0]))
        return;
    for (size_t p = 0; p < d->panel_count && count < sizeof strength / sizeof strength[0]; p++)
        if (d->panel[p].opened)
            strength[count++] = d->panel[p].strength;
    /* Panels that were levelled all have a part in the region's scale. */
    inside =
        scale->levelling.done ? count : panels_inside(poses, d, specimen->protocol->interval_um);
    uniformity = gsn_uniformity_of(strength, count, inside > 0 ? inside : 1);
    scale->stain_scatter = uniformity.scatter;
    scale->common_error = uniformity.error;
}

/* Shares of the region's voxels by levelled panel; returns their mean density, 0 where none has
 * data. */
static double share_panels(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                           const struct gsn_poses *poses, const struct gsn_densities *d,
                           const struct gsn_scale *scale, double share[GSN_GAIN_PANELS])
{
    const struct gsn_lattice *at = &d->grid->at;
    size_t total = 0, i = 0;
    double sum = 0;

    memset(share, 0, GSN_GAIN_PANELS * sizeof *share);
    for (size_t z = 0; z < at->nz; z++) {
        const int p = gsn_panel_of_plane(poses, d, at, z, specimen->protocol->interval_um);
        const struct gsn_panel_scale *panel = p >= 0 ? &scale->panel[p] : NULL;

        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++)
                if (panel && panel->levelled && !isnan(d->grid->value[i]) &&
                    gsn_mask_has(region, gsn_lattice_centre(at, x, y, z))) {
                    share[panel->place]++;
                    sum += d->grid->value[i];
                    total++;
                }
    }
    for (size_t p = 0; p < GSN_GAIN_PANELS && total > 0; p++)
        share[p] /= (double)total;
    return total > 0 ? sum / (double)total : 0;
}

/* What the steps between the panels leave open, relative to the mean. */
static double step_error(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                         const struct gsn_poses *poses, const struct gsn_densities *d,
                         struct gsn_scale *scale)
{
    struct gsn_normalisation *l = &scale->levelling;
    double mean;

    if (!l->done || !d->grid || !region)
        return 0;
    mean = share_panels(specimen, region, poses, d, scale, l->share);
    return mean > 0 ? gsn_gain_error(&l->fit, l->share, mean) / mean : 0;
}

/* The vectors of all panels lean on one prior, so their errors are taken as common; gains are
 * measured panel by panel. */
void gsn_scale_sum_errors(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                          const struct gsn_poses *poses, const struct gsn_densities *d,
                          struct gsn_scale *scale)
{
    double vectors = 0, gains = 0, panels = 0;

    judge_uniformity(specimen, poses, d, scale);
    scale->step_error = step_error(specimen, region, poses, d, scale);
    for (size_t p = 0; p < d->panel_count; p++) {
        const struct gsn_stain_gain *gain = &scale->panel[p].gain;

        if (!d->panel[p].opened)
            continue;
        panels++;
        vectors += d->panel[p].red_error;
        if (gain->gain > 0)
            gains += gain->error * gain->error / (gain->gain * gain->gain);
    }
    if (panels > 0)
        scale->red_error = hypot(hypot(vectors / panels, sqrt(gains) / panels), scale->step_error);
}

/* ---- by standards or a reference tissue --------------------------------------------------------
 */

/* The reference tissue in the plane z of its grid. scratch: as many values as a plane has. */
static struct gsn_reference_section reference_in(const struct gsn_densities *d, size_t z,
                                                 double *scratch)
{
    const struct gsn_lattice *at = &d->tissue_grid->at;
    const size_t first = gsn_lattice_index(at, 0, 0, z), plane = at->nx * at->ny;
    size_t n = 0;

    for (size_t i = first; i < first + plane; i++)
        if (d->tissue->inside[i] && !isnan(d->tissue_grid->value[i]))
            scratch[n++] = d->tissue_grid->value[i];
    return (struct gsn_reference_section){ .red = gsn_reference_red(scratch, n), .pixels = n };
}

static int measure_panel_gain(const struct gsn_specimen *specimen, const struct gsn_poses *poses,
                              const struct gsn_densities *d, size_t panel,
                              struct gsn_stain_gain *ret_gain, struct gsn_error *why,
                              struct gsn_error *err)
{
    const struct gsn_lattice *at = &d->tissue_grid->at;
    gsn_auto_mem(struct gsn_reference_section) sections = gsn_alloc_array(at->nz, sizeof *sections);
    gsn_auto_mem(double) scratch = gsn_alloc_array(at->nx * at->ny, sizeof *scratch);
    size_t count = 0;

    if (!sections || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the reference tissue");
    for (size_t z = 0; z < at->nz; z++)
        if (gsn_panel_of_plane(poses, d, at, z, specimen->protocol->interval_um) == (int)panel)
            sections[count++] = reference_in(d, z, scratch);
    *ret_gain = (struct gsn_stain_gain){ .gain = 1 };
    (void)gsn_stain_reference(sections, count, specimen->protocol->reference_density, ret_gain,
                              why);
    return GSN_OK;
}

/* A panel without enough of the reference takes what the others say. */
static int fill_gains(const struct gsn_densities *d, const struct gsn_error *why,
                      struct gsn_scale *scale, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_stain_gain) gains = gsn_alloc_array(d->panel_count + 1, sizeof *gains);
    struct gsn_stain_gain others;
    struct gsn_error none = { 0 };
    int told;

    if (!gains)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the reference tissue");
    for (size_t p = 0; p < d->panel_count; p++)
        gains[p] = scale->panel[p].gain;
    told = gsn_stain_gain_of_others(gains, d->panel_count, &others, &none) >= 0;
    for (size_t p = 0; p < d->panel_count; p++) {
        if (!d->panel[p].opened || scale->panel[p].gain.sections > 0)
            continue;
        if (told)
            scale->panel[p].gain = others;
        else if (!scale->not_comparable[0])
            (void)snprintf(scale->not_comparable, sizeof scale->not_comparable,
                           "batches not comparable: panel %u: %s", d->panel[p].stain.panel,
                           why[p].text);
    }
    return GSN_OK;
}

/* Divides each plane by the gain of its panel. */
static void divide_planes(const struct gsn_poses *poses, const struct gsn_scale *scale,
                          double interval_um, struct gsn_densities *d)
{
    const struct gsn_lattice *at = &d->grid->at;
    const size_t plane = at->nx * at->ny;

    for (size_t z = 0; z < at->nz; z++) {
        const int p = gsn_panel_of_plane(poses, d, at, z, interval_um);

        for (size_t i = z * plane; p >= 0 && i < (z + 1) * plane; i++)
            d->grid->value[i] = (float)(d->grid->value[i] / scale->panel[p].gain.gain);
    }
}

static void divide_by_standards(const struct gsn_poses *poses, double interval_um,
                                struct gsn_densities *d, struct gsn_scale *scale)
{
    for (size_t p = 0; p < d->panel_count; p++)
        if (d->panel[p].opened)
            scale->panel[p].gain = d->panel[p].calibrated.gain;
    divide_planes(poses, scale, interval_um, d);
}

/* Divides each plane by the gain that the reference tissue, or else the standards, tell of its
 * panel. */
static int divide_by_gains(const struct gsn_specimen *specimen, const struct gsn_poses *poses,
                           struct gsn_densities *d, struct gsn_scale *scale, struct gsn_error *err)
{
    const double interval_um = specimen->protocol->interval_um;
    gsn_auto_mem(struct gsn_error) why = NULL;
    int r = GSN_OK;

    if (scale->by_standards && d->grid)
        divide_by_standards(poses, interval_um, d, scale);
    if (!d->tissue_grid)
        return GSN_OK;
    why = gsn_alloc_array(d->panel_count + 1, sizeof *why);
    if (!why)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the reference tissue");
    for (size_t p = 0; p < d->panel_count && r >= 0; p++)
        if (d->panel[p].opened)
            r = measure_panel_gain(specimen, poses, d, p, &scale->panel[p].gain, &why[p], err);
    if (r >= 0)
        r = fill_gains(d, why, scale, err);
    if (r >= 0 && !scale->not_comparable[0])
        divide_planes(poses, scale, interval_um, d);
    return r;
}

/* ---- by tissue that goes on across the panels
 * ---------------------------------------------------- */

/* Cells of 128 um: texture is a percent of them, and neighbours three sections away still lie in
 * the same tissue. Three sections a side: fewer are at the mercy of one, more drift apart. */
enum { CELL_COLUMNS = 4, SIDE = 3 };

/* ---- cells --------------------------------------------------------------------------------- */

/* What is compared: cells of whole columns, and the panel of every plane. */
struct view {
    size_t planes, cells; /* cells: of one plane */
    float *cell;          /* owned; planes * cells; NaN: glass, masked, or near the region */
    int *panel;           /* owned; index into the reconstruction's panels, -1: nothing there */
    double *before, *after;
};

static void view_done(struct view *v)
{
    gsn_free(v->cell);
    gsn_free(v->panel);
    gsn_free(v->before);
    gsn_free(v->after);
}

static int view_init(const struct gsn_lattice *at, struct view *v, struct gsn_error *err)
{
    *v = (struct view){ .planes = at->nz,
                        .cells = (at->nx / CELL_COLUMNS) * (at->ny / CELL_COLUMNS) };
    v->cell = gsn_alloc_array(v->planes * v->cells + 1, sizeof *v->cell);
    v->panel = gsn_alloc_array(v->planes + 1, sizeof *v->panel);
    v->before = gsn_alloc_array(v->planes * v->cells + 1, sizeof *v->before);
    v->after = gsn_alloc_array(v->cells + 1, sizeof *v->after);
    if (v->cell && v->panel && v->before && v->after)
        return GSN_OK;
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the cells of a block");
}

/* The mean of a cell's columns; NaN unless all are seen, are tissue and lie off the region. */
static float cell_of(const struct gsn_grid *density, const struct gsn_mask *footprint, size_t x,
                     size_t y, size_t z)
{
    double sum = 0;

    for (size_t j = 0; j < CELL_COLUMNS; j++)
        for (size_t i = 0; i < CELL_COLUMNS; i++) {
            const size_t cx = CELL_COLUMNS * x + i, cy = CELL_COLUMNS * y + j;

            if (footprint->inside[cy * footprint->at.nx + cx])
                return NAN;
            sum += density->value[gsn_lattice_index(&density->at, cx, cy, z)];
        }
    return (float)(sum / (CELL_COLUMNS * CELL_COLUMNS));
}

static void fill_view(const struct gsn_specimen *specimen, const struct gsn_poses *poses,
                      const struct gsn_densities *d, const struct gsn_mask *footprint,
                      struct view *v)
{
    const struct gsn_grid *density = d->coarse->density;
    const size_t nx = density->at.nx / CELL_COLUMNS;

    for (size_t z = 0; z < v->planes; z++) {
        v->panel[z] =
            gsn_panel_of_plane(poses, d, &density->at, z, specimen->protocol->interval_um);
        for (size_t i = 0; i < v->cells; i++)
            v->cell[z * v->cells + i] = cell_of(density, footprint, i % nx, i / nx, z);
    }
}

/* What is not to be compared: the region and its surroundings; of a band that is still to be found
 * the cylinder that it lies within. */
static int find_footprint(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                          const struct gsn_lattice *at, struct gsn_mask **ret_footprint,
                          struct gsn_error *err)
{
    const struct gsn_region *stated = &specimen->protocol->region;
    struct gsn_lattice flat = *at;
    gsn_auto(gsn_mask) none = NULL;
    int r;

    if (region)
        return gsn_coarse_grid_footprint(region, at, GSN_SURROUNDINGS_UM, ret_footprint, err);
    flat.nz = 1;
    r = gsn_mask_new(&flat, &none, err);
    for (size_t i = 0; r >= 0 && i < gsn_lattice_count(&flat); i++) {
        const struct gsn_vec3 u = gsn_lattice_centre(&flat, i % flat.nx, i / flat.nx, 0);

        none->inside[i] =
            stated->radius_um > 0 && hypot(u.x - stated->centre.x, u.y - stated->centre.y) <=
                                         stated->radius_um + GSN_SURROUNDINGS_UM;
    }
    if (r >= 0)
        *ret_footprint = gsn_steal(&none);
    return r;
}

/* ---- lines --------------------------------------------------------------------------------- */

/* Mean over a side's sections; NaN where one of them has no data. */
static double side_of(const struct view *v, const size_t z[SIDE], size_t i)
{
    double sum = 0;

    for (size_t k = 0; k < SIDE; k++)
        sum += (double)v->cell[z[k] * v->cells + i];
    return sum / SIDE;
}

static double mean_plane(const size_t z[SIDE])
{
    double sum = 0;

    for (size_t k = 0; k < SIDE; k++)
        sum += (double)z[k];
    return sum / SIDE;
}

static int line_between(struct view *v, const size_t before[SIDE], const size_t after[SIDE],
                        struct gsn_gain_line *ret_line, struct gsn_error *err)
{
    size_t n = 0;
    int r;

    for (size_t i = 0; i < v->cells; i++) {
        const double x = side_of(v, before, i), y = side_of(v, after, i);

        if (isnan(x) || isnan(y))
            continue;
        v->before[n] = x;
        v->after[n++] = y;
    }
    r = gsn_gain_line(v->before, v->after, n, ret_line, err);
    if (r >= 0)
        ret_line->lag = mean_plane(after) - mean_plane(before);
    return r;
}

/* The planes of the block that hold something, panel after panel. */
struct order {
    size_t *plane; /* owned */
    size_t planes, panels;
    size_t first[GSN_GAIN_PANELS + 1]; /* of each panel, and the end */
    int panel[GSN_GAIN_PANELS];
};

static int order_planes(const struct view *v, struct order *o, struct gsn_error *err)
{
    *o = (struct order){ .plane = gsn_alloc_array(v->planes + 1, sizeof *o->plane) };
    if (!o->plane)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the planes");
    for (size_t z = 0; z < v->planes; z++) {
        if (v->panel[z] < 0)
            continue;
        if (o->panels == 0 || o->panel[o->panels - 1] != v->panel[z]) {
            /* One with too few sections cannot be compared. */
            if (o->panels > 0 && o->planes - o->first[o->panels - 1] < SIDE)
                o->planes = o->first[--o->panels];
            if (o->panels == GSN_GAIN_PANELS)
                break;
            o->panel[o->panels] = v->panel[z];
            o->first[o->panels++] = o->planes;
        }
        o->plane[o->planes++] = z;
    }
    if (o->panels > 0 && o->planes - o->first[o->panels - 1] < SIDE)
        o->planes = o->first[--o->panels];
    o->first[o->panels] = o->planes;
    return GSN_OK;
}

/* The comparisons within the panels; those that cannot be made do not count. */
static int compare_within(struct view *v, const struct order *o, struct gsn_gain_line *line,
                          size_t *ret_count, struct gsn_error *why)
{
    *ret_count = 0;
    for (size_t p = 0; p < o->panels; p++)
        for (size_t i = o->first[p]; i + 2 * SIDE <= o->first[p + 1]; i++) {
            const int r =
                line_between(v, o->plane + i, o->plane + i + SIDE, &line[*ret_count], why);

            if (r == GSN_E_NOMEM)
                return r;
            *ret_count += r >= 0;
        }
    return GSN_OK;
}

static int compare_panels(struct view *v, const struct order *o, struct gsn_gain_line *step,
                          struct gsn_error *why)
{
    int r = GSN_OK;

    for (size_t p = 0; p + 1 < o->panels && r >= 0; p++)
        r = line_between(v, o->plane + o->first[p + 1] - SIDE, o->plane + o->first[p + 1], &step[p],
                         why);
    return r;
}

/* The densities between which four fifths of the cells lie. */
static int spread_of(struct view *v, double at[2], struct gsn_error *why)
{
    size_t n = 0;

    for (size_t i = 0; i < v->planes * v->cells; i++)
        if (v->panel[i / v->cells] >= 0 && !isnan(v->cell[i]))
            v->before[n++] = (double)v->cell[i];
    if (n < 10)
        return gsn_fail(why, GSN_E_STAIN, "no tissue is seen outside of the region");
    at[0] = gsn_order_pick(v->before, n, n / 10);
    at[1] = gsn_order_pick(v->before, n, n - n / 10);
    if (!(at[1] - at[0] > 0.1))
        return gsn_fail(why, GSN_E_STAIN,
                        "the tissue outside of the region is all of one density, so gain and "
                        "offset of the stain cannot be told apart");
    return GSN_OK;
}

static int compare_all(struct view *v, const struct order *o, struct gsn_gain_offset *level,
                       struct gsn_gain_fit *fit, struct gsn_error *why)
{
    gsn_auto_mem(struct gsn_gain_line) within = gsn_alloc_array(v->planes + 1, sizeof *within);
    struct gsn_gain_line step[GSN_GAIN_PANELS];
    double at[2];
    size_t lines;
    int r = within ? GSN_OK : gsn_fail(why, GSN_E_NOMEM, "out of memory for comparing panels");

    if (r >= 0 && o->panels == 0)
        r = gsn_fail(why, GSN_E_STAIN, "no panel shows three sections of this block");
    if (r >= 0)
        r = spread_of(v, at, why);
    if (r >= 0)
        r = compare_within(v, o, within, &lines, why);
    if (r >= 0)
        r = compare_panels(v, o, step, why);
    return r < 0 ? r : gsn_gain_chain(step, o->panels - 1, within, lines, at, level, fit, why);
}

/* ---- levelling ----------------------------------------------------------------------------- */

static void apply_levels(const struct gsn_specimen *specimen, const struct gsn_poses *poses,
                         const struct gsn_densities *d, const struct gsn_scale *scale,
                         struct gsn_grid *grid)
{
    const size_t plane = grid->at.nx * grid->at.ny;

    for (size_t z = 0; z < grid->at.nz; z++) {
        const int p = gsn_panel_of_plane(poses, d, &grid->at, z, specimen->protocol->interval_um);
        const struct gsn_panel_scale *panel = p >= 0 ? &scale->panel[p] : NULL;

        for (size_t i = z * plane; panel && panel->levelled && i < (z + 1) * plane; i++)
            grid->value[i] = (float)((grid->value[i] - panel->level.offset) / panel->level.gain);
    }
}

static void take_levels(const struct order *o, const struct gsn_gain_offset *level,
                        struct gsn_scale *scale)
{
    for (size_t p = 0; p < o->panels; p++) {
        scale->panel[o->panel[p]].level = level[p];
        scale->panel[o->panel[p]].levelled = 1;
        scale->panel[o->panel[p]].place = p;
    }
    scale->levelling.panels = o->panels;
    scale->levelling.done = 1;
}

static int level_view(const struct gsn_specimen *specimen, const struct gsn_poses *poses,
                      struct view *v, struct gsn_densities *d, struct gsn_scale *scale,
                      struct gsn_error *err)
{
    struct gsn_normalisation *l = &scale->levelling;
    struct gsn_gain_offset level[GSN_GAIN_PANELS];
    struct gsn_error why = { 0 };
    struct order o;
    int r = order_planes(v, &o, err);

    if (r < 0)
        return r;
    r = compare_all(v, &o, level, &l->fit, &why);
    if (r >= 0)
        take_levels(&o, level, scale);
    gsn_free(o.plane);
    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    if (r < 0) {
        (void)snprintf(l->why, sizeof l->why, "%s", why.text);
        return GSN_OK;
    }
    apply_levels(specimen, poses, d, scale, d->grid);
    apply_levels(specimen, poses, d, scale, d->coarse->density);
    return GSN_OK;
}

static int level_panels(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                        const struct gsn_poses *poses, struct gsn_densities *d,
                        struct gsn_scale *scale, struct gsn_error *err)
{
    gsn_auto(gsn_mask) footprint = NULL;
    struct view v;
    int r;

    if (!d->coarse || d->tissue_grid || scale->by_standards)
        return GSN_OK;
    r = find_footprint(specimen, region, &d->coarse->density->at, &footprint, err);
    if (r < 0)
        return r;
    r = view_init(&d->coarse->density->at, &v, err);
    if (r >= 0) {
        fill_view(specimen, poses, d, footprint, &v);
        r = level_view(specimen, poses, &v, d, scale, err);
    }
    view_done(&v);
    return r;
}

/* ---- the record ------------------------------------------------------------------------------ */

int gsn_scale_normalise(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                        const struct gsn_poses *poses, struct gsn_densities *densities,
                        struct gsn_scale *scale, struct gsn_error *err)
{
    int r;

    scale->panel = gsn_alloc_array(densities->panel_count, sizeof *scale->panel);
    if (!scale->panel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the scale of a specimen");
    scale->panel_count = densities->panel_count;
    for (size_t p = 0; p < scale->panel_count; p++)
        scale->panel[p].level = (struct gsn_gain_offset){ 1, 0 };
    for (size_t i = 0; i < GSN_CONTROL_TISSUES; i++)
        scale->levelling.tissues.value[i] = scale->levelling.yellow[i] = (double)NAN;
    scale->by_standards = !densities->tissue_grid && gsn_calibrations_have_standards(specimen);
    r = divide_by_gains(specimen, poses, densities, scale, err);
    return r < 0 ? r : level_panels(specimen, region, poses, densities, scale, err);
}

void gsn_scale_done(struct gsn_scale *scale)
{
    gsn_free(scale->panel);
    gsn_cloud_free(scale->cloud);
}

/* ---- the colours of all tissue ----------------------------------------------------------------
 */

/* What brings a panel's density to the common scale: (density - offset) / gain. */
static struct gsn_gain_offset level_of(const struct gsn_densities *d, const struct gsn_scale *scale,
                                       const struct gsn_panel_scale *panel)
{
    if (panel->levelled)
        return panel->level;
    return (struct gsn_gain_offset){
        scale->by_standards || (d->tissue_grid && !scale->not_comparable[0]) ? panel->gain.gain : 1,
        0
    };
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
