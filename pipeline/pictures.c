/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/pictures.h"

#include "pipeline/decode/png_write.h"
#include "pipeline/render/canvas.h"
#include "pipeline/render/cut.h"
#include "pipeline/render/isosurface.h"
#include "pipeline/render/projection.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>

enum { CUT_PX = 480, XRAY_PX = 440, SURFACE_PX = 600, GUTTER_PX = 12 };

static int keep(const struct gsn_image *image, struct gsn_account_picture *picture,
                struct gsn_error *err)
{
    picture->width = image->width;
    picture->height = image->height;
    return gsn_png_encode(image, &picture->png, &picture->size, err);
}

static struct gsn_account_picture *next(struct gsn_account *account, const char *id,
                                        const char *title)
{
    struct gsn_account_picture *picture = &account->picture[account->picture_count];

    assert(account->picture_count < GSN_ACCOUNT_PICTURES);
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
static int cut(const struct gsn_grid *grid, const struct gsn_mask *region,
               const struct gsn_cut_frame *frame, const struct scale *scale, unsigned threads,
               struct gsn_account *account, struct gsn_account_picture *picture,
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
        r = gsn_cut_spline(account->spline, frame, threads, &model, err);
    if (r >= 0)
        leave_region_only(model, frame, region);
    if (r >= 0)
        r = gsn_cut_paint(data, frame, region, &style, &left, err);
    style.title = "model";
    if (r >= 0)
        r = gsn_cut_paint(model, frame, region, &style, &right, err);
    if (r >= 0)
        r = side_by_side(left, right, &both, err);
    return r < 0 ? r : keep(both, picture, err);
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

static double along(enum gsn_axis axis, struct gsn_vec3 u)
{
    return axis == GSN_AXIS_X ? u.x : axis == GSN_AXIS_Y ? u.y : u.z;
}

/* The sections themselves on the same plane, for whoever knows what tissue looks like. */
static int colour_cut(const struct gsn_colour_grid *colour, const struct gsn_mask *region,
                      const struct gsn_cut_frame *frame, size_t i, struct gsn_account *account,
                      struct gsn_error *err)
{
    struct gsn_account_picture *picture =
        next(account, PLANES[i].colour_id, PLANES[i].colour_title);
    gsn_auto(gsn_image) image = NULL;
    int r = gsn_cut_colour(colour, frame, region, "true colour", &image, err);

    if (r >= 0)
        r = keep(image, picture, err);
    if (r < 0)
        return r;
    (void)snprintf(picture->caption, sizeof picture->caption,
                   "The registered sections as scanned, voxel by voxel, at %s = %.0f um; %s. "
                   "Hatched: no section. The line is the region of interest.",
                   PLANES[i].name, frame->at_um, PLANES[i].seen);
    account->picture_count++;
    return GSN_OK;
}

static int cuts(const struct gsn_grid *grid, const struct gsn_mask *region,
                const struct scale *scale, const struct gsn_account_options *options,
                struct gsn_account *account, struct gsn_error *err)
{
    struct gsn_vec3 centre;
    int r = gsn_cut_centre(region, &centre, err);

    for (size_t i = 0; r >= 0 && i < sizeof PLANES / sizeof PLANES[0]; i++) {
        struct gsn_account_picture *picture = next(account, PLANES[i].id, PLANES[i].title);
        struct gsn_cut_frame frame;

        r = gsn_cut_frame(region, PLANES[i].axis, centre, CUT_PX, &frame, err);
        if (r >= 0)
            r = cut(grid, region, &frame, scale, options->threads, account, picture, err);
        if (r < 0)
            return r;
        (void)snprintf(picture->caption, sizeof picture->caption,
                       "Voxels as registered (left) and the fitted spline (right) at %s = %.0f um; "
                       "%s. Hatched: no data. The line is the region of interest.",
                       PLANES[i].name, along(PLANES[i].axis, centre), PLANES[i].seen);
        account->picture_count++;
        if (options->colour)
            r = colour_cut(options->colour, region, &frame, i, account, err);
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

static int xray(const struct gsn_account_options *options, const char *unit,
                struct gsn_account *account, struct gsn_error *err)
{
    struct gsn_account_picture *picture = next(account, "x-ray", "X-ray");
    const struct gsn_view view = view_of(XRAY_PX);
    gsn_auto(gsn_plane) plane = NULL;
    gsn_auto(gsn_image) image = NULL;
    struct gsn_camera camera;
    int r = gsn_projection(account->spline, &view, options->threads, options->progress, &plane,
                           &camera, err);

    if (r >= 0)
        r = gsn_projection_paint(plane, &camera, NULL, unit, 0, 0, GSN_MAP_GREY, &image, err);
    if (r >= 0)
        r = keep(image, picture, err);
    if (r < 0)
        return r;
    (void)snprintf(picture->caption, sizeof picture->caption,
                   "The integral of the fitted spline along every line of sight, by the exact "
                   "projection formula: no steps, no sampling.");
    account->picture_count++;
    return GSN_OK;
}

static int surface(const struct gsn_account_options *options, struct gsn_account *account,
                   struct gsn_error *err)
{
    struct gsn_account_picture *picture = next(account, "isosurface", "Isosurface");
    const double level = account->bound[account->bound_count / 2].threshold;
    const struct gsn_tets *mesh = gsn_dms_mesh(account->space);
    const struct gsn_view view = view_of(SURFACE_PX);
    gsn_auto(gsn_trimesh) triangles = NULL;
    gsn_auto(gsn_image) image = NULL;
    int r = gsn_isosurface(account->spline, level, mesh->tet_count > 40000 ? 0 : 1,
                           options->threads, &triangles, err);

    if (r >= 0)
        r = gsn_trimesh_paint(triangles, mesh, &view, NULL, options->threads, &image, err);
    if (r >= 0)
        r = keep(image, picture, err);
    if (r < 0)
        return r;
    (void)snprintf(picture->caption, sizeof picture->caption,
                   "The surface where the density is %.4g: %zu triangles by marching tetrahedra, "
                   "normals from the spline's own gradient. Open where it meets the edge of the "
                   "domain.",
                   level, triangles->triangle_count);
    account->picture_count++;
    return GSN_OK;
}

int gsn_pictures_make(const struct gsn_grid *grid, const struct gsn_mask *region,
                      const struct gsn_protocol *protocol,
                      const struct gsn_account_options *options, struct gsn_account *account,
                      struct gsn_error *err)
{
    struct scale scale = { .low = 0, .high = 1, .unit = "density" };
    int r;

    if (protocol->kind == GSN_KIND_VOLUME) {
        gsn_cut_range(grid, region, &scale.low, &scale.high);
        scale.unit = "value";
    }
    gsn_progress_say(options->progress, "pictures", 0, 5);
    r = cuts(grid, region, &scale, options, account, err);
    gsn_progress_say(options->progress, "pictures", 3, 5);
    if (r >= 0)
        r = xray(options, protocol->kind == GSN_KIND_VOLUME ? "value x um" : NULL, account, err);
    gsn_progress_say(options->progress, "pictures", 4, 5);
    return r < 0 ? r : surface(options, account, err);
}

/* What a profile made linear is coded again, or it would come out dark; other codes are shown as
 * they are. */
static uint8_t code_of(enum gsn_light light, double share)
{
    return (uint8_t)(255 * (light == GSN_LIGHT_PROFILE ? gsn_light_encode(GSN_LIGHT_SRGB, share)
                                                       : share));
}

/* The mean colour of the pixels that one pixel of the small picture stands for, of at most four by
 * four of them: more would show nothing more. */
static struct gsn_colour box_mean(const struct gsn_image *image, enum gsn_light light, int x0,
                                  int y0, int x1, int y1)
{
    const double full = image->bits == 16 ? 65535 : 255;
    const int right = (x1 - x0 + 3) / 4, down = (y1 - y0 + 3) / 4;
    unsigned long sum[3] = { 0 }, count = 0;
    double full_count;

    for (int y = y0 + down / 2; y < y1; y += down)
        for (int x = x0 + right / 2; x < x1; x += right, count++)
            for (unsigned c = 0; c < 3; c++)
                sum[c] += gsn_image_at(image, (uint32_t)x, (uint32_t)y, c);
    full_count = full * (double)(count ? count : 1);
    return (struct gsn_colour){ .r = code_of(light, (double)sum[0] / full_count),
                                .g = code_of(light, (double)sum[1] / full_count),
                                .b = code_of(light, (double)sum[2] / full_count) };
}

static void ring(struct gsn_image *image, double x, double y, double radius)
{
    static const struct gsn_colour ink = { .r = 0, .g = 110, .b = 230 };
    enum { SIDES = 20 };

    for (int i = 0; i < SIDES; i++) {
        const double a = 2 * M_PI * i / SIDES, b = 2 * M_PI * (i + 1) / SIDES;

        gsn_canvas_line(image, x + radius * cos(a), y + radius * sin(a), x + radius * cos(b),
                        y + radius * sin(b), 1.4, ink);
    }
}

int gsn_thumbnail(const struct gsn_image *image, enum gsn_light light, int x, int y, int width,
                  int height, const struct gsn_mark mark[GSN_MARKS], unsigned longest_px,
                  struct gsn_account_picture *ret_picture, struct gsn_error *err)
{
    static const struct gsn_colour white = { .r = 255, .g = 255, .b = 255 };
    const int longest = width > height ? width : height;
    const double scale = longest > (int)longest_px ? (double)longest_px / longest : 1;
    const uint32_t w = (uint32_t)fmax(1, floor(width * scale));
    const uint32_t h = (uint32_t)fmax(1, floor(height * scale));
    gsn_auto(gsn_image) small = NULL;
    int r = gsn_canvas_new(w, h, white, &small, err);

    if (r < 0)
        return r;
    for (uint32_t v = 0; v < h; v++)
        for (uint32_t u = 0; u < w; u++)
            gsn_canvas_put(small, (int)u, (int)v,
                           box_mean(image, light, x + (int)(u * (uint32_t)width / w),
                                    y + (int)(v * (uint32_t)height / h),
                                    x + (int)((u + 1) * (uint32_t)width / w),
                                    y + (int)((v + 1) * (uint32_t)height / h)));
    for (size_t i = 0; i < GSN_MARKS; i++)
        if (mark[i].found)
            ring(small, (mark[i].px.x - x) * scale, (mark[i].px.y - y) * scale,
                 fmax(4, 2.2 * mark[i].radius_px * scale));
    return keep(small, ret_picture, err);
}

int gsn_laid_picture(const struct gsn_image *image, enum gsn_light light,
                     const struct gsn_laid_box *box, struct gsn_point corner, double um_per_px,
                     unsigned side_px, struct gsn_image **ret_picture, struct gsn_error *err)
{
    static const struct gsn_colour white = { .r = 255, .g = 255, .b = 255 };
    const struct gsn_affine to_px = gsn_affine_inverse(&box->panel_to_block_um);
    const int reach =
        (int)fmax(1, ceil(um_per_px / sqrt(fabs(gsn_affine_det(&box->panel_to_block_um)))));
    const int right = box->x + box->width, down = box->y + box->height;
    gsn_auto(gsn_image) picture = NULL;
    int r = gsn_canvas_new(side_px, side_px, white, &picture, err);

    for (unsigned v = 0; r >= 0 && v < side_px; v++)
        for (unsigned u = 0; u < side_px; u++) {
            const struct gsn_point um = { corner.x + (u + 0.5) * um_per_px,
                                          corner.y + (v + 0.5) * um_per_px };
            const struct gsn_point px = gsn_affine_apply(&to_px, um);
            int x, y;

            if (!(px.x >= box->x && px.y >= box->y && px.x < right && px.y < down))
                continue;
            x = (int)px.x - reach / 2 > box->x ? (int)px.x - reach / 2 : box->x;
            y = (int)px.y - reach / 2 > box->y ? (int)px.y - reach / 2 : box->y;
            gsn_canvas_put(picture, (int)u, (int)v,
                           box_mean(image, light, x, y, x + reach < right ? x + reach : right,
                                    y + reach < down ? y + reach : down));
        }
    if (r >= 0)
        *ret_picture = gsn_steal(&picture);
    return r;
}
