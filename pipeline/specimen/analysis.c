/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The analysis of a region: fit, measures and pictures.
 *
 * 1. Voxels of the region that have data are the samples; below LEAST_COVERAGE nothing is fitted.
 * 2. A spline on a tetrahedral mesh is fitted and refined until each tetrahedron follows its voxels
 * to the tolerance, or the samples carry no more unknowns (model/refine.h). Odd and even planes
 *    validate each other.
 * 3. Mean density, densities of the tetrahedra, certified volumes above the thresholds
 *    (measure/level_set.h) and, for sections, volumes of the tissue with an interval.
 * 4. Pictures of all that (region_pictures.c).
 *
 * Fails with GSN_E_WITHHELD where too little of the region has data, and as its parts do. */
#include "pipeline/specimen/analysis.h"

#include "pipeline/measure/base_cells.h"
#include "pipeline/specimen/region_pictures.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/normalisation.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
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
    size_t *voxel; /* of the grid */
    double low, high;
};

static void voxels_done(struct voxels *v)
{
    gsn_free(v->at);
    gsn_free(v->value);
    gsn_free(v->fold);
    gsn_free(v->voxel);
}

static void take_voxel(struct voxels *v, struct gsn_vec3 u, size_t plane, size_t voxel, float value)
{
    v->voxel[v->count] = voxel;
    v->fold[v->count] = plane % 2;
    v->at[v->count][0] = u.x;
    v->at[v->count][1] = u.y;
    v->at[v->count][2] = u.z;
    v->value[v->count++] = value;
    v->low = fmin(v->low, (double)value);
    v->high = fmax(v->high, (double)value);
}

/* Two passes over the grid: count, then take. */
static int gather_voxels(const struct gsn_grid *grid, const struct gsn_mask *region,
                         struct voxels *v, struct gsn_error *err)
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
                        take_voxel(v, u, z, i, grid->value[i]);
                }
        if (pass == 1)
            break;
        if (v->region == 0)
            return gsn_fail(err, GSN_E_INPUT, "the region of interest holds no voxel of the stack");
        v->at = gsn_alloc_array(v->count, sizeof *v->at);
        v->value = gsn_alloc_array(v->count, sizeof *v->value);
        v->fold = gsn_alloc_array(v->count, sizeof *v->fold);
        v->voxel = gsn_alloc_array(v->count, sizeof *v->voxel);
        if (!v->at || !v->value || !v->fold || !v->voxel)
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

/* Bounds of the model's volumes lie this near to each other: five times nearer than the tissue's
 * own volume is ever known. At 0.001 they took a quarter of a specimen's time. */
static const double VOLUME_GAP = 0.005;

/* What layers along walls may cost: no more unknowns than the samples carry, at so many a vertex of
 * a quadratic spline. */
enum { SAMPLES_PER_UNKNOWN = 8, UNKNOWNS_PER_VERTEX = 8 };

static bool both_folds(const struct voxels *v)
{
    return v->count > 0 && memchr(v->fold, 0, v->count) && memchr(v->fold, 1, v->count);
}

static int fit_spline(const struct voxels *v, const struct gsn_grid *grid,
                      const struct gsn_mask *region, const struct gsn_analysis_options *options,
                      struct gsn_analysis *analysis, struct gsn_error *err)
{
    const struct gsn_samples samples = { .count = v->count,
                                         .at = (const double(*)[3])v->at,
                                         .value = v->value };
    const double tet_um3 = FIRST_TET_VOXELS * gsn_lattice_voxel_um3(&grid->at);
    const double edge_um = cbrt(6 * M_SQRT2 * tet_um3); /* of a regular tetrahedron */
    const double carried = fmin(MOST_UNKNOWNS, (double)v->count / SAMPLES_PER_UNKNOWN);
    const struct gsn_wall_options walls = { .most_points =
                                                (size_t)(carried / UNKNOWNS_PER_VERTEX) };
    const struct gsn_domain_options domain = { .mesher = options->mesher,
                                               .cell_um = CELL_PER_TET_EDGE * edge_um,
                                               .max_tet_um3 = 1.5 * tet_um3 };
    struct gsn_adapt_options adapt = { .fit = { .smoothing = GSN_FIT_SMOOTHING,
                                                .fold = both_folds(v) ? v->fold : NULL,
                                                .threads = options->threads,
                                                .forgiving = 1, /* the report says so */
                                                .progress = options->progress },
                                       .cloud = CLOUD,
                                       .tolerance = analysis->tolerance,
                                       .rounds = ROUNDS,
                                       .most_unknowns = MOST_UNKNOWNS,
                                       .progress = options->progress };
    gsn_auto(gsn_tets) mesh = NULL;
    int r = gsn_domain_follow(grid, region, &walls, &domain, &mesh, &analysis->domain, err);

    if (r >= 0)
        r = gsn_adapt(mesh, &samples, &adapt, &analysis->space, &analysis->spline, &analysis->fit,
                      err);
    for (size_t i = 0; r >= 0 && i < analysis->fit.rounds; i++)
        if (analysis->fit.round[i].accepted)
            analysis->over_tolerance = analysis->fit.round[i].over_tolerance;
    return r;
}

/* The colours of samples as light, those that have one; returns how many. */
static size_t gather_colours(const struct voxels *v, const struct gsn_colour_grid *colour,
                             double (*at)[3], double *const value[3])
{
    size_t n = 0;

    for (size_t i = 0; i < v->count; i++) {
        const uint8_t *const rgb = colour->rgb + 3 * v->voxel[i];

        if (!rgb[0] && !rgb[1] && !rgb[2])
            continue;
        memcpy(at[n], v->at[i], sizeof at[n]);
        for (int c = 0; c < 3; c++)
            value[c][n] = gsn_light_of_sample(GSN_LIGHT_SRGB, rgb[c], 8);
        n++;
    }
    return n;
}

/* True colour as equation (4) asks: three more splines of the same space, as smooth as the
 * density. */
static int fit_colours(const struct voxels *v, const struct gsn_analysis_options *options,
                       struct gsn_analysis *analysis, struct gsn_error *err)
{
    const struct gsn_fit_options fit = { .smoothing = GSN_FIT_SMOOTHING,
                                         .jump = analysis->fit.fit.jump,
                                         .threads = options->threads,
                                         .forgiving = 1,
                                         .progress = options->progress };
    gsn_auto_mem(__typeof__(double[3])) at = gsn_alloc_array(v->count, sizeof *at);
    gsn_auto_mem(double) value = gsn_alloc_array(v->count, 3 * sizeof *value);
    struct gsn_fit_report report[3];
    double *channel[3];
    struct gsn_samples samples;
    size_t n;

    if (!at || !value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu colours", v->count);
    for (int c = 0; c < 3; c++)
        channel[c] = value + (size_t)c * v->count;
    n = gather_colours(v, options->colour, at, channel);
    if (n == 0)
        return GSN_OK;
    samples = (struct gsn_samples){ .count = n, .at = (const double(*)[3])at };
    return gsn_fit_channels(analysis->space, &samples, (const double *const *)channel, 3, &fit,
                            analysis->colour, report, err);
}

static void area_figure(const struct voxels *v, double threshold, struct gsn_analysis *analysis)
{
    size_t above = 0;

    for (size_t i = 0; i < v->count; i++)
        above += (double)v->value[i] > threshold;
    analysis->above_share = v->count ? (double)above / (double)v->count : NAN;
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

static int measure_region(const struct voxels *v, const struct gsn_grid *grid,
                          const struct gsn_mask *region, const struct gsn_protocol *protocol,
                          const struct gsn_analysis_options *options, struct gsn_analysis *analysis,
                          struct gsn_error *err)
{
    const struct gsn_level_set_options level = { .gap = VOLUME_GAP,
                                                 .most_cells = MOST_CELLS,
                                                 .threads = options->threads,
                                                 .progress = options->progress };
    const size_t tets = gsn_dms_mesh(analysis->space)->tet_count;
    const int sections = protocol->kind == GSN_KIND_SECTIONS;
    const struct gsn_gain_offset scale =
        options->scale.gain > 0 ? options->scale : (struct gsn_gain_offset){ .gain = 1 };
    double thresholds[GSN_ANALYSIS_THRESHOLDS], here[GSN_ANALYSIS_THRESHOLDS];
    int r;

    choose_thresholds(protocol, v->low, v->high, thresholds, &analysis->bound_count);
    for (size_t i = 0; i < analysis->bound_count; i++)
        here[i] = scale.gain * thresholds[i] + scale.offset;
    area_figure(v, here[analysis->bound_count / 2], analysis);
    analysis->above_threshold = thresholds[analysis->bound_count / 2];
    r = gsn_region_density(analysis->spline, region, options->threads, options->progress,
                           &analysis->density, err);
    if (r >= 0)
        r = gsn_units(analysis->spline, region, analysis->fit.tet_samples, options->threads,
                      &analysis->units, err);
    if (r >= 0)
        r = gsn_units_summarise(analysis->units, tets, sections ? 0 : v->low,
                                sections           ? 1
                                : v->high > v->low ? v->high
                                                   : v->low + 1, /* a file may hold one value */
                                &analysis->summary, err);
    if (r >= 0)
        r = gsn_level_set_volume(analysis->spline, region, here, analysis->bound_count, &level,
                                 analysis->bound, err);
    for (size_t i = 0; r >= 0 && i < analysis->bound_count; i++)
        analysis->bound[i].threshold = thresholds[i];
    if (r >= 0)
        r = gsn_bone_measure(grid, region, here[analysis->bound_count / 2], options->threads,
                             &analysis->bone, err);
    analysis->has_bone = r >= 0;
    if (r == GSN_E_LIMIT)
        r = GSN_OK;
    analysis->section_error = sections ? gsn_section_error(grid, region) : (double)NAN;
    analysis->plane_error = (double)NAN;
    if (r >= 0 && sections)
        r = gsn_base_plane_error(grid, region, &analysis->plane_error, err);
    if (r >= 0 && sections)
        r = gsn_tissue_volumes(grid, region, here, analysis->bound_count, options->threads,
                               &analysis->tissue, err);
    return r;
}

/* ---- together ---------------------------------------------------------------------------- */

static int make_analysis(const struct voxels *v, const struct gsn_grid *grid,
                         const struct gsn_mask *region, const struct gsn_protocol *protocol,
                         const struct gsn_analysis_options *options, struct gsn_analysis *analysis,
                         struct gsn_error *err)
{
    int r;

    analysis->coverage = (double)v->count / (double)v->region;
    if (analysis->coverage < LEAST_COVERAGE)
        return gsn_fail(err, GSN_E_WITHHELD, "only %.0f %% of the region of interest has data: %s",
                        100 * analysis->coverage,
                        protocol->kind == GSN_KIND_SECTIONS
                            ? "look at the sections marked missing or held"
                            : "the file holds no numbers there");
    analysis->tolerance = protocol->tolerance > 0
                              ? protocol->tolerance
                              : fmax(TOLERANCE_SHARE * (v->high - v->low),
                                     FLOAT_SHARE * fmax(fabs(v->low), fabs(v->high)));
    r = fit_spline(v, grid, region, options, analysis, err);
    if (r >= 0 && options->colour)
        r = fit_colours(v, options, analysis, err);
    if (r >= 0)
        r = measure_region(v, grid, region, protocol, options, analysis, err);
    if (r >= 0)
        r = gsn_region_pictures(options->shown ? options->shown : grid, region, protocol, options,
                                analysis, err);
    return r;
}

int gsn_analyse(const struct gsn_grid *grid, const struct gsn_mask *region,
                const struct gsn_protocol *protocol, const struct gsn_analysis_options *options,
                struct gsn_analysis **ret_analysis, struct gsn_error *err)
{
    gsn_auto(gsn_analysis) analysis = gsn_alloc_array(1, sizeof *analysis);
    struct voxels v = { 0 };
    int r;

    if (!analysis)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the analysis of a region");
    r = gather_voxels(grid, region, &v, err);
    if (r >= 0)
        r = make_analysis(&v, grid, region, protocol, options, analysis, err);
    voxels_done(&v);
    if (r < 0)
        return r;
    *ret_analysis = gsn_steal(&analysis);
    return GSN_OK;
}

void gsn_analysis_free(struct gsn_analysis *analysis)
{
    if (!analysis)
        return;
    for (size_t i = 0; i < analysis->picture_count; i++)
        gsn_free(analysis->picture[i].png);
    gsn_free(analysis->units);
    gsn_adapt_report_done(&analysis->fit);
    gsn_spline_free(analysis->spline);
    for (int c = 0; c < 3; c++)
        gsn_spline_free(analysis->colour[c]);
    gsn_dms_free(analysis->space);
    gsn_free(analysis);
}
