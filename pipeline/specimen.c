/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen.h"

#include "pipeline/account.h"
#include "pipeline/assembly.h"
#include "pipeline/band.h"
#include "pipeline/decode/apart.h"
#include "pipeline/model/model_file.h"
#include "pipeline/summary.h"
#include "pipeline/tile.h"

#include <stdio.h>
#include <string.h>

/* What speaks of the evidence, not of the machine: the report is made all the same, without the
 * figure and with the sentence. */
static int is_about_evidence(int code)
{
    return code == GSN_E_WITHHELD || code == GSN_E_STAIN || code == GSN_E_MARKERS ||
           code == GSN_E_INPUT || code == GSN_E_UNSUPPORTED || code == GSN_E_LIMIT;
}

static int keep_poses(const struct gsn_assembly *a, struct gsn_specimen_result *result,
                      struct gsn_error *err)
{
    result->pose = gsn_alloc_array(a->section_count, sizeof *result->pose);
    result->stain = gsn_alloc_array(a->panel_count, sizeof *result->stain);
    result->candidates = gsn_alloc_array(a->section_count, sizeof *result->candidates);
    if (!result->pose || !result->stain || !result->candidates)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the poses of a specimen");
    for (size_t i = 0; i < a->section_count; i++)
        if (a->section[i].posed)
            result->pose[result->pose_count++] =
                (struct gsn_specimen_pose){ .panel = a->section[i].panel,
                                            .slot = a->section[i].seen.slot,
                                            .serial = a->section[i].seen.serial,
                                            .pose = a->section[i].pose };
    for (size_t i = 0; i < a->section_count; i++)
        if (a->section[i].candidates.count > 0)
            result->candidates[result->candidates_count++] =
                (struct gsn_specimen_candidates){ .panel = a->section[i].panel,
                                                  .slot = a->section[i].seen.slot,
                                                  .list = a->section[i].candidates };
    for (size_t i = 0; i < a->panel_count; i++)
        if (a->panel[i].opened)
            result->stain[result->stain_count++] = a->panel[i].stain;
    return GSN_OK;
}

/* Makes room for one more file; the caller fills in its bytes. */
static struct gsn_specimen_file *add_file(struct gsn_specimen_result *result, const char *name)
{
    result->file[result->file_count].name = name;
    return &result->file[result->file_count++];
}

static int keep_colour(const struct gsn_assembly *a, struct gsn_specimen_result *result,
                       struct gsn_error *err)
{
    struct gsn_specimen_file *file = add_file(result, "colour.nrrd");

    return gsn_colour_grid_nrrd(a->colour, &file->bytes, &file->size, err);
}

/* What the model's file says of each tetrahedron: the account's units, one array a figure. */
static int list_cells(const struct gsn_account *account, size_t tets, double **ret_density,
                      double **ret_share, struct gsn_error *err)
{
    gsn_auto_mem(double) density = gsn_alloc_array(tets, sizeof *density);
    gsn_auto_mem(double) share = gsn_alloc_array(tets, sizeof *share);

    if (!density || !share)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a model of %zu tetrahedra", tets);
    for (size_t t = 0; t < tets; t++) {
        density[t] = account->units[t].mean;
        share[t] = account->units[t].inside_share;
    }
    *ret_density = gsn_steal(&density);
    *ret_share = gsn_steal(&share);
    return GSN_OK;
}

/* The fitted spline as a file; nothing where there is no fit. */
static int keep_model(const struct gsn_account *account, const struct gsn_mask *region,
                      const struct gsn_specimen *specimen, struct gsn_specimen_result *result,
                      struct gsn_error *err)
{
    gsn_auto_mem(double) density = NULL;
    gsn_auto_mem(double) share = NULL;
    gsn_auto_mem(char) parameters = NULL;
    struct gsn_specimen_file *file;
    int r;

    if (!account)
        return GSN_OK;
    r = list_cells(account, gsn_dms_mesh(account->space)->tet_count, &density, &share, err);
    if (r < 0)
        return r;
    parameters =
        gsn_format("{\"key\": \"%s\", \"tolerance\": %.9g, \"smoothing\": %.9g, "
                   "\"rms_residual\": %.9g}",
                   specimen->key, account->tolerance, account->smoothing, account->fit.fit.rms);
    if (!parameters)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the model's parameters");
    file = add_file(result, "model.vtkhdf");
    return gsn_model_file_write(account->spline,
                                &(struct gsn_model_cells){ .density = density,
                                                           .inside_share = share,
                                                           .residual = account->fit.tet_rms,
                                                           .samples = account->fit.tet_samples },
                                region,
                                &(struct gsn_model_notes){ .name = specimen->protocol->specimen,
                                                           .parameters = parameters,
                                                           .version = GSN_VERSION },
                                &file->bytes, &file->size, err);
}

static struct gsn_account_options account_options(const struct gsn_specimen_options *options)
{
    return (struct gsn_account_options){ .mesher = options->mesher,
                                         .threads = options->threads,
                                         .progress = options->progress };
}

/* Makes the account, or says in why what stands against it. */
static int try_account(const struct gsn_grid *grid, const struct gsn_mask *region,
                       const struct gsn_specimen *specimen, const struct gsn_account_options *how,
                       struct gsn_account **ret_account, struct gsn_error *why,
                       struct gsn_error *err)
{
    const int r = gsn_account_make(grid, region, specimen->protocol, how, ret_account, why);

    if (r < 0 && !is_about_evidence(r)) {
        if (err)
            *err = *why;
        return r;
    }
    return GSN_OK;
}

static int copy_grid(const struct gsn_grid *grid, struct gsn_grid **ret_copy, struct gsn_error *err)
{
    const int r = gsn_grid_new(&grid->at, ret_copy, err);

    if (r >= 0)
        memcpy((*ret_copy)->value, grid->value, gsn_lattice_count(&grid->at) * sizeof *grid->value);
    return r;
}

/* The account of a stack whose short gaps are bridged; the cuts show it as it is. */
static int account_of_stack(const struct gsn_assembly *assembly,
                            const struct gsn_specimen *specimen,
                            const struct gsn_specimen_options *options,
                            struct gsn_account **ret_account,
                            struct gsn_gap_interpolation *ret_bridge, struct gsn_error *why,
                            struct gsn_error *err)
{
    struct gsn_account_options how = account_options(options);
    struct gsn_batch_calibration link;
    gsn_auto(gsn_grid) bridged = NULL;
    int r = copy_grid(assembly->grid, &bridged, err);

    if (r >= 0)
        r = gsn_gap_interpolate(bridged, assembly->region, ret_bridge, err);
    if (r < 0)
        return r;
    how.shown = assembly->grid;
    how.colour = assembly->colour;
    if (gsn_stain_link(specimen, assembly, &link, NULL) >= 0)
        how.scale = (struct gsn_gain_offset){ link.gain, link.offset };
    return try_account(bridged, assembly->region, specimen, &how, ret_account, why, err);
}

/* Marks whose places in the block nobody stated lie in a frame of their own: its origin and its
 * turn follow from the mounting, and a region of the block lies anywhere in it. By tissue alone the
 * job states the frame's section. */
static int check_frame(const struct gsn_specimen *specimen, const struct gsn_assembly *a,
                       struct gsn_error *why)
{
    const struct gsn_protocol *p = specimen->protocol;
    const struct gsn_point *t = a->summary.mean_triangle;
    char unknown[120] = "";

    if (p->has_markers || a->by_tissue.done || !a->solved ||
        !(gsn_region_has_coordinates(&p->region) ||
          gsn_region_has_coordinates(&p->reference_tissue) ||
          gsn_region_has_coordinates(&p->collagen_free)))
        return GSN_OK;
    if (p->unknown)
        (void)snprintf(unknown, sizeof unknown, "; it has keys that are not used: %.80s",
                       p->unknown);
    return gsn_fail(why, GSN_E_WITHHELD,
                    "the region is stated in the block frame, but \"markers_um\" is not stated in "
                    "job.json%s: where the region lies is not known. State where the three marks "
                    "lie in the block; a region that was drawn on this stack has them at "
                    "[[%.0f, %.0f], [%.0f, %.0f], [%.0f, %.0f]]",
                    unknown, t[0].x, t[0].y, t[1].x, t[1].y, t[2].x, t[2].y);
}

/* What specimens that have this one for their baseline need beside its figures. */
static void hand_on(struct gsn_assembly *a, struct gsn_specimen_result *result)
{
    result->colours.tissues = a->levelling.tissues;
    memcpy(result->colours.yellow, a->levelling.yellow, sizeof result->colours.yellow);
    memcpy(result->colours.region_od, a->region_od, sizeof result->colours.region_od);
    memcpy(result->colours.free_od, a->free_od, sizeof result->colours.free_od);
    result->colours.cloud = gsn_steal(&a->cloud);
}

static int work_sections(const struct gsn_specimen *specimen,
                         const struct gsn_specimen_options *options,
                         struct gsn_specimen_result *result, struct gsn_error *err)
{
    gsn_auto(gsn_assembly) assembly = NULL;
    gsn_auto(gsn_account) account = NULL;
    struct gsn_error why = { 0 };
    struct gsn_evidence evidence = { .specimen = specimen };
    int r = gsn_assembly_make(specimen, options, &assembly, &why);

    gsn_decoder_rest(options->decoder);

    if (r < 0 && !is_about_evidence(r)) {
        if (err)
            *err = why;
        return r;
    }
    if (r >= 0)
        r = check_frame(specimen, assembly, &why);
    if (r >= 0 && assembly->misordered[0])
        r = gsn_fail(&why, GSN_E_WITHHELD, "%s", assembly->misordered);
    if (r >= 0 && assembly->grid)
        r = account_of_stack(assembly, specimen, options, &account, &evidence.bridge, &why, err);
    else if (r >= 0 && !assembly->solved)
        (void)gsn_fail(&why, GSN_E_WITHHELD, "%s", assembly->unsolved);
    else if (r >= 0 && assembly->no_region[0])
        (void)gsn_fail(&why, GSN_E_WITHHELD, "%s", assembly->no_region);
    else if (r >= 0)
        (void)gsn_fail(&why, GSN_E_WITHHELD,
                       "no region of interest is stated: add \"region\" to job.json");
    if (r < 0 && !is_about_evidence(r))
        return r;
    if (assembly && (r = keep_poses(assembly, result, err)) < 0)
        return r;
    if (assembly && assembly->grid && (r = keep_colour(assembly, result, err)) < 0)
        return r;
    if ((r = keep_model(account, assembly ? assembly->region : NULL, specimen, result, err)) < 0)
        return r;
    evidence.assembly = assembly;
    evidence.account = account;
    evidence.withheld = account ? NULL : why.text;
    gsn_progress_say(options->progress, "report", 0, 1);
    r = gsn_summarise(&evidence, result, err);
    if (r >= 0 && assembly)
        hand_on(assembly, result);
    return r;
}

/* The whole volume, where no region is stated. */
static int whole(const struct gsn_grid *volume, struct gsn_mask **ret_mask, struct gsn_error *err)
{
    const int r = gsn_mask_new(&volume->at, ret_mask, err);

    if (r >= 0)
        memset((*ret_mask)->inside, 1, gsn_lattice_count(&volume->at));
    return r;
}

static int work_volume(const struct gsn_specimen *specimen,
                       const struct gsn_specimen_options *options,
                       struct gsn_specimen_result *result, struct gsn_error *err)
{
    const struct gsn_account_options how = account_options(options);
    gsn_auto(gsn_mask) made = NULL;
    gsn_auto(gsn_account) account = NULL;
    struct gsn_error why = { 0 };
    struct gsn_evidence evidence = { .specimen = specimen };
    int r = GSN_OK;

    if (specimen->protocol->region.kind == GSN_REGION_BAND)
        r = gsn_band_region(&specimen->protocol->region, specimen->region, specimen->volume,
                            options->threads, &made, &why);
    else if (specimen->protocol->region.kind > GSN_REGION_MASK)
        r = gsn_region_raster(&specimen->protocol->region, &specimen->volume->at, &made, &why);
    else if (!specimen->region)
        r = whole(specimen->volume, &made, &why);
    if (r < 0 && !is_about_evidence(r)) {
        if (err)
            *err = why;
        return r;
    }
    if (r >= 0)
        r = try_account(specimen->volume, made ? made : specimen->region, specimen, &how, &account,
                        &why, err);
    if (r < 0 && !is_about_evidence(r))
        return r;
    if ((r = keep_model(account, made ? made : specimen->region, specimen, result, err)) < 0)
        return r;
    evidence.account = account;
    evidence.withheld = account ? NULL : why.text;
    return gsn_summarise(&evidence, result, err);
}

static int work_tile(const struct gsn_specimen *specimen,
                     const struct gsn_specimen_options *options, struct gsn_specimen_result *result,
                     struct gsn_error *err)
{
    gsn_auto(gsn_tile) tile = NULL;
    struct gsn_error why = { 0 };
    struct gsn_evidence evidence = { .specimen = specimen };
    const int r = gsn_tile_work(specimen, options, &tile, &why);

    if (r < 0 && !is_about_evidence(r)) {
        if (err)
            *err = why;
        return r;
    }
    evidence.tile = tile;
    evidence.withheld = tile ? NULL : why.text;
    return gsn_summarise(&evidence, result, err);
}

int gsn_specimen_work(const struct gsn_specimen *specimen,
                      const struct gsn_specimen_options *options,
                      struct gsn_specimen_result **ret_result, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_result) result = gsn_alloc_array(1, sizeof *result);
    int r;

    if (!result)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the result of a specimen");
    switch (specimen->protocol->kind) {
    case GSN_KIND_VOLUME:
        r = work_volume(specimen, options, result, err);
        break;
    case GSN_KIND_TILE:
        r = work_tile(specimen, options, result, err);
        break;
    default:
        r = work_sections(specimen, options, result, err);
    }
    if (r < 0)
        return r;
    *ret_result = gsn_steal(&result);
    return GSN_OK;
}

void gsn_specimen_result_free(struct gsn_specimen_result *result)
{
    if (!result)
        return;
    gsn_free(result->json);
    gsn_free(result->html);
    for (size_t i = 0; i < result->file_count; i++)
        gsn_free(result->file[i].bytes);
    gsn_free(result->pose);
    gsn_free(result->candidates);
    gsn_free(result->stain);
    gsn_cloud_free(result->colours.cloud);
    gsn_free(result);
}
