/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/illumination_drift.h"

#include "tests/check.h"
#include "tests/stain/paint.h"

#include <string.h>

enum { WIDTH = 600, HEIGHT = 440 };

struct planes {
    struct gsn_plane *od[3];
};

static void planes_done(struct planes *p)
{
    for (int c = 0; c < 3; c++)
        gsn_plane_free(p->od[c]);
}
#define planes_auto __attribute__((cleanup(planes_done))) struct planes

/* Glass with noise, half of it under red tissue; the light of each row and column as told. */
static struct planes drawn(double (*row)(int), double (*column)(int))
{
    struct planes p = { { NULL, NULL, NULL } };
    struct dice dice = { 3 };
    struct gsn_error err = { 0 };

    for (int c = 0; c < 3; c++)
        CHECK_OK(gsn_plane_new(WIDTH, HEIGHT, &p.od[c], &err), err);
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++)
            for (int c = 0; c < 3; c++) {
                const double tissue = (x / 100 + y / 100) % 2 ? 0 : 0.2 * (1 + c);

                p.od[c]->value[y * WIDTH + x] =
                    (float)(tissue + row(y) + column(x) + 0.006 * dice_normal(&dice));
            }
    return p;
}

static double steady(int at)
{
    (void)at;
    return 0;
}

static double flicker(int at)
{
    return 0.02 * sin(at * 2 * M_PI / 200);
}

static const struct gsn_pixel_box ALL = { 0, 0, WIDTH, HEIGHT };

TEST(a_steady_lamp_leaves_only_noise)
{
    planes_auto p = drawn(steady, steady);
    const struct gsn_illumination lamp = gsn_illumination_drift(p.od, &ALL);

    /* 0.006 of a pixel and channel is 0.006 / 8 / sqrt(3) of a block. */
    CHECK_NEAR(lamp.residual, 0.006 / 8 / sqrt(3), 1e-4);
    CHECK(lamp.rows < 0.001 && lamp.columns < 0.001);
}

/* Case 8. A sine of amplitude a has 2 a between its bands and a / sqrt(2) in the mean square. */
TEST(a_lamp_that_flickers_is_measured_along_the_way_it_moves)
{
    planes_auto down = drawn(flicker, steady);
    planes_auto across = drawn(steady, flicker);
    struct gsn_illumination lamp = gsn_illumination_drift(down.od, &ALL);

    CHECK_NEAR(lamp.rows, 0.04, 0.002);
    CHECK(lamp.columns < 0.03);
    CHECK_NEAR(lamp.residual, 0.02 / sqrt(2), 0.001);
    lamp = gsn_illumination_drift(across.od, &ALL);
    CHECK_NEAR(lamp.columns, 0.04, 0.002);
}

TEST(a_picture_without_glass_tells_nothing)
{
    planes_auto p = drawn(steady, steady);
    struct gsn_illumination lamp;

    for (size_t i = 0; i < WIDTH * HEIGHT; i++)
        p.od[1]->value[i] += 0.3F;
    lamp = gsn_illumination_drift(p.od, &ALL);
    CHECK(isnan(lamp.rows) && isnan(lamp.columns) && isnan(lamp.residual));
    lamp = gsn_illumination_drift(p.od, &(struct gsn_pixel_box){ 0, 0, 0, 0 });
    CHECK(isnan(lamp.rows) && isnan(lamp.residual));
}
