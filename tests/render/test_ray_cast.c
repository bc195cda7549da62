/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/ray_cast.h"

#include <string.h>

#include "pipeline/core/srgb.h"
#include "pipeline/model/pieces.h"
#include "tests/render/box_scene.h"

static const struct quadric quadratic = { 0.2, { 1e-4, -2e-4, 3e-4 }, { 2e-7, -1e-7, 4e-7 } };

static double quadric_on(const struct quadric *q, const double start[3], const double into[3],
                         double t)
{
    const double u[3] = { start[0] + t * into[0], start[1] + t * into[1], start[2] + t * into[2] };

    return quadric_at(q, u);
}

/* Simpson's rule, exact for quadratic fields. */
static double integral(const struct quadric *q, const double start[3], const double into[3],
                       double from, double to)
{
    return (to - from) / 6 *
           (quadric_on(q, start, into, from) + 4 * quadric_on(q, start, into, (from + to) / 2) +
            quadric_on(q, start, into, to));
}

/* The X-ray of a field in what is left of the box is that of the chords. */
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
    CHECK_OK(gsn_ray_xray(kuhn.spline, &camera, clip, &style, 0, NULL, &plane, &err), err);
    for (uint32_t j = 0; j < view->height; j++) {
        for (uint32_t i = 0; i < view->width; i++) {
            const double value = (double)plane->value[j * view->width + i];
            double start[3], into[3], in, out;

            (void)line_of(&camera, i + 0.5, j + 0.5, start, into);
            if (chord(from, to, start, into, &in, &out)) {
                const double truth = integral(q, start, into, in, out);

                /* Floats, and rays that are off by 1e-9 px. */
                CHECK_NEAR(isnan(value) ? 0 : value, truth, 1e-6 * fabs(truth) + 1e-4);
                hit++;
            } else {
                CHECK(isnan(value) || fabs(value) < 1e-4);
                missed++;
            }
        }
    }
    CHECK(hit > view->width * view->height / 8 && missed > 0);
    kuhn_done(&kuhn);
}

TEST(the_x_ray_of_a_polynomial_field_is_that_of_its_chords)
{
    const struct gsn_view view = oblique(40, 31);

    for (unsigned degree = 1; degree <= 3; degree++)
        check_xray(degree == 1 ? &linear : &quadratic, degree, &view, NULL, low, high);
}

TEST(seen_from_an_eye_it_is_that_of_the_chords_too)
{
    struct gsn_view view = oblique(40, 31);

    view.eye_distance = 2.5;
    check_xray(&quadratic, 2, &view, NULL, low, high);
}

TEST(looking_along_an_axis_with_faces_edge_on_is_no_special_case)
{
    const struct gsn_view view = {
        .direction = { 0, 0, 1 }, .up = { 0, -1, 0 }, .width = 41, .height = 37
    };

    check_xray(&one, 1, &view, NULL, low, high);
    check_xray(&linear, 2, &view, NULL, low, high);
}

TEST(a_box_and_planes_cut_exactly_where_they_are)
{
    const struct gsn_view view = oblique(40, 31);
    const double plane[2][6] = { { 700, 0, 0, 2, 0, 0 }, { 0, 250, 0, 0, -1, 0 } };
    const double left_low[3] = { 100, 250, 50 }, left_high[3] = { 700, 900, 480 };
    const struct gsn_ray_clip clip = { .has_box = 1,
                                       .low = { 100, -1e9, 50 },
                                       .high = { 5000, 2000, 480 },
                                       .plane_count = 2,
                                       .plane = plane };

    check_xray(&quadratic, 2, &view, &clip, left_low, left_high);
}

/* The camera frames a small box, and the eye stands in the mesh: tetrahedra reach behind it. */
TEST(an_eye_inside_the_mesh_sees_what_is_before_it)
{
    const double from[3] = { 560, 410, 270 }, to[3] = { 640, 490, 330 };
    struct gsn_view view = oblique(31, 31);
    const struct gsn_ray_style style = plain(0, 1, 1);
    const struct gsn_ray_clip clip = { .has_box = 1,
                                       .low = { from[0], from[1], from[2] },
                                       .high = { to[0], to[1], to[2] } };
    double corner[8][3];
    const struct gsn_tets box = { .vertex_count = 8, .vertex = corner };
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    size_t hit = 0;

    for (int i = 0; i < 24; i++)
        corner[i / 3][i % 3] = i / 3 >> i % 3 & 1 ? to[i % 3] : from[i % 3];
    view.eye_distance = 2;
    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.05, &quadratic, &kuhn, &err), err);
    CHECK_OK(gsn_camera_frame(&view, &box, &camera, &err), err);
    CHECK_OK(gsn_ray_xray(kuhn.spline, &camera, &clip, &style, 0, NULL, &plane, &err), err);
    for (uint32_t j = 0; j < view.height; j++) {
        for (uint32_t i = 0; i < view.width; i++) {
            const double value = (double)plane->value[j * view.width + i];
            double start[3], into[3], in, out;

            (void)line_of(&camera, i + 0.5, j + 0.5, start, into);
            if (!chord(from, to, start, into, &in, &out))
                continue;
            CHECK_NEAR(isnan(value) ? 0 : value, integral(&quadratic, start, into, in, out), 1e-4);
            hit++;
        }
    }
    CHECK(hit > 100);
    kuhn_done(&kuhn);
}

/* In a random spline nothing cancels: the pieces against the recurrence, along segments. */
TEST(the_pieces_of_a_line_add_up_to_the_segment_integral)
{
    static const double end[5][2][3] = { { { 60, 50, 40 }, { 1130, 820, 560 } },
                                         { { 1100, 30, 300 }, { 100, 870, 310 } },
                                         { { 600, 450, 20 }, { 610, 455, 590 } },
                                         { { 310, 299, 10 }, { 330, 312, 580 } },
                                         { { 500, 400, 300 }, { 505, 400, 300 } } };

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto_mem(struct gsn_face_line) face = gsn_alloc_array(1, sizeof *face);
        struct gsn_error err = { 0 };
        struct kuhn kuhn;

        CHECK(face != NULL);
        CHECK_OK(kuhn_random(low, high, cells, degree, 0.15, 7 + degree, &kuhn, &err), err);
        for (size_t s = 0; s < 5; s++) {
            double into[3], length = 0, truth, sum = 0;

            for (int c = 0; c < 3; c++) {
                into[c] = end[s][1][c] - end[s][0][c];
                length += into[c] * into[c];
            }
            length = sqrt(length);
            for (int c = 0; c < 3; c++)
                into[c] /= length;
            for (size_t t = 0; t < kuhn.mesh->tet_count; t++) {
                struct gsn_line_piece piece[GSN_FACE_CORRECTION_MAX_LEAVES];
                struct gsn_tet_line tet;

                gsn_tet_line_init(kuhn.spline, t, &tet);
                if (gsn_tet_line_piece(&tet, end[s][0], into, 0, length, 0, piece))
                    sum += (piece->to - piece->from) * (piece->value[0] + piece->value[1] / 2 +
                                                        piece->value[2] / 3 + piece->value[3] / 4);
                for (unsigned k = 0; k < 4; k++) {
                    size_t count;

                    if (!gsn_face_line_init(kuhn.spline, t, k, face))
                        continue;
                    count = gsn_face_line_pieces(face, end[s][0], into, 0, length, 0, piece);
                    for (size_t i = 0; i < count; i++)
                        sum += (piece[i].to - piece[i].from) *
                               (piece[i].value[0] + piece[i].value[1] / 2 + piece[i].value[2] / 3 +
                                piece[i].value[3] / 4);
                }
            }
            CHECK_OK(gsn_spline_segment(kuhn.spline, end[s][0], end[s][1], &truth, &err), err);
            CHECK_NEAR(sum, truth, 1e-10 * length);
        }
        kuhn_done(&kuhn);
    }
}

/* Nor is a picture of it what its tetrahedra alone would give. */
TEST(the_x_ray_of_a_random_spline_is_that_of_the_recurrence_along_segments)
{
    const struct gsn_view view = oblique(21, 18);
    const struct gsn_ray_style style = plain(0, 1, 1);

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_plane) plane = NULL;
        struct gsn_camera camera;
        struct gsn_error err = { 0 };
        struct kuhn kuhn;
        size_t met = 0;

        CHECK_OK(kuhn_random(low, high, cells, degree, 0.15, 17, &kuhn, &err), err);
        camera = frame(&kuhn, &view);
        CHECK_OK(gsn_ray_xray(kuhn.spline, &camera, NULL, &style, 0, NULL, &plane, &err), err);
        for (uint32_t j = 0; j < view.height; j++) {
            for (uint32_t i = 0; i < view.width; i++) {
                double start[3], into[3], end[2][3], in, out, truth;

                (void)line_of(&camera, i + 0.5, j + 0.5, start, into);
                if (!chord(low, high, start, into, &in, &out))
                    continue;
                for (int c = 0; c < 3; c++) {
                    end[0][c] = start[c] + in * into[c];
                    end[1][c] = start[c] + out * into[c];
                }
                CHECK_OK(gsn_spline_segment(kuhn.spline, end[0], end[1], &truth, &err), err);
                CHECK_NEAR((double)plane->value[j * view.width + i], truth,
                           1e-6 * fabs(truth) + 1e-4);
                met++;
            }
        }
        CHECK(met > 100);
        kuhn_done(&kuhn);
    }
}

/* Emission in one colour: 1 - exp(-depth), whatever the density does. The window is so wide that
 * the map has one colour, and extinction is linear in the density. */
TEST(absorption_by_a_polynomial_field_has_its_closed_form)
{
    const struct gsn_view view = oblique(48, 40);
    const struct gsn_ray_style style = plain(0, 1, 300);
    gsn_auto(gsn_ray_picture) picture = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    double square = 0;

    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.05, &quadratic, &kuhn, &err), err);
    camera = frame(&kuhn, &view);
    CHECK_OK(gsn_ray_volume(kuhn.spline, &camera, NULL, &style, 0, NULL, &picture, &err), err);
    for (uint32_t j = 0; j < view.height; j++) {
        for (uint32_t i = 0; i < view.width; i++) {
            double start[3], into[3], in, out, truth = 0, off;

            (void)line_of(&camera, i + 0.5, j + 0.5, start, into);
            /* The field is between 0 and 1 in all of the box but a corner of it. */
            if (chord(low, high, start, into, &in, &out) &&
                quadric_on(&quadratic, start, into, in) > 0 &&
                quadric_on(&quadratic, start, into, out) > 0 &&
                quadric_on(&quadratic, start, into, in) < 1 &&
                quadric_on(&quadratic, start, into, out) < 1)
                truth = -expm1(-integral(&quadratic, start, into, in, out) / style.opaque_um);
            else
                continue;
            off = (double)picture->rgba[j * view.width + i][3] - truth;
            square = fmax(square, off * off);
        }
    }
    /* A hundredth of a step of 8 bits is asked for; this is a hundredth of that. */
    CHECK(sqrt(square) < 0.0001 / 255);
    kuhn_done(&kuhn);
}

/* Three more splines on the space of the first: red, green and blue that change along x, y and
 * z. */
static const struct quadric dyed[3] = { { 0.5, { 0.0004, 0, 0 }, { 0 } },
                                        { 0.4, { 0, 0.0003, 0 }, { 0 } },
                                        { 0.6, { 0, 0, -0.0003 }, { 0 } } };

static void dye(const struct kuhn *kuhn, unsigned degree, struct gsn_spline *ret_colour[3])
{
    for (int c = 0; c < 3; c++) {
        struct gsn_error err = { 0 };
        struct kuhn other;

        CHECK_OK(kuhn_sharp(low, high, cells, degree, 0.05, &dyed[c], &other, &err), err);
        CHECK_OK(
            gsn_spline_new(kuhn->space, gsn_spline_controls(other.spline), &ret_colour[c], &err),
            err);
        kuhn_done(&other);
    }
}

/* Extinction is the same all through the box; so the light of a colour a + b t is a (1 - e) + b (L
 * - (L + D) e) with e = exp(-D / L). */
TEST(true_colours_have_their_closed_form)
{
    static const struct quadric dense = { 2, { 0 }, { 0 } };
    const struct gsn_view view = oblique(48, 40);
    struct gsn_spline *colour[3] = { NULL };
    struct gsn_ray_style style = plain(0, 1, 300);
    gsn_auto(gsn_ray_picture) picture = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    size_t met = 0;

    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.05, &dense, &kuhn, &err), err);
    dye(&kuhn, 2, colour);
    style.colour = (const struct gsn_spline *const *)colour;
    camera = frame(&kuhn, &view);
    CHECK_OK(gsn_ray_volume(kuhn.spline, &camera, NULL, &style, 0, NULL, &picture, &err), err);
    CHECK(picture->is_light);
    for (uint32_t j = 0; j < view.height; j++) {
        for (uint32_t i = 0; i < view.width; i++) {
            const float *got = picture->rgba[j * view.width + i];
            const double away = style.opaque_um;
            double start[3], into[3], in, out, left;

            (void)line_of(&camera, i + 0.5, j + 0.5, start, into);
            if (!chord(low, high, start, into, &in, &out))
                continue;
            left = exp(-(out - in) / away);
            CHECK_NEAR((double)got[3], 1 - left, 1e-6);
            for (int c = 0; c < 3; c++) {
                const double a = quadric_on(&dyed[c], start, into, in),
                             b = (quadric_on(&dyed[c], start, into, out) - a) / (out - in);

                CHECK_NEAR((double)got[c], a * (1 - left) + b * (away - (away + out - in) * left),
                           GSN_RAY_TOLERANCE);
            }
            met++;
        }
    }
    CHECK(met > 100);
    for (int c = 0; c < 3; c++)
        gsn_spline_free(colour[c]);
    kuhn_done(&kuhn);
}

TEST(a_cut_shows_the_true_colour_where_the_ray_comes_in)
{
    static const struct quadric dense = { 2, { 0 }, { 0 } };
    const struct gsn_view view = oblique(24, 20);
    struct gsn_spline *colour[3] = { NULL };
    struct gsn_ray_style style = plain(0, 1, 300);
    gsn_auto(gsn_ray_picture) picture = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.05, &dense, &kuhn, &err), err);
    dye(&kuhn, 2, colour);
    style.colour = (const struct gsn_spline *const *)colour;
    style.level = 1;
    camera = frame(&kuhn, &view);
    CHECK_OK(gsn_ray_surface(kuhn.spline, &camera, NULL, &style, 0, NULL, &picture, &err), err);
    CHECK(!picture->is_light);
    for (uint32_t j = 0; j < view.height; j++) {
        for (uint32_t i = 0; i < view.width; i++) {
            double start[3], into[3], in, out;

            (void)line_of(&camera, i + 0.5, j + 0.5, start, into);
            if (!chord(low, high, start, into, &in, &out) || out - in < 1)
                continue;
            for (int c = 0; c < 3; c++)
                CHECK_NEAR((double)picture->rgba[j * view.width + i][c],
                           gsn_srgb_of_light(quadric_on(&dyed[c], start, into, in)), 1e-5);
        }
    }
    for (int c = 0; c < 3; c++)
        gsn_spline_free(colour[c]);
    kuhn_done(&kuhn);
}

/* The same light by brute force: many small steps of the exact field. */
static void step_light(const struct quadric *q, const struct gsn_ray_style *style,
                       const double start[3], const double into[3], double from, double to,
                       double ret_light[3])
{
    enum { STEPS = 40000 };
    struct gsn_colour knot[17];
    double depth = 0;

    for (int i = 0; i < 17; i++)
        knot[i] = gsn_colour_of(style->map, i / 16.0);
    memset(ret_light, 0, 3 * sizeof *ret_light);
    for (int i = 0; i < STEPS; i++) {
        const double step = (to - from) / STEPS, t = from + (i + 0.5) * step;
        const double share = fmin(
            1, fmax(0, (quadric_on(q, start, into, t) - style->low) / (style->high - style->low)));
        const double here = share * step / style->opaque_um, at = fmin(15.999999, share * 16);
        const struct gsn_colour a = knot[(int)at], b = knot[(int)at + 1];
        const double part = at - floor(at), weight = exp(-depth) * -expm1(-here);

        ret_light[0] += weight * (a.r + part * (b.r - a.r)) / 255;
        ret_light[1] += weight * (a.g + part * (b.g - a.g)) / 255;
        ret_light[2] += weight * (a.b + part * (b.b - a.b)) / 255;
        depth += here;
    }
}

TEST(colours_are_within_the_stated_tolerance_of_many_small_steps)
{
    struct gsn_view view = oblique(9, 7);
    /* The window's ends are crossed inside. */
    const struct gsn_ray_style style = plain(0.15, 0.3, 60);
    gsn_auto(gsn_ray_picture) picture = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    size_t seen = 0;

    view.eye_distance = 3;
    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.05, &quadratic, &kuhn, &err), err);
    camera = frame(&kuhn, &view);
    CHECK_OK(gsn_ray_volume(kuhn.spline, &camera, NULL, &style, 0, NULL, &picture, &err), err);
    for (uint32_t j = 0; j < view.height; j++) {
        for (uint32_t i = 0; i < view.width; i++) {
            double start[3], into[3], in, out, light[3];

            (void)line_of(&camera, i + 0.5, j + 0.5, start, into);
            if (!chord(low, high, start, into, &in, &out))
                continue;
            step_light(&quadratic, &style, start, into, in, out, light);
            for (int c = 0; c < 3; c++)
                CHECK_NEAR((double)picture->rgba[j * view.width + i][c], light[c],
                           GSN_RAY_TOLERANCE);
            seen++;
        }
    }
    CHECK(seen > 10);
    kuhn_done(&kuhn);
}

TEST(one_density_glows_in_one_colour_by_one_minus_exp)
{
    const struct gsn_view view = oblique(20, 17);
    const struct gsn_ray_style style = plain(0.5, 1.5, 400);
    const struct gsn_colour colour = gsn_colour_of(GSN_MAP_VIRIDIS, 0.5);
    gsn_auto(gsn_ray_picture) picture = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.05, &one, &kuhn, &err), err);
    camera = frame(&kuhn, &view);
    CHECK_OK(gsn_ray_volume(kuhn.spline, &camera, NULL, &style, 0, NULL, &picture, &err), err);
    for (uint32_t j = 0; j < view.height; j++) {
        for (uint32_t i = 0; i < view.width; i++) {
            const float *p = picture->rgba[j * view.width + i];
            double start[3], into[3], in, out, truth = 0;

            (void)line_of(&camera, i + 0.5, j + 0.5, start, into);
            if (chord(low, high, start, into, &in, &out))
                truth = -expm1(-0.5 * (out - in) / style.opaque_um);
            CHECK_NEAR((double)p[3], truth, 1e-6);
            CHECK_NEAR((double)p[0], truth * colour.r / 255, 1e-6);
            CHECK_NEAR((double)p[1], truth * colour.g / 255, 1e-6);
            CHECK_NEAR((double)p[2], truth * colour.b / 255, 1e-6);
        }
    }
    kuhn_done(&kuhn);
}

TEST(shading_darkens_what_is_seen_edge_on_and_nothing_else)
{
    /* The gradient lies along x: seen along x it faces the eye, along y it is edge on. */
    const struct quadric slope = { 0, { 1.0 / 1200, 0, 0 }, { 0, 0, 0 } };
    struct gsn_ray_style style = plain(0, 1, 100);
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.05, &slope, &kuhn, &err), err);
    for (int axis = 0; axis < 2; axis++) {
        const struct gsn_view view = {
            .direction = { axis == 0, axis == 1, 0 }, .up = { 0, 0, -1 }, .width = 9, .height = 9
        };
        float light[2];

        for (int shaded = 0; shaded < 2; shaded++) {
            gsn_auto(gsn_ray_picture) picture = NULL;
            const struct gsn_camera camera = frame(&kuhn, &view);

            style.shading = shaded ? 0.8 : 0;
            CHECK_OK(gsn_ray_volume(kuhn.spline, &camera, NULL, &style, 1, NULL, &picture, &err),
                     err);
            light[shaded] = picture->rgba[40][1];
        }
        CHECK(light[0] > 0.2F);
        CHECK(axis == 0 ? fabsf(light[1] - light[0]) < 1e-4F : light[1] < 0.98F * light[0]);
    }
    kuhn_done(&kuhn);
}

TEST(a_surface_lies_where_the_level_is_and_a_cut_shows_the_density)
{
    const struct quadric slope = { 0, { 0, 0, 1.0 / 600 }, { 0, 0, 0 } };
    const double away[1][6] = { { 0, 0, 450, 0, 0, -1 } };
    const struct gsn_ray_clip clip = { .plane_count = 1, .plane = away };
    const struct gsn_view view = {
        .direction = { 0, 0, 1 }, .up = { 0, -1, 0 }, .width = 12, .height = 9
    };
    const struct gsn_colour at_cut = gsn_colour_of(GSN_MAP_VIRIDIS, 0.75);
    struct gsn_ray_style style = plain(0, 1, 1);
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    style.level = 0.5;
    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.05, &slope, &kuhn, &err), err);
    camera = frame(&kuhn, &view);
    for (int cut = 0; cut < 2; cut++) {
        gsn_auto(gsn_ray_picture) picture = NULL;
        const float *p;

        CHECK_OK(gsn_ray_surface(kuhn.spline, &camera, cut ? &clip : NULL, &style, 1, NULL,
                                 &picture, &err),
                 err);
        p = picture->rgba[4 * 12 + 6];
        CHECK_NEAR((double)p[3], 1, 0);
        CHECK(picture->rgba[0][3] == 0);
        if (cut) {
            CHECK_NEAR((double)p[0], at_cut.r / 255.0, 1e-6);
            CHECK_NEAR((double)p[1], at_cut.g / 255.0, 1e-6);
        } else {
            CHECK(p[0] > p[1] && p[1] > p[2]); /* the colour of bone */
        }
    }
    kuhn_done(&kuhn);
}

/* Light of two films and of what they leave of a surface, all faced: bone is base * k + m there. */
TEST(a_surface_is_seen_through_films_in_the_order_in_which_they_lie)
{
    const struct quadric slope = { 0, { 0, 0, 1.0 / 600 }, { 0, 0, 0 } };
    const struct gsn_view view = {
        .direction = { 0, 0, 1 }, .up = { 0, -1, 0 }, .width = 12, .height = 9
    };
    const double h = 0.3, middle = 4 * 12 + 6;
    struct gsn_ray_style style = plain(0, 1, 1);
    gsn_auto(gsn_ray_picture) bare = NULL;
    gsn_auto(gsn_ray_picture) covered = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    style.level = 0.5;
    style.film_opacity = h;
    style.film[0] = 0.35;
    style.film[1] = 0.2; /* nearer to the eye, though named later */
    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.05, &slope, &kuhn, &err), err);
    camera = frame(&kuhn, &view);
    CHECK_OK(gsn_ray_surface(kuhn.spline, &camera, NULL, &style, 1, NULL, &bare, &err), err);
    style.films = 2;
    CHECK_OK(gsn_ray_surface(kuhn.spline, &camera, NULL, &style, 1, NULL, &covered, &err), err);
    {
        const float *const s = bare->rgba[(size_t)middle], *const p = covered->rgba[(size_t)middle];
        const double k = (double)(s[0] - s[2]) / ((226 - 176) / 255.0);
        const double m = (double)s[0] - 226 / 255.0 * k;
        const struct gsn_colour near = gsn_colour_of(GSN_MAP_VIRIDIS, 0.2);
        const struct gsn_colour far = gsn_colour_of(GSN_MAP_VIRIDIS, 0.35);
        const double first[3] = { near.r / 255.0, near.g / 255.0, near.b / 255.0 };
        const double second[3] = { far.r / 255.0, far.g / 255.0, far.b / 255.0 };

        CHECK_NEAR((double)p[3], 1, 1e-7);
        for (int c = 0; c < 3; c++)
            CHECK_NEAR((double)p[c],
                       h * (first[c] * k + m) + (1 - h) * h * (second[c] * k + m) +
                           (1 - h) * (1 - h) * (double)s[c],
                       0.5 / 255); /* gsn_colour_of() rounds to codes */
    }
    style.film[0] = 0.5;
    CHECK(gsn_ray_surface(kuhn.spline, &camera, NULL, &style, 1, NULL, &covered, &err) ==
          GSN_E_INPUT);
    kuhn_done(&kuhn);
}

TEST(a_film_hides_more_the_flatter_it_is_looked_through)
{
    const struct quadric slope = { 0, { 0, 0, 1.0 / 600 }, { 0, 0, 0 } };
    struct gsn_ray_style style = plain(0, 1, 1);
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    style.level = 2; /* nowhere */
    style.films = 1;
    style.film[0] = 0.5;
    style.film_opacity = 0.3;
    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.05, &slope, &kuhn, &err), err);
    for (int steep = 0; steep < 2; steep++) {
        const struct gsn_view view = {
            .direction = { steep, 0, 1 }, .up = { 0, -1, 0 }, .width = 13, .height = 9
        };
        const struct gsn_camera camera = frame(&kuhn, &view);
        gsn_auto(gsn_ray_picture) picture = NULL;

        CHECK_OK(gsn_ray_surface(kuhn.spline, &camera, NULL, &style, 1, NULL, &picture, &err), err);
        CHECK_NEAR((double)picture->rgba[4 * 13 + 6][3], 1 - pow(0.7, steep ? M_SQRT2 : 1), 1e-5);
    }
    kuhn_done(&kuhn);
}

TEST(a_region_bounds_what_is_seen)
{
    /* 600 x 400 x 300 um in the middle, in voxels of 20 um. */
    const double corner[3] = { 300, 250, 150 }, end[3] = { 900, 650, 450 };
    struct gsn_mask *mask = full_mask(corner, 20, 30, 20, 15);
    const struct gsn_view view = oblique(40, 31);
    const struct gsn_ray_style style = plain(0, 1, 1);
    gsn_auto(gsn_border) border = NULL;
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    double sum = 0, truth = 0;

    CHECK_OK(gsn_border_new(mask, 0, &border, &err), err);
    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.05, &one, &kuhn, &err), err);
    camera = frame(&kuhn, &view);
    {
        const struct gsn_ray_clip clip = { .border = border, .border_step_um = 20 };

        CHECK_OK(gsn_ray_xray(kuhn.spline, &camera, &clip, &style, 0, NULL, &plane, &err), err);
    }
    for (uint32_t j = 0; j < view.height; j++) {
        for (uint32_t i = 0; i < view.width; i++) {
            const double value = (double)plane->value[j * view.width + i];
            double start[3], into[3], in, out;

            (void)line_of(&camera, i + 0.5, j + 0.5, start, into);
            sum += isnan(value) ? 0 : value;
            truth += chord(corner, end, start, into, &in, &out) ? out - in : 0;
        }
    }
    /* The edges of the box are rounded by 0.7 voxel. */
    CHECK_NEAR(sum / truth, 1, 0.02);
    CHECK(sum < truth);
    gsn_mask_free(mask);
    kuhn_done(&kuhn);
}

/* 70 slabs of two voxels, two voxels apart: the distance from their faces is antisymmetric, so that
 * smoothing moves none but the outermost two, where 1/4 of a voxel inside
 * meets 1/2 outside: a third of the way from centre to centre, not half. */
TEST(a_ray_may_enter_a_region_any_number_of_times)
{
    enum { SLABS = 70, ACROSS = 12 };
    const double corner[3] = { 500, 350, 20 }, step = 2, inside = (2 * SLABS - 1.0 / 3) * step;
    struct gsn_mask *mask = full_mask(corner, step, ACROSS, ACROSS, 4 * SLABS);
    const struct gsn_view view = {
        .direction = { 0, 0, 1 }, .up = { 0, -1, 0 }, .width = 3, .height = 3
    };
    const struct gsn_ray_style style = plain(0, 2, 100);
    gsn_auto(gsn_border) border = NULL;
    gsn_auto(gsn_plane) plane = NULL;
    gsn_auto(gsn_ray_picture) picture = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    for (size_t i = 0; i < (size_t)ACROSS * ACROSS * 4 * SLABS; i++)
        mask->inside[i] = i / (ACROSS * ACROSS) % 4 < 2;
    CHECK_OK(gsn_border_new(mask, 0, &border, &err), err);
    CHECK_OK(kuhn_sharp(low, high, cells, 2, 0.05, &one, &kuhn, &err), err);
    camera = frame(&kuhn, &view);
    camera.centre[0] = corner[0] + step * ACROSS / 2;
    camera.centre[1] = corner[1] + step * ACROSS / 2;
    {
        const struct gsn_ray_clip clip = { .border = border, .border_step_um = step };

        CHECK_OK(gsn_ray_xray(kuhn.spline, &camera, &clip, &style, 1, NULL, &plane, &err), err);
        CHECK_OK(gsn_ray_volume(kuhn.spline, &camera, &clip, &style, 1, NULL, &picture, &err), err);
    }
    CHECK_NEAR((double)plane->value[4], inside, 1e-4);
    CHECK_NEAR((double)picture->rgba[4][3], -expm1(-0.5 * inside / style.opaque_um), 1e-6);
    gsn_mask_free(mask);
    kuhn_done(&kuhn);
}

TEST(several_rays_a_pixel_average)
{
    const struct gsn_view fine = oblique(40, 30), coarse = oblique(20, 15);
    struct gsn_ray_style style = plain(0, 1, 300);
    struct gsn_ray_picture *picture[2] = { NULL, NULL };
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_random(low, high, cells, 2, 0.05, 17, &kuhn, &err), err);
    camera = frame(&kuhn, &fine);
    CHECK_OK(gsn_ray_volume(kuhn.spline, &camera, NULL, &style, 0, NULL, &picture[0], &err), err);
    style.across = 2;
    camera = frame(&kuhn, &coarse);
    CHECK_OK(gsn_ray_volume(kuhn.spline, &camera, NULL, &style, 0, NULL, &picture[1], &err), err);
    for (uint32_t j = 0; j < 15; j++) {
        for (uint32_t i = 0; i < 20; i++) {
            float mean = 0;

            for (uint32_t k = 0; k < 4; k++)
                mean += picture[0]->rgba[(2 * j + k / 2) * 40 + 2 * i + k % 2][1] / 4;
            CHECK_NEAR((double)picture[1]->rgba[j * 20 + i][1], (double)mean, 1e-6);
        }
    }
    gsn_ray_picture_free(picture[0]);
    gsn_ray_picture_free(picture[1]);
    kuhn_done(&kuhn);
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
    CHECK_OK(kuhn_random(low, high, cells, 2, 0.05, 17, &kuhn, &err), err);
    camera = frame(&kuhn, &view);
    for (unsigned k = 0; k < 2; k++)
        CHECK_OK(gsn_ray_volume(kuhn.spline, &camera, NULL, &style, k + 1, NULL, &picture[k], &err),
                 err);
    CHECK(memcmp(picture[0]->rgba, picture[1]->rgba,
                 (size_t)view.width * view.height * sizeof *picture[0]->rgba) == 0);
    gsn_ray_picture_free(picture[0]);
    gsn_ray_picture_free(picture[1]);
    kuhn_done(&kuhn);
}

static void check_refused(const struct kuhn *kuhn, const struct gsn_view *view,
                          const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                          const char *word)
{
    struct gsn_ray_picture *picture = NULL;
    const struct gsn_camera camera = frame(kuhn, view);
    struct gsn_error err = { 0 };

    CHECK(gsn_ray_volume(kuhn->spline, &camera, clip, style, 1, NULL, &picture, &err) ==
          GSN_E_INPUT);
    CHECK(picture == NULL && strstr(err.text, word) != NULL);
}

TEST(what_cannot_be_drawn_is_refused)
{
    const struct gsn_view view = oblique(10, 10);
    const double plane[1][6] = { { 1, 2, 3, 0, 0, 0 } };
    const struct gsn_ray_clip no_normal = { .plane_count = 1, .plane = plane };
    const struct gsn_ray_clip empty = { .has_box = 1, .low = { 0, 5, 0 }, .high = { 9, 5, 9 } };
    const struct gsn_ray_style good = plain(0, 1, 100);
    struct gsn_view large = view;
    struct gsn_ray_style style;
    struct gsn_ray_picture *picture = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, (const unsigned[3]){ 1, 1, 1 }, 2, 0.05, &one, &kuhn, &err), err);
    camera = frame(&kuhn, &view);
    check_refused(&kuhn, &view, &no_normal, &good, "normal");
    check_refused(&kuhn, &view, &empty, &good, "empty along y");
    style = plain(1, 1, 100);
    check_refused(&kuhn, &view, NULL, &style, "width");
    style = plain(0, 1, 0);
    check_refused(&kuhn, &view, NULL, &style, "opacity");
    style = good;
    style.shading = 1.5;
    check_refused(&kuhn, &view, NULL, &style, "shading");
    style = good;
    style.across = 5;
    check_refused(&kuhn, &view, NULL, &style, "rays");
    large.width = 9000;
    style.across = 2;
    check_refused(&kuhn, &large, NULL, &style, "too many");
    CHECK(gsn_ray_surface(kuhn.spline, &camera, NULL, &good, 1, NULL, &picture, &err) ==
          GSN_E_INPUT);
    CHECK(strstr(err.text, "level") != NULL);
    kuhn_done(&kuhn);
}

static int once(const struct kuhn *kuhn, struct gsn_error *err)
{
    const struct gsn_view view = oblique(8, 6);
    const struct gsn_ray_style style = plain(0, 1, 100);
    gsn_auto(gsn_plane) plane = NULL;
    gsn_auto(gsn_ray_picture) picture = NULL;
    gsn_auto(gsn_image) image = NULL;
    const struct gsn_camera camera = frame(kuhn, &view);
    int r = gsn_ray_xray(kuhn->spline, &camera, NULL, &style, 1, NULL, &plane, err);

    if (r == GSN_OK)
        r = gsn_ray_volume(kuhn->spline, &camera, NULL, &style, 1, NULL, &picture, err);
    if (r == GSN_OK)
        r = gsn_ray_paint(picture, &camera, &style, NULL, "title", "note", &image, err);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, (const unsigned[3]){ 1, 1, 1 }, 2, 0.05, &one, &kuhn, &err), err);
    CHECK_EVERY_OOM(once(&kuhn, &err), err);
    kuhn_done(&kuhn);
}
