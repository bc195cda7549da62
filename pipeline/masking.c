/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/masking.h"

#include "pipeline/stain/artefact/detection.h"
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

static int is_there(const struct gsn_assembly_section *s, unsigned panel)
{
    return s->panel == panel && s->seen.width > 0 && s->seen.height > 0;
}

static struct gsn_artefact_section place_of(const struct gsn_panel_section *seen)
{
    struct gsn_artefact_section place = {
        .x = seen->x, .y = seen->y, .width = seen->width, .height = seen->height
    };

    for (size_t m = 0; m < GSN_MARKS; m++)
        if (seen->mark[m].found)
            place.halo[place.halo_count++] =
                (struct gsn_artefact_disc){ .px = { seen->mark[m].px.x, seen->mark[m].px.y },
                                            .radius_px = HALO_RADII * seen->mark[m].radius_px };
    return place;
}

static void add_flags(struct gsn_assembly_section *s)
{
    for (unsigned bit = 0; bit < GSN_DEFECTS; bit++) {
        const size_t used = strlen(s->flags);

        if (1u << bit != GSN_DEFECT_HALO && s->masked.area_um2[bit] > 0)
            (void)snprintf(s->flags + used, sizeof s->flags - used, "%s%s", used ? " " : "",
                           gsn_defect_word(bit));
    }
}

static int near_mark(const struct gsn_panel_section *seen, double x, double y)
{
    for (int m = 0; m < GSN_MARKS; m++)
        if (seen->mark[m].found && hypot(x - seen->mark[m].px.x, y - seen->mark[m].px.y) <=
                                       MARK_REACH * seen->mark[m].radius_px)
            return 1;
    return 0;
}

int gsn_masking_tissue(const struct gsn_scan *scan, unsigned panel, const struct gsn_assembly *a,
                       struct gsn_image **ret_tissue, struct gsn_error *err)
{
    const struct gsn_plane *od = scan->od[0];
    const int apart = (int)scan->apart;
    gsn_auto(gsn_image) tissue = NULL;
    const int r = gsn_image_new(od->width, od->height, 1, 8, &tissue, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_panel_section *seen = &a->section[i].seen;

        if (a->section[i].panel != panel)
            continue;
        for (int y = seen->y / apart; y < (seen->y + seen->height) / apart; y++)
            for (int x = seen->x / apart; x < (seen->x + seen->width) / apart; x++)
                ((uint8_t *)tissue->samples)[(size_t)y * od->width + (size_t)x] =
                    !near_mark(seen, x * apart + 0.5, y * apart + 0.5);
    }
    *ret_tissue = gsn_steal(&tissue);
    return GSN_OK;
}

/* The dyes as the panel's own tissue shows them. That it cannot tell is no failure: *ret_own stays
 * as it is. */
static int find_own(const struct gsn_scan *scan, unsigned panel, const struct gsn_assembly *a,
                    struct gsn_dyes *ret_own, struct gsn_error *err)
{
    const struct gsn_dyes_prior prior = gsn_dyes_prior_builtin(scan->glass.light);
    gsn_auto(gsn_stain_sample) sample = NULL;
    gsn_auto(gsn_image) tissue = NULL;
    struct gsn_error why = { 0 };
    struct gsn_unmixer mix;
    struct gsn_dyes_fit fit;
    int r = gsn_masking_tissue(scan, panel, a, &tissue, err);

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
                      unsigned threads, const struct gsn_assembly *a,
                      struct gsn_artefact_labels **ret_labels,
                      struct gsn_artefact_figures *ret_figures, struct gsn_error *err)
{
    struct gsn_dyes own = *dyes;
    gsn_auto_mem(struct gsn_artefact_section) places =
        gsn_alloc_array(a->section_count, sizeof *places);
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
    r = find_own(scan, panel, a, &own, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < a->section_count; i++)
        if (is_there(&a->section[i], panel))
            places[look.section_count++] = place_of(&a->section[i].seen);
    return gsn_artefact_find(&look, threads, ret_labels, ret_figures, err);
}

int gsn_masking_find(const struct gsn_scan *scan, const struct gsn_dyes *dyes, unsigned panel,
                     unsigned threads, struct gsn_assembly *a,
                     struct gsn_artefact_labels **ret_labels, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_artefact_figures) figures =
        gsn_alloc_array(a->section_count, sizeof *figures);
    int r;

    if (!figures)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the masks of a panel");
    r = gsn_masking_label(scan, dyes, panel, threads, a, ret_labels, figures, err);
    for (size_t i = 0, k = 0; r >= 0 && i < a->section_count; i++)
        if (is_there(&a->section[i], panel)) {
            a->section[i].masked = figures[k++];
            add_flags(&a->section[i]);
        }
    return r;
}

size_t gsn_masking_index(const struct gsn_assembly *a, size_t i)
{
    size_t index = 0;

    for (size_t k = 0; k < i; k++)
        index += (size_t)is_there(&a->section[k], a->section[i].panel);
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
                        const struct gsn_mask *region, size_t z, struct gsn_assembly_section *s)
{
    const struct gsn_affine block_to_panel = gsn_affine_inverse(&s->pose.panel_to_block_um);
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
static size_t plane_of(const struct gsn_assembly_section *s, double interval_um,
                       const struct gsn_lattice *at)
{
    const double z =
        round((interval_um * (s->seen.serial + 0.5) - at->origin_um.z) / at->step_um.z);

    return z >= 0 && z < (double)at->nz ? (size_t)z : at->nz;
}

void gsn_masking_region(const struct gsn_artefact_labels *labels, unsigned panel,
                        double interval_um, struct gsn_assembly *a)
{
    for (size_t i = 0; a->region && i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];
        const size_t z = plane_of(s, interval_um, &a->region->at);

        if (is_there(s, panel) && s->posed && z < a->region->at.nz)
            count_plane(labels, gsn_masking_index(a, i), a->region, z, s);
    }
}

void gsn_masking_gaps(double interval_um, struct gsn_assembly *a)
{
    for (size_t i = 0; a->region && i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];
        const struct gsn_lattice *at = &a->region->at;
        const size_t z = plane_of(s, interval_um, at);
        size_t all = 0, gaps = 0;

        for (size_t k = z * at->nx * at->ny; z < at->nz && k < (z + 1) * at->nx * at->ny; k++) {
            all += a->region->inside[k] != 0;
            gaps += a->region->inside[k] && isnan(a->grid->value[k]);
        }
        if (s->posed)
            s->region_masked = all > 0 ? (double)gaps / (double)all : 0;
    }
}
