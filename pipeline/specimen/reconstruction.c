/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From the panels of one specimen to one stack in the block frame.
 *
 * 1. Every slot that the job expects or that came becomes a section (poses.c).
 * 2. The region and the lattice around it (region.c).
 * 3. Poses: by marks, all sections together (poses.c), by the tissue of neighbours where marks
 * place none (tissue_poses.c); then the extent of what is posed, on which later lattices of the
 * whole block rest, and refinement by tissue where the job asks for it (tissue_refinement.c). What
 * cannot be placed is a state with a reason.
 * 4. Every panel is opened once more: masks, quality control, density and colour, resampled into
 * the stack; what is told by comparing sections or panels is gathered on the way (density_stack.c).
 * 5. The panels are brought to one scale (normalisation.c), a band is looked for, and what the
 * stain leaves open is summed up.
 * 6. Tissue that was not treated (control_tissue.c) and the colours of all tissue (normalisation.c)
 * are kept for other specimens.
 *
 * Sections and panels that cannot be used are states with a reason, not failures. */
#include "pipeline/specimen/reconstruction.h"

#include <math.h>

/* The boxes of all posed sections in the block. */
static struct gsn_block_box find_extent(const struct gsn_poses *poses, double interval_um)
{
    struct gsn_block_box box = { { INFINITY, INFINITY, INFINITY },
                                 { -INFINITY, -INFINITY, -INFINITY } };

    for (size_t i = 0; i < poses->section_count; i++) {
        const struct gsn_section *s = &poses->section[i];

        for (int corner = 0; s->posed && corner < 4; corner++) {
            const struct gsn_point px = { s->seen.x + (corner & 1 ? s->seen.width : 0),
                                          s->seen.y + (corner & 2 ? s->seen.height : 0) };
            const struct gsn_point um = gsn_affine_apply(&s->pose.panel_to_block_um, px);

            box.low = gsn_vec3_make(fmin(box.low.x, um.x), fmin(box.low.y, um.y),
                                    fmin(box.low.z, interval_um * s->seen.serial));
            box.high = gsn_vec3_make(fmax(box.high.x, um.x), fmax(box.high.y, um.y),
                                     fmax(box.high.z, interval_um * (s->seen.serial + 1)));
        }
    }
    return box;
}

static int find_poses(const struct gsn_specimen *specimen,
                      const struct gsn_specimen_options *options, const struct gsn_mask *region,
                      struct gsn_calibrations *calibrations, struct gsn_poses *poses,
                      struct gsn_error *err)
{
    int r = gsn_poses_by_fiducials(specimen, region, poses, err);

    if (r >= 0)
        r = gsn_poses_by_tissue(specimen, options, region, poses, err);
    if (r < 0)
        return r;
    poses->extent = find_extent(poses, specimen->protocol->interval_um);
    return gsn_poses_refine(specimen, options, region, calibrations, poses, err);
}

/* The lattice of the stack: of the stated region, or, where a band will be looked for, of all that
 * is posed. ret_lattice is NULL where there is neither region nor solution. */
static int place_stack(const struct gsn_specimen *specimen, double px_um, int has_band,
                       const struct gsn_reconstruction *a, struct gsn_lattice *lattice,
                       const struct gsn_lattice **ret_lattice, struct gsn_error *err)
{
    *ret_lattice = a->poses.solved && (a->region || has_band) ? lattice : NULL;
    if (!*ret_lattice || !has_band)
        return GSN_OK;
    return gsn_region_place_block(specimen, px_um, gsn_poses_length(&a->poses), &a->poses.extent,
                                  lattice, err);
}

static int run_stages(const struct gsn_specimen *specimen,
                      const struct gsn_specimen_options *options, struct gsn_reconstruction *a,
                      struct gsn_error *err)
{
    const double px_um = gsn_region_voxel_um(specimen);
    const int has_band = specimen->protocol->region.kind == GSN_REGION_BAND;
    const struct gsn_lattice *stack = NULL;
    struct gsn_lattice lattice = { 0 };
    int r = gsn_poses_list(specimen, &a->poses, err);

    if (r >= 0 && px_um > 0 && !has_band &&
        (specimen->region || specimen->protocol->region.kind > GSN_REGION_MASK))
        r = gsn_region_place(specimen, px_um, gsn_poses_length(&a->poses), &a->region, &lattice,
                             err);
    if (r >= 0)
        r = gsn_calibrations_init(specimen, &a->calibrations, err);
    if (r >= 0)
        r = find_poses(specimen, options, a->region, &a->calibrations, &a->poses, err);
    if (r >= 0)
        r = place_stack(specimen, px_um, has_band, a, &lattice, &stack, err);
    if (r >= 0)
        r = gsn_densities_stack(specimen, options, stack, a->region, &a->poses, &a->calibrations,
                                &a->densities, err);
    if (r >= 0)
        r = gsn_scale_normalise(specimen, a->region, &a->poses, &a->densities, &a->scale, err);
    if (r >= 0 && has_band && a->densities.grid)
        r = gsn_densities_find_band(specimen, options, &a->poses, &a->densities, &a->region,
                                    a->no_region, err);
    if (r < 0)
        return r;
    gsn_scale_sum_errors(specimen, a->region, &a->poses, &a->densities, &a->scale);
    r = gsn_scale_find_tissues(specimen, a->region, &a->poses, &a->densities, &a->scale, err);
    return r < 0 ? r
                 : gsn_scale_count_colours(specimen, a->region, &a->poses, &a->densities, &a->scale,
                                           err);
}

int gsn_reconstruct(const struct gsn_specimen *specimen, const struct gsn_specimen_options *options,
                    struct gsn_reconstruction **ret_reconstruction, struct gsn_error *err)
{
    gsn_auto(gsn_reconstruction) a = gsn_alloc_array(1, sizeof *a);
    int r;

    if (!a)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the reconstruction of a specimen");
    r = run_stages(specimen, options, a, err);
    if (r < 0)
        return r;
    *ret_reconstruction = gsn_steal(&a);
    return GSN_OK;
}

void gsn_reconstruction_free(struct gsn_reconstruction *a)
{
    if (!a)
        return;
    gsn_scale_done(&a->scale);
    gsn_densities_done(&a->densities);
    gsn_poses_done(&a->poses);
    gsn_calibrations_done(&a->calibrations);
    gsn_mask_free(a->region);
    gsn_free(a);
}
