/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Exact values on every quick way and every instruction set of the processor. */
#include "tests/model/golden.h"

#include "tests/check.h"
#include "tests/model/paths.h"

#include <string.h>

struct expected {
    const struct gsn_spline *spline;
    struct golden_table points, exact;
    double (*at)[3], *value, (*slope)[3];
    double steepest;
    double gap, slope_gap; /* largest found, of all ways */
    size_t outside;
};

static void expected_init(struct expected *e, const struct golden_case *golden,
                          const struct gsn_spline *spline)
{
    *e = (struct expected){ .spline = spline,
                            .points = golden_read(golden, "points"),
                            .exact = golden_read(golden, "spline") };
    e->at = gsn_alloc_array(e->points.rows, sizeof *e->at);
    e->value = gsn_alloc_array(e->points.rows, sizeof *e->value);
    e->slope = gsn_alloc_array(e->points.rows, sizeof *e->slope);
    for (size_t p = 0; p < e->points.rows; p++) {
        size_t home;

        memcpy(e->at[p], golden_row(&e->points, p) + 2, sizeof *e->at);
        for (int c = 0; c < 3; c++)
            e->steepest = fmax(e->steepest, fabs(golden_row(&e->exact, p)[3 + c]));
        e->outside += gsn_dms_locate(golden->space, e->at[p], 0, &home) == GSN_DMS_OUTSIDE;
    }
}

static void expected_done(struct expected *e)
{
    golden_done(&e->points);
    golden_done(&e->exact);
    gsn_free(e->at);
    gsn_free(e->value);
    gsn_free(e->slope);
}

static void check_point(struct expected *e, enum path path, size_t p)
{
    const double *row = golden_row(&e->exact, p);

    CHECK_NEAR(e->value[p], row[2], 1e-12);
    e->gap = fmax(e->gap, fabs(e->value[p] - row[2]));
    for (int c = 0; path_has_slope(path) && c < 3; c++) {
        CHECK_NEAR(e->slope[p][c], row[3 + c], 1e-10 * e->steepest);
        e->slope_gap = fmax(e->slope_gap, fabs(e->slope[p][c] - row[3 + c]) / e->steepest);
    }
}

static void check_ways(void *context, const char *name)
{
    struct expected *e = context;

    (void)name;
    for (enum path path = PATH_EVAL; path < PATHS; path++) {
        size_t outside = 0;

        path_run(path, e->spline, (const double(*)[3])e->at, e->points.rows, e->value, e->slope);
        for (size_t p = 0; p < e->points.rows; p++) {
            outside += isnan(e->value[p]) != 0;
            CHECK(strcmp(e->points.kind[p], isnan(e->value[p]) ? "inside" : "outside") != 0);
            if (!isnan(e->value[p]))
                check_point(e, path, p);
        }
        CHECK(outside == e->outside);
    }
}

/* Outside of the mesh the product has no data, and the formula has values: on a larger mesh, of
 * which they are inside. */
static void check_ways_beyond(void *context, const char *name)
{
    struct expected *e = context;

    (void)name;
    for (enum path path = PATH_EVAL; path < PATHS; path++) {
        path_run(path, e->spline, (const double(*)[3])e->at, e->points.rows, e->value, e->slope);
        for (size_t p = 0; p < e->points.rows; p++) {
            if (strcmp(e->points.kind[p], "outside") != 0)
                continue;
            CHECK(isfinite(e->value[p]) != 0);
            check_point(e, path, p);
        }
    }
}

static void check_case(const struct golden_case *golden)
{
    gsn_auto(gsn_spline) spline = golden_spline(golden);
    struct golden_larger larger = golden_enlarge(golden);
    struct expected e;

    expected_init(&e, golden, spline);
    path_each_isa(golden->space, check_ways, &e);
    print_message("    largest errors: s %.1e, gradient %.1e of the largest\n", e.gap, e.slope_gap);
    e.spline = larger.spline;
    path_each_isa(larger.space, check_ways_beyond, &e);
    print_message("    with those outside: s %.1e, gradient %.1e\n", e.gap, e.slope_gap);
    expected_done(&e);
    golden_larger_done(&larger);
}

TEST(every_quick_way_has_the_exact_values_and_gradients_on_every_instruction_set)
{
    golden_each("spline", check_case);
}

struct means {
    const struct golden_case *golden;
    const struct gsn_spline *spline;
    struct golden_table exact;
    double gap;
    size_t found;
};

static int is_cell(const struct gsn_tets *mesh, size_t tet, const double *corners)
{
    for (int k = 0; k < 4; k++) {
        if (memcmp(mesh->vertex[mesh->tet[tet][k]], corners + 3 * k, sizeof *mesh->vertex) != 0)
            return 0;
    }
    return 1;
}

static void check_tets(void *context, const char *name)
{
    struct means *means = context;
    struct gsn_error err = { 0 };

    (void)name;
    for (size_t i = 0; i < means->exact.rows; i++) {
        const double *row = golden_row(&means->exact, i);

        for (size_t t = 0; t < means->golden->mesh->tet_count; t++) {
            double mean;

            if (!is_cell(means->golden->mesh, t, row + 2))
                continue;
            CHECK_OK(gsn_spline_tet_mean(means->spline, t, &mean, &err), err);
            CHECK_NEAR(mean, row[15], 1e-12);
            means->gap = fmax(means->gap, fabs(mean - row[15]));
            means->found++;
        }
    }
}

static void check_means(const struct golden_case *golden)
{
    gsn_auto(gsn_spline) spline = golden_spline(golden);
    struct means means = { .golden = golden, .spline = spline };

    means.exact = golden_read(golden, "cells");
    path_each_isa(golden->space, check_tets, &means);
    CHECK(means.found > 0 || means.exact.rows == 0);
    print_message("    largest error of a mean: %.1e\n", means.gap);
    golden_done(&means.exact);
}

TEST(means_over_tetrahedra_of_the_mesh_are_exact)
{
    golden_each("cells", check_means);
}
