/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/free_knots.h"

#include "tests/check.h"
#include "tests/model/test_domain_shapes.h"

#include <string.h>

enum { GRID = 16 };

/* A wall, soft over some um, that no mesh knows of. */
static double wall(const double u[3])
{
    return 0.5 + 0.5 * tanh((u[0] + 0.35 * u[1] - 0.2 * u[2] - 44) / 6);
}

static double linear(const double u[3])
{
    return u[0] / 4 - u[1] / 8 + u[2] / 2;
}

struct moved {
    struct gsn_dms *fixed, *space;
    struct gsn_spline *spline;
    struct gsn_free_knots_report report;
};

static void moved_done(struct moved *m)
{
    gsn_spline_free(m->spline);
    gsn_dms_free(m->space);
    gsn_dms_free(m->fixed);
}

static int move(double (*f)(const double u[3]), unsigned degree, unsigned steps, struct moved *ret,
                struct gsn_error *err)
{
    gsn_auto(gsn_mask) region = shape_mask(8, 8, 8, 10, 10, 10, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 40, 30000);
    struct shape_samples grid = shape_grid(0, 80, GRID, f);
    const struct gsn_free_knots_options options = { .fit = { .smoothing = 1e-8 },
                                                    .vertex_steps = steps,
                                                    .cloud_steps = steps / 4 };
    double(*knots)[3] = NULL;
    int r;

    CHECK_OK(gsn_dms_clouds(mesh, degree, 0.015, &knots, err), *err);
    CHECK_OK(gsn_dms_new(mesh, degree, (const double(*)[3])knots, GSN_DMS_SHARED, &ret->fixed, err),
             *err);
    gsn_free(knots);
    r = gsn_free_knots(ret->fixed, &grid.samples, &options, &ret->space, &ret->spline, &ret->report,
                       err);
    shape_samples_done(&grid);
    return r;
}

TEST(knots_that_may_move_follow_a_wall_better)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        struct moved m = { .space = NULL };
        struct gsn_error err = { 0 };

        CHECK_OK(move(wall, degree, 12, &m, &err), err);
        print_message(
            "  degree %u: %zu unknowns, rms %.2e, with moved vertices %.2e (%u steps), with "
            "moved knots %.2e (%u steps)\n",
            degree, m.report.fit.unknowns, m.report.rms_fixed, m.report.rms_vertices,
            m.report.vertex_steps, m.report.fit.rms, m.report.cloud_steps);
        CHECK(m.report.rms_vertices < 0.8 * m.report.rms_fixed);
        CHECK(m.report.fit.rms <= m.report.rms_vertices);
        moved_done(&m);
    }
}

TEST(the_domain_stays_and_the_result_is_the_fit_on_the_moved_knots)
{
    struct moved m = { .space = NULL };
    struct gsn_error err = { 0 };
    const struct gsn_tets *before, *after;
    double was = 0, is = 0;
    size_t gone = 0;

    CHECK_OK(move(wall, 2, 4, &m, &err), err);
    before = gsn_dms_mesh(m.fixed);
    after = gsn_dms_mesh(m.space);
    CHECK(after->tet_count == before->tet_count && after->vertex_count == before->vertex_count);
    for (size_t p = 0; p < before->vertex_count; p++) {
        const double *u = before->vertex[p], *v = after->vertex[p];

        gone += u[0] != v[0] || u[1] != v[1] || u[2] != v[2] ? 1 : 0;
        CHECK(memcmp(gsn_dms_knots(m.space)[3 * p], v, 3 * sizeof *v) == 0);
    }
    CHECK(gone > 0);
    /* A border that moved would change how large the domain is. */
    for (size_t t = 0; t < before->tet_count; t++) {
        was += gsn_tets_volume(before, t);
        is += gsn_tets_volume(after, t);
    }
    CHECK_NEAR(is, was, 1e-12 * was);
    CHECK(gsn_spline_space(m.spline) == m.space);
    moved_done(&m);
}

TEST(what_the_space_holds_already_moves_nothing)
{
    struct moved m = { .space = NULL };
    struct gsn_error err = { 0 };

    CHECK_OK(move(linear, 2, 4, &m, &err), err);
    CHECK(m.report.rms_fixed < 1e-3 && m.report.fit.rms > 0.98 * m.report.rms_fixed);
    moved_done(&m);
}

/* The same steps on any day: nothing is drawn, and threads only share a fit. */
TEST(the_same_input_gives_the_same_knots)
{
    struct moved a = { .space = NULL }, b = a;
    struct gsn_error err = { 0 };

    CHECK_OK(move(wall, 2, 2, &a, &err), err);
    CHECK_OK(move(wall, 2, 2, &b, &err), err);
    CHECK(memcmp(gsn_dms_knots(a.space), gsn_dms_knots(b.space),
                 3 * gsn_dms_mesh(a.space)->vertex_count * sizeof(double[3])) == 0);
    moved_done(&a);
    moved_done(&b);
}

TEST(samples_outside_are_refused_as_by_a_fit)
{
    struct moved m = { .space = NULL };
    struct gsn_error err = { 0 };
    const double at[1][3] = { { 900, 0, 0 } };
    const float value[1] = { 1 };
    const struct gsn_samples samples = { .count = 1, .at = at, .value = value };
    const struct gsn_free_knots_options options = { .fit = { .smoothing = 1e-6 } };
    struct gsn_dms *space = NULL;
    struct gsn_spline *spline = NULL;
    struct gsn_free_knots_report report;

    CHECK_OK(move(wall, 1, 0, &m, &err), err);
    CHECK(gsn_free_knots(m.fixed, &samples, &options, &space, &spline, &report, &err) ==
          GSN_E_INPUT);
    CHECK(!space && !spline);
    moved_done(&m);
}

static int move_once(const struct gsn_dms *fixed, const struct gsn_samples *samples,
                     struct gsn_error *err)
{
    const struct gsn_free_knots_options options = { .fit = { .smoothing = 1e-6, .threads = 1 },
                                                    .vertex_steps = 1,
                                                    .cloud_steps = 1 };
    struct gsn_free_knots_report report;
    struct gsn_dms *space = NULL;
    struct gsn_spline *spline = NULL;
    const int r = gsn_free_knots(fixed, samples, &options, &space, &spline, &report, err);

    gsn_spline_free(spline);
    gsn_dms_free(space);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct moved m = { .space = NULL };
    struct shape_samples grid = shape_grid(0, 80, 8, wall);
    struct gsn_error err = { 0 };

    CHECK_OK(move(wall, 1, 0, &m, &err), err);
    CHECK_EVERY_OOM(move_once(m.fixed, &grid.samples, &err), err);
    shape_samples_done(&grid);
    moved_done(&m);
}
