/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/integral.h"

#include "pipeline/model/spline.h"

#include <string.h>

#include "tests/check.h"
#include "tests/measure/kuhn.h"

static const double low[3] = { 0, 0, 0 }, high[3] = { 1200, 900, 600 };
static const unsigned cells[3] = { 4, 3, 2 };
static const double corner[3] = { 120, 96, 48 };
static const struct quadric field = { 0.2, { 1e-4, -2e-4, 3e-4 }, { 2e-7, -1e-7, 4e-7 } };

static struct kuhn make_field(void)
{
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.03, &field, &kuhn, &err), err);
    return kuhn;
}

/* Of u over [a, b]: mean, and mean of the square. */
static double mean1(double a, double b)
{
    return (a + b) / 2;
}

static double mean2(double a, double b)
{
    return (a * a + a * b + b * b) / 3;
}

TEST(the_mean_of_a_quadratic_field_on_a_plane_is_exact)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24, 40, 30, 20);
    struct kuhn kuhn = make_field();
    const double side[3][2] = { { 120, 1080 }, { 96, 816 }, { 48, 528 } };
    const double at[3] = { 401, 333, 290 };
    struct gsn_error err = { 0 };

    for (int c = 0; c < 3; c++) {
        double normal[3] = { 0 }, mean = field.constant, area = 1;
        struct gsn_plane_cut cut;

        normal[c] = c == 1 ? -7 : 0.01;
        for (int k = 0; k < 3; k++) {
            const double a = k == c ? at[c] : side[k][0], b = k == c ? at[c] : side[k][1];

            mean += field.linear[k] * mean1(a, b) + field.square[k] * mean2(a, b);
            area *= k == c ? 1 : b - a;
        }
        CHECK_OK(gsn_region_cut(kuhn.spline, region, at, normal, 1, &cut, &err), err);
        CHECK_NEAR(cut.area_um2, area, 1e-9 * area);
        CHECK_NEAR(cut.integral / cut.area_um2, mean, 1e-12);
    }
    kuhn_done(&kuhn);
}

/* Cavalieri: planes through the middle of layers are the midpoint rule of the volume. */
TEST(planes_through_a_region_add_up_to_its_volume)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24, 20, 15, 10);
    struct kuhn kuhn = make_field();
    const double normal[3] = { 1, 2, 2 };
    struct gsn_error err = { 0 };
    double volume = 0;

    /* Holes: every third voxel is out. */
    for (size_t i = 0; i < gsn_lattice_count(&region->at); i += 3)
        region->inside[i] = 0;
    /* Along the normal (of length 3) from corner to corner: 480 + 720 + 480 = 1680 of x + 2y + 2z.
     */
    for (int i = 0; i < 840; i++) {
        const double point[3] = { corner[0] + 2.0 * i + 1, corner[1], corner[2] };
        struct gsn_plane_cut cut = { 0, 0 };

        (void)gsn_region_cut(kuhn.spline, region, point, normal, 1, &cut, &err);
        volume += cut.area_um2 * 2 / 3;
    }
    CHECK_NEAR(volume, 24.0 * 24 * 24 * (double)gsn_mask_count(region), 1e-4 * volume);
    kuhn_done(&kuhn);
}

TEST(a_plane_that_misses_or_is_none_is_refused)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24, 4, 4, 4);
    const double at[3] = { 0, 0, 10 }, up[3] = { 0, 0, 1 }, none[3] = { 0 };
    struct kuhn kuhn = make_field();
    struct gsn_plane_cut cut = { 5, 6 };
    struct gsn_error err = { 0 };

    CHECK(gsn_region_cut(kuhn.spline, region, at, up, 1, &cut, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "misses"));
    CHECK(gsn_region_cut(kuhn.spline, region, at, none, 1, &cut, &err) == GSN_E_INPUT);
    CHECK(cut.area_um2 == 5 && cut.integral == 6);
    kuhn_done(&kuhn);
}

TEST(a_segment_in_the_region_is_cut_at_its_voxels)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24, 20, 15, 10);
    struct kuhn kuhn = make_field();
    const double a[3] = { -500, 200, 100 }, b[3] = { 3000, 200, 100 };
    double um = 0, integral = 0, inside = 0;
    struct gsn_error err = { 0 };

    /* A gap of two voxels: 168 to 216 um. */
    for (size_t i = 0; i < gsn_lattice_count(&region->at); i++)
        if (i % 20 == 2 || i % 20 == 3)
            region->inside[i] = 0;
    CHECK_OK(gsn_region_segment(kuhn.spline, region, a, b, &um, &integral, &err), err);
    CHECK_NEAR(um, 480 - 48, 1e-9);
    {
        const double rest = field.constant + field.linear[1] * 200 + field.linear[2] * 100 +
                            field.square[1] * 200 * 200 + field.square[2] * 100 * 100;
        const double part[2][2] = { { 120, 168 }, { 216, 600 } };
        double truth = 0;

        for (int i = 0; i < 2; i++)
            truth += (part[i][1] - part[i][0]) *
                     (rest + field.linear[0] * mean1(part[i][0], part[i][1]) +
                      field.square[0] * mean2(part[i][0], part[i][1]));
        CHECK_NEAR(integral, truth, 1e-9 * truth);
    }
    CHECK_OK(gsn_segment_inside(kuhn.mesh, a, b, &inside, &err), err);
    CHECK_NEAR(inside, 1200, 1e-9);
    kuhn_done(&kuhn);
}

/* Along an edge that six tetrahedra share, in a face, and beside the mesh. */
TEST(a_segment_along_edges_and_faces_counts_once)
{
    struct kuhn kuhn = make_field();
    const double along[3][2][3] = { { { -9, 300, 300 }, { 2000, 300, 300 } },
                                    { { 0, 0, 0 }, { 1200, 900, 600 } },
                                    { { -9, 0, 0 }, { 700, 0, 0 } } };
    const double truth[3] = { 1200, sqrt(1200.0 * 1200 + 900.0 * 900 + 600.0 * 600), 700 };
    const double beside[2][3] = { { -1, -1, 0 }, { -1, 900, 0 } };
    struct gsn_error err = { 0 };
    double um = -1;

    for (int i = 0; i < 3; i++) {
        CHECK_OK(gsn_segment_inside(kuhn.mesh, along[i][0], along[i][1], &um, &err), err);
        CHECK_NEAR(um, truth[i], 1e-9);
    }
    CHECK_OK(gsn_segment_inside(kuhn.mesh, beside[0], beside[1], &um, &err), err);
    CHECK_NEAR(um, 0, 0);
    kuhn_done(&kuhn);
}

TEST(the_integral_over_the_domain_is_that_of_the_field)
{
    struct gsn_error err = { 0 };
    double volume = 0, integral = 0, mean = field.constant;
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.03, &field, &kuhn, &err), err);
    for (int k = 0; k < 3; k++)
        mean += field.linear[k] * mean1(low[k], high[k]) + field.square[k] * mean2(low[k], high[k]);
    CHECK_OK(gsn_domain_integral(kuhn.spline, 1, &volume, &integral, &err), err);
    CHECK_NEAR(volume, 1200.0 * 900 * 600, 1e-3);
    CHECK_NEAR(integral / volume, mean, 1e-10);
    kuhn_done(&kuhn);
}

TEST(a_box_without_voxels_is_refused)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24, 4, 4, 4);
    const double far[3] = { 5000, 5000, 5000 }, further[3] = { 6000, 6000, 6000 };
    struct gsn_mask *part = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_region_in_box(region, far, further, &part, &err) == GSN_E_INPUT && !part);
}

static int ask_all(const struct kuhn *kuhn, const struct gsn_mask *region, struct gsn_error *err)
{
    const double at[3] = { 150, 100, 60 }, to[3] = { 300, 300, 300 }, up[3] = { 0, 0, 1 };
    gsn_auto(gsn_mask) part = NULL;
    struct gsn_plane_cut cut;
    double one, other;
    int r = gsn_region_in_box(region, at, to, &part, err);

    if (r >= 0)
        r = gsn_region_cut(kuhn->spline, region, at, up, 1, &cut, err);
    if (r >= 0)
        r = gsn_region_segment(kuhn->spline, region, at, to, &one, &other, err);
    if (r >= 0)
        r = gsn_segment_inside(kuhn->mesh, at, to, &one, err);
    return r < 0 ? r : gsn_domain_integral(kuhn->spline, 1, &one, &other, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24, 4, 4, 4);
    struct kuhn kuhn = make_field();
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(ask_all(&kuhn, region, &err), err);
    kuhn_done(&kuhn);
}
