/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/conditions.h"

#include "pipeline/masking.h"
#include "pipeline/register/panel/reduce.h"
#include "pipeline/stain/artefact/dust.h"
#include "pipeline/stain/illumination_drift.h"
#include "pipeline/stain/staining_uniformity.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Dust of half a cell still darkens it. */
static const double CELL_UM = 20;
/* Around a mark, in its radii: bleached rim and blur. */
static const double MARK_RADII = 2;

static int is_there(const struct gsn_assembly_section *s, unsigned panel)
{
    return s->panel == panel && s->seen.width > 0 && s->seen.height > 0;
}

static struct gsn_pixel_box box_of(const struct gsn_panel_section *seen)
{
    return (struct gsn_pixel_box){ seen->x, seen->y, seen->width, seen->height };
}

/* The least box that holds all sections of a panel: no label and no frame lies in it. */
static struct gsn_pixel_box box_of_all(const struct gsn_assembly *a, unsigned panel)
{
    int x0 = INT32_MAX, y0 = INT32_MAX, x1 = 0, y1 = 0;

    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_panel_section *s = &a->section[i].seen;

        if (!is_there(&a->section[i], panel))
            continue;
        x0 = s->x < x0 ? s->x : x0;
        y0 = s->y < y0 ? s->y : y0;
        x1 = s->x + s->width > x1 ? s->x + s->width : x1;
        y1 = s->y + s->height > y1 ? s->y + s->height : y1;
    }
    return x0 < x1 ? (struct gsn_pixel_box){ x0, y0, x1 - x0, y1 - y0 }
                   : (struct gsn_pixel_box){ 0, 0, 0, 0 };
}

/* A panel in cells, and what is asked of it there. */
struct look {
    const struct gsn_scan *scan;
    struct gsn_assembly_panel *panel;
    struct gsn_assembly *a;
    int side; /* pixels of the panel along a cell */
    struct gsn_plane *od[3];
};

static struct gsn_pixel_box in_cells(const struct gsn_pixel_box *box, int side)
{
    return (struct gsn_pixel_box){ box->x / side, box->y / side,
                                   (box->x + box->width) / side - box->x / side,
                                   (box->y + box->height) / side - box->y / side };
}

static int see_cells(struct look *look, struct gsn_error *err)
{
    const struct gsn_image *image = look->scan->picture->image;
    struct gsn_flat_field glass = look->scan->glass;
    gsn_auto(gsn_image) small = NULL;
    int r;

    look->side = (int)fmax(1, floor(CELL_UM / look->scan->px_um));
    look->panel->cell_px = (unsigned)look->side;
    r = gsn_panel_reduce(image, (unsigned)look->side, &small, err);
    if (r < 0)
        return r;
    glass.width = small->width;
    glass.height = small->height;
    return gsn_od_thin(small, &glass, 1, look->od, err);
}

static int add_dust(const struct look *look, const struct gsn_pixel_box *box, struct gsn_error *err)
{
    struct gsn_assembly *a = look->a;
    gsn_auto_mem(struct gsn_artefact_disc) mark =
        gsn_alloc_array(GSN_MARKS * a->section_count + 1, sizeof *mark);
    size_t count = 0;
    int r = mark ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for a map of dust");

    if (r >= 0 && !a->dust)
        r = gsn_dust_new(&a->dust, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < a->section_count; i++)
        for (size_t m = 0; is_there(&a->section[i], look->panel->given->number) && m < GSN_MARKS;
             m++) {
            const struct gsn_mark *one = &a->section[i].seen.mark[m];

            if (one->found)
                mark[count++] = (struct gsn_artefact_disc){
                    .px = { one->px.x / look->side, one->px.y / look->side },
                    .radius_px = MARK_RADII * one->radius_px / look->side
                };
        }
    return gsn_dust_add(a->dust, look->od, look->scan->px_um * look->side, look->scan->upright.turn,
                        box, mark, count, err);
}

/* gives: in cells of the box 0, or NaN where the section is masked. */
static int mask_of(const struct look *look, const struct gsn_artefact_labels *labels, size_t i,
                   const struct gsn_pixel_box *box, struct gsn_plane **ret_mask,
                   struct gsn_error *err)
{
    const size_t section = gsn_masking_index(look->a, i);
    struct gsn_plane *mask = NULL;
    const int r = gsn_plane_new(look->od[0]->width, look->od[0]->height, &mask, err);

    if (r < 0)
        return r;
    for (int y = box->y; y < box->y + box->height; y++)
        for (int x = box->x; x < box->x + box->width; x++)
            if (gsn_artefact_label(labels, section, x * look->side + look->side / 2,
                                   y * look->side + look->side / 2))
                mask->value[(size_t)y * mask->width + (size_t)x] = NAN;
    *ret_mask = mask;
    return GSN_OK;
}

static int add_tone(const struct look *look, const struct gsn_artefact_labels *labels, size_t i,
                    struct gsn_error *err)
{
    struct gsn_assembly_section *s = &look->a->section[i];
    const struct gsn_pixel_box whole = box_of(&s->seen);
    const struct gsn_pixel_box box = in_cells(&whole, look->side);
    gsn_auto(gsn_plane) mask = NULL;
    int r = mask_of(look, labels, i, &box, &mask, err);

    if (r >= 0)
        r = gsn_stain_amounts_of(look->od, mask, &look->panel->stain.fit.dyes, &box, &s->tone, err);
    if (r >= 0)
        look->panel->tone = gsn_stain_amounts_sum(&look->panel->tone, &s->tone);
    return r;
}

static int look_at_cells(const struct look *look, const struct gsn_artefact_labels *labels,
                         struct gsn_error *err)
{
    const struct gsn_pixel_box whole = box_of_all(look->a, look->panel->given->number);
    const struct gsn_pixel_box box = in_cells(&whole, look->side);
    int r = GSN_OK;

    look->panel->turn = look->scan->upright.turn;
    look->panel->lamp = gsn_illumination_drift(look->od, &box);
    for (size_t i = 0; i < look->a->section_count && r >= 0; i++)
        if (is_there(&look->a->section[i], look->panel->given->number))
            r = add_tone(look, labels, i, err);
    return r < 0 ? r : add_dust(look, &box, err);
}

int gsn_conditions_look(const struct gsn_scan *scan, const struct gsn_artefact_labels *labels,
                        struct gsn_assembly_panel *panel, struct gsn_assembly *a,
                        struct gsn_error *err)
{
    struct look look = { .scan = scan, .panel = panel, .a = a };
    int r = see_cells(&look, err);

    if (r >= 0)
        r = look_at_cells(&look, labels, err);
    for (int c = 0; c < 3; c++)
        gsn_plane_free(look.od[c]);
    return r;
}

/* ---- thickness ------------------------------------------------------------------------------ */

static void add_flag(struct gsn_assembly_section *s, const char *word)
{
    const size_t used = strlen(s->flags);

    (void)snprintf(s->flags + used, sizeof s->flags - used, "%s%s", used ? " " : "", word);
}

/* Of one panel, whose sections shared one bath. tone and place: room for all sections. */
static void judge_thickness(struct gsn_assembly *a, unsigned panel, struct gsn_stain_amounts *tone,
                            size_t *place)
{
    size_t count = 0;

    for (size_t i = 0; i < a->section_count; i++)
        if (a->section[i].panel == panel && a->section[i].tone.pixels > 0) {
            place[count] = i;
            tone[count++] = a->section[i].tone;
        }
    for (size_t k = 0; k < count; k++) {
        struct gsn_assembly_section *s = &a->section[place[k]];

        s->thickness = gsn_stain_amounts_thickness(tone, count, k);
        if (s->thickness != 1)
            add_flag(s, s->thickness > 1 ? "thick" : "thin");
    }
}

/* ---- dust ------------------------------------------------------------------------------------ */

/* The plane of a lattice that shows the section; nz when there is none. */
static size_t plane_of(const struct gsn_assembly_section *s, double interval_um,
                       const struct gsn_lattice *at)
{
    const double z =
        round((interval_um * (s->seen.serial + 0.5) - at->origin_um.z) / at->step_um.z);

    return z >= 0 && z < (double)at->nz ? (size_t)z : at->nz;
}

/* Takes a disc of the block out of one plane; the share of the region's plane that was lost. */
static double take_out(struct gsn_grid *grid, size_t z, struct gsn_point um, double radius_um,
                       const struct gsn_mask *region)
{
    size_t all = 0, lost = 0;

    for (size_t y = 0; y < grid->at.ny; y++)
        for (size_t x = 0; x < grid->at.nx; x++) {
            const size_t i = gsn_lattice_index(&grid->at, x, y, z);
            const struct gsn_vec3 u = gsn_lattice_centre(&grid->at, x, y, z);
            const int counts = region && region->inside[i];

            all += counts != 0;
            if (hypot(u.x - um.x, u.y - um.y) > radius_um)
                continue;
            lost += counts && !isnan(grid->value[i]);
            grid->value[i] = NAN;
        }
    return all ? (double)lost / (double)all : 0;
}

static void mask_spot(const struct gsn_artefact_disc *spot, double px_um, double interval_um,
                      struct gsn_assembly_section *s, struct gsn_assembly *a)
{
    enum { DUST = 9 };
    _Static_assert(GSN_DEFECT_DUST == 1 << DUST, "the bit of dust");
    const struct gsn_point um =
        gsn_affine_apply(&s->pose.panel_to_block_um, (struct gsn_point){ spot->px.x, spot->px.y });
    const double radius_um = spot->radius_px * px_um;
    const size_t z = plane_of(s, interval_um, &a->grid->at);
    double lost = 0;

    if (z < a->grid->at.nz)
        lost = take_out(a->grid, z, um, radius_um, a->region);
    if (a->tissue_grid && plane_of(s, interval_um, &a->tissue_grid->at) < a->tissue_grid->at.nz)
        (void)take_out(a->tissue_grid, plane_of(s, interval_um, &a->tissue_grid->at), um, radius_um,
                       NULL);
    s->region_by[DUST] += lost;
    s->region_masked += lost;
    s->masked.area_um2[DUST] += M_PI * radius_um * radius_um;
    s->masked.masked_um2 += M_PI * radius_um * radius_um;
}

/* A spot beside the section is the scanner's trouble, not the section's. */
static int covers(const struct gsn_artefact_disc *spot, const struct gsn_panel_section *seen)
{
    return spot->px.x >= seen->x && spot->px.x < seen->x + seen->width && spot->px.y >= seen->y &&
           spot->px.y < seen->y + seen->height;
}

static const struct gsn_assembly_panel *panel_of(const struct gsn_assembly *a, unsigned number)
{
    for (size_t p = 0; p < a->panel_count; p++)
        if (a->panel[p].opened && a->panel[p].given->number == number)
            return &a->panel[p];
    return NULL;
}

static void mask_dust(const struct gsn_specimen *specimen, struct gsn_assembly *a)
{
    for (size_t i = 0; i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];
        const struct gsn_assembly_panel *panel = panel_of(a, s->panel);
        int covered = 0;

        if (!panel || (s->state != GSN_SECTION_USED && s->state != GSN_SECTION_DOUBTFUL))
            continue;
        for (size_t k = 0; k < a->spot_count; k++) {
            const struct gsn_artefact_disc cells =
                gsn_dust_upright(a->dust, &a->spot[k], panel->turn);
            const struct gsn_artefact_disc spot = { .px = { cells.px.x * panel->cell_px,
                                                            cells.px.y * panel->cell_px },
                                                    .radius_px = cells.radius_px * panel->cell_px };

            if (!covers(&spot, &s->seen))
                continue;
            mask_spot(&spot, panel->given->px_um, specimen->protocol->interval_um, s, a);
            covered = 1;
        }
        if (covered)
            add_flag(s, "dust");
    }
}

int gsn_conditions_judge(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                         struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_stain_amounts) tone =
        gsn_alloc_array(a->section_count + 1, sizeof *tone);
    gsn_auto_mem(size_t) place = gsn_alloc_array(a->section_count + 1, sizeof *place);
    int r = GSN_OK;

    if (!tone || !place)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the sections of a panel");
    for (size_t p = 0; p < a->panel_count; p++)
        if (a->panel[p].opened)
            judge_thickness(a, a->panel[p].given->number, tone, place);
    if (!a->dust || !a->grid)
        return GSN_OK;
    r = gsn_dust_find(a->dust, &a->spot, &a->spot_count, &a->spot_panels, err);
    if (r >= 0)
        mask_dust(specimen, a);
    return r;
}
