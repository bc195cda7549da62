/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Quality control of a panel: defects masked section by section, and the conditions under which the
 * panels were cut, stained and scanned.
 *
 * Masks (stain/artefact/detection.h): folds, tears, ink, bubbles, blur and the like, and the halo
 * of each mark. Ink is what neither the dyes in use nor those of the panel's own tissue explain.
 * The share of the region that a section loses is counted voxel by voxel.
 *
 * Conditions, in cells of CELL_UM:
 * 1. the lamp by the drift of blank glass along rows and columns (stain/illumination_drift.h);
 * 2. the bath by the amounts of yellow and red dye over the panel's tissue
 * (stain/staining_uniformity.h);
 * 3. the knife by sections whose dyes differ together from the panel's others;
 * 4. the scanner's dust by what is dark at one place of every panel (stain/artefact/dust.h); the
 * density behind it is taken out of the stack.
 *
 * Findings are flags and sentences. Fails with GSN_E_STAIN as gsn_unmix(), GSN_E_NOMEM. */
#include "pipeline/specimen/quality_control.h"

#include "pipeline/core/calendar.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/panel/reduce.h"
#include "pipeline/stain/artefact/detection.h"
#include "pipeline/stain/artefact/dust.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/illumination_drift.h"
#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/stain_sample.h"
#include "pipeline/stain/stain_vectors.h"
#include "pipeline/stain/staining_uniformity.h"
#include "pipeline/stain/unmixing.h"
#include "pipeline/stain/vector_estimation.h"

#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

/* Heat changes the stain around a burn, so a disc of this many mark radii is masked: the bleached
 * ring of the marks seen so far ends at 1.5 radii, the rest is margin for the blur. */
static const double HALO_RADII = 2.0;

/* Around a mark, in its radii: char is no dye. */
static const double MARK_REACH = 3;

/* Bits of defects. */
enum { INK = 5, DUST = 9 };
_Static_assert(GSN_DEFECT_INK == 1 << INK && GSN_DEFECT_DUST == 1 << DUST, "bits of defects");

static int is_there(const struct gsn_section *s, unsigned panel)
{
    return s->panel == panel && s->seen.width > 0 && s->seen.height > 0;
}

static struct gsn_artefact_section place_of(const struct gsn_panel_section *seen,
                                            const struct gsn_fiducial mark[GSN_FIDUCIALS])
{
    struct gsn_artefact_section place = {
        .x = seen->x, .y = seen->y, .width = seen->width, .height = seen->height
    };

    for (size_t m = 0; m < GSN_FIDUCIALS; m++)
        if (mark[m].found)
            place.halo[place.halo_count++] =
                (struct gsn_artefact_disc){ .px = { mark[m].px.x, mark[m].px.y },
                                            .radius_px = HALO_RADII * mark[m].radius_px };
    return place;
}

static void add_flags(struct gsn_section_density *s)
{
    for (unsigned bit = 0; bit < GSN_DEFECTS; bit++)
        if (1u << bit != GSN_DEFECT_HALO && s->masked.area_um2[bit] > 0)
            gsn_flags_add(&s->flags, GSN_FLAG_DEFECT + bit);
}

static int near_mark(const struct gsn_fiducial mark[GSN_FIDUCIALS], double x, double y)
{
    for (int m = 0; m < GSN_FIDUCIALS; m++)
        if (mark[m].found &&
            hypot(x - mark[m].px.x, y - mark[m].px.y) <= MARK_REACH * mark[m].radius_px)
            return 1;
    return 0;
}

int gsn_masking_tissue(const struct gsn_scan *scan, unsigned panel, const struct gsn_poses *poses,
                       const struct gsn_section_marks *marks, struct gsn_image **ret_tissue,
                       struct gsn_error *err)
{
    const struct gsn_plane *od = scan->od[0];
    const int apart = (int)scan->apart;
    gsn_auto(gsn_image) tissue = NULL;
    const int r = gsn_image_new(od->width, od->height, 1, 8, &tissue, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < poses->section_count; i++) {
        const struct gsn_panel_section *seen = &poses->section[i].seen;

        if (poses->section[i].panel != panel)
            continue;
        for (int y = seen->y / apart; y < (seen->y + seen->height) / apart; y++)
            for (int x = seen->x / apart; x < (seen->x + seen->width) / apart; x++)
                ((uint8_t *)tissue->samples)[(size_t)y * od->width + (size_t)x] =
                    !near_mark(marks[i].mark, x * apart + 0.5, y * apart + 0.5);
    }
    *ret_tissue = gsn_steal(&tissue);
    return GSN_OK;
}

/* The dyes as the panel's own tissue shows them. That it cannot tell is no failure: *ret_own stays
 * as it is. */
static int find_own(const struct gsn_scan *scan, unsigned panel, const struct gsn_poses *poses,
                    const struct gsn_section_marks *marks, struct gsn_dyes *ret_own,
                    struct gsn_error *err)
{
    const struct gsn_dyes_prior prior = gsn_dyes_prior_builtin(scan->glass.light);
    gsn_auto(gsn_stain_sample) sample = NULL;
    gsn_auto(gsn_image) tissue = NULL;
    struct gsn_error why = { 0 };
    struct gsn_unmixer mix;
    struct gsn_dyes_fit fit;
    int r = gsn_masking_tissue(scan, panel, poses, marks, &tissue, err);

    if (r >= 0)
        r = gsn_stain_sample_new(&sample, err);
    if (r >= 0)
        r = gsn_stain_sample_add(sample, scan->od, tissue, &scan->glass, err);
    if (r < 0)
        return r;
    r = gsn_dyes_estimate(sample, &prior, &fit, &why);
    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    if (r >= 0 && gsn_unmixer_init(&mix, &fit.dyes, &why) >= 0)
        *ret_own = fit.dyes;
    return GSN_OK;
}

int gsn_masking_label(const struct gsn_scan *scan, const struct gsn_dyes *dyes, unsigned panel,
                      unsigned threads, const struct gsn_poses *poses,
                      const struct gsn_section_marks *marks,
                      struct gsn_artefact_labels **ret_labels,
                      struct gsn_artefact_figures *ret_figures, struct gsn_error *err)
{
    struct gsn_dyes own = *dyes;
    gsn_auto_mem(struct gsn_artefact_section) places =
        gsn_alloc_array(poses->section_count, sizeof *places);
    struct gsn_artefact_panel look = { .image = scan->picture->image,
                                       .od = scan->od,
                                       .glass = &scan->glass,
                                       .dyes = dyes,
                                       .px_um = scan->px_um,
                                       .section = places,
                                       .own = &own };
    int r;

    if (!places)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the masks of a panel");
    r = find_own(scan, panel, poses, marks, &own, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < poses->section_count; i++)
        if (is_there(&poses->section[i], panel))
            places[look.section_count++] = place_of(&poses->section[i].seen, marks[i].mark);
    return gsn_artefact_find(&look, threads, ret_labels, ret_figures, err);
}

int gsn_masking_find(const struct gsn_scan *scan, const struct gsn_dyes *dyes, unsigned panel,
                     unsigned threads, const struct gsn_poses *poses,
                     struct gsn_densities *densities, struct gsn_artefact_labels **ret_labels,
                     struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_artefact_figures) figures =
        gsn_alloc_array(poses->section_count, sizeof *figures);
    int r;

    if (!figures)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the masks of a panel");
    r = gsn_masking_label(scan, dyes, panel, threads, poses, densities->marks, ret_labels, figures,
                          err);
    for (size_t i = 0, k = 0; r >= 0 && i < poses->section_count; i++)
        if (is_there(&poses->section[i], panel)) {
            densities->section[i].masked = figures[k++];
            add_flags(&densities->section[i]);
        }
    return r;
}

size_t gsn_masking_index(const struct gsn_poses *poses, size_t i)
{
    size_t index = 0;

    for (size_t k = 0; k < i; k++)
        index += (size_t)is_there(&poses->section[k], poses->section[i].panel);
    return index;
}

/* The label of the pixel of section k that shows this voxel. */
static unsigned label_at(const struct gsn_artefact_labels *labels, size_t k,
                         const struct gsn_affine *block_to_panel, struct gsn_vec3 u)
{
    const struct gsn_point um = { u.x, u.y };
    const struct gsn_point px = gsn_affine_apply(block_to_panel, um);

    if (!(px.x >= 0 && px.y >= 0 && px.x < INT_MAX && px.y < INT_MAX))
        return 0;
    return gsn_artefact_label(labels, k, (int)px.x, (int)px.y);
}

static void count_plane(const struct gsn_artefact_labels *labels, size_t k,
                        const struct gsn_mask *region, size_t z, const struct gsn_section *section,
                        struct gsn_section_density *s)
{
    const struct gsn_affine block_to_panel = gsn_affine_inverse(&section->pose.panel_to_block_um);
    const struct gsn_lattice *at = &region->at;
    size_t all = 0, masked = 0, by[GSN_DEFECTS] = { 0 };

    for (size_t y = 0; y < at->ny; y++)
        for (size_t x = 0; x < at->nx; x++) {
            unsigned label;

            if (!region->inside[gsn_lattice_index(at, x, y, z)])
                continue;
            label = label_at(labels, k, &block_to_panel, gsn_lattice_centre(at, x, y, z));
            all++;
            masked += label != 0;
            for (unsigned bit = 0; bit < GSN_DEFECTS; bit++)
                by[bit] += label >> bit & 1;
        }
    for (unsigned bit = 0; all > 0 && bit < GSN_DEFECTS; bit++)
        s->region_by[bit] = (double)by[bit] / (double)all;
    s->region_masked = all > 0 ? (double)masked / (double)all : 0;
}

/* The plane of the region's lattice that shows a section; nz when there is none. */
static size_t plane_of(const struct gsn_section *s, double interval_um,
                       const struct gsn_lattice *at)
{
    const double z =
        round((interval_um * (s->seen.serial + 0.5) - at->origin_um.z) / at->step_um.z);

    return z >= 0 && z < (double)at->nz ? (size_t)z : at->nz;
}

void gsn_masking_region(const struct gsn_artefact_labels *labels, unsigned panel,
                        double interval_um, const struct gsn_mask *region,
                        const struct gsn_poses *poses, struct gsn_densities *densities)
{
    for (size_t i = 0; region && i < poses->section_count; i++) {
        const struct gsn_section *s = &poses->section[i];
        const size_t z = plane_of(s, interval_um, &region->at);

        if (is_there(s, panel) && s->posed && z < region->at.nz)
            count_plane(labels, gsn_masking_index(poses, i), region, z, s, &densities->section[i]);
    }
}

void gsn_masking_gaps(double interval_um, const struct gsn_mask *region,
                      const struct gsn_poses *poses, struct gsn_densities *densities)
{
    for (size_t i = 0; region && i < poses->section_count; i++) {
        const struct gsn_lattice *at = &region->at;
        const size_t z = plane_of(&poses->section[i], interval_um, at);
        size_t all = 0, gaps = 0;

        for (size_t k = z * at->nx * at->ny; z < at->nz && k < (z + 1) * at->nx * at->ny; k++) {
            all += region->inside[k] != 0;
            gaps += region->inside[k] && isnan(densities->grid->value[k]);
        }
        if (poses->section[i].posed)
            densities->section[i].region_masked = all > 0 ? (double)gaps / (double)all : 0;
    }
}

/* Dust of half a cell still darkens it. */
static const double CELL_UM = 20;

static struct gsn_pixel_box box_of(const struct gsn_panel_section *seen)
{
    return (struct gsn_pixel_box){ seen->x, seen->y, seen->width, seen->height };
}

/* The least box that holds all sections of a panel: no label and no frame lies in it. */
static struct gsn_pixel_box box_of_all(const struct gsn_poses *poses, unsigned panel)
{
    int x0 = INT32_MAX, y0 = INT32_MAX, x1 = 0, y1 = 0;

    for (size_t i = 0; i < poses->section_count; i++) {
        const struct gsn_panel_section *s = &poses->section[i].seen;

        if (!is_there(&poses->section[i], panel))
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
struct cells_view {
    const struct gsn_scan *scan;
    struct gsn_stack_panel *panel;
    const struct gsn_poses *poses;
    struct gsn_densities *densities;
    int side; /* pixels of the panel along a cell */
    struct gsn_plane *od[3];
};

static struct gsn_pixel_box in_cells(const struct gsn_pixel_box *box, int side)
{
    return (struct gsn_pixel_box){ box->x / side, box->y / side,
                                   (box->x + box->width) / side - box->x / side,
                                   (box->y + box->height) / side - box->y / side };
}

static int see_cells(struct cells_view *look, struct gsn_error *err)
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

static int add_dust(const struct cells_view *look, const struct gsn_pixel_box *box,
                    struct gsn_error *err)
{
    const struct gsn_poses *poses = look->poses;
    gsn_auto_mem(struct gsn_artefact_disc) mark =
        gsn_alloc_array(GSN_FIDUCIALS * poses->section_count + 1, sizeof *mark);
    size_t count = 0;
    int r = mark ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for a map of dust");

    if (r >= 0 && !look->densities->dust)
        r = gsn_dust_new(&look->densities->dust, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < poses->section_count; i++)
        for (size_t m = 0;
             is_there(&poses->section[i], look->panel->given->number) && m < GSN_FIDUCIALS; m++) {
            const struct gsn_fiducial *one = &look->densities->marks[i].mark[m];

            if (one->found)
                mark[count++] = (struct gsn_artefact_disc){
                    .px = { one->px.x / look->side, one->px.y / look->side },
                    .radius_px = HALO_RADII * one->radius_px / look->side
                };
        }
    return gsn_dust_add(look->densities->dust, look->od, look->scan->px_um * look->side,
                        look->scan->upright.turn, box, mark, count, err);
}

/* gives: in cells of the box 0, or NaN where the section is masked. */
static int mask_of(const struct cells_view *look, const struct gsn_artefact_labels *labels,
                   size_t i, const struct gsn_pixel_box *box, struct gsn_plane **ret_mask,
                   struct gsn_error *err)
{
    const size_t section = gsn_masking_index(look->poses, i);
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

static int add_tone(const struct cells_view *look, const struct gsn_artefact_labels *labels,
                    size_t i, struct gsn_error *err)
{
    struct gsn_section_density *s = &look->densities->section[i];
    const struct gsn_pixel_box whole = box_of(&look->poses->section[i].seen);
    const struct gsn_pixel_box box = in_cells(&whole, look->side);
    gsn_auto(gsn_plane) mask = NULL;
    int r = mask_of(look, labels, i, &box, &mask, err);

    if (r >= 0)
        r = gsn_stain_amounts_of(look->od, mask, &look->panel->stain.fit.dyes, &box, &s->tone, err);
    if (r >= 0)
        look->panel->tone = gsn_stain_amounts_sum(&look->panel->tone, &s->tone);
    return r;
}

static int measure_cells(const struct cells_view *look, const struct gsn_artefact_labels *labels,
                         struct gsn_error *err)
{
    const struct gsn_pixel_box whole = box_of_all(look->poses, look->panel->given->number);
    const struct gsn_pixel_box box = in_cells(&whole, look->side);
    int r = GSN_OK;

    look->panel->turn = look->scan->upright.turn;
    look->panel->lamp = gsn_illumination_drift(look->od, &box);
    for (size_t i = 0; i < look->poses->section_count && r >= 0; i++)
        if (is_there(&look->poses->section[i], look->panel->given->number))
            r = add_tone(look, labels, i, err);
    return r < 0 ? r : add_dust(look, &box, err);
}

int gsn_quality_measure_panel(const struct gsn_scan *scan, const struct gsn_artefact_labels *labels,
                              const struct gsn_poses *poses, struct gsn_stack_panel *panel,
                              struct gsn_densities *densities, struct gsn_error *err)
{
    struct cells_view look = {
        .scan = scan, .panel = panel, .poses = poses, .densities = densities
    };
    int r = see_cells(&look, err);

    if (r >= 0)
        r = measure_cells(&look, labels, err);
    for (int c = 0; c < 3; c++)
        gsn_plane_free(look.od[c]);
    return r;
}

/* ---- thickness ------------------------------------------------------------------------------ */

/* Of one panel, whose sections shared one bath. tone and place: room for all sections. */
static void judge_thickness(const struct gsn_poses *poses, unsigned panel,
                            struct gsn_densities *densities, struct gsn_stain_amounts *tone,
                            size_t *place)
{
    size_t count = 0;

    for (size_t i = 0; i < poses->section_count; i++)
        if (poses->section[i].panel == panel && densities->section[i].tone.pixels > 0) {
            place[count] = i;
            tone[count++] = densities->section[i].tone;
        }
    for (size_t k = 0; k < count; k++) {
        struct gsn_section_density *s = &densities->section[place[k]];

        s->thickness = gsn_stain_amounts_thickness(tone, count, k);
        if (s->thickness != 1)
            gsn_flags_add(&s->flags, s->thickness > 1 ? GSN_FLAG_THICK : GSN_FLAG_THIN);
    }
}

/* ---- dust ------------------------------------------------------------------------------------ */

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
                      const struct gsn_section *section, const struct gsn_mask *region,
                      struct gsn_densities *densities, struct gsn_section_density *s)
{
    const struct gsn_point um = gsn_affine_apply(&section->pose.panel_to_block_um,
                                                 (struct gsn_point){ spot->px.x, spot->px.y });
    const double radius_um = spot->radius_px * px_um;
    const size_t z = plane_of(section, interval_um, &densities->grid->at);
    double lost = 0;

    if (z < densities->grid->at.nz)
        lost = take_out(densities->grid, z, um, radius_um, region);
    if (densities->tissue_grid &&
        plane_of(section, interval_um, &densities->tissue_grid->at) < densities->tissue_grid->at.nz)
        (void)take_out(densities->tissue_grid,
                       plane_of(section, interval_um, &densities->tissue_grid->at), um, radius_um,
                       NULL);
    s->region_by[DUST] += lost;
    s->region_masked += lost;
    s->masked.area_um2[DUST] += M_PI * radius_um * radius_um;
    s->masked.masked_um2 += M_PI * radius_um * radius_um;
}

/* A spot beside the section is the scanner's trouble, not the section's. */
static int spot_covers(const struct gsn_artefact_disc *spot, const struct gsn_panel_section *seen)
{
    return spot->px.x >= seen->x && spot->px.x < seen->x + seen->width && spot->px.y >= seen->y &&
           spot->px.y < seen->y + seen->height;
}

static const struct gsn_stack_panel *panel_of(const struct gsn_densities *d, unsigned number)
{
    for (size_t p = 0; p < d->panel_count; p++)
        if (d->panel[p].opened && d->panel[p].given->number == number)
            return &d->panel[p];
    return NULL;
}

static void mask_dust(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                      const struct gsn_poses *poses, struct gsn_densities *d)
{
    for (size_t i = 0; i < poses->section_count; i++) {
        const struct gsn_section *section = &poses->section[i];
        struct gsn_section_density *s = &d->section[i];
        const struct gsn_stack_panel *panel = panel_of(d, section->panel);
        int covered = 0;

        if (!panel || (s->state != GSN_SECTION_USED && s->state != GSN_SECTION_DOUBTFUL))
            continue;
        for (size_t k = 0; k < d->spot_count; k++) {
            const struct gsn_artefact_disc cells =
                gsn_dust_upright(d->dust, &d->spot[k], panel->turn);
            const struct gsn_artefact_disc spot = { .px = { cells.px.x * panel->cell_px,
                                                            cells.px.y * panel->cell_px },
                                                    .radius_px = cells.radius_px * panel->cell_px };

            if (!spot_covers(&spot, &section->seen))
                continue;
            mask_spot(&spot, panel->given->px_um, specimen->protocol->interval_um, section, region,
                      d, s);
            covered = 1;
        }
        if (covered)
            gsn_flags_add(&s->flags, GSN_FLAG_DEFECT + DUST);
    }
}

int gsn_quality_judge(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                      const struct gsn_poses *poses, struct gsn_densities *d, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_stain_amounts) tone =
        gsn_alloc_array(poses->section_count + 1, sizeof *tone);
    gsn_auto_mem(size_t) place = gsn_alloc_array(poses->section_count + 1, sizeof *place);
    int r = GSN_OK;

    if (!tone || !place)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the sections of a panel");
    for (size_t p = 0; p < d->panel_count; p++)
        if (d->panel[p].opened)
            judge_thickness(poses, d->panel[p].given->number, d, tone, place);
    if (!d->dust || !d->grid)
        return GSN_OK;
    r = gsn_dust_find(d->dust, &d->spot, &d->spot_count, &d->spot_panels, err);
    if (r >= 0)
        mask_dust(specimen, region, poses, d);
    return r;
}

/* ---- in words -------------------------------------------------------------------------------- */

/* Bands of the blank glass may differ by this much, 2.3 % of the light: it moves a density of 0.7
 * by 1.4 %. The vignetting that the glass's surface cannot follow stays below 0.008. */
static const double STEADY_OD = 0.01;

/* A stain that waited longer for its scan is told: picro-fuchsin fades, in acid mounting media
 * quickly. */
static const double TOLD_DAYS = 28;

/* More of a panel's tissue than pens ever cover. */
static const double MUCH_INK = 0.25;

static int add_sentence(struct gsn_quality_sentences *words, char *sentence)
{
    char **more = gsn_realloc_array(words->sentence, words->count + 1, sizeof *more);

    if (more)
        words->sentence = more;
    if (!more || !sentence) {
        gsn_free(sentence);
        return GSN_E_NOMEM;
    }
    words->sentence[words->count++] = sentence;
    return GSN_OK;
}

void gsn_quality_sentences_done(struct gsn_quality_sentences *words)
{
    for (size_t i = 0; i < words->count; i++)
        gsn_free(words->sentence[i]);
    gsn_free(words->sentence);
}

static int say_lamp(const struct gsn_stack_panel *p, struct gsn_quality_sentences *words)
{
    const int rows = !(p->lamp.rows < p->lamp.columns);
    const double drift = rows ? p->lamp.rows : p->lamp.columns;

    if (!(drift > STEADY_OD))
        return GSN_OK;
    return add_sentence(
        words, gsn_format("panel %u: the blank glass drifts by %.1f %% from %s to %s within "
                          "the scan, and %.1f %% are allowed: the lamp flickers or was "
                          "still warming up; let it warm up and scan the panel again",
                          p->given->number, 100 * (pow(10, drift) - 1), rows ? "row" : "column",
                          rows ? "row" : "column", 100 * (pow(10, STEADY_OD) - 1)));
}

static int say_bath(const struct gsn_stack_panel *p, const struct gsn_protocol *protocol,
                    struct gsn_quality_sentences *words)
{
    const double ratio = gsn_stain_amounts_yellow_to_red(&p->tone);
    const double low = protocol->yellow_to_red[0], high = protocol->yellow_to_red[1];

    if (!(low > 0) || isnan(ratio) || (ratio >= low && ratio <= high))
        return GSN_OK;
    return add_sentence(
        words,
        gsn_format("panel %u: yellow dye is %.2f times the red, the batch's limits "
                   "are %g to %g: %s; compare with the batch's control glass",
                   p->given->number, ratio, low, high,
                   ratio > high ? "red was washed out (differentiated too long) or yellow "
                                  "rinsed too little"
                                : "yellow was washed out (in water) or red differentiated too "
                                  "little"));
}

/* Pen strokes cover little of what they are drawn on; tissue of another hue than the dyes' may be
 * taken for ink, and is lost to the figures like it. */
static int say_ink(const struct gsn_poses *poses, const struct gsn_densities *d, unsigned panel,
                   struct gsn_quality_sentences *words)
{
    double ink = 0, tissue = 0;

    for (size_t i = 0; i < poses->section_count; i++)
        if (poses->section[i].panel == panel) {
            ink += d->section[i].masked.area_um2[INK];
            tissue += d->section[i].masked.outline_um2;
        }
    if (!(ink > MUCH_INK * tissue))
        return GSN_OK;
    return add_sentence(
        words, gsn_format("panel %u: %.0f %% of its tissue has a colour that the dyes do not "
                          "explain and is left out as ink; if it is not drawn upon, it was "
                          "stained by other dyes than those that the job goes by: state a "
                          "calibration panel, or \"dyes\": \"estimate\"",
                          panel, 100 * fmin(ink / tissue, 1)));
}

/* "2 (1.4 times), 7 (0.7 times)" */
static int say_knife(const struct gsn_poses *poses, const struct gsn_densities *d,
                     struct gsn_quality_sentences *words)
{
    char list[400] = "";
    size_t used = 0, count = 0;

    for (size_t i = 0; i < poses->section_count; i++) {
        const double times = d->section[i].thickness;
        int n;

        if (!(times > 0) || times == 1)
            continue;
        count++;
        if (used + 30 > sizeof list)
            continue;
        n = snprintf(list + used, sizeof list - used, "%s%u (%.1f times)", used ? ", " : "",
                     poses->section[i].seen.serial, times);
        used += n > 0 ? (size_t)n : 0;
    }
    if (count == 0)
        return GSN_OK;
    return add_sentence(
        words, gsn_format("all dyes of section%s %s differ together from the panel's other "
                          "sections: thickness suspected, look at the knife; %s density is "
                          "not corrected",
                          count == 1 ? "" : "s", list, count == 1 ? "its" : "their"));
}

static int say_dust(const struct gsn_densities *d, struct gsn_quality_sentences *words)
{
    char list[200] = "";
    size_t used = 0;

    if (d->spot_count == 0)
        return GSN_OK;
    for (size_t i = 0; i < d->spot_count && used + 30 < sizeof list; i++) {
        const int n = snprintf(list + used, sizeof list - used, "%s(%.0f, %.0f)", used ? ", " : "",
                               d->spot[i].px.x, d->spot[i].px.y);

        used += n > 0 ? (size_t)n : 0;
    }
    return add_sentence(
        words, gsn_format("%zu spot%s at the same place of all %u panels, at %s px: dirt on "
                          "the scanner's glass or sensor. %s masked; clean it before the "
                          "next panel",
                          d->spot_count, d->spot_count == 1 ? " is dark" : "s are dark",
                          d->spot_panels, list, d->spot_count == 1 ? "It is" : "They are"));
}

static int say_age(const struct gsn_protocol *p, struct gsn_quality_sentences *words)
{
    if (!(p->days_to_scan > TOLD_DAYS))
        return GSN_OK;
    return add_sentence(
        words, gsn_format("stained on %s and scanned on %s, %.0f days later: picro-fuchsin "
                          "fades, and what has faded looks like loss; compare only with a "
                          "control of the same age",
                          p->stained, p->scanned, p->days_to_scan));
}

int gsn_quality_sentences(const struct gsn_poses *poses, const struct gsn_densities *d,
                          const struct gsn_protocol *protocol, struct gsn_quality_sentences *words)
{
    int r = say_age(protocol, words);

    for (size_t p = 0; r >= 0 && p < d->panel_count; p++) {
        if (!d->panel[p].opened || !d->grid)
            continue;
        r = say_lamp(&d->panel[p], words);
        if (r >= 0)
            r = say_bath(&d->panel[p], protocol, words);
        if (r >= 0)
            r = say_ink(poses, d, d->panel[p].given->number, words);
    }
    if (r >= 0)
        r = say_knife(poses, d, words);
    return r < 0 ? r : say_dust(d, words);
}
