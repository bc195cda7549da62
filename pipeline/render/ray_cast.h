/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures by rays through the spline: X-ray, emission and absorption, the surface at a level;
 * orthographic or from an eye, of the whole domain or of what a region, a box and planes leave.
 *
 * Along a ray the spline is known piece by piece as a polynomial (pipeline/model/pieces.h), in the
 * order in which the ray meets them. The X-ray integral of a piece, its optical depth, where it
 * crosses the window's ends or the level are exact but for rounding. */
#ifndef GSN_RENDER_RAY_CAST_H
#define GSN_RENDER_RAY_CAST_H

#include "pipeline/core/progress.h"
#include "pipeline/model/spline.h"
#include "pipeline/render/block_axes.h"
#include "pipeline/render/canvas.h"
#include "pipeline/render/region_border.h"
#include "pipeline/render/view.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What of the domain is seen. Keeps what it points to. */
struct gsn_ray_clip {
    const struct gsn_border *border; /* of a region; NULL: all of the domain */
    double border_step_um; /* nothing of the region thinner than this along a ray is surely seen */
    int has_box;
    double low[3], high[3]; /* of the box, um */
    size_t plane_count;
    const double (*plane)[6]; /* a point and a normal: what lies on the normal's side is away */
};

enum { GSN_RAY_FILMS = 3 };

/* How density becomes opacity and colour. Extinction is 0 up to low, rises linearly to high and
 * stays; there, opaque_um of it let 1/e of the light through. */
struct gsn_ray_style {
    double low, high;
    double opaque_um;
    enum gsn_colour_map map;
    const struct gsn_spline *const *colour; /* red, green, blue as light, 0..1, on the space of the
                                               spline that is drawn; NULL: the map's colours */
    double shading; /* 0..1: how much darker is what the light from the eye grazes, by the exact
                        gradient */
    double level;   /* of gsn_ray_surface() alone, as are the films */
    unsigned films; /* surfaces at levels below it that are seen through */
    double film[GSN_RAY_FILMS], film_opacity; /* their levels; what one hides seen face on, 0..1 */
    unsigned across;                          /* rays a pixel's side, 1..4 */
};

/* Red, green, blue, each times the opacity, and the opacity; all 0..1. Codes of sRGB, or light. */
struct gsn_ray_picture {
    uint32_t width, height;
    int is_light;
    float (*rgba)[4];
};
void gsn_ray_picture_free(struct gsn_ray_picture *picture);
GSN_DEFINE_AUTO(gsn_ray_picture);

/* All give a picture, of camera's size. clip may be NULL; threads 0: all, the same bytes on any
 * number; progress may be NULL. Fail with GSN_E_INPUT on an unusable style, too many rays, a plane
 * without a normal or an empty box, GSN_E_LIMIT on more tetrahedra than can be numbered,
 * GSN_E_NOMEM. */

/* Integrals of the density along the rays, density times um; NaN where a ray meets nothing. Uses of
 * style across alone. */
int gsn_ray_xray(const struct gsn_spline *spline, const struct gsn_camera *camera,
                 const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                 unsigned threads, const struct gsn_progress *progress,
                 struct gsn_plane **ret_plane, struct gsn_error *err);

/* Light that is emitted in proportion to the extinction, in the colour of the density or in that of
 * style's colour, and absorbed on its way to the eye. With style's colour the picture is of light,
 * not of codes. Each colour of a ray is good to GSN_RAY_TOLERANCE. */
int gsn_ray_volume(const struct gsn_spline *spline, const struct gsn_camera *camera,
                   const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                   unsigned threads, const struct gsn_progress *progress,
                   struct gsn_ray_picture **ret_picture, struct gsn_error *err);
#define GSN_RAY_TOLERANCE 2e-5

/* The nearest place where s rises to the level, lit by its exact gradient. Where the ray comes in
 * at more than the level already, on a clip or the border of a region, the density there is shown
 * in the colours of the window. With style's colour the surface has that, and so has a cut. Before
 * it lie the films, in the colours of the window, wherever the ray passes their levels, up or down:
 * a thin layer that hides the more the flatter it is looked through. They end where a clip or the
 * region ends. Fails with GSN_E_INPUT where a film's level is not below the surface's. */
int gsn_ray_surface(const struct gsn_spline *spline, const struct gsn_camera *camera,
                    const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                    unsigned threads, const struct gsn_progress *progress,
                    struct gsn_ray_picture **ret_picture, struct gsn_error *err);

/* gives: the sheet: the picture with title (may be NULL), the block's cube, the axes of box (NULL:
 * none), scale bar, and a colour scale from 0, or the smallest value below, to the largest (or over
 * range, unless NULL), in "density x um" unless unit is given. Fails with GSN_E_NOMEM, and with
 * GSN_E_NOTFOUND without the fonts (lettering.h). */
int gsn_xray_paint(const struct gsn_plane *plane, const struct gsn_camera *camera,
                   const struct gsn_block_box_um *box, const double range[2], const char *title,
                   const char *unit, enum gsn_colour_map map, struct gsn_image **ret_image,
                   struct gsn_error *err);

/* gives: the sheet: the picture on white, title, note, the block's cube, the axes of box (NULL:
 * none), scale bar, and the colour scale of the style unless it has colours of its own. Fails
 * alike. */
int gsn_ray_paint(const struct gsn_ray_picture *picture, const struct gsn_camera *camera,
                  const struct gsn_ray_style *style, const struct gsn_block_box_um *box,
                  const char *title, const char *note, struct gsn_image **ret_image,
                  struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
