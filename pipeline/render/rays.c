/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The rays of a picture: from pixels into space, through what a clip leaves, and past what.
 *
 * Method: box and planes shorten a ray by half-spaces. A region is met by sphere tracing of its
 * distance field (J. C. Hart 1996, 10.1007/s003710050084) with bisection where the sign changes, on
 * and on until the ray's end: however often it enters, every stretch is kept.
 *
 * Failure: GSN_E_INPUT on a view, style or clip that cannot be; GSN_E_NOMEM.
 * Cost: a region's distance a step; steps are half a voxel near its border. */
#include "pipeline/render/rays_internal.h"

#include "pipeline/core/geom.h"

#include <math.h>

struct gsn_ray gsn_ray_of(const struct gsn_camera *camera, uint32_t x, uint32_t y)
{
    const double right = (x + 0.5 + 1.1e-9 - 0.5 * camera->width) / camera->px_per_um;
    const double down = (y + 0.5 + 0.7e-9 - 0.5 * camera->height) / camera->px_per_um;
    struct gsn_ray ray = { .from = -INFINITY, .to = INFINITY };
    double length = 0;

    for (int c = 0; c < 3; c++) {
        ray.start[c] = camera->centre[c] + right * camera->right[c] + down * camera->down[c];
        ray.into[c] = camera->into[c];
        if (camera->eye_um > 0)
            ray.into[c] = ray.start[c] - (camera->centre[c] - camera->eye_um * camera->into[c]);
        length += ray.into[c] * ray.into[c];
    }
    length = sqrt(length);
    for (int c = 0; c < 3; c++)
        ray.into[c] /= length;
    if (camera->eye_um > 0)
        ray.from = -length;
    return ray;
}

/* --- clips --- */

static void cut_half_space(struct gsn_ray *ray, double at, double rise)
{
    if (rise > 0)
        ray->from = fmax(ray->from, -at / rise);
    else if (rise < 0)
        ray->to = fmin(ray->to, -at / rise);
    else if (at < 0)
        ray->to = ray->from;
}

void gsn_ray_cut_box(const double low[3], const double high[3], struct gsn_ray *ray)
{
    for (int c = 0; c < 3; c++) {
        cut_half_space(ray, ray->start[c] - low[c], ray->into[c]);
        cut_half_space(ray, high[c] - ray->start[c], -ray->into[c]);
    }
}

void gsn_ray_cut(const struct gsn_ray_clip *clip, struct gsn_ray *ray)
{
    if (clip->has_box)
        gsn_ray_cut_box(clip->low, clip->high, ray);
    for (size_t p = 0; p < clip->plane_count; p++) {
        const double *plane = clip->plane[p];
        const double away[3] = { ray->start[0] - plane[0], ray->start[1] - plane[1],
                                 ray->start[2] - plane[2] };

        cut_half_space(ray, -gsn_dot3(away, plane + 3), -gsn_dot3(ray->into, plane + 3));
    }
}

void gsn_ray_spans_done(struct gsn_ray_spans *spans)
{
    gsn_free(spans->span);
}

static double border_at(const struct gsn_ray_clip *clip, const struct gsn_ray *ray, double t)
{
    const double u[3] = { ray->start[0] + t * ray->into[0], ray->start[1] + t * ray->into[1],
                          ray->start[2] + t * ray->into[2] };

    return gsn_border_at(clip->border, u, NULL);
}

int gsn_ray_add_span(struct gsn_ray_spans *spans, double from, double to, struct gsn_error *err)
{
    if (spans->count == spans->room) {
        const size_t room = 2 * spans->room + 64;
        double(*span)[2] = gsn_realloc_array(spans->span, room, sizeof *span);

        if (!span)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu stretches of rays", room);
        spans->span = span;
        spans->room = room;
    }
    spans->span[spans->count][0] = from;
    spans->span[spans->count++][1] = to;
    return GSN_OK;
}

/* The distance from the border is no more than twice as steep between voxels as it is in space, so
 * that half of it is a step that passes over no border; near one it is looked at every half voxel,
 * and found to a millionth of that. */
int gsn_ray_find_spans(const struct gsn_ray_clip *clip, const struct gsn_ray *ray, double from,
                       double to, struct gsn_ray_spans *spans, struct gsn_error *err)
{
    const double step = 0.5 * clip->border_step_um;
    double entry = from;
    int was_in = 0, r = GSN_OK;

    for (double t = from, low = from; r >= 0;) {
        const double distance = border_at(clip, ray, t);
        const int is_in = distance > 0;
        double high = t;

        while (is_in != was_in && high - low > 1e-6 * step) {
            const double middle = (low + high) / 2;

            if ((border_at(clip, ray, middle) > 0) == was_in)
                low = middle;
            else
                high = middle;
        }
        if (is_in && !was_in)
            entry = high;
        else if (!is_in && was_in)
            r = gsn_ray_add_span(spans, entry, high, err);
        was_in = is_in;
        if (!(t < to))
            break;
        low = t;
        t = fmin(to, t + fmax(step, fabs(distance) / 2));
    }
    if (r >= 0 && was_in)
        r = gsn_ray_add_span(spans, entry, to, err);
    return r;
}

/* --- what can be drawn --- */

static int check_clip(const struct gsn_ray_clip *clip, struct gsn_error *err)
{
    for (int c = 0; clip->has_box && c < 3; c++) {
        if (!(clip->low[c] < clip->high[c]))
            return gsn_fail(err, GSN_E_INPUT, "the box to draw is empty along %c", "xyz"[c]);
    }
    for (size_t p = 0; p < clip->plane_count; p++) {
        const double *normal = clip->plane[p] + 3;

        if (!(gsn_dot3(normal, normal) > 0) || !isfinite(gsn_dot3(normal, normal)))
            return gsn_fail(err, GSN_E_INPUT, "plane %zu to cut at has no normal", p + 1);
    }
    return GSN_OK;
}

int gsn_ray_check(const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                  int with_window, int with_light, struct gsn_error *err)
{
    if (style->across < 1 || style->across > 4)
        return gsn_fail(err, GSN_E_INPUT, "%u rays a pixel's side cannot be, 1 to 4 can",
                        style->across);
    if (with_window && !(style->low < style->high && isfinite(style->high - style->low)))
        return gsn_fail(err, GSN_E_INPUT, "the window from %g to %g has no width", style->low,
                        style->high);
    if (with_light && !(style->opaque_um > 0))
        return gsn_fail(err, GSN_E_INPUT, "an opacity over %g um cannot be", style->opaque_um);
    if (with_light && !(style->shading >= 0 && style->shading <= 1))
        return gsn_fail(err, GSN_E_INPUT, "a shading of %g is not between 0 and 1",
                        style->shading);
    return clip ? check_clip(clip, err) : GSN_OK;
}

int gsn_ray_camera(const struct gsn_camera *camera, const struct gsn_ray_style *style,
                   struct gsn_camera *ret_camera, struct gsn_error *err)
{
    struct gsn_camera fine = *camera;

    fine.width *= style->across;
    fine.height *= style->across;
    fine.px_per_um *= style->across;
    if (fine.width > 16384 || fine.height > 16384)
        return gsn_fail(err, GSN_E_INPUT, "%u x %u rays are too many", fine.width, fine.height);
    *ret_camera = fine;
    return GSN_OK;
}

/* --- which pixels something may touch --- */

/* A point behind the eye, or nearly so, may have its neighbours anywhere in the picture. */
void gsn_ray_reach_point(const struct gsn_camera *camera, const double point[3], double low[2],
                         double high[2])
{
    double pixel[2], depth;

    gsn_camera_project(camera, point, pixel, &depth);
    for (int c = 0; c < 2; c++) {
        if (camera->eye_um > 0 && depth < -0.9 * camera->eye_um) {
            low[c] = -INFINITY;
            high[c] = INFINITY;
            continue;
        }
        low[c] = fmin(low[c], pixel[c]);
        high[c] = fmax(high[c], pixel[c]);
    }
}

struct gsn_ray_reach gsn_ray_reach_of(const struct gsn_camera *camera, const double low[2],
                                      const double high[2])
{
    const uint32_t size[2] = { camera->width, camera->height };
    struct gsn_ray_reach reach;

    /* Centres at +0.5; a thousandth of a pixel more than the nudge of the rays. */
    for (int c = 0; c < 2; c++) {
        reach.low[c] = (int16_t)fmax(0, fmin(32767, ceil(low[c] - 0.501)));
        reach.high[c] = (int16_t)fmax(-1, fmin(size[c] - 1.0, floor(high[c] - 0.499)));
    }
    return reach;
}

void gsn_ray_bins_done(struct gsn_ray_bins *bins)
{
    gsn_free(bins->start);
    gsn_free(bins->item);
}

/* Counts the items of tiles, or with fill writes them down. */
static void visit_tiles(const struct gsn_ray_reach *reach, const uint32_t *order, size_t items,
                        unsigned tile, struct gsn_ray_bins *bins, int fill)
{
    for (size_t i = 0; i < items; i++) {
        const uint32_t item = order ? order[i] : (uint32_t)i;
        const struct gsn_ray_reach *at = &reach[item];

        if (at->low[0] > at->high[0] || at->low[1] > at->high[1])
            continue;
        for (size_t y = (unsigned)at->low[1] / tile; y <= (unsigned)at->high[1] / tile; y++) {
            for (size_t x = (unsigned)at->low[0] / tile; x <= (unsigned)at->high[0] / tile; x++) {
                size_t *start = &bins->start[y * bins->across + x];

                if (fill)
                    bins->item[start[1]] = item;
                start[fill ? 1 : 2]++;
            }
        }
    }
}

int gsn_ray_bin(const struct gsn_ray_reach *reach, const uint32_t *order, size_t items,
                const struct gsn_camera *camera, unsigned tile, struct gsn_ray_bins *bins,
                struct gsn_error *err)
{
    size_t tiles;

    bins->across = (camera->width + tile - 1) / tile;
    bins->down = (camera->height + tile - 1) / tile;
    tiles = bins->across * bins->down;
    /* Counted two places on, filled one place on: start[i] is where tile i begins. */
    bins->start = gsn_alloc_array(tiles + 2, sizeof *bins->start);
    if (!bins->start)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the %zu tiles of a picture", tiles);
    visit_tiles(reach, order, items, tile, bins, 0);
    for (size_t i = 2; i < tiles + 2; i++)
        bins->start[i] += bins->start[i - 1];
    bins->item = gsn_alloc_array(bins->start[tiles + 1], sizeof *bins->item);
    if (!bins->item)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the %zu tiles of a picture", tiles);
    visit_tiles(reach, order, items, tile, bins, 1);
    return GSN_OK;
}

/* --- colours --- */

void gsn_ray_colours_init(enum gsn_colour_map map, struct gsn_ray_colours *ret_colours)
{
    ret_colours->steepest = 0;
    for (size_t i = 0; i < GSN_RAY_COLOURS; i++) {
        const struct gsn_colour colour = gsn_colour_of(map, (double)i / (GSN_RAY_COLOURS - 1));

        ret_colours->at[i][0] = colour.r / 255.0;
        ret_colours->at[i][1] = colour.g / 255.0;
        ret_colours->at[i][2] = colour.b / 255.0;
    }
    for (size_t i = 1; i < GSN_RAY_COLOURS; i++) {
        for (int c = 0; c < 3; c++)
            ret_colours->steepest = fmax(ret_colours->steepest,
                                         (GSN_RAY_COLOURS - 1) * fabs(ret_colours->at[i][c] -
                                                                      ret_colours->at[i - 1][c]));
    }
}

void gsn_ray_colour_at(const struct gsn_ray_colours *colours, double share, double ret[3])
{
    const double place = fmin(1, fmax(0, share)) * (GSN_RAY_COLOURS - 1);
    const size_t below = (size_t)fmin(GSN_RAY_COLOURS - 2, place);

    for (int c = 0; c < 3; c++)
        ret[c] = colours->at[below][c] +
                 (place - (double)below) * (colours->at[below + 1][c] - colours->at[below][c]);
}

double gsn_ray_blur(const struct gsn_camera *camera, const struct gsn_ray_style *style)
{
    return 4 * (style->high - style->low) * camera->px_per_um /
           fmax(camera->width, camera->height);
}

/* --- several rays a pixel --- */

int gsn_ray_mean_values(const float *value, unsigned across, uint32_t width, uint32_t height,
                        struct gsn_plane **ret_plane, struct gsn_error *err)
{
    gsn_auto(gsn_plane) plane = NULL;
    const int r = gsn_plane_new(width, height, &plane, err);

    if (r < 0)
        return r;
    for (size_t y = 0; y < height; y++) {
        for (size_t x = 0; x < width; x++) {
            double sum = 0;
            int met = 0;

            for (size_t i = 0; i < (size_t)across * across; i++) {
                const double one = (double)value[((y * across + i / across) * width + x) * across +
                                                 i % across];

                met |= !isnan(one);
                sum += isnan(one) ? 0 : one;
            }
            plane->value[y * width + x] = met ? (float)(sum / (across * across)) : NAN;
        }
    }
    *ret_plane = gsn_steal(&plane);
    return GSN_OK;
}

int gsn_ray_mean_light(const float (*rgba)[4], unsigned across, uint32_t width, uint32_t height,
                       struct gsn_ray_picture **ret_picture, struct gsn_error *err)
{
    gsn_auto(gsn_ray_picture) picture = gsn_alloc_array(1, sizeof *picture);

    if (picture)
        picture->rgba = gsn_alloc_array((size_t)width * height, sizeof *picture->rgba);
    if (!picture || !picture->rgba)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a picture of %u x %u pixels", width,
                        height);
    picture->width = width;
    picture->height = height;
    for (size_t y = 0; y < height * (size_t)across; y++) {
        for (size_t x = 0; x < width * (size_t)across; x++) {
            float *to = picture->rgba[y / across * width + x / across];

            for (int c = 0; c < 4; c++)
                to[c] += rgba[y * width * across + x][c] / (float)(across * across);
        }
    }
    *ret_picture = gsn_steal(&picture);
    return GSN_OK;
}
