/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/view.h"

#include <string.h>

#include "tests/check.h"
#include "tests/measure/kuhn.h"

static const double low[3] = { 100.0, 200.0, 300.0 }, high[3] = { 1100.0, 900.0, 700.0 };
static const unsigned cells[3] = { 1, 1, 1 };
static const struct quadric nothing = { 0.0, { 0.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };

TEST(looking_along_z_shows_the_scan_as_it_lies)
{
    const struct gsn_view view = {
        .direction = { 0, 0, 5 }, .up = { 0, -1, 0 }, .width = 300, .height = 200
    };
    const double corner[3] = { 100.0, 200.0, 300.0 }, right_of[3] = { 600.0, 200.0, 300.0 };
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    double p[2], q[2], depth;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &nothing, &kuhn, &err), err);
    CHECK_OK(gsn_camera_frame(&view, kuhn.mesh, &camera, &err), err);
    gsn_camera_project(&camera, corner, p, &depth);
    CHECK_NEAR(depth, -200.0, 1e-9);
    gsn_camera_project(&camera, right_of, q, &depth);
    /* x to the right, y down; 700 um fill 88 % of 200 px. */
    CHECK_NEAR(q[0] - p[0], 500.0 * 0.88 * 200.0 / 700.0, 1e-9);
    CHECK_NEAR(q[1], p[1], 1e-9);
    CHECK_NEAR(p[1], 12.0, 1e-9);
    kuhn_done(&kuhn);
}

TEST(every_vertex_is_in_the_picture_from_every_side)
{
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &nothing, &kuhn, &err), err);
    for (int i = 0; i < 40; i++) {
        const double theta = 0.3 + 0.06 * i, phi = 0.7 * i;
        const struct gsn_view view = { .direction = { sin(theta) * cos(phi), sin(theta) * sin(phi),
                                                      cos(theta) },
                                       .up = { 0.1, 0.2, -1.0 },
                                       .eye_distance = i % 2 ? 3.0 : 0.0,
                                       .width = 200,
                                       .height = 320 };
        struct gsn_camera camera;
        double reach = 0.0;

        CHECK_OK(gsn_camera_frame(&view, kuhn.mesh, &camera, &err), err);
        for (size_t v = 0; v < kuhn.mesh->vertex_count; v++) {
            double p[2], depth;

            gsn_camera_project(&camera, kuhn.mesh->vertex[v], p, &depth);
            CHECK(p[0] >= 11.9 && p[0] <= 188.1 && p[1] >= 19.1 && p[1] <= 300.9);
            reach = fmax(reach, fmax(fabs(p[0] - 100.0) / 100.0, fabs(p[1] - 160.0) / 160.0));
        }
        CHECK_NEAR(reach, 0.88, 1e-9);
    }
    kuhn_done(&kuhn);
}

TEST(a_view_that_shows_nothing_is_refused)
{
    struct gsn_view view = { .up = { 0, -1, 0 }, .width = 10, .height = 10 };
    struct gsn_camera camera, before;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    memset(&camera, 0x5a, sizeof camera);
    before = camera;
    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &nothing, &kuhn, &err), err);
    CHECK(gsn_camera_frame(&view, kuhn.mesh, &camera, &err) == GSN_E_INPUT);
    view.direction[1] = -3.0;
    CHECK(gsn_camera_frame(&view, kuhn.mesh, &camera, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "up is parallel") != NULL);
    view.direction[2] = 1.0;
    view.height = 0;
    CHECK(gsn_camera_frame(&view, kuhn.mesh, &camera, &err) == GSN_E_INPUT);
    CHECK(memcmp(&camera, &before, sizeof camera) == 0);
    kuhn_done(&kuhn);
}
