/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A triangle mesh as a picture, by a z-buffer.
 *
 * Method: vertices are projected, triangles filled by their barycentric coordinates, and normals
 * interpolated and shaded at each sample (B. T. Phong, "Illumination for computer generated
 * pictures", 1975), with the half-way vector for the highlight (J. F. Blinn, "Models of light
 * reflection for computer synthesized pictures", 1977). In perspective the depth kept is -1 /
 * distance, which is linear across the picture.
 *
 * Steps: (1) camera and sheet; (2) all vertices projected; (3) the domain's edges where it bends,
 * behind; (4) bands of 8 rows go to threads: each fills all triangles into 2 x 2 samples a pixel,
 * nearest wins, equals in the order of the mesh; (5) the samples of a pixel are shaded, averaged
 * and mixed over the ground by their share.
 *
 * Failure: GSN_E_INPUT on an unusable view, GSN_E_NOMEM. Cost: every triangle is looked at once a
 * band. */
#include "pipeline/core/geom.h"
#include "pipeline/render/isosurface.h"

#include <math.h>

#include "pipeline/core/parallel.h"
#include "pipeline/render/lettering.h"

enum {
    BAND = 8,    /* rows of the picture a thread paints at a time */
    SAMPLES = 2, /* per pixel and axis */
};

static const struct gsn_colour background = { 240, 240, 242 };
static const struct gsn_colour edge_colour = { 150, 152, 160 };
static const struct gsn_colour bone = { 226, 205, 176 };

/* Light from above, from the left and from the eye; the coordinates are right, down, into. */
static const double to_light[3] = { -0.45, -0.60, -0.66 };

/* A vertex in the picture, in samples; depth is such that larger is farther and that it is linear
 * across the picture: -1 / distance in perspective. */
struct corner {
    float x, y, depth;
    float normal[3]; /* right, down, into */
};

/* One sample. */
struct sample {
    float depth;
    float normal[3];
};

struct painting {
    const struct gsn_trimesh *surface;
    const struct gsn_camera *camera;
    struct corner *corner;
    struct gsn_colour colour;
    struct gsn_image *sheet;
    int x, y;
};

static struct corner project_vertex(const struct painting *painting, size_t v)
{
    const struct gsn_camera *camera = painting->camera;
    const double *axis[3] = { camera->right, camera->down, camera->into };
    const float *n = painting->surface->normal[v];
    const double normal[3] = { (double)n[0], (double)n[1], (double)n[2] };
    struct corner corner;
    double pixel[2], depth;

    gsn_camera_project(camera, painting->surface->vertex[v], pixel, &depth);
    corner.x = (float)(pixel[0] * SAMPLES);
    corner.y = (float)(pixel[1] * SAMPLES);
    corner.depth = (float)(camera->eye_um > 0.0 ? -1.0 / (camera->eye_um + depth) : depth);
    for (int a = 0; a < 3; a++)
        corner.normal[a] = (float)gsn_dot3(normal, axis[a]);
    return corner;
}

/* Rows [top, top + rows) of samples. Nearest wins; of equal depths the triangle that came first. */
static void fill_triangle(struct sample *sample, int width, int top, int rows,
                          const struct corner *a, const struct corner *b, const struct corner *c)
{
    const double ax = (double)a->x, ay = (double)a->y;
    const double bx = (double)b->x - ax, by = (double)b->y - ay;
    const double cx = (double)c->x - ax, cy = (double)c->y - ay;
    const double det = bx * cy - by * cx;
    const double low_x = fmin(0.0, fmin(bx, cx)) + ax, high_x = fmax(0.0, fmax(bx, cx)) + ax;
    const double low_y = fmin(0.0, fmin(by, cy)) + ay, high_y = fmax(0.0, fmax(by, cy)) + ay;
    const int first_x = (int)fmax(0.0, floor(low_x - 0.5));
    const int first_y = (int)fmax(top, floor(low_y - 0.5));
    const int end_x = (int)fmin(width, ceil(high_x + 0.5));
    const int end_y = (int)fmin(top + rows, ceil(high_y + 0.5));

    if (!(fabs(det) > 0.0))
        return;
    for (int y = first_y; y < end_y; y++) {
        for (int x = first_x; x < end_x; x++) {
            const double px = x + 0.5 - ax, py = y + 0.5 - ay;
            const double wb = (px * cy - py * cx) / det, wc = (bx * py - by * px) / det;
            const double wa = 1.0 - wb - wc;
            struct sample *to = sample + (size_t)(y - top) * (size_t)width + (size_t)x;
            float depth;

            /* A hair outside counts: no pinholes along shared edges. */
            if (wa < -1e-6 || wb < -1e-6 || wc < -1e-6)
                continue;
            depth = (float)(wa * (double)a->depth + wb * (double)b->depth + wc * (double)c->depth);
            if (!(depth < to->depth))
                continue;
            to->depth = depth;
            for (int k = 0; k < 3; k++)
                to->normal[k] = (float)(wa * (double)a->normal[k] + wb * (double)b->normal[k] +
                                        wc * (double)c->normal[k]);
        }
    }
}

/* Two-sided: the normal is turned to the eye. */
static void shade_sample(const struct sample *sample, struct gsn_colour colour, double ret_rgb[3])
{
    const double base[3] = { colour.r, colour.g, colour.b };
    double n[3] = { (double)sample->normal[0], (double)sample->normal[1],
                    (double)sample->normal[2] };
    const double length = sqrt(gsn_dot3(n, n)), turn = n[2] > 0.0 ? -1.0 : 1.0;
    const double half[3] = { to_light[0], to_light[1], to_light[2] - 1.0 };
    double diffuse, shine, fill;

    for (int a = 0; a < 3; a++)
        n[a] *= turn / fmax(1e-12, length);
    diffuse = fmax(0.0, gsn_dot3(n, to_light));
    /* A weak light from below right keeps the dark side readable. */
    fill = fmax(0.0, 0.6 * n[0] + 0.5 * n[1] - 0.62 * n[2]);
    shine = pow(fmax(0.0, gsn_dot3(n, half) / sqrt(gsn_dot3(half, half))), 40.0);
    for (int a = 0; a < 3; a++)
        ret_rgb[a] = fmin(255.0, base[a] * (0.30 + 0.66 * diffuse + 0.14 * fill) + 52.0 * shine);
}

/* The SAMPLES x SAMPLES samples of a pixel, mixed over what is there by the part that is covered.
 */
static void resolve_pixel(const struct painting *painting, const struct sample *first, int width,
                          int x, int y)
{
    double sum[3] = { 0.0, 0.0, 0.0 };
    int hits = 0;

    for (int k = 0; k < SAMPLES * SAMPLES; k++) {
        const struct sample *sample = first + (k / SAMPLES) * width + k % SAMPLES;
        double rgb[3];

        if (isinf(sample->depth))
            continue;
        shade_sample(sample, painting->colour, rgb);
        for (int a = 0; a < 3; a++)
            sum[a] += rgb[a];
        hits++;
    }
    if (hits > 0)
        gsn_canvas_mix(painting->sheet, painting->x + x, painting->y + y,
                       (struct gsn_colour){ (uint8_t)(sum[0] / hits + 0.5),
                                            (uint8_t)(sum[1] / hits + 0.5),
                                            (uint8_t)(sum[2] / hits + 0.5) },
                       hits / (double)(SAMPLES * SAMPLES));
}

static int paint_band(size_t band, void *context, struct gsn_error *err)
{
    const struct painting *painting = context;
    const int width = (int)painting->camera->width * SAMPLES, top = (int)band * BAND * SAMPLES;
    const int rows_px = (int)fmin(BAND, (double)painting->camera->height - (double)band * BAND);
    const size_t count = (size_t)width * (size_t)(rows_px * SAMPLES);
    gsn_auto_mem(struct sample) sample = gsn_alloc_array(count, sizeof *sample);

    if (!sample)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu samples", count);
    for (size_t i = 0; i < count; i++)
        sample[i].depth = INFINITY;
    for (size_t t = 0; t < painting->surface->triangle_count; t++) {
        const uint32_t *v = painting->surface->triangle[t];

        fill_triangle(sample, width, top, rows_px * SAMPLES, &painting->corner[v[0]],
                      &painting->corner[v[1]], &painting->corner[v[2]]);
    }
    for (int y = 0; y < rows_px; y++) {
        for (int x = 0; x < (int)painting->camera->width; x++)
            resolve_pixel(painting, sample + (y * width + x) * SAMPLES, width, x,
                          (int)band * BAND + y);
    }
    return GSN_OK;
}

static void face_normal(const struct gsn_tets *mesh, size_t tet, int opposite, double ret[3])
{
    const double *p[3], *apex = mesh->vertex[mesh->tet[tet][opposite]];
    double length;

    for (int j = 0; j < 3; j++)
        p[j] = mesh->vertex[mesh->tet[tet][(opposite + 1 + j) % 4]];
    for (int a = 0; a < 3; a++) {
        const int m = (a + 1) % 3, n = (a + 2) % 3;

        ret[a] =
            (p[1][m] - p[0][m]) * (p[2][n] - p[0][n]) - (p[1][n] - p[0][n]) * (p[2][m] - p[0][m]);
    }
    length = sqrt(gsn_dot3(ret, ret));
    if ((apex[0] - p[0][0]) * ret[0] + (apex[1] - p[0][1]) * ret[1] + (apex[2] - p[0][2]) * ret[2] >
        0.0)
        length = -length;
    for (int a = 0; a < 3; a++)
        ret[a] /= length;
}

/* The other boundary face at an edge of a boundary face: turning through the tetrahedra around the
 * edge until a face has no neighbour. */
static void turn_around(const struct gsn_tets *mesh, size_t tet, int opposite, uint32_t u,
                        uint32_t v, double ret_normal[3])
{
    for (;;) {
        int next = -1;
        uint32_t enter;

        /* The face that also holds the edge lies opposite the corner of this one that is not on it.
         */
        for (int k = 0; k < 4; k++) {
            if (k != opposite && mesh->tet[tet][k] != u && mesh->tet[tet][k] != v)
                next = k;
        }
        if (mesh->neighbour[tet][next] < 0) {
            face_normal(mesh, tet, next, ret_normal);
            return;
        }
        enter = mesh->tet[tet][opposite];
        tet = (size_t)mesh->neighbour[tet][next];
        /* In the next one the face we came through has the edge and enter; opposite it is the
         * fourth corner. */
        for (int k = 0; k < 4; k++) {
            if (mesh->tet[tet][k] != u && mesh->tet[tet][k] != v && mesh->tet[tet][k] != enter)
                opposite = k;
        }
    }
}

/* The domain's boundary edges at which it bends; each is met from both of its faces. */
static int draw_outline(const struct painting *painting, const struct gsn_tets *mesh,
                        struct gsn_error *err)
{
    gsn_auto(gsn_pen) pen = NULL;
    const int r = gsn_pen_new(painting->sheet, &pen, err);

    if (r < 0)
        return r;
    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (int k = 0; k < 4; k++) {
            double here[3], there[3];

            if (mesh->neighbour[t][k] >= 0)
                continue;
            face_normal(mesh, t, k, here);
            for (int j = 0; j < 3; j++) {
                const uint32_t u = mesh->tet[t][(k + 1 + j) % 4];
                const uint32_t v = mesh->tet[t][(k + 1 + (j + 1) % 3) % 4];
                double a[2], b[2], depth;

                turn_around(mesh, t, k, u, v, there);
                if (gsn_dot3(here, there) > 0.9)
                    continue;
                gsn_camera_project(painting->camera, mesh->vertex[u], a, &depth);
                gsn_camera_project(painting->camera, mesh->vertex[v], b, &depth);
                gsn_pen_line(pen, painting->x + a[0], painting->y + a[1], painting->x + b[0],
                             painting->y + b[1]);
            }
        }
    }
    return gsn_pen_ink(pen, painting->sheet, 0.7, edge_colour, err);
}

int gsn_trimesh_paint(const struct gsn_trimesh *surface, const struct gsn_tets *mesh,
                      const struct gsn_view *view, const struct gsn_trimesh_style *style,
                      unsigned threads, struct gsn_image **ret_image, struct gsn_error *err)
{
    static const struct gsn_trimesh_style plain = { 0 };
    gsn_auto_mem(struct corner) corner = NULL;
    gsn_auto(gsn_image) sheet = NULL;
    struct gsn_camera camera;
    struct gsn_plate plate = { 0 };
    struct painting painting = { .surface = surface, .camera = &camera };
    int r = gsn_camera_frame(view, mesh, &camera, err);

    if (r < 0)
        return r;
    if (!style)
        style = &plain;
    painting.colour = style->colour;
    if (style->colour.r == 0 && style->colour.g == 0 && style->colour.b == 0)
        painting.colour = bone;
    plate.title = style->title;
    plate.um_per_px = 1.0 / camera.px_per_um;
    plate.note = camera.eye_um > 0.0 ? "perspective; scale at the middle"
                 : style->box        ? "axes in \xc2\xb5m"
                                     : NULL;
    r = gsn_plate_new(&plate, camera.width, camera.height, &sheet, &painting.x, &painting.y, err);
    if (r < 0)
        return r;
    corner = gsn_alloc_array(surface->vertex_count, sizeof *corner);
    if (!corner)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", surface->vertex_count);
    painting.sheet = sheet;
    painting.corner = corner;
    for (size_t v = 0; v < surface->vertex_count; v++)
        corner[v] = project_vertex(&painting, v);
    gsn_canvas_box(sheet, painting.x, painting.y, (int)camera.width, (int)camera.height,
                   background);
    if (style->outline)
        r = draw_outline(&painting, mesh, err);
    if (r < 0)
        return r;
    r = gsn_parallel_for((camera.height + BAND - 1) / BAND, threads, paint_band, &painting, err);
    if (r >= 0)
        r = gsn_block_axes_paint(sheet, painting.x, painting.y, &camera, style->box, err);
    if (r < 0)
        return r;
    *ret_image = gsn_steal(&sheet);
    return GSN_OK;
}
