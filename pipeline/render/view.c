/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The camera: an orthonormal frame from a direction of view and what is up, scaled so that all of a
 * scene is in the picture with a margin around it.
 *
 * Steps: (1) right, down and into by two cross products; (2) the middle of the scene along these,
 * and the ball around it, from which an eye keeps its distance; (3) the vertex that reaches
 * furthest in the picture gives the scale.
 *
 * Failure: GSN_E_INPUT on a view without a direction or of an impossible size. Cost: three passes
 * over the vertices. */
#include "pipeline/render/view.h"

#include "pipeline/core/geom.h"

#include <math.h>

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

void gsn_ray_start(const struct gsn_camera *camera, double x_px, double y_px, double ret_point[3])
{
    const double right = (x_px - 0.5 * camera->width) / camera->px_per_um;
    const double down = (y_px - 0.5 * camera->height) / camera->px_per_um;

    for (int a = 0; a < 3; a++)
        ret_point[a] = camera->centre[a] + right * camera->right[a] + down * camera->down[a];
}
