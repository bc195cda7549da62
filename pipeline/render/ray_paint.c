/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The sheets that pictures by rays are mounted on: title, note, colour scale, scale bar, and the axes
 * of the block as the camera sees them.
 *
 * Failure: GSN_E_NOMEM; GSN_E_NOTFOUND without the fonts (lettering.h). Cost: linear in the pixels. */
#include "pipeline/render/ray_cast.h"

#include "pipeline/render/lettering.h"

#include <math.h>

/* Into the lower left corner of the picture, which is at (x, y); an axis that points at the eye is a
 * dot. */
static int paint_axes(struct gsn_image *sheet, int x, int y, const struct gsn_camera *camera,
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

int gsn_xray_paint(const struct gsn_plane *plane, const struct gsn_camera *camera,
                   const char *title, const char *unit, enum gsn_colour_map map,
                   struct gsn_image **ret_image, struct gsn_error *err)
{
    gsn_auto(gsn_image) sheet = NULL;
    struct gsn_plate plate = { .title = title,
                               .note = "integral along the line of view",
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
    r = paint_axes(sheet, x, y + (int)plane->height, camera, err);
    if (r < 0)
        return r;
    *ret_image = gsn_steal(&sheet);
    return GSN_OK;
}

int gsn_ray_paint(const struct gsn_ray_picture *picture, const struct gsn_camera *camera,
                  const struct gsn_ray_style *style, const char *title, const char *note,
                  struct gsn_image **ret_image, struct gsn_error *err)
{
    const struct gsn_plate plate = { .title = title,
                                     .note = note,
                                     .um_per_px = 1 / camera->px_per_um,
                                     .has_scale = 1,
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

            for (int c = 0; c < 3; c++)
                rgb[c] = (uint8_t)fminf(255, 255 * (p[c] + 1 - p[3]) + 0.5F);
            gsn_canvas_put(sheet, x + (int)i, y + (int)j,
                           (struct gsn_colour){ rgb[0], rgb[1], rgb[2] });
        }
    }
    r = paint_axes(sheet, x, y + (int)picture->height, camera, err);
    if (r < 0)
        return r;
    *ret_image = gsn_steal(&sheet);
    return GSN_OK;
}
