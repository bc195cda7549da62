/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Cells drawn apart, by a z-buffer of their faces.
 *
 * Steps: (1) of each cell that is shown the four corners are drawn towards its middle and
 * projected; in perspective the depth kept is -1 / distance, which is linear across the picture;
 * (2) bands of rows go to threads: each fills the faces that look at the eye into across x across
 * samples a pixel, nearest wins, of equals the cell that came first; (3) the samples of a pixel are
 * averaged. A face has one colour: the density's, darker the more it turns from the light
 * (Lambert).
 *
 * Failure: GSN_E_INPUT on what cannot be drawn, GSN_E_NOMEM. Cost: every cell is looked at once a
 * band. */
#include "pipeline/render/cells_picture.h"

#include "pipeline/core/geom.h"
#include "pipeline/core/mem.h"
#include "pipeline/core/parallel.h"

#include <math.h>

enum { BAND = 8 }; /* rows of the picture a thread paints at a time */

/* From the left, from above and from the eye, as right, down, into; what the shade leaves. */
static const double TO_LIGHT[3] = { -0.27, -0.32, -0.91 };
static const double AMBIENT = 0.5;

/* A cell in the picture, in samples. */
struct cell {
    float x[4], y[4], depth[4];
    float shade[4]; /* of the face opposite each corner; below 0: it looks away from the eye */
    struct gsn_colour colour;
};

struct sample {
    float depth, rgb[3];
};

struct drawing {
    const struct gsn_camera *camera;
    unsigned across;
    struct cell *cell;
    size_t cells;
    struct gsn_ray_picture *picture;
};

static int is_clipped(const struct gsn_ray_clip *clip, const double middle[3])
{
    for (int c = 0; clip && clip->has_box && c < 3; c++)
        if (middle[c] < clip->low[c] || middle[c] > clip->high[c])
            return 1;
    for (size_t p = 0; clip && p < clip->plane_count; p++) {
        const double *plane = clip->plane[p];
        double along = 0;

        for (int c = 0; c < 3; c++)
            along += (middle[c] - plane[c]) * plane[3 + c];
        if (along > 0)
            return 1;
    }
    return 0;
}

/* What the light leaves of a face's colour; below 0 where it is not seen. */
static float shade_of(const struct gsn_camera *camera, const double at[4][3], int opposite)
{
    const double *p = at[(opposite + 1) % 4], *q = at[(opposite + 2) % 4];
    const double *s = at[(opposite + 3) % 4];
    const double *axis[3] = { camera->right, camera->down, camera->into };
    double u[3], v[3], n[3], inward[3], to_face[3], light = 0, length;

    for (int c = 0; c < 3; c++) {
        u[c] = q[c] - p[c];
        v[c] = s[c] - p[c];
        inward[c] = at[opposite][c] - p[c];
        /* From the eye to the face. */
        to_face[c] = camera->into[c];
        if (camera->eye_um > 0)
            to_face[c] = p[c] - camera->centre[c] + camera->eye_um * camera->into[c];
    }
    gsn_cross3(u, v, n);
    length = sqrt(gsn_dot3(n, n));
    if (!(length > 0))
        return -1;
    if (gsn_dot3(n, inward) > 0)
        length = -length;
    for (int c = 0; c < 3; c++)
        n[c] /= length;
    if (gsn_dot3(n, to_face) >= 0)
        return -1;
    for (int c = 0; c < 3; c++)
        light += gsn_dot3(n, axis[c]) * TO_LIGHT[c];
    return (float)(AMBIENT + (1 - AMBIENT) * fmax(0, light));
}

static int project_cells(const struct gsn_tets *mesh, const double *density, double share,
                         const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                         struct drawing *d, struct gsn_error *err)
{
    d->cell = gsn_alloc_array(mesh->tet_count + 1, sizeof *d->cell);
    if (!d->cell)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", mesh->tet_count);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        struct cell *cell = &d->cell[d->cells];
        double at[4][3], middle[3] = { 0 };

        for (int k = 0; k < 4; k++)
            for (int c = 0; c < 3; c++)
                middle[c] += 0.25 * mesh->vertex[mesh->tet[t][k]][c];
        if (!(density[t] >= style->low) || is_clipped(clip, middle))
            continue;
        for (int k = 0; k < 4; k++) {
            double pixel[2], depth;

            for (int c = 0; c < 3; c++)
                at[k][c] = middle[c] + share * (mesh->vertex[mesh->tet[t][k]][c] - middle[c]);
            gsn_camera_project(d->camera, at[k], pixel, &depth);
            cell->x[k] = (float)(pixel[0] * d->across);
            cell->y[k] = (float)(pixel[1] * d->across);
            cell->depth[k] =
                (float)(d->camera->eye_um > 0 ? -1 / (d->camera->eye_um + depth) : depth);
        }
        for (int k = 0; k < 4; k++)
            cell->shade[k] = shade_of(d->camera, (const double(*)[3])at, k);
        cell->colour =
            gsn_colour_of(style->map, (density[t] - style->low) / (style->high - style->low));
        d->cells++;
    }
    return GSN_OK;
}

/* Rows [top, top + rows) of samples. */
static void fill_face(const struct cell *cell, int opposite, struct sample *sample, int width,
                      int top, int rows)
{
    const int a = (opposite + 1) % 4, b = (opposite + 2) % 4, c = (opposite + 3) % 4;
    const double ax = (double)cell->x[a], ay = (double)cell->y[a];
    const double bx = (double)cell->x[b] - ax, by = (double)cell->y[b] - ay;
    const double cx = (double)cell->x[c] - ax, cy = (double)cell->y[c] - ay;
    const double det = bx * cy - by * cx;
    const int first_x = (int)fmax(0, floor(ax + fmin(0, fmin(bx, cx)) - 0.5));
    const int end_x = (int)fmin(width, ceil(ax + fmax(0, fmax(bx, cx)) + 0.5));
    const int first_y = (int)fmax(top, floor(ay + fmin(0, fmin(by, cy)) - 0.5));
    const int end_y = (int)fmin(top + rows, ceil(ay + fmax(0, fmax(by, cy)) + 0.5));

    if (!(fabs(det) > 0))
        return;
    for (int y = first_y; y < end_y; y++)
        for (int x = first_x; x < end_x; x++) {
            const double px = x + 0.5 - ax, py = y + 0.5 - ay;
            const double wb = (px * cy - py * cx) / det, wc = (bx * py - by * px) / det;
            const double wa = 1 - wb - wc;
            struct sample *to = sample + (size_t)(y - top) * (size_t)width + (size_t)x;
            float depth;

            /* A hair outside counts: no pinholes along shared edges. */
            if (wa < -1e-6 || wb < -1e-6 || wc < -1e-6)
                continue;
            depth = (float)(wa * (double)cell->depth[a] + wb * (double)cell->depth[b] +
                            wc * (double)cell->depth[c]);
            if (!(depth < to->depth))
                continue;
            *to = (struct sample){ depth,
                                   { cell->shade[opposite] * cell->colour.r / 255,
                                     cell->shade[opposite] * cell->colour.g / 255,
                                     cell->shade[opposite] * cell->colour.b / 255 } };
        }
}

static int paint_band(size_t band, void *context, struct gsn_error *err)
{
    const struct drawing *d = context;
    const unsigned n = d->across;
    const int width = (int)(d->camera->width * n), top = (int)(band * BAND * n);
    const int rows_px = (int)fmin(BAND, (double)d->camera->height - (double)band * BAND);
    const int rows = rows_px * (int)n;
    const size_t count = (size_t)width * (size_t)rows;
    gsn_auto_mem(struct sample) sample = gsn_alloc_array(count, sizeof *sample);

    if (!sample)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu samples", count);
    for (size_t i = 0; i < count; i++)
        sample[i].depth = INFINITY;
    for (size_t t = 0; t < d->cells; t++) {
        const struct cell *cell = &d->cell[t];
        const double low =
            (double)fminf(fminf(cell->y[0], cell->y[1]), fminf(cell->y[2], cell->y[3]));
        const double high =
            (double)fmaxf(fmaxf(cell->y[0], cell->y[1]), fmaxf(cell->y[2], cell->y[3]));

        if (low > top + rows || high < top)
            continue;
        for (int k = 0; k < 4; k++)
            if (cell->shade[k] >= 0)
                fill_face(cell, k, sample, width, top, rows);
    }
    for (int y = 0; y < rows_px; y++)
        for (int x = 0; x < (int)d->camera->width; x++) {
            float *to = d->picture->rgba[(band * BAND + (size_t)y) * d->camera->width + (size_t)x];

            for (unsigned k = 0; k < n * n; k++) {
                const struct sample *s =
                    sample + ((size_t)y * n + k / n) * (size_t)width + (size_t)x * n + k % n;

                if (isinf(s->depth))
                    continue;
                for (int c = 0; c < 3; c++)
                    to[c] += s->rgb[c] / (float)(n * n);
                to[3] += 1 / (float)(n * n);
            }
        }
    return GSN_OK;
}

int gsn_cells_picture(const struct gsn_tets *mesh, const double *density, double share,
                      const struct gsn_camera *camera, const struct gsn_ray_clip *clip,
                      const struct gsn_ray_style *style, unsigned threads,
                      struct gsn_ray_picture **ret_picture, struct gsn_error *err)
{
    gsn_auto(gsn_ray_picture) picture = gsn_alloc_array(1, sizeof *picture);
    struct drawing d = { .camera = camera, .across = style->across, .picture = picture };
    gsn_auto_mem(struct cell) cell = NULL;
    int r;

    if (!(share > 0 && share <= 1) || !(style->low < style->high) || style->across < 1 ||
        style->across > 4)
        return gsn_fail(err, GSN_E_INPUT,
                        "cells of %g of their size, from %g to %g, cannot be drawn", share,
                        style->low, style->high);
    if (picture)
        picture->rgba =
            gsn_alloc_array((size_t)camera->width * camera->height, sizeof *picture->rgba);
    if (!picture || !picture->rgba)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a picture of %u x %u pixels",
                        camera->width, camera->height);
    picture->width = camera->width;
    picture->height = camera->height;
    r = project_cells(mesh, density, share, clip, style, &d, err);
    cell = d.cell;
    if (r >= 0)
        r = gsn_parallel_for((camera->height + BAND - 1) / BAND, threads, paint_band, &d, err);
    if (r >= 0)
        *ret_picture = gsn_steal(&picture);
    return r;
}
