/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From the panels of one specimen to one stack in the block frame.
 *
 * 1. Every slot that the job expects or that came becomes a section (poses.c).
 * 2. The region and the lattice around it (region.c).
 * 3. Poses (poses.c): by marks, by neighbouring tissue, refined where the job asks for it.
 * 4. Every panel is opened once more: masks, quality control, density and colour, resampled into
 * the stack; what is told by comparing sections or panels is gathered on the way (density_stack.c).
 * 5. The panels are brought to one scale (normalisation.c), a band is looked for, and what the
 * stain leaves open is summed up.
 * 6. Tissue that was not treated and the colours of all tissue are kept for other specimens
 *    (control_tissue.c, coarse_grid.c).
 *
 * Sections and panels that cannot be used are states with a reason, not failures. */
#include "pipeline/specimen/reconstruction.h"

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
        r = gsn_poses_find(specimen, options, a->region, &a->calibrations, &a->poses, err);
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
