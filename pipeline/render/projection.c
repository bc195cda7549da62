/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The X-ray picture: the ray integral of a spline along the line of sight of every pixel, exact.
 *
 * Method: projection of simplex splines: seen along a line they are bivariate splines of one degree
 * more (docs/MATH.md, section 4, equations (7) and (8)). Object order: the shadow of a tetrahedron
 * is the convex hull of its projected knots (A. M. Andrew's monotone chain, 1979), and only pixels
 * in it are asked.
 *
 * Steps: (1) frame the mesh with a camera; (2) per tetrahedron its shadow; (3) rows of the picture,
 * band by band, each pixel adding the tetrahedra in order; (4) paint with a colour scale.
 *
 * Failure: GSN_E_INPUT on a view without a direction or of an impossible size; GSN_E_NOMEM.
 * Cost: one integral a pixel and tetrahedron of its line; the same bytes for any number of
 * threads. */
#include "pipeline/render/projection.h"

#include "pipeline/core/geom.h"
#include "pipeline/core/parallel.h"
#include "pipeline/render/canvas.h"
#include "pipeline/render/ray.h"
#include "pipeline/render/view.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* --- the camera --- */

static const double margin = 0.06; /* of the picture, on every side */

/* Whether the vector could be brought to length 1. */
static int make_unit(double a[3])
{
    const double length = sqrt(gsn_dot3(a, a));

    if (!isfinite(length) || !(length > 0.0))
        return 0;
    for (int k = 0; k < 3; k++)
        a[k] /= length;
    return 1;
}

static int find_axes(const struct gsn_view *view, struct gsn_camera *camera)
{
    double up[3];

    for (int a = 0; a < 3; a++) {
        camera->into[a] = view->direction[a];
        up[a] = view->up[a];
    }
    if (!make_unit(camera->into) || !make_unit(up))
        return 0;
    gsn_cross3(camera->into, up, camera->right);
    /* Nearly parallel to the view, up says nothing that survives rounding. */
    if (gsn_dot3(camera->right, camera->right) < 1e-12 || !make_unit(camera->right))
        return 0;
    gsn_cross3(camera->into, camera->right, camera->down);
    return 1;
}

void gsn_camera_project(const struct gsn_camera *camera, const double point[3], double ret_pixel[2],
                        double *ret_depth)
{
    const double away[3] = { point[0] - camera->centre[0], point[1] - camera->centre[1],
                             point[2] - camera->centre[2] };
    const double depth = gsn_dot3(away, camera->into);
    double scale = camera->px_per_um;

    if (camera->eye_um > 0.0)
        scale *= camera->eye_um / (camera->eye_um + depth);
    ret_pixel[0] = 0.5 * camera->width + scale * gsn_dot3(away, camera->right);
    ret_pixel[1] = 0.5 * camera->height + scale * gsn_dot3(away, camera->down);
    *ret_depth = depth;
}

/* The middle of the mesh as this camera sees it, and the radius of the ball around it. */
static double centre_camera(const struct gsn_tets *mesh, struct gsn_camera *camera)
{
    const double *axis[3] = { camera->right, camera->down, camera->into };
    double radius2 = 0.0;

    for (int a = 0; a < 3; a++)
        camera->centre[a] = 0.0;
    for (int k = 0; k < 3; k++) {
        double low = INFINITY, high = -INFINITY;

        for (size_t v = 0; v < mesh->vertex_count; v++) {
            low = fmin(low, gsn_dot3(mesh->vertex[v], axis[k]));
            high = fmax(high, gsn_dot3(mesh->vertex[v], axis[k]));
        }
        for (int a = 0; a < 3; a++)
            camera->centre[a] += 0.5 * (low + high) * axis[k][a];
    }
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        const double away[3] = { mesh->vertex[v][0] - camera->centre[0],
                                 mesh->vertex[v][1] - camera->centre[1],
                                 mesh->vertex[v][2] - camera->centre[2] };

        radius2 = fmax(radius2, gsn_dot3(away, away));
    }
    return sqrt(radius2);
}

int gsn_camera_frame(const struct gsn_view *view, const struct gsn_tets *mesh,
                     struct gsn_camera *ret_camera, struct gsn_error *err)
{
    struct gsn_camera camera = { .width = view->width, .height = view->height, .px_per_um = 1.0 };
    double radius, fill = 0.0;

    if (view->width == 0 || view->height == 0 || view->width > 16384 || view->height > 16384)
        return gsn_fail(err, GSN_E_INPUT, "a picture of %u x %u pixels cannot be drawn",
                        view->width, view->height);
    if (!find_axes(view, &camera))
        return gsn_fail(err, GSN_E_INPUT, "the view has no direction, or up is parallel to it");
    radius = centre_camera(mesh, &camera);
    /* Nearer than this the eye would be inside the scene. */
    if (view->eye_distance > 0.0)
        camera.eye_um = radius * fmax(1.5, view->eye_distance);
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        double pixel[2], depth;

        gsn_camera_project(&camera, mesh->vertex[v], pixel, &depth);
        fill = fmax(fill, fabs(pixel[0] - 0.5 * camera.width) / (0.5 * camera.width));
        fill = fmax(fill, fabs(pixel[1] - 0.5 * camera.height) / (0.5 * camera.height));
    }
    camera.px_per_um = (1.0 - 2.0 * margin) / fill;
    *ret_camera = camera;
    return GSN_OK;
}

/* --- the shadow of a tetrahedron --- */

/* Pixels. A centre this near outside is integrated too: it costs one evaluation that gives 0. */
static const double generous = 1e-6;

static int by_place(const void *a, const void *b)
{
    const double *p = a, *q = b;

    if (p[0] < q[0] || p[0] > q[0])
        return p[0] < q[0] ? -1 : 1;
    return (p[1] > q[1]) - (p[1] < q[1]);
}

static double turn_of(const double a[2], const double b[2], const double c[2])
{
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

/* Andrew's monotone chain. Dropping a corner that is collinear up to rounding moves the hull by
 * less than generous. */
static unsigned convex_hull(double (*point)[2], unsigned count, double (*ret_hull)[2])
{
    double chain[2 * GSN_SHADOW_MOST][2];
    unsigned size = 0;

    qsort(point, count, sizeof *point, by_place);
    for (int upper = 0; upper < 2; upper++) {
        const unsigned start = size;

        for (unsigned i = 0; i < count; i++) {
            const double *next = point[upper ? count - 1 - i : i];

            while (size >= start + 2 && turn_of(chain[size - 2], chain[size - 1], next) <= 0.0)
                size--;
            memcpy(chain[size++], next, sizeof *chain);
        }
        size--; /* the end of one chain is the start of the other */
    }
    if (size < 2) {
        /* All in one place: keep it as a segment of no length. */
        memcpy(chain[1], chain[0], sizeof *chain);
        size = 2;
    }
    memcpy(ret_hull, chain, size * sizeof *chain);
    return size;
}

/* The camera is orthographic. */
static void make_shadow(const struct gsn_dms *space, size_t tet, const struct gsn_camera *camera,
                        struct gsn_shadow *ret_shadow)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const double(*knot)[3] = gsn_dms_knots(space);
    const unsigned cloud = gsn_dms_degree(space) + 1;
    double point[GSN_SHADOW_MOST][2];
    unsigned count = 0;

    for (int k = 0; k < 4; k++) {
        for (unsigned l = 0; l < cloud; l++) {
            double depth;

            gsn_camera_project(camera, knot[(size_t)mesh->tet[tet][k] * cloud + l], point[count++],
                               &depth);
        }
    }
    ret_shadow->count = convex_hull(point, count, ret_shadow->corner);
    ret_shadow->top = INFINITY;
    ret_shadow->bottom = -INFINITY;
    for (unsigned i = 0; i < ret_shadow->count; i++) {
        ret_shadow->top = fmin(ret_shadow->top, ret_shadow->corner[i][1]);
        ret_shadow->bottom = fmax(ret_shadow->bottom, ret_shadow->corner[i][1]);
    }
}

void gsn_shadow_span(const struct gsn_shadow *shadow, uint32_t row, uint32_t width,
                     uint32_t *ret_first, uint32_t *ret_end)
{
    const double y = fmin(shadow->bottom, fmax(shadow->top, row + 0.5));
    double low = INFINITY, high = -INFINITY;

    *ret_first = *ret_end = 0;
    if (fabs(y - (row + 0.5)) > generous)
        return;
    for (unsigned i = 0; i < shadow->count; i++) {
        const double *a = shadow->corner[i], *b = shadow->corner[(i + 1) % shadow->count];

        if (y < fmin(a[1], b[1]) || y > fmax(a[1], b[1]))
            continue;
        if (a[1] < b[1] || a[1] > b[1]) {
            const double x = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);

            low = fmin(low, x);
            high = fmax(high, x);
        } else {
            low = fmin(low, fmin(a[0], b[0]));
            high = fmax(high, fmax(a[0], b[0]));
        }
    }
    if (low > high)
        return;
    /* Centres at +0.5: the first at or right of low, the last at or left of high. */
    *ret_first = (uint32_t)fmin(width, fmax(0.0, ceil(low - 0.5 - generous)));
    *ret_end = (uint32_t)fmin(width, fmax(0.0, floor(high - 0.5 + generous) + 1.0));
    if (*ret_end < *ret_first)
        *ret_end = *ret_first;
}

void gsn_ray_start(const struct gsn_camera *camera, double x_px, double y_px, double ret_point[3])
{
    const double right = (x_px - 0.5 * camera->width) / camera->px_per_um;
    const double down = (y_px - 0.5 * camera->height) / camera->px_per_um;

    for (int a = 0; a < 3; a++)
        ret_point[a] = camera->centre[a] + right * camera->right[a] + down * camera->down[a];
}

/* --- the picture --- */

enum { BATCHES = 20 }; /* how often progress is said */

struct projecting {
    const struct gsn_spline *spline;
    const struct gsn_camera *camera;
    const struct gsn_shadow *shadow; /* one per tetrahedron */
    size_t tet_count, first_row;
    struct gsn_plane *plane;
};

/* One row of pixels: every tetrahedron whose shadow meets it, in order, so that the sum in a pixel
 * does not depend on the threads. */
static int project_row(size_t index, void *context, struct gsn_error *err)
{
    const struct projecting *projecting = context;
    const struct gsn_camera *camera = projecting->camera;
    const uint32_t row = (uint32_t)(projecting->first_row + index), width = camera->width;
    gsn_auto_mem(double) sum = gsn_alloc_array(width, sizeof *sum);

    if (!sum)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a row of %u pixels", width);
    for (uint32_t i = 0; i < width; i++)
        sum[i] = NAN;
    for (size_t t = 0; t < projecting->tet_count; t++) {
        uint32_t first, end;

        gsn_shadow_span(&projecting->shadow[t], row, width, &first, &end);
        for (uint32_t i = first; i < end; i++) {
            double start[3], part;

            gsn_ray_start(camera, i + 0.5, row + 0.5, start);
            part = gsn_spline_tet_line(projecting->spline, t, start, camera->into);
            sum[i] = isnan(sum[i]) ? part : sum[i] + part;
        }
    }
    for (uint32_t i = 0; i < width; i++)
        projecting->plane->value[(size_t)row * width + i] = (float)sum[i];
    return GSN_OK;
}

static int project_rows(struct projecting *projecting, unsigned threads,
                        const struct gsn_progress *progress, struct gsn_error *err)
{
    const size_t rows = projecting->camera->height;

    for (size_t batch = 0; batch < BATCHES; batch++) {
        const size_t first = rows * batch / BATCHES, end = rows * (batch + 1) / BATCHES;
        int r;

        gsn_progress_say(progress, "projection", first, rows);
        projecting->first_row = first;
        r = gsn_parallel_for(end - first, threads, project_row, projecting, err);
        if (r < 0)
            return r;
    }
    gsn_progress_say(progress, "projection", rows, rows);
    return GSN_OK;
}

int gsn_projection(const struct gsn_spline *spline, const struct gsn_view *view, unsigned threads,
                   const struct gsn_progress *progress, struct gsn_plane **ret_plane,
                   struct gsn_camera *ret_camera, struct gsn_error *err)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const size_t count = gsn_dms_mesh(space)->tet_count;
    gsn_auto_mem(struct gsn_shadow) shadow = NULL;
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_camera camera;
    struct projecting projecting = { .spline = spline, .camera = &camera, .tet_count = count };
    int r;

    if (view->eye_distance > 0.0)
        return gsn_fail(err, GSN_E_INPUT, "an X-ray picture has no eye: the view is orthographic");
    r = gsn_camera_frame(view, gsn_dms_mesh(space), &camera, err);
    if (r == GSN_OK)
        r = gsn_plane_new(camera.width, camera.height, &plane, err);
    if (r < 0)
        return r;
    shadow = gsn_alloc_array(count, sizeof *shadow);
    if (!shadow)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", count);
    for (size_t t = 0; t < count; t++)
        make_shadow(space, t, &camera, &shadow[t]);
    projecting.shadow = shadow;
    projecting.plane = plane;
    r = project_rows(&projecting, threads, progress, err);
    if (r < 0)
        return r;
    *ret_camera = camera;
    *ret_plane = gsn_steal(&plane);
    return GSN_OK;
}

int gsn_axes_paint(struct gsn_image *sheet, int x, int y, const struct gsn_camera *camera,
                   struct gsn_error *err)
{
    static const struct gsn_colour ink[3] = { { 176, 60, 40 }, { 30, 120, 80 }, { 40, 70, 170 } };
    const double length = 22, letter_px = 12, at[2] = { x + 36, y - 36 };
    gsn_auto(gsn_lettering) letters = NULL;
    int r = gsn_lettering_new(GSN_FONT_FOLDER, &letters, err);

    for (int a = 0; r >= 0 && a < 3; a++) {
        const char name[2] = { "xyz"[a], 0 };
        const double right = camera->right[a], down = camera->down[a];
        const double off = 9 / fmax(0.2, hypot(right, down));
        const double tip[2] = { at[0] + length * right, at[1] + length * down };
        const int wide = gsn_lettering_width(letters, GSN_FACE_BOLD, letter_px, name);
        const int high = gsn_lettering_height(letters, GSN_FACE_BOLD, letter_px);
        gsn_auto(gsn_pen) pen = NULL;

        r = gsn_pen_new(sheet, &pen, err);
        if (r < 0)
            return r;
        gsn_pen_line(pen, at[0], at[1], tip[0], tip[1]);
        r = gsn_pen_ink(pen, sheet, 2, ink[a], err);
        if (r >= 0)
            r = gsn_lettering_draw(letters, sheet, (int)(tip[0] + off * right) - wide / 2,
                                   (int)(tip[1] + off * down) - high / 2, GSN_FACE_BOLD, letter_px,
                                   name, ink[a], err);
    }
    return r;
}

int gsn_projection_paint(const struct gsn_plane *plane, const struct gsn_camera *camera,
                         const char *title, const char *unit, double low, double high,
                         enum gsn_colour_map map, struct gsn_image **ret_image,
                         struct gsn_error *err)
{
    gsn_auto(gsn_image) sheet = NULL;
    struct gsn_plate plate = { .title = title,
                               .note = "integral along the line of view",
                               .um_per_px = 1.0 / camera->px_per_um,
                               .has_scale = 1,
                               .unit = unit ? unit : "density \xc3\x97 \xc2\xb5m",
                               .low = low,
                               .high = high,
                               .map = map };
    int r, x, y;

    if (!(low < high)) {
        gsn_plate_range(plane, &plate.low, &plate.high);
        plate.low = fmin(0.0, plate.low);
    }
    r = gsn_plate_new(&plate, plane->width, plane->height, &sheet, &x, &y, err);
    if (r < 0)
        return r;
    gsn_plate_fill(sheet, x, y, plane, map, plate.low, plate.high);
    r = gsn_axes_paint(sheet, x, y + (int)plane->height, camera, err);
    if (r < 0)
        return r;
    *ret_image = gsn_steal(&sheet);
    return GSN_OK;
}
