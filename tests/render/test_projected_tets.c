/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/projected_tets.h"

#include <string.h>

#include "tests/render/box_scene.h"

/* Floats: of the longest way through the box, 1616 um, times a density of at most 1. */
#define ROUNDING 2e-3

/* The integral of a linear field over what is left of a box of the line of a pixel; NaN where
 * nothing is, and where the line comes so near to an edge that rounding decides. */
static double chord_integral(const struct gsn_camera *camera, uint32_t x, uint32_t y,
                             const struct quadric *q, const double from[3], const double to[3])
{
    double start[3], into[3], middle[3], in, out;
    const double eye = line_of(camera, x + 0.5, y + 0.5, start, into);

    if (!chord(from, to, start, into, &in, &out) || !(out > fmax(in, -eye)))
        return NAN;
    in = fmax(in, -eye);
    for (int c = 0; c < 3; c++)
        middle[c] = start[c] + (in + out) / 2 * into[c];
    return (out - in) * quadric_at(q, middle);
}

static void check_xray(const struct quadric *q, unsigned degree, const struct gsn_view *view,
                       const struct gsn_ray_clip *clip, const double from[3], const double to[3])
{
    const struct gsn_ray_style style = plain(0, 1, 1);
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    size_t hit = 0, missed = 0;

    CHECK_OK(kuhn_sharp(low, high, cells, degree, 0.05, q, &kuhn, &err), err);
    camera = frame(&kuhn, view);
    CHECK_OK(gsn_projected_xray(kuhn.spline, &camera, clip, &style, 0, NULL, &plane, &err), err);
    for (uint32_t j = 0; j < view->height; j++) {
        for (uint32_t i = 0; i < view->width; i++) {
            const double value = (double)plane->value[j * view->width + i];
            const double truth = chord_integral(&camera, i, j, q, from, to);

            CHECK_NEAR(isnan(value) ? 0 : value, isnan(truth) ? 0 : truth, ROUNDING);
            hit += isnan(truth) ? 0 : 1;
            missed += isnan(value) ? 1 : 0;
        }
    }
    CHECK(hit > view->width * view->height / 8 && missed > 0);
    kuhn_done(&kuhn);
}

TEST(the_x_ray_of_a_linear_field_is_that_of_its_chords)
{
    const struct gsn_view view = oblique(83, 71);

    for (unsigned degree = 1; degree <= 3; degree++)
        check_xray(&linear, degree, &view, NULL, low, high);
}

TEST(seen_from_an_eye_it_is_that_of_the_chords_too)
{
    struct gsn_view view = oblique(83, 71);

    view.eye_distance = 1.5;
    check_xray(&linear, 1, &view, NULL, low, high);
}

/* Of density 1 the X-ray is the way through the box. A pixel that two cells count, or none, is off
 * by what the ray has in one. Along the axes and the diagonals of the cubes faces are edge on, and
 * pixels line up with them. */
TEST(cells_leave_no_pixel_out_and_count_none_twice)
{
    static const double direction[6][3] = { { 0, 0, 1 }, { 1, 0, 0 }, { 0, 1, 0 },
                                            { 1, 1, 0 }, { 3, 3, 2 }, { 1, 1e-7, 1e-9 } };

    for (size_t d = 0; d < 6; d++) {
        for (int eye = 0; eye < 2; eye++) {
            struct gsn_view view = { .up = { 0.1, 0.2, -1 }, .width = 97, .height = 81 };

            memcpy(view.direction, direction[d], sizeof view.direction);
            if (d == 0)
                memcpy(view.up, (const double[3]){ 0, -1, 0 }, sizeof view.up);
            view.eye_distance = eye ? 4 : 0;
            check_xray(&one, 1, &view, NULL, low, high);
        }
    }
}

/* Six tetrahedra a thousandth of a micrometre thick, seen along their plane: the middle row looks
 * through them lengthwise. */
TEST(a_flat_tetrahedron_seen_edge_on_is_as_long_as_it_is)
{
    const double thin_low[3] = { 0, 0, -5e-4 }, thin_high[3] = { 1200, 900, 5e-4 };
    const struct gsn_view view = {
        .direction = { 0, 1, 0 }, .up = { 0, 0, -1 }, .width = 61, .height = 11
    };
    const struct gsn_ray_style style = plain(0, 1, 1);
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(
        kuhn_sharp(thin_low, thin_high, (const unsigned[3]){ 1, 1, 1 }, 1, 0.05, &one, &kuhn, &err),
        err);
    camera = frame(&kuhn, &view);
    CHECK_OK(gsn_projected_xray(kuhn.spline, &camera, NULL, &style, 1, NULL, &plane, &err), err);
    for (uint32_t j = 0; j < 11; j++) {
        CHECK(j == 5 ? fabs((double)plane->value[j * 61 + 30] - 900) < ROUNDING
                     : isnan(plane->value[j * 61 + 30]));
    }
    kuhn_done(&kuhn);
}

TEST(a_box_and_planes_cut_exactly_where_they_are)
{
    struct gsn_view view = oblique(40, 31);
    const double plane[2][6] = { { 700, 0, 0, 2, 0, 0 }, { 0, 250, 0, 0, -1, 0 } };
    const double left_low[3] = { 100, 250, 50 }, left_high[3] = { 700, 900, 480 };
    const struct gsn_ray_clip clip = { .has_box = 1,
                                       .low = { 100, -1e9, 50 },
                                       .high = { 5000, 2000, 480 },
                                       .plane_count = 2,
                                       .plane = plane };

    check_xray(&linear, 1, &view, &clip, left_low, left_high);
    view.eye_distance = 3;
    check_xray(&linear, 2, &view, &clip, left_low, left_high);
}

/* The camera frames a small box, and the eye stands in the mesh: cells reach behind it, and one
 * holds it. */
TEST(an_eye_inside_the_mesh_sees_what_is_before_it)
{
    static const double direction[6][3] = { { 0.31, 0.42, 0.85 }, { -0.31, -0.42, -0.85 },
                                            { -0.7, 0.5, 0.2 },   { 0.1, -0.9, 0.3 },
                                            { 0.8, 0.3, -0.5 },   { -0.2, 0.6, -0.7 } };
    const double from[3] = { 560, 410, 270 }, to[3] = { 640, 490, 330 };
    const struct gsn_ray_clip box_clip = { .has_box = 1,
                                           .low = { from[0], from[1], from[2] },
                                           .high = { to[0], to[1], to[2] } };
    const struct gsn_ray_style style = plain(0, 1, 1);
    double corner[8][3];
    const struct gsn_tets box = { .vertex_count = 8, .vertex = corner };
    struct gsn_view view = oblique(31, 31);
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    for (int i = 0; i < 24; i++)
        corner[i / 3][i % 3] = i / 3 >> i % 3 & 1 ? to[i % 3] : from[i % 3];
    view.eye_distance = 2;
    CHECK_OK(kuhn_sharp(low, high, cells, 1, 0.05, &linear, &kuhn, &err), err);
    for (int look = 0; look < 12; look++) {
        const int clipped = look % 2;
        gsn_auto(gsn_plane) plane = NULL;
        struct gsn_camera camera;
        size_t hit = 0;

        memcpy(view.direction, direction[look / 2], sizeof view.direction);
        CHECK_OK(gsn_camera_frame(&view, &box, &camera, &err), err);
        camera.px_per_um /= clipped ? 1 : 6; /* a wide angle */
        CHECK_OK(gsn_projected_xray(kuhn.spline, &camera, clipped ? &box_clip : NULL, &style, 0,
                                    NULL, &plane, &err),
                 err);
        for (uint32_t j = 0; j < view.height; j++) {
            for (uint32_t i = 0; i < view.width; i++) {
                const double value = (double)plane->value[j * view.width + i];
                const double truth = chord_integral(&camera, i, j, &linear, clipped ? from : low,
                                                    clipped ? to : high);

                CHECK_NEAR(isnan(value) ? 0 : value, isnan(truth) ? 0 : truth, ROUNDING);
                hit += isnan(truth) ? 0 : 1;
            }
        }
        CHECK(hit > 100);
    }
    kuhn_done(&kuhn);
}

/* The region of the test of the same name of rays: 70 slabs, 70 stretches a ray, which rays find.
 */
TEST(a_region_is_cut_out_of_cells_as_it_is_of_rays)
{
    enum { SLABS = 70, ACROSS = 12 };
    const double corner[3] = { 500, 350, 20 };
    struct gsn_mask *mask = full_mask(corner, 2, ACROSS, ACROSS, 4 * SLABS);
    struct gsn_view view = oblique(200, 200);
    const struct gsn_ray_style style = plain(0, 1, 1);
    gsn_auto(gsn_border) border = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    for (size_t i = 0; i < (size_t)ACROSS * ACROSS * 4 * SLABS; i++)
        mask->inside[i] = i / (ACROSS * ACROSS) % 4 < 2;
    CHECK_OK(gsn_border_new(mask, 0, &border, &err), err);
    CHECK_OK(kuhn_sharp(low, high, cells, 1, 0.05, &linear, &kuhn, &err), err);
    view.direction[0] = view.direction[1] = 0.01;
    for (int eye = 0; eye < 2; eye++) {
        const struct gsn_ray_clip clip = { .border = border, .border_step_um = 2 };
        gsn_auto(gsn_plane) plane = NULL;
        gsn_auto(gsn_plane) rays = NULL;
        struct gsn_camera camera;
        size_t hit = 0;

        view.eye_distance = eye ? 3 : 0;
        camera = frame(&kuhn, &view);
        CHECK_OK(gsn_projected_xray(kuhn.spline, &camera, &clip, &style, 0, NULL, &plane, &err),
                 err);
        CHECK_OK(gsn_ray_xray(kuhn.spline, &camera, &clip, &style, 0, NULL, &rays, &err), err);
        for (size_t i = 0; i < (size_t)view.width * view.height; i++) {
            const double value = (double)plane->value[i], truth = (double)rays->value[i];

            CHECK_NEAR(isnan(value) ? 0 : value, isnan(truth) ? 0 : truth, ROUNDING);
            hit += truth > 50;
        }
        CHECK(hit > 3);
    }
    gsn_mask_free(mask);
    kuhn_done(&kuhn);
}

/* 1 - exp(-depth), also where the window's ends are crossed inside cells. */
TEST(opacity_of_a_linear_field_is_exact_and_colours_are_near)
{
    static const unsigned fine[3] = { 8, 6, 6 };
    struct gsn_view view = oblique(61, 53);
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_sharp(low, high, fine, 1, 0.05, &linear, &kuhn, &err), err);
    for (int eye = 0; eye < 2; eye++) {
        struct gsn_ray_style style = plain(0.1, 0.3, 200);
        struct gsn_camera camera;

        view.eye_distance = eye ? 3 : 0;
        camera = frame(&kuhn, &view);
        for (int shaded = 0; shaded < 2; shaded++) {
            gsn_auto(gsn_ray_picture) picture = NULL;
            gsn_auto(gsn_ray_picture) rays = NULL;
            double square = 0, met = 0;

            style.shading = shaded ? 0.6 : 0;
            CHECK_OK(
                gsn_projected_volume(kuhn.spline, &camera, NULL, &style, 0, NULL, &picture, &err),
                err);
            CHECK_OK(gsn_ray_volume(kuhn.spline, &camera, NULL, &style, 0, NULL, &rays, &err), err);
            for (size_t i = 0; i < (size_t)view.width * view.height; i++) {
                CHECK_NEAR((double)picture->rgba[i][3], (double)rays->rgba[i][3], 1e-5);
                for (int c = 0; c < 3; c++) {
                    const double off = (double)picture->rgba[i][c] - (double)rays->rgba[i][c];

                    square += off * off;
                    CHECK_NEAR(off, 0, 4.0 / 255);
                }
                met += rays->rgba[i][3] > 0.5F;
            }
            CHECK(met > 500 && sqrt(square / 3 / met) < 0.5 / 255);
        }
    }
    kuhn_done(&kuhn);
}

/* The field rises along x from nothing to all; what is dense hides what is behind, from either
 * side. Cells are 20 um thick and 900 um long: across them their middles say nothing of who is
 * before whom, and the pixels' own order alone is right. */
TEST(what_is_before_hides_what_is_behind)
{
    const struct quadric slope = { 0, { 1.0 / 1200, 0, 0 }, { 0, 0, 0 } };
    const struct gsn_ray_style style = plain(0, 1, 40);
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    float green[2];

    CHECK_OK(kuhn_sharp(low, high, (const unsigned[3]){ 60, 1, 1 }, 1, 0.05, &slope, &kuhn, &err),
             err);
    for (int side = 0; side < 4; side++) {
        const double across = side < 2 ? 1e-3 : 0.6;
        const struct gsn_view view = { .direction = { side % 2 ? -1 : 1, across, 2 * across / 3 },
                                       .up = { 0, 0, -1 },
                                       .width = 29,
                                       .height = 29 };
        const struct gsn_camera camera = frame(&kuhn, &view);
        gsn_auto(gsn_ray_picture) picture = NULL;
        gsn_auto(gsn_ray_picture) rays = NULL;

        CHECK_OK(gsn_projected_volume(kuhn.spline, &camera, NULL, &style, 1, NULL, &picture, &err),
                 err);
        CHECK_OK(gsn_ray_volume(kuhn.spline, &camera, NULL, &style, 1, NULL, &rays, &err), err);
        for (size_t i = 0; i < 29 * 29 * 4; i++)
            CHECK_NEAR((double)picture->rgba[i / 4][i % 4], (double)rays->rgba[i / 4][i % 4],
                       1.0 / 255);
        if (side < 2)
            green[side] = picture->rgba[14 * 29 + 14][1];
    }
    CHECK(green[1] > green[0] + 0.2F);
    kuhn_done(&kuhn);
}

/* Cells of higher degree keep their means: the sum over the picture is that of the exact one, which
 * the values at vertices would miss by a tenth. */
TEST(a_cell_weighs_what_it_weighs_in_the_model)
{
    const struct quadric bent = { 0.1, { 0, 0, 0 }, { 2e-6, 0, 0 } };
    const struct gsn_view view = oblique(160, 140);
    const struct gsn_ray_style style = plain(0, 1, 1);

    for (unsigned degree = 2; degree <= 3; degree++) {
        gsn_auto(gsn_plane) plane = NULL;
        gsn_auto(gsn_plane) rays = NULL;
        struct gsn_error err = { 0 };
        struct gsn_camera camera;
        struct kuhn kuhn;
        double sum = 0, truth = 0;

        CHECK_OK(
            kuhn_sharp(low, high, (const unsigned[3]){ 2, 2, 2 }, degree, 0.05, &bent, &kuhn, &err),
            err);
        camera = frame(&kuhn, &view);
        CHECK_OK(gsn_projected_xray(kuhn.spline, &camera, NULL, &style, 0, NULL, &plane, &err),
                 err);
        CHECK_OK(gsn_ray_xray(kuhn.spline, &camera, NULL, &style, 0, NULL, &rays, &err), err);
        for (size_t i = 0; i < (size_t)view.width * view.height; i++) {
            sum += isnan(plane->value[i]) ? 0 : (double)plane->value[i];
            truth += isnan(rays->value[i]) ? 0 : (double)rays->value[i];
        }
        CHECK_NEAR(sum / truth, 1, 2e-4);
        kuhn_done(&kuhn);
    }
}

TEST(one_and_two_threads_give_the_same_picture)
{
    const struct gsn_view view = oblique(60, 50);
    struct gsn_ray_style style = plain(0, 1, 200);
    struct gsn_ray_picture *picture[2] = { NULL, NULL };
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    style.shading = 0.5;
    style.across = 2;
    CHECK_OK(kuhn_random(low, high, cells, 2, 0.05, 17, &kuhn, &err), err);
    camera = frame(&kuhn, &view);
    for (unsigned k = 0; k < 2; k++)
        CHECK_OK(gsn_projected_volume(kuhn.spline, &camera, NULL, &style, k + 1, NULL, &picture[k],
                                      &err),
                 err);
    CHECK(memcmp(picture[0]->rgba, picture[1]->rgba,
                 (size_t)view.width * view.height * sizeof *picture[0]->rgba) == 0);
    gsn_ray_picture_free(picture[0]);
    gsn_ray_picture_free(picture[1]);
    kuhn_done(&kuhn);
}

TEST(what_cannot_be_drawn_is_refused)
{
    const struct gsn_view view = oblique(10, 10);
    const struct gsn_ray_clip empty = { .has_box = 1, .low = { 0, 5, 0 }, .high = { 9, 5, 9 } };
    struct gsn_ray_style style = plain(1, 1, 100);
    struct gsn_ray_picture *picture = NULL;
    struct gsn_plane *plane = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, (const unsigned[3]){ 1, 1, 1 }, 2, 0.05, &one, &kuhn, &err), err);
    camera = frame(&kuhn, &view);
    CHECK(gsn_projected_volume(kuhn.spline, &camera, NULL, &style, 1, NULL, &picture, &err) ==
          GSN_E_INPUT);
    CHECK(strstr(err.text, "width") != NULL && picture == NULL);
    CHECK(gsn_projected_xray(kuhn.spline, &camera, &empty, &style, 1, NULL, &plane, &err) ==
          GSN_E_INPUT);
    CHECK(strstr(err.text, "empty along y") != NULL && plane == NULL);
    kuhn_done(&kuhn);
}

static int once(const struct kuhn *kuhn, struct gsn_error *err)
{
    const struct gsn_view view = oblique(8, 6);
    const struct gsn_ray_style style = plain(0, 1, 100);
    gsn_auto(gsn_plane) plane = NULL;
    gsn_auto(gsn_ray_picture) picture = NULL;
    const struct gsn_camera camera = frame(kuhn, &view);
    const int r = gsn_projected_xray(kuhn->spline, &camera, NULL, &style, 1, NULL, &plane, err);

    return r < 0
               ? r
               : gsn_projected_volume(kuhn->spline, &camera, NULL, &style, 1, NULL, &picture, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, (const unsigned[3]){ 1, 1, 1 }, 2, 0.05, &one, &kuhn, &err), err);
    CHECK_EVERY_OOM(once(&kuhn, &err), err);
    kuhn_done(&kuhn);
}
