/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/cells_picture.h"

#include <string.h>

#include "pipeline/core/mem.h"
#include "tests/render/box_scene.h"

/* What a camera sees of the box: each pair of opposite faces once. */
static double box_px2(const struct gsn_camera *camera)
{
    const double side[3] = { high[0] - low[0], high[1] - low[1], high[2] - low[2] };
    double sum = 0;

    for (int a = 0; a < 3; a++)
        sum += side[(a + 1) % 3] * side[(a + 2) % 3] * fabs(camera->into[a]);
    return sum * camera->px_per_um * camera->px_per_um;
}

static double covered(const struct gsn_ray_picture *picture)
{
    double sum = 0;

    for (size_t i = 0; i < (size_t)picture->width * picture->height; i++)
        sum += (double)picture->rgba[i][3];
    return sum;
}

static struct gsn_ray_picture *drawn(const struct kuhn *kuhn, const double *density, double share,
                                     const struct gsn_view *view, const struct gsn_ray_clip *clip,
                                     unsigned threads)
{
    struct gsn_ray_style style = plain(0, 1, 1);
    const struct gsn_camera camera = frame(kuhn, view);
    struct gsn_ray_picture *picture = NULL;
    struct gsn_error err = { 0 };

    style.across = 4;
    CHECK_OK(gsn_cells_picture(kuhn->mesh, density, share, &camera, clip, &style, threads, &picture,
                               &err),
             err);
    return picture;
}

static double *evenly(const struct kuhn *kuhn, double value)
{
    double *density = gsn_alloc_array(kuhn->mesh->tet_count, sizeof *density);

    assert_non_null(density);
    for (size_t t = 0; t < kuhn->mesh->tet_count; t++)
        density[t] = value;
    return density;
}

static double middle_of(const struct kuhn *kuhn, size_t t, int c)
{
    double sum = 0;

    for (int k = 0; k < 4; k++)
        sum += 0.25 * kuhn->mesh->vertex[kuhn->mesh->tet[t][k]][c];
    return sum;
}

static void make(struct kuhn *kuhn)
{
    struct gsn_error err = { 0 };

    CHECK_OK(kuhn_new(low, high, cells, 1, 0.05, &one, kuhn, &err), err);
}

TEST(whole_cells_cover_what_their_box_does)
{
    struct kuhn kuhn;

    make(&kuhn);
    for (int i = 0; i < 6; i++) {
        const struct gsn_view view = { .direction = { sin(i), cos(1.7 * i), 0.6 - 0.3 * i },
                                       .up = { 0.1, -1, 0.2 },
                                       .width = 160,
                                       .height = 160 };
        const struct gsn_camera camera = frame(&kuhn, &view);
        gsn_auto_mem(double) density = evenly(&kuhn, 0.5);
        gsn_auto(gsn_ray_picture) picture = drawn(&kuhn, density, 1, &view, NULL, 1);

        CHECK_NEAR(covered(picture), box_px2(&camera), 0.004 * box_px2(&camera));
    }
    kuhn_done(&kuhn);
}

/* A convex body's outline is half of what its faces cover; lengths go with the share. */
TEST(a_cell_of_its_own_covers_as_much_as_its_size_says)
{
    const struct gsn_view view = oblique(300, 300);
    struct kuhn kuhn;

    make(&kuhn);
    for (size_t t = 0; t < kuhn.mesh->tet_count; t += 17) {
        gsn_auto_mem(double) density = evenly(&kuhn, (double)NAN);
        const struct gsn_camera camera = frame(&kuhn, &view);
        double px[4][2], depth, outline = 0;

        density[t] = 0.5;
        for (int k = 0; k < 4; k++)
            gsn_camera_project(&camera, kuhn.mesh->vertex[kuhn.mesh->tet[t][k]], px[k], &depth);
        for (int k = 0; k < 4; k++) {
            const double *p = px[(k + 1) % 4], *q = px[(k + 2) % 4], *s = px[(k + 3) % 4];

            outline += 0.25 * fabs((q[0] - p[0]) * (s[1] - p[1]) - (q[1] - p[1]) * (s[0] - p[0]));
        }
        for (int i = 1; i <= 2; i++) {
            const double share = 0.5 * i;
            gsn_auto(gsn_ray_picture) picture = drawn(&kuhn, density, share, &view, NULL, 1);

            CHECK_NEAR(covered(picture), share * share * outline, 0.03 * share * outline);
        }
    }
    kuhn_done(&kuhn);
}

/* Two layers, the far one denser: along z one sees the near one's colour, from behind the other's;
 * both face the eye, so all of the picture has one shade. */
TEST(the_nearest_cells_hide_the_others_and_have_the_colours_of_their_density)
{
    struct kuhn kuhn;

    make(&kuhn);
    for (int i = 0; i < 4; i++) {
        const int behind = i & 1;
        const struct gsn_view view = { .direction = { 0, 0, behind ? -1 : 1 },
                                       .up = { 0, -1, 0 },
                                       .eye_distance = i & 2 ? 3 : 0,
                                       .width = 80,
                                       .height = 80 };
        const struct gsn_colour wanted = gsn_colour_of(GSN_MAP_VIRIDIS, behind ? 0.9 : 0.1);
        gsn_auto_mem(double) density = evenly(&kuhn, 0.1);
        gsn_auto(gsn_ray_picture) picture = NULL;
        double whole = 0, right = 0;

        for (size_t t = 0; t < kuhn.mesh->tet_count; t++)
            if (middle_of(&kuhn, t, 2) > 0.5 * (low[2] + high[2]))
                density[t] = 0.9;
        picture = drawn(&kuhn, density, 1, &view, NULL, 1);
        for (size_t k = 0; k < (size_t)80 * 80; k++) {
            const float *p = picture->rgba[k];
            const float light = 0.5F + 0.5F * 0.91F;

            if (p[3] < 1)
                continue;
            whole++;
            right += fabsf(p[0] - light * wanted.r / 255) < 0.004F &&
                     fabsf(p[1] - light * wanted.g / 255) < 0.004F &&
                     fabsf(p[2] - light * wanted.b / 255) < 0.004F;
        }
        /* Samples right on a seam may be an inner face's, which is as near. */
        CHECK(whole > 2000 && right > 0.95 * whole);
    }
    kuhn_done(&kuhn);
}

TEST(a_cut_leaves_the_cells_whose_middles_it_leaves)
{
    static const double plane[1][6] = { { 600, 0, 0, 1, 0, 0 } };
    const struct gsn_ray_clip cut = { .plane = plane, .plane_count = 1 };
    const struct gsn_ray_clip within = { .has_box = 1,
                                         .low = { 0, 0, 0 },
                                         .high = { 600, 900, 600 } };
    const struct gsn_view view = oblique(100, 100);
    gsn_auto_mem(double) every = NULL;
    gsn_auto_mem(double) left = NULL;
    struct kuhn kuhn;

    make(&kuhn);
    every = evenly(&kuhn, 0.5);
    left = evenly(&kuhn, 0.5);
    for (size_t t = 0; t < kuhn.mesh->tet_count; t++)
        if (middle_of(&kuhn, t, 0) > 600)
            left[t] =
                t % 2 ? (double)NAN : -0.1; /* less than the window's lower end: left out too */
    gsn_auto(gsn_ray_picture) wanted = drawn(&kuhn, left, 0.7, &view, NULL, 1);
    gsn_auto(gsn_ray_picture) by_plane = drawn(&kuhn, every, 0.7, &view, &cut, 1);
    gsn_auto(gsn_ray_picture) by_box = drawn(&kuhn, every, 0.7, &view, &within, 1);
    gsn_auto(gsn_ray_picture) threads = drawn(&kuhn, every, 0.7, &view, &within, 3);

    assert_memory_equal(wanted->rgba, by_plane->rgba, sizeof *wanted->rgba * 100 * 100);
    assert_memory_equal(wanted->rgba, by_box->rgba, sizeof *wanted->rgba * 100 * 100);
    assert_memory_equal(wanted->rgba, threads->rgba, sizeof *wanted->rgba * 100 * 100);
    CHECK(covered(wanted) > 500);
    kuhn_done(&kuhn);
}

static int once(const struct kuhn *kuhn, const double *density, double share,
                struct gsn_ray_picture **ret_picture, struct gsn_error *err)
{
    const struct gsn_view view = oblique(20, 20);
    const struct gsn_ray_style style = plain(0, 1, 1);
    const struct gsn_camera camera = frame(kuhn, &view);

    return gsn_cells_picture(kuhn->mesh, density, share, &camera, NULL, &style, 1, ret_picture,
                             err);
}

static int once_freed(const struct kuhn *kuhn, const double *density, struct gsn_error *err)
{
    gsn_auto(gsn_ray_picture) picture = NULL;

    return once(kuhn, density, 0.5, &picture, err);
}

TEST(what_cannot_be_drawn_is_refused_and_running_out_of_memory_leaks_nothing)
{
    struct gsn_ray_picture *picture = NULL;
    gsn_auto_mem(double) density = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    make(&kuhn);
    density = evenly(&kuhn, 0.5);
    CHECK(once(&kuhn, density, 0, &picture, &err) == GSN_E_INPUT && !picture);
    CHECK(once(&kuhn, density, 1.01, &picture, &err) == GSN_E_INPUT && !picture);
    CHECK(once(&kuhn, density, (double)NAN, &picture, &err) == GSN_E_INPUT && !picture);
    CHECK_EVERY_OOM(once_freed(&kuhn, density, &err), err);
    kuhn_done(&kuhn);
}
