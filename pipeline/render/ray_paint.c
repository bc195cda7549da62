/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The sheets that pictures by rays are mounted on: title, note, colour scale, scale bar, and which
 * way the block lies (block_axes.h).
 *
 * Failure: GSN_E_NOMEM; GSN_E_NOTFOUND without the fonts (lettering.h). Cost: linear in the
 * pixels. */
#include "pipeline/core/srgb.h"
#include "pipeline/render/lettering.h"
#include "pipeline/render/ray_cast.h"

#include <math.h>

int gsn_xray_paint(const struct gsn_plane *plane, const struct gsn_camera *camera,
                   const struct gsn_block_box_um *box, const double range[2], const char *title,
                   const char *unit, enum gsn_colour_map map, struct gsn_image **ret_image,
                   struct gsn_error *err)
{
    gsn_auto(gsn_image) sheet = NULL;
    struct gsn_plate plate = { .title = title,
                               .note = box ? "integral along the view; axes in \xc2\xb5m"
                                           : "integral along the view",
                               .low = range ? range[0] : 0,
                               .high = range ? range[1] : 0,
                               .um_per_px = 1.0 / camera->px_per_um,
                               .has_scale = 1,
                               .unit = unit ? unit : "density \xc3\x97 \xc2\xb5m",
                               .map = map };
    int r, x, y;

    gsn_plate_range(plane, &plate.low, &plate.high);
    plate.low = fmin(0.0, plate.low);
    r = gsn_plate_new(&plate, plane->width, plane->height, &sheet, &x, &y, err);
    if (r < 0)
        return r;
    gsn_plate_fill(sheet, x, y, plane, map, plate.low, plate.high);
    r = gsn_block_axes_paint(sheet, x, y, camera, box, err);
    if (r < 0)
        return r;
    *ret_image = gsn_steal(&sheet);
    return GSN_OK;
}

int gsn_ray_paint(const struct gsn_ray_picture *picture, const struct gsn_camera *camera,
                  const struct gsn_ray_style *style, const struct gsn_block_box_um *box,
                  const char *title, const char *note, struct gsn_image **ret_image,
                  struct gsn_error *err)
{
    const struct gsn_plate plate = { .title = title,
                                     .note = note,
                                     .um_per_px = 1 / camera->px_per_um,
                                     .has_scale = !style->colour,
                                     .unit = "density",
                                     .low = style->low,
                                     .high = style->high,
                                     .map = style->map };
    gsn_auto(gsn_image) sheet = NULL;
    int x, y, r;

    r = gsn_plate_new(&plate, picture->width, picture->height, &sheet, &x, &y, err);
    if (r < 0)
        return r;
    for (uint32_t j = 0; j < picture->height; j++) {
        for (uint32_t i = 0; i < picture->width; i++) {
            const float *p = picture->rgba[(size_t)j * picture->width + i];
            uint8_t rgb[3];

            for (int c = 0; c < 3; c++) {
                const double on_white = fmin(1, (double)p[c] + 1 - (double)p[3]);

                rgb[c] =
                    (uint8_t)(255 * (picture->is_light ? gsn_srgb_of_light(on_white) : on_white) +
                              0.5);
            }
            gsn_canvas_put(sheet, x + (int)i, y + (int)j,
                           (struct gsn_colour){ rgb[0], rgb[1], rgb[2] });
        }
    }
    r = gsn_block_axes_paint(sheet, x, y, camera, box, err);
    if (r < 0)
        return r;
    *ret_image = gsn_steal(&sheet);
    return GSN_OK;
}
