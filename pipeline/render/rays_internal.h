/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What ray casting and the projection of tetrahedra share: the rays of a picture, what a clip
 * leaves of them, the colours of a window, and several rays a pixel made one. */
#ifndef GSN_RENDER_RAYS_INTERNAL_H
#define GSN_RENDER_RAYS_INTERNAL_H

#include "pipeline/render/ray_cast.h"

/* What is behind a ray that has this little left is not looked at; the tolerance of a part. */
#define GSN_RAY_PART_TOLERANCE (GSN_RAY_TOLERANCE / 3)

enum { GSN_RAY_COLOURS = 17 };

struct gsn_ray {
    double start[3], into[3], from, to; /* |into| = 1 */
};

/* The ray of a pixel; its start lies in the plane of the picture. Moved by 1e-9 px, so that none
 * runs in a face that pixels line up with. */
struct gsn_ray gsn_ray_of(const struct gsn_camera *camera, uint32_t x, uint32_t y);
/* Shortens it to what box and planes leave. */
void gsn_ray_cut(const struct gsn_ray_clip *clip, struct gsn_ray *ray);
/* The same by low <= u <= high. */
void gsn_ray_cut_box(const double low[3], const double high[3], struct gsn_ray *ray);

/* Stretches of rays, one after the other; as many as there are. */
struct gsn_ray_spans {
    double (*span)[2];
    size_t count, room;
};
void gsn_ray_spans_done(struct gsn_ray_spans *spans);

/* Appends one. Fails with GSN_E_NOMEM. */
int gsn_ray_add_span(struct gsn_ray_spans *spans, double from, double to, struct gsn_error *err);

/* Appends where the ray is in the region between from and to. Fails with GSN_E_NOMEM. */
int gsn_ray_find_spans(const struct gsn_ray_clip *clip, const struct gsn_ray *ray, double from,
                       double to, struct gsn_ray_spans *spans, struct gsn_error *err);

/* Fails with GSN_E_INPUT on what cannot be drawn. clip may be NULL; with_window, with_light: what
 * the style says of a window, and of light, counts too. */
int gsn_ray_check(const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                  int with_window, int with_light, struct gsn_error *err);
/* The camera with a pixel a ray. Fails with GSN_E_INPUT on too many. */
int gsn_ray_camera(const struct gsn_camera *camera, const struct gsn_ray_style *style,
                   struct gsn_camera *ret_camera, struct gsn_error *err);

/* Pixels from low to high, inclusive; nothing when low > high. */
struct gsn_ray_reach {
    int16_t low[2], high[2];
};
/* Widens low..high, in pixels, by the point. */
void gsn_ray_reach_point(const struct gsn_camera *camera, const double point[3], double low[2],
                         double high[2]);
struct gsn_ray_reach gsn_ray_reach_of(const struct gsn_camera *camera, const double low[2],
                                      const double high[2]);

/* Which items the tiles of a picture have: those of tile i at item[start[i]..start[i + 1]), in the
 * order they were given in. */
struct gsn_ray_bins {
    size_t across, down, *start;
    uint32_t *item;
};
void gsn_ray_bins_done(struct gsn_ray_bins *bins);
/* gives: the bins of tiles this many pixels wide. order: which item comes when; NULL: as they are.
 * Fails with GSN_E_NOMEM; what is there then is for gsn_ray_bins_done(). */
int gsn_ray_bin(const struct gsn_ray_reach *reach, const uint32_t *order, size_t items,
                const struct gsn_camera *camera, unsigned tile, struct gsn_ray_bins *bins,
                struct gsn_error *err);

/* The colours of a map, 0..1, and the most that a channel changes by a unit of share. */
struct gsn_ray_colours {
    double at[GSN_RAY_COLOURS][3], steepest;
};
void gsn_ray_colours_init(enum gsn_colour_map map, struct gsn_ray_colours *ret_colours);
void gsn_ray_colour_at(const struct gsn_ray_colours *colours, double share, double ret[3]);

/* A gradient of this size is half shaded: four windows over the picture. */
double gsn_ray_blur(const struct gsn_camera *camera, const struct gsn_ray_style *style);

/* gives: the mean over the rays of each pixel; a value is NaN where all are. */
int gsn_ray_mean_values(const float *value, unsigned across, uint32_t width, uint32_t height,
                        struct gsn_plane **ret_plane, struct gsn_error *err);
int gsn_ray_mean_light(const float (*rgba)[4], unsigned across, uint32_t width, uint32_t height,
                       struct gsn_ray_picture **ret_picture, struct gsn_error *err);

#endif
