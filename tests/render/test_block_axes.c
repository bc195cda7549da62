/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/block_axes.h"

#include <math.h>
#include <stdlib.h>

#include "tests/check.h"

/* Of the cube, as the header and the .c have them: its middle from the corner, half a side. */
static const double CORNER_PX = 44, HALF_PX = 15;

static const struct gsn_block_box_um box = { { 0, -200, 100 }, { 1000, 600, 500 } };
static const struct gsn_colour grey = { 128, 128, 128 };

static struct gsn_camera look(const double direction[3], const double up[3], double eye,
                              uint32_t size)
{
    double corner[8][3];
    const struct gsn_tets scene = { .vertex_count = 8, .vertex = corner };
    const struct gsn_view view = { .direction = { direction[0], direction[1], direction[2] },
                                   .up = { up[0], up[1], up[2] },
                                   .eye_distance = eye,
                                   .width = size,
                                   .height = size };
    struct gsn_camera camera;
    struct gsn_error err = { 0 };

    for (int i = 0; i < 8; i++)
        for (int c = 0; c < 3; c++)
            corner[i][c] = (i >> c & 1 ? box.high : box.low)[c];
    CHECK_OK(gsn_camera_frame(&view, &scene, &camera, &err), err);
    camera.px_per_um *= 0.84;
    return camera;
}

static struct gsn_image *painted(const struct gsn_camera *camera,
                                 const struct gsn_block_box_um *axes)
{
    struct gsn_image *sheet = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_canvas_new(camera->width + 20, camera->height + 30, grey, &sheet, &err), err);
    CHECK_OK(gsn_block_axes_paint(sheet, 10, 15, camera, axes, &err), err);
    return sheet;
}

/* Directions from all sides, none along an axis. */
static struct gsn_camera any_side(int i, double eye)
{
    const double theta = 0.25 + 0.066 * i, phi = 0.7 * i;
    const double direction[3] = { sin(theta) * cos(phi), sin(theta) * sin(phi), cos(theta) };

    return look(direction, (const double[]){ 0.1, 0.2, -1 }, eye, 400);
}

/* Nothing of the box is beyond an axis, so no number lies on what is shown. */
TEST(the_axes_lie_on_the_outline_of_what_is_shown)
{
    size_t found = 0;

    for (int i = 0; i < 80; i++) {
        const struct gsn_camera camera = any_side(i % 40, i < 40 ? 0 : 3);

        for (int axis = 0; axis < 3; axis++) {
            double from[3], to[3], a[2], b[2], p[2], depth, most = 0, least = 0;

            if (!gsn_block_axes_edge(&camera, &box, axis, from, to)) {
                /* An eye that sees no face along the axis. */
                CHECK(camera.eye_um > 0);
                continue;
            }
            found++;
            CHECK_NEAR(from[axis], box.low[axis], 1e-12);
            CHECK_NEAR(to[axis], box.high[axis], 1e-12);
            gsn_camera_project(&camera, from, a, &depth);
            gsn_camera_project(&camera, to, b, &depth);
            for (int k = 0; k < 8; k++) {
                double corner[3], off;

                for (int c = 0; c < 3; c++)
                    corner[c] = (k >> c & 1 ? box.high : box.low)[c];
                gsn_camera_project(&camera, corner, p, &depth);
                off = ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])) /
                      hypot(b[0] - a[0], b[1] - a[1]);
                most = fmax(most, off);
                least = fmin(least, off);
            }
            CHECK(fmin(most, -least) < 1e-6);
        }
    }
    CHECK(found > 200);
}

TEST(an_axis_that_points_at_the_eye_is_none)
{
    const struct gsn_camera camera =
        look((const double[]){ 0, 0, 1 }, (const double[]){ 0, -1, 0 }, 0, 400);
    double from[3], to[3];

    CHECK(!gsn_block_axes_edge(&camera, &box, 2, from, to));
    CHECK(gsn_block_axes_edge(&camera, &box, 0, from, to) && from[1] == box.high[1]); /* below */
    CHECK(gsn_block_axes_edge(&camera, &box, 1, from, to) && from[0] == box.low[0]);  /* left */
}

static int is_like(const struct gsn_image *image, double x, double y, struct gsn_colour colour,
                   int within)
{
    const uint32_t u = (uint32_t)floor(x), v = (uint32_t)floor(y);

    return abs((int)gsn_image_at(image, u, v, 0) - colour.r) <= within &&
           abs((int)gsn_image_at(image, u, v, 1) - colour.g) <= within &&
           abs((int)gsn_image_at(image, u, v, 2) - colour.b) <= within;
}

/* Seen along z the scale is that of the camera: 1000 um are 0.88 x 0.84 of 700 pixels. */
TEST(ticks_stand_at_round_places_of_the_block)
{
    const struct gsn_camera camera =
        look((const double[]){ 0, 0, 1 }, (const double[]){ 0, -1, 0 }, 0, 700);
    gsn_auto(gsn_image) sheet = painted(&camera, &box);
    const double px_per_um = 0.88 * 0.84 * 700 / 1000;

    for (int um = 0; um <= 1000; um += 50) {
        const double x = 10 + 350 + (um - 500) * px_per_um, y = 15 + 350 + 400 * px_per_um;
        const int tick = !is_like(sheet, x, y + 3, grey, 12);

        CHECK(!is_like(sheet, x, y, grey, 12) ||
              !is_like(sheet, x, y - 1, grey, 12)); /* the axis */
        CHECK(tick == (um % 100 == 0));             /* numbers need 48 pixels: 93 um */
    }
}

TEST(the_faces_of_the_cube_that_look_at_the_eye_are_lit_by_how_much)
{
    for (int i = 0; i < 40; i++) {
        const struct gsn_camera camera = any_side(i, 0);
        gsn_auto(gsn_image) sheet = painted(&camera, NULL);
        const double x = 10 + 400 - CORNER_PX, y = 15 + CORNER_PX;

        for (int a = 0; a < 3; a++) {
            const double side = camera.into[a] > 0 ? -1 : 1, away = HALF_PX * side;
            const uint8_t light = (uint8_t)(188 + 54 * fabs(camera.into[a]));

            const int b = (a + 1) % 3, c = (a + 2) % 3;
            int lit = 0;

            for (int k = 0; k < 9; k++) {
                const double u = 0.5 * HALF_PX * (k % 3 - 1), v = 0.5 * HALF_PX * (k / 3 - 1.);

                lit += is_like(
                    sheet, x + away * camera.right[a] + u * camera.right[b] + v * camera.right[c],
                    y + away * camera.down[a] + u * camera.down[b] + v * camera.down[c],
                    (struct gsn_colour){ light, light, light }, 2);
            }
            /* Wide enough to be seen; an axis or its letter may be before some of it. */
            CHECK(fabs(camera.into[a]) < 0.4 || lit >= 5);
        }
    }
}

/* Where an axis leaves the cube towards the eye its ink is on top; one that leaves away from the
 * eye is hidden where the cube is before it. */
TEST(the_axes_of_the_cube_point_as_those_of_the_block)
{
    static const struct gsn_colour ink[3] = { { 176, 60, 40 }, { 30, 120, 80 }, { 40, 70, 170 } };

    for (int i = 0; i < 40; i++) {
        const struct gsn_camera camera = any_side(i, 0);
        gsn_auto(gsn_image) sheet = painted(&camera, NULL);

        for (int a = 0; a < 3; a++) {
            const double far = 1 + 5 / HALF_PX;
            double x = 10 + 400 - CORNER_PX, y = 15 + CORNER_PX;

            for (int c = 0; c < 3; c++) {
                x += HALF_PX * (c == a ? far : -1) * camera.right[c];
                y += HALF_PX * (c == a ? far : -1) * camera.down[c];
            }
            if (camera.into[a] < -0.05 && hypot(camera.right[a], camera.down[a]) > 0.5)
                CHECK(is_like(sheet, x, y, ink[a], 90));
        }
    }
}

TEST(a_small_picture_has_the_cube_and_no_numbers)
{
    const struct gsn_camera camera =
        look((const double[]){ 0.4, 0.6, 0.6 }, (const double[]){ 0, 0, -1 }, 0, 200);
    gsn_auto(gsn_image) with = painted(&camera, &box);
    gsn_auto(gsn_image) without = painted(&camera, NULL);

    assert_memory_equal(with->samples, without->samples, gsn_image_bytes(with));
    CHECK(
        !is_like(with, 10 + 200 - CORNER_PX / 2, 15 + CORNER_PX / 2, grey, 20)); /* half as large */
}

static int once(const struct gsn_camera *camera, struct gsn_error *err)
{
    gsn_auto(gsn_image) sheet = NULL;
    const int r = gsn_canvas_new(camera->width, camera->height, grey, &sheet, err);

    return r < 0 ? r : gsn_block_axes_paint(sheet, 0, 0, camera, &box, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct gsn_camera camera =
        look((const double[]){ 0.4, 0.6, 0.6 }, (const double[]){ 0, 0, -1 }, 0, 240);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(once(&camera, &err), err);
}
