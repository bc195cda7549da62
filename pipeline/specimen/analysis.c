/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The analysis of a region: fit, measures and pictures.
 *
 * 1. Voxels of the region that have data are the samples; below LEAST_COVERAGE nothing is fitted.
 * 2. A spline on a tetrahedral mesh is fitted and refined until each tetrahedron follows its voxels
 * to the tolerance, or the samples carry no more unknowns (model/refine.h). Odd and even planes
 *    validate each other.
 * 3. Mean density, densities of the tetrahedra, certified volumes above the thresholds
 *    (measure/level_set.h) and, for sections, volumes of the tissue with an interval.
 * 4. Three cuts through data and model, the same in true colour, an X-ray by the exact integral, an
 *    isosurface.
 *
 * Fails with GSN_E_WITHHELD where too little of the region has data, and as its parts do. */
#include "pipeline/specimen/analysis.h"

#include "pipeline/decode/png_write.h"
#include "pipeline/render/canvas.h"
#include "pipeline/render/cut.h"
#include "pipeline/render/isosurface.h"
#include "pipeline/render/ray_cast.h"
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
    if (r >= 0 && sections)
        r = gsn_tissue_volumes(grid, region, here, analysis->bound_count, options->threads,
                               &analysis->tissue, err);
    return r;
}

/* ---- pictures ---------------------------------------------------------------------------- */

static const double SURFACE_WITHIN_PX = 0.5;
enum {
    SURFACE_CELLS = 1 << 18,
    CUT_PX = 480,
    XRAY_PX = 440,
    XRAY_RAYS = 2,
    SURFACE_PX = 600,
    GUTTER_PX = 12
};

static int encode_picture(const struct gsn_image *image, struct gsn_png_picture *picture,
                          struct gsn_error *err)
{
    picture->width = image->width;
    picture->height = image->height;
    return gsn_png_encode(image, &picture->png, &picture->size, err);
}

static struct gsn_png_picture *next_picture(struct gsn_analysis *analysis, const char *id,
                                            const char *title)
{
    struct gsn_png_picture *picture = &analysis->picture[analysis->picture_count];

    assert(analysis->picture_count < GSN_ANALYSIS_PICTURES);
    picture->id = id;
    picture->title = title;
    return picture;
}

static int side_by_side(const struct gsn_image *left, const struct gsn_image *right,
                        struct gsn_image **ret_both, struct gsn_error *err)
{
    static const struct gsn_colour white = { .r = 255, .g = 255, .b = 255 };
    const uint32_t height = left->height > right->height ? left->height : right->height;
    const int r =
        gsn_canvas_new(left->width + GUTTER_PX + right->width, height, white, ret_both, err);

    if (r < 0)
        return r;
    gsn_canvas_paste(*ret_both, left, 0, 0);
    gsn_canvas_paste(*ret_both, right, (int)left->width + GUTTER_PX, 0);
    return GSN_OK;
}

/* Beyond the region the spline only goes on; a picture must not show that as data. */
static void leave_region_only(struct gsn_plane *plane, const struct gsn_cut_frame *frame,
                              const struct gsn_mask *region)
{
    for (uint32_t y = 0; y < plane->height; y++)
        for (uint32_t x = 0; x < plane->width; x++)
            if (!gsn_mask_has(region, gsn_cut_pixel(frame, x, y)))
                plane->value[(size_t)y * plane->width + x] = NAN;
}

struct scale {
    double low, high;
    const char *unit;
};

/* Data and model on one plane, with one colour scale. */
static int draw_cut(const struct gsn_grid *grid, const struct gsn_mask *region,
                    const struct gsn_cut_frame *frame, const struct scale *scale, unsigned threads,
                    struct gsn_analysis *analysis, struct gsn_png_picture *picture,
                    struct gsn_error *err)
{
    struct gsn_cut_style style = { .title = "data",
                                   .unit = scale->unit,
                                   .low = scale->low,
                                   .high = scale->high,
                                   .map = GSN_MAP_VIRIDIS };
    gsn_auto(gsn_plane) data = NULL;
    gsn_auto(gsn_plane) model = NULL;
    gsn_auto(gsn_image) left = NULL;
    gsn_auto(gsn_image) right = NULL;
    gsn_auto(gsn_image) both = NULL;
    int r = gsn_cut_grid(grid, frame, &data, err);

    if (r >= 0)
        r = gsn_cut_spline(analysis->spline, frame, threads, &model, err);
    if (r >= 0)
        leave_region_only(model, frame, region);
    if (r >= 0)
        r = gsn_cut_paint(data, frame, region, &style, &left, err);
    style.title = "model";
    if (r >= 0)
        r = gsn_cut_paint(model, frame, region, &style, &right, err);
    if (r >= 0)
        r = side_by_side(left, right, &both, err);
    return r < 0 ? r : encode_picture(both, picture, err);
}

static const struct {
    enum gsn_axis axis;
    const char *id, *title, *colour_id, *colour_title, *name, *seen;
} PLANES[] = { { GSN_AXIS_Z, "cut-z", "Cut across z, as sectioned", "colour-z",
                 "True colour across z, as sectioned", "z", "x right, y down" },
               { GSN_AXIS_Y, "cut-y", "Cut across y, through the stack", "colour-y",
                 "True colour across y, through the stack", "y", "x right, z down" },
               { GSN_AXIS_X, "cut-x", "Cut across x, through the stack", "colour-x",
                 "True colour across x, through the stack", "x", "y right, z down" } };

static double coordinate_along(enum gsn_axis axis, struct gsn_vec3 u)
{
    return axis == GSN_AXIS_X ? u.x : axis == GSN_AXIS_Y ? u.y : u.z;
}

/* The sections themselves on the same plane, for whoever knows what tissue looks like. */
static int draw_colour_cut(const struct gsn_colour_grid *colour, const struct gsn_mask *region,
                           const struct gsn_cut_frame *frame, size_t i,
                           struct gsn_analysis *analysis, struct gsn_error *err)
{
    struct gsn_png_picture *picture =
        next_picture(analysis, PLANES[i].colour_id, PLANES[i].colour_title);
    gsn_auto(gsn_image) image = NULL;
    int r = gsn_cut_colour(colour, frame, region, "true colour", &image, err);

    if (r >= 0)
        r = encode_picture(image, picture, err);
    if (r < 0)
        return r;
    (void)snprintf(picture->caption, sizeof picture->caption,
                   "The registered sections as scanned, voxel by voxel, at %s = %.0f um; %s. "
                   "Hatched: no section. The line is the region of interest.",
                   PLANES[i].name, frame->at_um, PLANES[i].seen);
    analysis->picture_count++;
    return GSN_OK;
}

static int draw_cuts(const struct gsn_grid *grid, const struct gsn_mask *region,
                     const struct scale *scale, const struct gsn_analysis_options *options,
                     struct gsn_analysis *analysis, struct gsn_error *err)
{
    struct gsn_vec3 centre;
    int r = gsn_cut_centre(region, &centre, err);

    for (size_t i = 0; r >= 0 && i < sizeof PLANES / sizeof PLANES[0]; i++) {
        struct gsn_png_picture *picture = next_picture(analysis, PLANES[i].id, PLANES[i].title);
        struct gsn_cut_frame frame;

        r = gsn_cut_frame(region, PLANES[i].axis, centre, CUT_PX, &frame, err);
        if (r >= 0)
            r = draw_cut(grid, region, &frame, scale, options->threads, analysis, picture, err);
        if (r < 0)
            return r;
        (void)snprintf(picture->caption, sizeof picture->caption,
                       "Voxels as registered (left) and the fitted spline (right) at %s = %.0f um; "
                       "%s. Hatched: no data. The line is the region of interest.",
                       PLANES[i].name, coordinate_along(PLANES[i].axis, centre), PLANES[i].seen);
        analysis->picture_count++;
        if (options->colour)
            r = draw_colour_cut(options->colour, region, &frame, i, analysis, err);
    }
    return r;
}

/* Seen a little from above and the side, so that all three extents show. */
static struct gsn_view view_of(uint32_t px)
{
    return (struct gsn_view){
        .direction = { 0.45, 0.62, 0.64 }, .up = { 0, -0.35, -1 }, .width = px, .height = px
    };
}

/* The region's box, and corners as far apart that its axes' numbers have room beside it. */
static void find_scene(const struct gsn_mask *region, struct gsn_block_box_um *box,
                       double ret_corner[8][3])
{
    gsn_mask_box(region, box->low, box->high);
    for (int k = 0; k < 8; k++)
        for (int c = 0; c < 3; c++)
            ret_corner[k][c] =
                0.5 * (box->low[c] + box->high[c]) +
                0.5 * (k >> c & 1 ? 1 : -1) * (box->high[c] - box->low[c]) / GSN_BLOCK_AXES_SHARE;
}

/* Of the region alone, whose border is smooth; several rays a pixel make it so in the picture. */
static int draw_xray(const struct gsn_mask *region, const struct gsn_border *border,
                     const struct gsn_analysis_options *options, const char *unit,
                     struct gsn_analysis *analysis, struct gsn_error *err)
{
    struct gsn_png_picture *picture = next_picture(analysis, "x-ray", "X-ray");
    const struct gsn_view view = view_of(XRAY_PX);
    const struct gsn_ray_style style = { .across = XRAY_RAYS };
    const struct gsn_vec3 step = region->at.step_um;
    const struct gsn_ray_clip clip = { .border = border,
                                       .border_step_um = fmin(step.x, fmin(step.y, step.z)) };
    gsn_auto(gsn_plane) plane = NULL;
    gsn_auto(gsn_image) image = NULL;
    double corner[8][3];
    const struct gsn_tets scene = { .vertex_count = 8, .vertex = corner };
    struct gsn_block_box_um box;
    struct gsn_camera camera;
    int r;

    find_scene(region, &box, corner);
    r = gsn_camera_frame(&view, &scene, &camera, err);
    if (r >= 0)
        r = gsn_ray_xray(analysis->spline, &camera, &clip, &style, options->threads,
                         options->progress, &plane, err);
    if (r >= 0)
        r = gsn_xray_paint(plane, &camera, &box, NULL, NULL, unit, GSN_MAP_GREY, &image, err);
    if (r >= 0)
        r = encode_picture(image, picture, err);
    if (r < 0)
        return r;
    (void)snprintf(picture->caption, sizeof picture->caption,
                   "The integral of the fitted spline along every line of sight within the region, "
                   "exact polynomial by polynomial: no steps, no sampling.");
    analysis->picture_count++;
    return GSN_OK;
}

static int draw_surface(const struct gsn_mask *region, const struct gsn_border *border,
                        const struct gsn_analysis_options *options, struct gsn_analysis *analysis,
                        struct gsn_error *err)
{
    struct gsn_png_picture *picture = next_picture(analysis, "isosurface", "Isosurface");
    struct gsn_isosurface_options wanted = {
        .level = analysis->bound[analysis->bound_count / 2].threshold,
        .border = border,
        .most_cells = SURFACE_CELLS,
        .threads = options->threads,
    };
    const struct gsn_view view = view_of(SURFACE_PX);
    double corner[8][3];
    const struct gsn_tets scene = { .vertex_count = 8, .vertex = corner };
    struct gsn_block_box_um box;
    const struct gsn_trimesh_style style = { .box = &box };
    struct gsn_camera camera;
    gsn_auto(gsn_trimesh) triangles = NULL;
    gsn_auto(gsn_image) image = NULL;
    int r;

    find_scene(region, &box, corner);
    r = gsn_camera_frame(&view, &scene, &camera, err);
    if (r < 0)
        return r;
    wanted.error_um = SURFACE_WITHIN_PX / camera.px_per_um;
    r = gsn_isosurface(analysis->spline, &wanted, &triangles, err);
    if (r >= 0)
        r = gsn_trimesh_paint(triangles, &scene, &view, &style, options->threads, &image, err);
    if (r >= 0)
        r = encode_picture(image, picture, err);
    if (r < 0)
        return r;
    (void)snprintf(picture->caption, sizeof picture->caption,
                   "The surface where the density is %.4g: %zu triangles by marching tetrahedra, "
                   "normals from the spline's own gradient. It bounds what is denser, and follows "
                   "the edge of the region where that ends.",
                   wanted.level, triangles->triangle_count);
    analysis->picture_count++;
    return GSN_OK;
}

static int draw_pictures(const struct gsn_grid *grid, const struct gsn_mask *region,
                         const struct gsn_protocol *protocol,
                         const struct gsn_analysis_options *options, struct gsn_analysis *analysis,
                         struct gsn_error *err)
{
    struct scale scale = { .low = 0, .high = 1, .unit = "density" };
    gsn_auto(gsn_border) border = NULL;
    int r;

    if (protocol->kind == GSN_KIND_VOLUME) {
        gsn_cut_range(grid, region, &scale.low, &scale.high);
        scale.unit = "value";
    }
    analysis->low = scale.low;
    analysis->high = scale.high;
    analysis->unit = scale.unit;
    gsn_progress_say(options->progress, "pictures", 0, 5);
    r = draw_cuts(grid, region, &scale, options, analysis, err);
    gsn_progress_say(options->progress, "pictures", 3, 5);
    if (r >= 0)
        r = gsn_border_new(region, options->threads, &border, err);
    if (r >= 0)
        r = draw_xray(region, border, options,
                      protocol->kind == GSN_KIND_VOLUME ? "value x um" : NULL, analysis, err);
    gsn_progress_say(options->progress, "pictures", 4, 5);
    return r < 0 ? r : draw_surface(region, border, options, analysis, err);
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
        r = draw_pictures(options->shown ? options->shown : grid, region, protocol, options,
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
