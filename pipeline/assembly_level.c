/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"

#include "pipeline/core/robust.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Cells of 128 um: texture is a percent of them, and neighbours three sections away still lie in
 * the same tissue. Three sections a side: fewer are at the mercy of one, more drift apart. */
enum { CELL_COLUMNS = 4, SIDE = 3 };

/* A lesion does not end where the region does. */
static const double SURROUNDINGS_UM = 300;

/* A block of more cells than this is a mistake in a pose, not a block. */
static const double MOST_COLUMNS = 1 << 27;

int gsn_assembly_place_columns(const struct gsn_specimen *specimen, unsigned sections,
                               struct gsn_assembly *a, struct gsn_error *err)
{
    struct gsn_lattice at;

    if (!a->grid)
        return GSN_OK;
    if (gsn_assembly_place_block(specimen, GSN_COLUMN_UM, sections, a, &at, NULL) < 0 ||
        (double)at.nx * (double)at.ny * (double)at.nz > MOST_COLUMNS)
        return GSN_OK;
    return gsn_columns_new(&at, &a->columns, err);
}

/* ---- cells --------------------------------------------------------------------------------- */

/* What is compared: cells of whole columns, and the panel of every plane. */
struct view {
    size_t planes, cells; /* cells: of one plane */
    float *cell;          /* owned; planes * cells; NaN: glass, masked, or near the region */
    int *panel;           /* owned; index into the assembly's panels, -1: nothing there */
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

static void fill_view(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                      const struct gsn_mask *footprint, struct view *v)
{
    const struct gsn_lattice *at = &a->columns->density->at;
    const size_t nx = at->nx / CELL_COLUMNS;

    for (size_t z = 0; z < v->planes; z++) {
        const struct gsn_assembly_panel *panel = gsn_assembly_panel_of_serial(
            a, gsn_assembly_serial_of_plane(at, z, specimen->protocol->interval_um));

        v->panel[z] = panel ? (int)(panel - a->panel) : -1;
        for (size_t i = 0; i < v->cells; i++)
            v->cell[z * v->cells + i] = cell_of(a->columns->density, footprint, i % nx, i / nx, z);
    }
}

/* What is not to be compared: the region and its surroundings; of a band that is still to be found
 * the cylinder that it lies within. */
static int find_footprint(const struct gsn_specimen *specimen, const struct gsn_assembly *a,
                          struct gsn_mask **ret_footprint, struct gsn_error *err)
{
    const struct gsn_region *stated = &specimen->protocol->region;
    const struct gsn_lattice *at = &a->columns->density->at;
    struct gsn_lattice flat = *at;
    gsn_auto(gsn_mask) none = NULL;
    int r;

    if (a->region)
        return gsn_columns_footprint(a->region, at, SURROUNDINGS_UM, ret_footprint, err);
    flat.nz = 1;
    r = gsn_mask_new(&flat, &none, err);
    for (size_t i = 0; r >= 0 && i < gsn_lattice_count(&flat); i++) {
        const struct gsn_vec3 u = gsn_lattice_centre(&flat, i % flat.nx, i / flat.nx, 0);

        none->inside[i] =
            stated->radius_um > 0 && hypot(u.x - stated->centre.x, u.y - stated->centre.y) <=
                                         stated->radius_um + SURROUNDINGS_UM;
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

static double middle(const size_t z[SIDE])
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
        ret_line->lag = middle(after) - middle(before);
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

static int compare(struct view *v, const struct order *o, struct gsn_gain_offset *level,
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

static void apply(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                  struct gsn_grid *grid)
{
    const size_t plane = grid->at.nx * grid->at.ny;

    for (size_t z = 0; z < grid->at.nz; z++) {
        const struct gsn_assembly_panel *panel = gsn_assembly_panel_of_serial(
            a, gsn_assembly_serial_of_plane(&grid->at, z, specimen->protocol->interval_um));

        for (size_t i = z * plane; panel && panel->levelled && i < (z + 1) * plane; i++)
            grid->value[i] = (float)((grid->value[i] - panel->level.offset) / panel->level.gain);
    }
}

static void take_levels(const struct order *o, const struct gsn_gain_offset *level,
                        struct gsn_assembly *a)
{
    for (size_t p = 0; p < o->panels; p++) {
        a->panel[o->panel[p]].level = level[p];
        a->panel[o->panel[p]].levelled = 1;
        a->panel[o->panel[p]].place = p;
    }
    a->levelling.panels = o->panels;
    a->levelling.done = 1;
}

static int level_view(const struct gsn_specimen *specimen, struct gsn_assembly *a, struct view *v,
                      struct gsn_error *err)
{
    struct gsn_gain_offset level[GSN_GAIN_PANELS];
    struct gsn_error why = { 0 };
    struct order o;
    int r = order_planes(v, &o, err);

    if (r < 0)
        return r;
    r = compare(v, &o, level, &a->levelling.fit, &why);
    if (r >= 0)
        take_levels(&o, level, a);
    gsn_free(o.plane);
    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    if (r < 0) {
        (void)snprintf(a->levelling.why, sizeof a->levelling.why, "%s", why.text);
        return GSN_OK;
    }
    apply(specimen, a, a->grid);
    apply(specimen, a, a->columns->density);
    return GSN_OK;
}

int gsn_assembly_level(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                       struct gsn_error *err)
{
    gsn_auto(gsn_mask) footprint = NULL;
    struct view v;
    int r;

    for (size_t p = 0; p < a->panel_count; p++)
        a->panel[p].level = (struct gsn_gain_offset){ 1, 0 };
    for (size_t i = 0; i < GSN_CONTROL_TISSUES; i++)
        a->levelling.tissues.value[i] = a->levelling.yellow[i] = (double)NAN;
    if (!a->columns || a->tissue_grid || a->by_standards)
        return GSN_OK;
    r = find_footprint(specimen, a, &footprint, err);
    if (r < 0)
        return r;
    r = view_init(&a->columns->density->at, &v, err);
    if (r >= 0) {
        fill_view(specimen, a, footprint, &v);
        r = level_view(specimen, a, &v, err);
    }
    view_done(&v);
    return r;
}
