/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/cut.h"

#include <string.h>

#include "tests/check.h"
#include "tests/measure/kuhn.h"

static const double low[3] = { 0.0, 0.0, 0.0 }, high[3] = { 1200.0, 900.0, 600.0 };
static const unsigned cells[3] = { 4, 3, 2 };
static const double corner[3] = { 120.0, 96.0, 48.0 };
static const struct quadric field = { 0.2, { 1e-4, -2e-4, 3e-4 }, { 0.0, 0.0, 0.0 } };

TEST(a_cut_of_a_linear_field_is_right_at_every_pixel_centre)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 30, 20);
    struct gsn_vec3 centre;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    CHECK_OK(gsn_cut_centre(region, &centre, &err), err);
    for (int axis = 0; axis < 3; axis++) {
        const int right = axis == 0 ? 1 : 0, down = axis == 2 ? 1 : 2;
        struct gsn_cut_frame frame;
        gsn_auto(gsn_plane) plane = NULL;

        CHECK_OK(gsn_cut_frame(region, (enum gsn_axis)axis, centre, 80, &frame, &err), err);
        CHECK(frame.width == 80 || frame.height == 80);
        CHECK_OK(gsn_cut_spline(kuhn.spline, &frame, 0, &plane, &err), err);
        for (uint32_t j = 0; j < frame.height; j++) {
            for (uint32_t i = 0; i < frame.width; i++) {
                double u[3];

                u[axis] = frame.at_um;
                u[right] = frame.left_um + (i + 0.5) * frame.um_per_px;
                u[down] = frame.top_um + (j + 0.5) * frame.um_per_px;
                CHECK_NEAR((double)plane->value[j * frame.width + i], quadric_at(&field, u), 1e-7);
            }
        }
    }
    kuhn_done(&kuhn);
}

TEST(a_pixel_is_the_spline_at_its_centre_on_any_axis_and_any_number_of_threads)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 30, 20);
    const struct gsn_vec3 through = { 481.7, 399.3, 305.1 };
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_random(low, high, cells, 3, 0.05, 11, &kuhn, &err), err);
    for (int axis = 0; axis < 3; axis++) {
        struct gsn_cut_frame frame;
        gsn_auto(gsn_plane) one = NULL;
        gsn_auto(gsn_plane) two = NULL;
        size_t hint = 0;

        CHECK_OK(gsn_cut_frame(region, (enum gsn_axis)axis, through, 150, &frame, &err), err);
        CHECK_OK(gsn_cut_spline(kuhn.spline, &frame, 1, &one, &err), err);
        CHECK_OK(gsn_cut_spline(kuhn.spline, &frame, 2, &two, &err), err);
        CHECK(memcmp(one->value, two->value,
                     (size_t)frame.width * frame.height * sizeof *one->value) == 0);
        for (uint32_t j = 0; j < frame.height; j++) {
            for (uint32_t i = 0; i < frame.width; i++) {
                const struct gsn_vec3 p = gsn_cut_pixel(&frame, i, j);
                const double u[3] = { p.x, p.y, p.z };
                double truth;

                CHECK_NEAR(u[axis], frame.at_um, 0.0);
                CHECK(gsn_spline_eval(kuhn.spline, u, &hint, &truth, NULL) == GSN_OK);
                /* Half a unit in the last place of a float below 1. */
                CHECK_NEAR((double)one->value[j * frame.width + i], truth, 6e-8);
            }
        }
    }
    kuhn_done(&kuhn);
}

TEST(a_frame_that_is_nowhere_is_refused)
{
    const struct gsn_cut_frame frame = {
        .axis = GSN_AXIS_Y, .at_um = NAN, .um_per_px = 30.0, .width = 6, .height = 5
    };
    struct gsn_plane *plane = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    CHECK(gsn_cut_spline(kuhn.spline, &frame, 1, &plane, &err) == GSN_E_INPUT);
    CHECK(plane == NULL && strstr(err.text, "not finite") != NULL);
    kuhn_done(&kuhn);
}

TEST(a_frame_holds_the_region_with_a_margin_on_both_sides)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 30, 20);
    const struct gsn_vec3 through = { 500.0, 400.0, 300.0 };
    struct gsn_cut_frame frame;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_cut_frame(region, GSN_AXIS_Y, through, 106, &frame, &err), err);
    CHECK_NEAR(frame.at_um, 400.0, 0.0);
    CHECK_NEAR(frame.um_per_px, 960.0 * 1.06 / 106.0, 1e-12);
    CHECK_NEAR(frame.left_um, 120.0 - 28.8, 1e-9);
    CHECK_NEAR(frame.top_um, 48.0 - 28.8, 1e-9);
    CHECK(frame.width == 106);
    CHECK(frame.height == 56); /* (480 + 2 * 28.8) / 9.6 = 56 */
}

TEST(beyond_the_domain_there_is_no_data_and_no_zero)
{
    const struct gsn_cut_frame frame = { .axis = GSN_AXIS_Z,
                                         .at_um = 300.0,
                                         .left_um = -300.0,
                                         .top_um = -300.0,
                                         .um_per_px = 30.0,
                                         .width = 60,
                                         .height = 50 };
    const struct gsn_cut_style style = { .low = 0.0, .high = 1.0, .map = GSN_MAP_GREY };
    gsn_auto(gsn_plane) plane = NULL;
    gsn_auto(gsn_image) image = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    size_t hatched = 0;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    CHECK_OK(gsn_cut_spline(kuhn.spline, &frame, 0, &plane, &err), err);
    CHECK_OK(gsn_cut_paint(plane, &frame, NULL, &style, &image, &err), err);
    for (uint32_t j = 0; j < 50; j++) {
        for (uint32_t i = 0; i < 60; i++) {
            const double x = -300.0 + 30.0 * (i + 0.5), y = -300.0 + 30.0 * (j + 0.5);
            const int outside = x < 0.0 || x > 1200.0 || y < 0.0 || y > 900.0;
            /* Values are pure grey in this map, the hatching is bluish. */
            const int drawn =
                gsn_image_at(image, 12 + i, 12 + j, 0) != gsn_image_at(image, 12 + i, 12 + j, 2);
            const int blank = isnan((double)plane->value[j * 60 + i]) ? 1 : 0;

            CHECK(outside == blank);
            CHECK(outside == drawn);
            hatched += drawn ? 1U : 0U;
        }
    }
    CHECK(hatched == 60 * 50 - 40 * 30);
    kuhn_done(&kuhn);
}

TEST(a_grid_is_shown_voxel_by_voxel_with_its_gaps)
{
    const struct gsn_lattice at = { 4, 3, 2, { 0.0, 0.0, 0.0 }, { 10.0, 10.0, 20.0 } };
    const struct gsn_cut_frame frame = { .axis = GSN_AXIS_Z,
                                         .at_um = 19.0,
                                         .left_um = -15.0,
                                         .top_um = -5.0,
                                         .um_per_px = 5.0,
                                         .width = 12,
                                         .height = 6 };
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new(&at, &grid, &err), err);
    for (size_t i = 0; i < 24; i++)
        grid->value[i] = (float)i;
    grid->value[12 + 4 + 2] = NAN;
    CHECK_OK(gsn_cut_grid(grid, &frame, &plane, &err), err);
    for (uint32_t j = 0; j < 6; j++) {
        for (uint32_t i = 0; i < 12; i++) {
            const float value = plane->value[j * 12 + i];

            if (i < 2 || i >= 10 || (j / 2 == 1 && i / 2 == 3))
                CHECK(!(value >= 0.0F));
            else
                CHECK_NEAR((double)value, 12.0 + 4.0 * (j / 2) + (i / 2 - 1), 0.0);
        }
    }
}

TEST(true_colours_are_shown_voxel_by_voxel_and_a_missing_section_is_hatched)
{
    const struct gsn_lattice at = { 4, 4, 2, { 12, 12, 12 }, { 24, 24, 24 } };
    const struct gsn_cut_frame frame = { GSN_AXIS_Z, 12, 0, 0, 24, 4, 4 };
    gsn_auto(gsn_colour_grid) grid = NULL;
    gsn_auto(gsn_image) image = NULL;
    gsn_auto(gsn_image) gap = NULL;
    struct gsn_cut_frame missing = frame;
    struct gsn_error err = { 0 };
    size_t seen = 0, same = 0;

    CHECK_OK(gsn_colour_grid_new(&at, &grid, &err), err);
    for (size_t i = 0; i < 16; i++)
        memcpy(grid->rgb + 3 * i, (const uint8_t[3]){ 201, 17, (uint8_t)(40 + i) }, 3);
    CHECK_OK(gsn_cut_colour(grid, &frame, NULL, NULL, &image, &err), err);
    missing.at_um = 36;
    CHECK_OK(gsn_cut_colour(grid, &missing, NULL, NULL, &gap, &err), err);
    for (uint32_t y = 0; y < image->height; y++)
        for (uint32_t x = 0; x < image->width; x++) {
            const unsigned b = gsn_image_at(image, x, y, 2);

            seen += gsn_image_at(image, x, y, 0) == 201 && gsn_image_at(image, x, y, 1) == 17 &&
                    b >= 40 && b < 56;
            same += gsn_image_at(gap, x, y, 0) == 201 && gsn_image_at(gap, x, y, 1) == 17;
        }
    CHECK(seen == 16 && same == 0);
}

TEST(the_centre_of_a_hollow_region_is_in_the_region)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 9, 9, 9);
    struct gsn_vec3 centre;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < 729; i++) {
        const size_t x = i % 9, y = i / 9 % 9, z = i / 81;

        region->inside[i] = x < 2 || y < 2 || z < 2 || x > 6 || y > 6 || z > 6;
    }
    CHECK_OK(gsn_cut_centre(region, &centre, &err), err);
    CHECK(gsn_mask_has(region, centre));
    memset(region->inside, 0, 729);
    CHECK(gsn_cut_centre(region, &centre, &err) == GSN_E_INPUT);
    struct gsn_cut_frame frame;
    CHECK(gsn_cut_frame(region, GSN_AXIS_X, centre, 50, &frame, &err) == GSN_E_INPUT);
}

TEST(the_range_is_that_of_the_region_with_data)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 2, 2, 1);
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };
    double least, most;

    CHECK_OK(gsn_grid_new(&region->at, &grid, &err), err);
    grid->value[0] = 9.0F;
    region->inside[0] = 0;
    grid->value[1] = 0.25F;
    grid->value[2] = NAN;
    grid->value[3] = 0.5F;
    gsn_cut_range(grid, region, &least, &most);
    CHECK_NEAR(least, 0.25, 0.0);
    CHECK_NEAR(most, 0.5, 0.0);
    region->inside[3] = 0;
    gsn_cut_range(grid, region, &least, &most);
    CHECK_NEAR(least, 0.25, 0.0);
    CHECK_NEAR(most, 1.25, 0.0);
    memset(region->inside, 0, 4);
    gsn_cut_range(grid, region, &least, &most);
    CHECK_NEAR(least, 0.0, 0.0);
    CHECK_NEAR(most, 1.0, 0.0);
}

/* Everything from the spline to the sheet. */
static int whole_cut(const struct kuhn *kuhn, const struct gsn_mask *region, unsigned threads,
                     struct gsn_image **ret_image, struct gsn_error *err)
{
    const struct gsn_cut_style style = { .title = "S02, model", .unit = "collagen" };
    const struct gsn_vec3 through = { 500.0, 400.0, 300.0 };
    struct gsn_cut_frame frame;
    gsn_auto(gsn_plane) plane = NULL;
    int r = gsn_cut_frame(region, GSN_AXIS_Z, through, 60, &frame, err);

    if (r == GSN_OK)
        r = gsn_cut_spline(kuhn->spline, &frame, threads, &plane, err);
    if (r == GSN_OK)
        r = gsn_cut_paint(plane, &frame, region, &style, ret_image, err);
    return r;
}

TEST(one_and_two_threads_paint_the_same_picture_and_it_has_an_outline)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 30, 20);
    gsn_auto(gsn_image) one = NULL;
    gsn_auto(gsn_image) two = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    size_t red = 0;

    CHECK_OK(kuhn_random(low, high, cells, 2, 0.05, 3, &kuhn, &err), err);
    CHECK_OK(whole_cut(&kuhn, region, 1, &one, &err), err);
    CHECK_OK(whole_cut(&kuhn, region, 2, &two, &err), err);
    CHECK(gsn_image_bytes(one) == gsn_image_bytes(two));
    CHECK(memcmp(one->samples, two->samples, gsn_image_bytes(one)) == 0);
    for (uint32_t y = 0; y < one->height; y++) {
        for (uint32_t x = 0; x < one->width; x++)
            red += gsn_image_at(one, x, y, 0) > 150 && gsn_image_at(one, x, y, 1) < 110;
    }
    /* About the perimeter of 56 x 42 pixels, on one or both sides of the edge. */
    CHECK(red > 150 && red < 450);
    kuhn_done(&kuhn);
}

static int once(const struct kuhn *kuhn, const struct gsn_mask *region, struct gsn_error *err)
{
    gsn_auto(gsn_image) image = NULL;

    return whole_cut(kuhn, region, 1, &image, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 30, 20);
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    CHECK_EVERY_OOM(once(&kuhn, region, &err), err);
    kuhn_done(&kuhn);
}
