/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/projection.h"

#include <string.h>

#include "pipeline/render/ray.h"
#include "tests/check.h"
#include "tests/measure/kuhn.h"

static const double low[3] = { 0.0, 0.0, 0.0 }, high[3] = { 1200.0, 900.0, 600.0 };
static const unsigned cells[3] = { 4, 3, 3 };

static struct gsn_view oblique(uint32_t width, uint32_t height)
{
    return (struct gsn_view){ .direction = { 0.31, 0.42, 0.85 },
                              .up = { 0.05, -1.0, 0.1 },
                              .width = width,
                              .height = height };
}

/* Where the line start + t into crosses the box; 0 when it passes by. */
static int chord(const double start[3], const double into[3], double *ret_from, double *ret_to)
{
    double from = -INFINITY, to = INFINITY;

    for (int a = 0; a < 3; a++) {
        if (fabs(into[a]) < 1e-12) {
            if (start[a] < low[a] || start[a] > high[a])
                return 0;
            continue;
        }
        const double t0 = (low[a] - start[a]) / into[a], t1 = (high[a] - start[a]) / into[a];

        from = fmax(from, fmin(t0, t1));
        to = fmin(to, fmax(t0, t1));
    }
    *ret_from = from;
    *ret_to = to;
    return from < to;
}

/* The integral of a quadratic field along a chord: Simpson's rule is exact. */
static double integral(const struct quadric *q, const double start[3], const double into[3],
                       double from, double to)
{
    const double weight[3] = { 1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0 };
    double sum = 0.0;

    for (int k = 0; k < 3; k++) {
        const double t = from + 0.5 * k * (to - from);
        const double u[3] = { start[0] + t * into[0], start[1] + t * into[1],
                              start[2] + t * into[2] };

        sum += weight[k] * quadric_at(q, u);
    }
    return sum * (to - from);
}

static void check_field(const struct quadric *q, unsigned degree, const struct gsn_view *view)
{
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    size_t hit = 0, missed = 0;

    CHECK_OK(kuhn_sharp(low, high, cells, degree, 0.05, q, &kuhn, &err), err);
    CHECK_OK(gsn_projection(kuhn.spline, view, 0, NULL, &plane, &camera, &err), err);
    for (uint32_t j = 0; j < view->height; j++) {
        for (uint32_t i = 0; i < view->width; i++) {
            const double value = (double)plane->value[j * view->width + i];
            double start[3], from, to, truth;

            gsn_ray_start(&camera, i + 0.5, j + 0.5, start);
            if (chord(start, camera.into, &from, &to)) {
                truth = integral(q, start, camera.into, from, to);
                /* The plane holds floats; the integral itself is good to much more. */
                CHECK_NEAR(value, truth, 1e-7 * fabs(truth) + 1e-7);
                CHECK_NEAR(gsn_spline_line(kuhn.spline, start, camera.into), truth,
                           1e-10 * fmax(1.0, fabs(truth)));
                hit++;
            } else {
                CHECK(isnan(value) || fabs(value) < 1e-9);
                missed++;
            }
        }
    }
    CHECK(hit > view->width * view->height / 4 && missed > 0);
    kuhn_done(&kuhn);
}

TEST(the_x_ray_of_a_constant_is_the_length_of_the_chord)
{
    const struct quadric one = { 1.0, { 0.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };
    const struct gsn_view view = oblique(40, 31);

    for (unsigned degree = 1; degree <= 3; degree++)
        check_field(&one, degree, &view);
}

TEST(the_x_ray_of_a_linear_field_is_that_of_the_chords_middle)
{
    const struct quadric linear = { 0.2, { 1e-4, -2e-4, 3e-4 }, { 0.0, 0.0, 0.0 } };
    const struct gsn_view view = oblique(40, 31);

    check_field(&linear, 2, &view);
}

TEST(the_x_ray_of_a_quadratic_field_is_exact_too)
{
    const struct quadric quadratic = { 0.2, { 1e-4, -2e-4, 3e-4 }, { 2e-7, -1e-7, 4e-7 } };
    const struct gsn_view view = oblique(40, 31);

    check_field(&quadratic, 2, &view);
}

TEST(looking_along_an_axis_with_faces_edge_on_is_no_special_case)
{
    const struct quadric linear = { 0.2, { 1e-4, -2e-4, 3e-4 }, { 0.0, 0.0, 0.0 } };
    const struct gsn_view view = {
        .direction = { 0, 0, 1 }, .up = { 0, -1, 0 }, .width = 41, .height = 37
    };

    check_field(&linear, 2, &view);
}

TEST(leaving_out_what_lies_outside_the_shadows_loses_nothing)
{
    const struct gsn_view view = oblique(36, 28);
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    size_t empty = 0;

    CHECK_OK(kuhn_random(low, high, cells, 2, 0.1, 17, &kuhn, &err), err);
    CHECK_OK(gsn_projection(kuhn.spline, &view, 0, NULL, &plane, &camera, &err), err);
    for (uint32_t j = 0; j < view.height; j++) {
        for (uint32_t i = 0; i < view.width; i++) {
            const float value = plane->value[j * view.width + i];
            double start[3], whole;

            gsn_ray_start(&camera, i + 0.5, j + 0.5, start);
            whole = gsn_spline_line(kuhn.spline, start, camera.into);
            if (isnan((double)value)) {
                CHECK_NEAR(whole, 0.0, 0.0);
                empty++;
            } else {
                CHECK_NEAR((double)value, whole, 1e-6 * fabs(whole) + 1e-5);
            }
        }
    }
    CHECK(empty > 10);
    kuhn_done(&kuhn);
}

TEST(a_shadow_spans_what_its_knots_hull_covers)
{
    const struct gsn_shadow triangle = { .count = 3,
                                         .corner = { { 1.0, 1.0 }, { 9.0, 1.0 }, { 1.0, 9.0 } },
                                         .top = 1.0,
                                         .bottom = 9.0 };
    uint32_t first, end;

    for (uint32_t row = 0; row < 12; row++) {
        gsn_shadow_span(&triangle, row, 100, &first, &end);
        if (row < 1 || row > 8) {
            CHECK(first == end);
        } else {
            /* x from 1 to 10 - y at y = row + 1/2; centres at +1/2. */
            CHECK(first == 1 && end == 10 - row);
        }
    }
    gsn_shadow_span(&triangle, 2, 4, &first, &end);
    CHECK(first == 1 && end == 4);
}

TEST(one_and_two_threads_give_the_same_picture)
{
    const struct gsn_view view = oblique(60, 50);
    struct gsn_image *image[2] = { NULL, NULL };
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_random(low, high, cells, 2, 0.05, 17, &kuhn, &err), err);
    for (unsigned k = 0; k < 2; k++) {
        gsn_auto(gsn_plane) plane = NULL;
        struct gsn_camera camera;

        CHECK_OK(gsn_projection(kuhn.spline, &view, k + 1, NULL, &plane, &camera, &err), err);
        CHECK_OK(gsn_projection_paint(plane, &camera, "X-ray", NULL, 0.0, 0.0, GSN_MAP_VIRIDIS,
                                      &image[k], &err),
                 err);
    }
    CHECK(gsn_image_bytes(image[0]) == gsn_image_bytes(image[1]));
    CHECK(memcmp(image[0]->samples, image[1]->samples, gsn_image_bytes(image[0])) == 0);
    gsn_image_free(image[0]);
    gsn_image_free(image[1]);
    kuhn_done(&kuhn);
}

TEST(a_view_with_an_eye_is_refused)
{
    const struct quadric one = { 1.0, { 0.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };
    struct gsn_view view = oblique(10, 10);
    struct gsn_plane *plane = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &one, &kuhn, &err), err);
    view.eye_distance = 4.0;
    CHECK(gsn_projection(kuhn.spline, &view, 0, NULL, &plane, &camera, &err) == GSN_E_INPUT);
    CHECK(plane == NULL && strstr(err.text, "orthographic") != NULL);
    kuhn_done(&kuhn);
}

static int once(const struct kuhn *kuhn, struct gsn_error *err)
{
    const struct gsn_view view = oblique(8, 6);
    gsn_auto(gsn_plane) plane = NULL;
    gsn_auto(gsn_image) image = NULL;
    struct gsn_camera camera;
    int r = gsn_projection(kuhn->spline, &view, 1, NULL, &plane, &camera, err);

    if (r == GSN_OK)
        r = gsn_projection_paint(plane, &camera, NULL, NULL, 0.0, 1.0, GSN_MAP_GREY, &image, err);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct quadric one = { 1.0, { 0.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };
    const unsigned few[3] = { 1, 1, 1 };
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, few, 2, 0.05, &one, &kuhn, &err), err);
    CHECK_EVERY_OOM(once(&kuhn, &err), err);
    kuhn_done(&kuhn);
}
