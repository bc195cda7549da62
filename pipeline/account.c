/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/account.h"

#include "pipeline/pictures.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

/* Below this share of voxels with data nothing is fitted at all. The report withholds the loss much
 * earlier, but a picture of what there is helps the person who must decide. */
static const double LEAST_COVERAGE = 0.5;

/* Each tetrahedron follows its voxels to within this share of the range of the data, as long as the
 * voxels can carry the unknowns. */
static const double TOLERANCE_SHARE = 0.03;

/* Data without a range, such as a blank volume, would ask for no residual at all; float voxels are
 * not more exact than this share of their size. */
static const double FLOAT_SHARE = 1e-6;

struct voxels {
    size_t count, region; /* with data; in the region */
    double (*at)[3];
    float *value;
    uint8_t *fold; /* 0 and 1 from section to section */
    double low, high;
};

static void voxels_done(struct voxels *v)
{
    gsn_free(v->at);
    gsn_free(v->value);
    gsn_free(v->fold);
}

static void take_voxel(struct voxels *v, struct gsn_vec3 u, size_t plane, float value)
{
    v->fold[v->count] = plane % 2;
    v->at[v->count][0] = u.x;
    v->at[v->count][1] = u.y;
    v->at[v->count][2] = u.z;
    v->value[v->count++] = value;
    v->low = fmin(v->low, (double)value);
    v->high = fmax(v->high, (double)value);
}

/* Two passes over the grid: count, then take. */
static int gather(const struct gsn_grid *grid, const struct gsn_mask *region, struct voxels *v,
                  struct gsn_error *err)
{
    const struct gsn_lattice *at = &grid->at;

    v->low = INFINITY;
    v->high = -INFINITY;
    for (int pass = 0; pass < 2; pass++) {
        for (size_t i = 0, z = 0; z < at->nz; z++)
            for (size_t y = 0; y < at->ny; y++)
                for (size_t x = 0; x < at->nx; x++, i++) {
                    const struct gsn_vec3 u = gsn_lattice_centre(at, x, y, z);

                    if (!gsn_mask_has(region, u))
                        continue;
                    if (pass == 0)
                        v->region++;
                    if (!isfinite(grid->value[i]))
                        continue;
                    if (pass == 0)
                        v->count++;
                    else
                        take_voxel(v, u, z, grid->value[i]);
                }
        if (pass == 1)
            break;
        if (v->region == 0)
            return gsn_fail(err, GSN_E_INPUT, "the region of interest holds no voxel of the stack");
        v->at = gsn_alloc_array(v->count, sizeof *v->at);
        v->value = gsn_alloc_array(v->count, sizeof *v->value);
        v->fold = gsn_alloc_array(v->count, sizeof *v->fold);
        if (!v->at || !v->value || !v->fold)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu samples", v->count);
        v->count = 0;
    }
    return GSN_OK;
}

/* The first mesh has tetrahedra of about this many voxels; refinement goes on from there until the
 * samples carry no more unknowns. Cells a little shorter than the edges of such tetrahedra cover
 * the region. */
static const double FIRST_TET_VOXELS = 300;
static const double CELL_PER_TET_EDGE = 0.6;
/* Radius of the knot clouds over the smallest altitude. It buys no accuracy (docs/MATH.md); what it
 * costs is the share of the volume that lies in seams, where bounds are wider. */
static const double CLOUD = 0.003;

enum { ROUNDS = 5, MOST_UNKNOWNS = 150000, MOST_CELLS = 2000000 };

static bool both_folds(const struct voxels *v)
{
    return v->count > 0 && memchr(v->fold, 0, v->count) && memchr(v->fold, 1, v->count);
}

static int fit(const struct voxels *v, const struct gsn_lattice *at, const struct gsn_mask *region,
               const struct gsn_account_options *options, struct gsn_account *account,
               struct gsn_error *err)
{
    const struct gsn_samples samples = { .count = v->count,
                                         .at = (const double(*)[3])v->at,
                                         .value = v->value };
    const double tet_um3 = FIRST_TET_VOXELS * gsn_lattice_voxel_um3(at);
    const double edge_um = cbrt(6 * M_SQRT2 * tet_um3); /* of a regular tetrahedron */
    const struct gsn_adapt_options adapt = { .domain = { .mesher = options->mesher,
                                                         .cell_um = CELL_PER_TET_EDGE * edge_um,
                                                         .max_tet_um3 = 1.5 * tet_um3 },
                                             .fit = { .threads = options->threads,
                                                      .progress = options->progress },
                                             .cloud = CLOUD,
                                             .tolerance = account->tolerance,
                                             .rounds = ROUNDS,
                                             .most_unknowns = MOST_UNKNOWNS,
                                             .fold = both_folds(v) ? v->fold : NULL,
                                             .progress = options->progress };
    int r =
        gsn_adapt(region, &samples, &adapt, &account->space, &account->spline, &account->fit, err);

    account->smoothing = account->fit.smoothing;
    for (size_t i = 0; r >= 0 && i < account->fit.rounds; i++)
        if (account->fit.round[i].accepted)
            account->over_tolerance = account->fit.round[i].over_tolerance;
    return r;
}

static void area_figure(const struct voxels *v, double threshold, struct gsn_account *account)
{
    size_t above = 0;

    for (size_t i = 0; i < v->count; i++)
        above += (double)v->value[i] > threshold;
    account->above_share = v->count ? (double)above / (double)v->count : NAN;
}

/* The protocol's thresholds, or three that divide the range of the data. */
static void choose_thresholds(const struct gsn_protocol *protocol, double low, double high,
                              double *thresholds, size_t *count)
{
    static const double densities[] = { 0.3, 0.5, 0.7 };

    *count = protocol->threshold_count ? protocol->threshold_count : 3;
    for (size_t i = 0; i < *count; i++)
        thresholds[i] = protocol->threshold_count           ? protocol->threshold[i]
                        : protocol->kind == GSN_KIND_VOLUME ? low + (high - low) * densities[i]
                                                            : densities[i];
}

static int measure(const struct voxels *v, const struct gsn_grid *grid,
                   const struct gsn_mask *region, const struct gsn_protocol *protocol,
                   const struct gsn_account_options *options, struct gsn_account *account,
                   struct gsn_error *err)
{
    const struct gsn_level_set_options level = { .most_cells = MOST_CELLS,
                                                 .threads = options->threads,
                                                 .progress = options->progress };
    const size_t tets = gsn_dms_mesh(account->space)->tet_count;
    const int sections = protocol->kind == GSN_KIND_SECTIONS;
    const struct gsn_gain_offset scale =
        options->scale.gain > 0 ? options->scale : (struct gsn_gain_offset){ .gain = 1 };
    double thresholds[GSN_ACCOUNT_THRESHOLDS], here[GSN_ACCOUNT_THRESHOLDS];
    int r;

    choose_thresholds(protocol, v->low, v->high, thresholds, &account->bound_count);
    for (size_t i = 0; i < account->bound_count; i++)
        here[i] = scale.gain * thresholds[i] + scale.offset;
    area_figure(v, here[account->bound_count / 2], account);
    account->above_threshold = thresholds[account->bound_count / 2];
    r = gsn_region_density(account->spline, region, options->threads, options->progress,
                           &account->density, err);
    if (r >= 0)
        r = gsn_units(account->spline, region, account->fit.tet_samples, options->threads,
                      &account->units, err);
    if (r >= 0)
        r = gsn_units_summarise(account->units, tets, sections ? 0 : v->low,
                                sections           ? 1
                                : v->high > v->low ? v->high
                                                   : v->low + 1, /* a file may hold one value */
                                &account->summary, err);
    if (r >= 0)
        r = gsn_level_set_volume(account->spline, region, here, account->bound_count, &level,
                                 account->bound, err);
    for (size_t i = 0; r >= 0 && i < account->bound_count; i++)
        account->bound[i].threshold = thresholds[i];
    if (r >= 0 && sections)
        r = gsn_tissue_volumes(grid, region, here, account->bound_count, options->threads,
                               &account->tissue, err);
    return r;
}

static int make(const struct voxels *v, const struct gsn_grid *grid, const struct gsn_mask *region,
                const struct gsn_protocol *protocol, const struct gsn_account_options *options,
                struct gsn_account *account, struct gsn_error *err)
{
    int r;

    account->coverage = (double)v->count / (double)v->region;
    if (account->coverage < LEAST_COVERAGE)
        return gsn_fail(err, GSN_E_WITHHELD,
                        "only %.0f %% of the region of interest has data: look at the sections "
                        "marked missing or held",
                        100 * account->coverage);
    account->tolerance = protocol->tolerance > 0
                             ? protocol->tolerance
                             : fmax(TOLERANCE_SHARE * (v->high - v->low),
                                    FLOAT_SHARE * fmax(fabs(v->low), fabs(v->high)));
    r = fit(v, &grid->at, region, options, account, err);
    if (r >= 0)
        r = measure(v, grid, region, protocol, options, account, err);
    if (r >= 0)
        r = gsn_pictures_make(options->shown ? options->shown : grid, region, protocol, options,
                              account, err);
    return r;
}

int gsn_account_make(const struct gsn_grid *grid, const struct gsn_mask *region,
                     const struct gsn_protocol *protocol, const struct gsn_account_options *options,
                     struct gsn_account **ret_account, struct gsn_error *err)
{
    gsn_auto(gsn_account) account = gsn_alloc_array(1, sizeof *account);
    struct voxels v = { 0 };
    int r;

    if (!account)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the account of a region");
    r = gather(grid, region, &v, err);
    if (r >= 0)
        r = make(&v, grid, region, protocol, options, account, err);
    voxels_done(&v);
    if (r < 0)
        return r;
    *ret_account = gsn_steal(&account);
    return GSN_OK;
}

void gsn_account_free(struct gsn_account *account)
{
    if (!account)
        return;
    for (size_t i = 0; i < account->picture_count; i++)
        gsn_free(account->picture[i].png);
    gsn_free(account->units);
    gsn_adapt_report_done(&account->fit);
    gsn_spline_free(account->spline);
    gsn_dms_free(account->space);
    gsn_free(account);
}
