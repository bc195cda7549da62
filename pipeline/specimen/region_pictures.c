/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The pictures of a region: what was measured, what was fitted, and what was lost.
 *
 * Method: cuts are values on the pixels of a plane through colour maps (render/cut.h); the X-ray is
 * the exact integral along each pixel's rays (render/ray_cast.h); the isosurface is marching
 * tetrahedra on the spline (render/isosurface.h).
 *
 * Steps: (1) three cuts through data and model, each with the same plane in true colour where there
 * are colours; (2) the X-ray of the region alone; (3) the isosurface at the middle threshold. Of a
 * loss: (4) two planes, each with the baseline, this specimen and the cells' losses beside one
 * another on one frame.
 *
 * Failure: as the parts of render, GSN_E_NOMEM. Cost: rays and triangles; the cuts are little. */
#include "pipeline/specimen/region_pictures.h"

#include "pipeline/decode/png_write.h"
#include "pipeline/model/model_file.h"
#include "pipeline/render/canvas.h"
#include "pipeline/render/cut.h"
#include "pipeline/render/isosurface.h"
#include "pipeline/render/ray_cast.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>

static const double SURFACE_WITHIN_PX = 0.5;
enum {
    SURFACE_CELLS = 1 << 18,
    CUT_PX = 480,
    LOSS_PX = 400,
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
    const double level = analysis->bound[analysis->bound_count / 2].threshold;
    struct gsn_isosurface_options wanted = {
        .level =
            options->scale.gain > 0 ? options->scale.gain * level + options->scale.offset : level,
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
    (void)snprintf(
        picture->caption, sizeof picture->caption,
        "The surface where the density is %.4g: %zu triangles by marching tetrahedra, "
        "normals from the spline's own gradient%s. It bounds what is denser, and follows "
        "the edge of the region where that ends.",
        level, triangles->triangle_count,
        triangles->error_um > wanted.error_um ? "; coarser than half a pixel here and there" : "");
    analysis->picture_count++;
    return GSN_OK;
}

int gsn_region_pictures(const struct gsn_grid *grid, const struct gsn_mask *region,
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

/* ---- where it was lost ---------------------------------------------------------------------- */

/* The mean of the controls in this specimen's stain, where a control's region has the pixel. */
static int cut_controls(const struct gsn_loss_scene *scene, const struct gsn_cut_frame *frame,
                        unsigned threads, struct gsn_plane **ret_plane, struct gsn_error *err)
{
    const size_t pixels = (size_t)frame->width * frame->height;
    gsn_auto(gsn_plane) mean = NULL;
    gsn_auto_mem(double) count = gsn_alloc_array(pixels, sizeof *count);
    int r = gsn_plane_new(frame->width, frame->height, &mean, err);

    if (r >= 0 && !count)
        r = gsn_fail(err, GSN_E_NOMEM, "out of memory for a cut of %zu pixels", pixels);
    for (size_t k = 0; r >= 0 && k < scene->controls; k++) {
        const struct gsn_model *const model = scene->control[k].model;
        gsn_auto(gsn_plane) one = NULL;

        r = gsn_cut_spline(model->spline, frame, threads, &one, err);
        if (r >= 0)
            leave_region_only(one, frame, model->region);
        for (size_t i = 0; r >= 0 && i < pixels; i++)
            if (!isnan(one->value[i])) {
                mean->value[i] +=
                    (float)(scene->scale->gain * (double)one->value[i] + scene->scale->offset);
                count[i]++;
            }
    }
    if (r < 0)
        return r;
    for (size_t i = 0; i < pixels; i++)
        mean->value[i] = count[i] > 0 ? mean->value[i] / (float)count[i] : NAN;
    *ret_plane = gsn_steal(&mean);
    return GSN_OK;
}

static int cut_losses(const struct gsn_loss_scene *scene, const struct gsn_cut_frame *frame,
                      struct gsn_plane **ret_plane, struct gsn_error *err)
{
    const int r = gsn_plane_new(frame->width, frame->height, ret_plane, err);

    for (size_t y = 0; r >= 0 && y < frame->height; y++)
        for (size_t x = 0; x < frame->width; x++)
            (*ret_plane)->value[y * frame->width + x] =
                (float)gsn_loss_map_at(scene->map, gsn_cut_pixel(frame, x, y));
    if (r >= 0)
        leave_region_only(*ret_plane, frame, scene->region);
    return r;
}

static int paint_losses(const struct gsn_loss_scene *scene, const struct gsn_cut_frame *frame,
                        unsigned threads, struct gsn_image **ret_image, struct gsn_error *err)
{
    const struct gsn_analysis *const a = scene->analysis;
    struct gsn_cut_style style = {
        .unit = a->unit, .low = a->low, .high = a->high, .map = GSN_MAP_VIRIDIS
    };
    gsn_auto(gsn_plane) there = NULL;
    gsn_auto(gsn_plane) here = NULL;
    gsn_auto(gsn_plane) lost = NULL;
    gsn_auto(gsn_image) left = NULL;
    gsn_auto(gsn_image) middle = NULL;
    gsn_auto(gsn_image) right = NULL;
    gsn_auto(gsn_image) both = NULL;
    int r = cut_controls(scene, frame, threads, &there, err);

    if (r >= 0)
        r = gsn_cut_spline(a->spline, frame, threads, &here, err);
    if (r >= 0)
        leave_region_only(here, frame, scene->region);
    if (r >= 0)
        r = cut_losses(scene, frame, &lost, err);
    style.title = "baseline";
    if (r >= 0)
        r = gsn_cut_paint(there, frame, scene->region, &style, &left, err);
    style.title = "this specimen";
    if (r >= 0)
        r = gsn_cut_paint(here, frame, scene->region, &style, &middle, err);
    style = (struct gsn_cut_style){ .title = "lost",
                                    .unit = "%",
                                    .low = scene->map->low,
                                    .high = scene->map->high,
                                    .map = GSN_MAP_VIRIDIS };
    if (r >= 0)
        r = gsn_cut_paint(lost, frame, scene->region, &style, &right, err);
    if (r >= 0)
        r = side_by_side(left, middle, &both, err);
    return r < 0 ? r : side_by_side(both, right, ret_image, err);
}

int gsn_loss_pictures(const struct gsn_loss_scene *scene, unsigned threads,
                      struct gsn_png_picture ret_picture[GSN_LOSS_PICTURES], struct gsn_error *err)
{
    static const char *const id[GSN_LOSS_PICTURES] = { "loss-z", "loss-y" };
    static const char *const title[GSN_LOSS_PICTURES] = { "Loss across z, as sectioned",
                                                          "Loss across y, through the stack" };
    struct gsn_png_picture made[GSN_LOSS_PICTURES] = { { 0 } };
    struct gsn_vec3 centre;
    int r = gsn_cut_centre(scene->region, &centre, err);

    for (size_t i = 0; r >= 0 && i < GSN_LOSS_PICTURES; i++) {
        gsn_auto(gsn_image) image = NULL;
        struct gsn_cut_frame frame;

        r = gsn_cut_frame(scene->region, PLANES[i].axis, centre, LOSS_PX, &frame, err);
        if (r >= 0)
            r = paint_losses(scene, &frame, threads, &image, err);
        if (r >= 0)
            r = encode_picture(image, &made[i], err);
        made[i].id = id[i];
        made[i].title = title[i];
        (void)snprintf(made[i].caption, sizeof made[i].caption,
                       "Both fitted splines on one scale, and the loss of each cell, between its "
                       "5 and 95 %%, at %s = %.0f um; %s. Hatched: not in both regions, or nothing "
                       "to lose. The line is this specimen's region.",
                       PLANES[i].name, coordinate_along(PLANES[i].axis, centre), PLANES[i].seen);
    }
    for (size_t i = 0; i < GSN_LOSS_PICTURES; i++)
        if (r >= 0)
            ret_picture[i] = made[i];
        else
            gsn_free(made[i].png);
    return r;
}
