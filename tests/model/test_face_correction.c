/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/face_correction.h"

#include "tests/check.h"
#include "tests/model/golden.h"
#include "tests/model/kuhn.h"

#include "pipeline/model/bpatch.h"
#include "pipeline/model/spline.h"

#include <string.h>

/* s and its gradient by the identity of face_correction.h, from every face of the mesh. */
static int eval(const struct gsn_dms *space, const struct gsn_spline *spline, const double u[3],
                double *ret_value, double ret_slope[3])
{
    const double *at[3] = { &u[0], &u[1], &u[2] };
    double *slope[3] = { &ret_slope[0], &ret_slope[1], &ret_slope[2] };
    double bernstein[GSN_DMS_MAX_FUNCTIONS], lambda[4];
    struct gsn_barycentric frame;
    const uint32_t *v;
    size_t home;

    if (gsn_dms_locate(space, u, 0, &home) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    v = space->mesh->tet[home];
    gsn_barycentric_init(&frame, space->mesh->vertex[v[0]], space->mesh->vertex[v[1]],
                         space->mesh->vertex[v[2]], space->mesh->vertex[v[3]]);
    gsn_barycentric_at(&frame, u, lambda);
    gsn_spline_bernstein(spline, home, bernstein);
    *ret_value = gsn_bernstein_at(space->degree, bernstein, &frame, lambda, ret_slope);
    for (size_t t = 0; t < space->mesh->tet_count; t++) {
        for (unsigned k = 0; k < 4; k++) {
            struct gsn_prism prism;
            struct gsn_face_correction seam;
            int unclear;

            if (!gsn_prism_init(space, t, k, &prism))
                continue;
            unclear = gsn_prism_at(&prism, u);
            if (unclear < 0)
                continue;
            gsn_face_correction_init(&seam, space, &prism, gsn_spline_controls(spline));
            gsn_face_correction_add(&seam, (unsigned)unclear, at, 1, ret_value, slope);
        }
    }
    return GSN_OK;
}

static void check_golden(const struct golden_case *golden)
{
    struct golden_table points = golden_read(golden, "points");
    struct golden_table exact = golden_read(golden, "spline");
    const double steepest = golden_steepest(&exact);
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spline_new(golden->space, golden->control, &spline, &err), err);
    for (int isa = 0; isa < GSN_ISA_COUNT; isa++) {
        if (!gsn_kernels_for((enum gsn_isa)isa))
            continue;
        gsn_dms_use(golden->space, gsn_kernels_for((enum gsn_isa)isa));
        for (size_t p = 0; p < points.rows; p++) {
            const double *row = golden_row(&exact, p);
            double value, slope[3];

            if (eval(golden->space, spline, golden_row(&points, p) + 2, &value, slope) != GSN_OK)
                continue;
            CHECK_NEAR(value, row[2], 1e-12);
            for (int c = 0; c < 3; c++)
                CHECK_NEAR(slope[c], row[3 + c], 1e-10 * steepest);
        }
    }
    gsn_spline_free(spline);
    golden_done(&points);
    golden_done(&exact);
}

TEST(the_seams_complete_the_polynomials_to_the_exact_spline)
{
    golden_each("spline", check_golden);
}

/* The mean over a tetrahedron of the mesh: its polynomial's, and what every face adds in it. */
static double mean_over(const struct gsn_dms *space, const struct gsn_spline *spline, size_t tet)
{
    const struct gsn_tets *mesh = space->mesh;
    const size_t functions = gsn_dms_functions(space);
    double bernstein[GSN_DMS_MAX_FUNCTIONS], corner[4][3], mean = 0;

    gsn_spline_bernstein(spline, tet, bernstein);
    for (size_t f = 0; f < functions; f++)
        mean += bernstein[f] / (double)functions;
    for (int k = 0; k < 4; k++)
        memcpy(corner[k], mesh->vertex[mesh->tet[tet][k]], sizeof corner[k]);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (unsigned k = 0; k < 4; k++) {
            static struct gsn_face_correction seam;
            struct gsn_prism prism;

            if (!gsn_prism_init(space, t, k, &prism))
                continue;
            gsn_face_correction_init(&seam, space, &prism, gsn_spline_controls(spline));
            mean += gsn_face_correction_integral(&seam, (const double(*)[3])corner) /
                    gsn_tets_volume(mesh, tet);
        }
    }
    return mean;
}

static void check_means(const struct golden_case *golden)
{
    struct golden_table exact = golden_read(golden, "cells");
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };
    size_t found = 0;

    CHECK_OK(gsn_spline_new(golden->space, golden->control, &spline, &err), err);
    for (size_t i = 0; i < exact.rows; i++) {
        const double *row = golden_row(&exact, i);

        for (size_t t = 0; t < golden->mesh->tet_count; t++) {
            int same = 1;

            for (int k = 0; k < 4; k++)
                same = same && memcmp(golden->mesh->vertex[golden->mesh->tet[t][k]],
                                      row + 2 + 3 * k, 3 * sizeof *row) == 0;
            if (!same)
                continue;
            CHECK_NEAR(mean_over(golden->space, spline, t), row[15], 1e-12);
            found++;
        }
    }
    CHECK(found > 0 || exact.rows == 0);
    gsn_spline_free(spline);
    golden_done(&exact);
}

TEST(the_seams_complete_the_mean_over_a_tetrahedron)
{
    golden_each("cells", check_means);
}

enum { ROOM = 4096 };

/* s and its gradient by the recurrence, over all functions. */
static int sum_basis(const struct gsn_dms *space, const double *control, const double u[3],
                     double *ret_value, double ret_slope[3])
{
    static struct gsn_dms_term term[ROOM];
    size_t count, hint = 0;

    if (gsn_dms_basis(space, u, 1, &hint, term, ROOM, &count) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    CHECK(count <= ROOM);
    *ret_value = ret_slope[0] = ret_slope[1] = ret_slope[2] = 0;
    for (size_t i = 0; i < count; i++) {
        *ret_value += control[term[i].control] * term[i].value;
        for (int c = 0; c < 3; c++)
            ret_slope[c] += control[term[i].control] * term[i].gradient[c];
    }
    return GSN_OK;
}

/* A point of tetrahedron t, often near a face, an edge or a vertex, or exactly on one. */
static void draw_near(const struct gsn_tets *mesh, size_t t, uint64_t *seed, double ret_u[3])
{
    static const double share[5] = { 1, 1, 0.05, 0.01, 0 };
    double lambda[4], sum = 0;

    for (int k = 0; k < 4; k++)
        sum += lambda[k] = 1e-6 + share[(int)(5 * draw(seed))] * draw(seed);
    for (int c = 0; c < 3; c++) {
        ret_u[c] = 0;
        for (int k = 0; k < 4; k++)
            ret_u[c] += lambda[k] / sum * mesh->vertex[mesh->tet[t][k]][c];
    }
}

static void compare(struct gsn_dms *space, uint64_t *seed, double tolerance, double steep_tolerance)
{
    const size_t controls = gsn_dms_controls(space), tets = gsn_dms_mesh(space)->tet_count;
    double *control = gsn_alloc_array(controls, sizeof *control);
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };
    size_t compared = 0;

    assert_non_null(control);
    for (size_t i = 0; i < controls; i++)
        control[i] = 2 * draw(seed) - 1;
    CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
    for (size_t i = 0; i < 4 * tets; i++) {
        double u[3], value, slope[3], exact, steep[3];

        draw_near(gsn_dms_mesh(space), i / 4, seed, u);
        if (sum_basis(space, control, u, &exact, steep) != GSN_OK)
            continue;
        CHECK(eval(space, spline, u, &value, slope) == GSN_OK);
        CHECK_NEAR(value, exact, tolerance);
        for (int c = 0; c < 3; c++)
            CHECK_NEAR(slope[c], steep[c], steep_tolerance);
        compared++;
    }
    CHECK(compared > tets);
    gsn_spline_free(spline);
    gsn_free(control);
}

TEST(shared_and_own_control_points_agree_with_the_recurrence_at_all_cloud_sizes)
{
    const size_t cells[3] = { 2, 2, 2 };
    const double fraction[3] = { 1e-3, 0.03, 0.3 };
    uint64_t seed = 5;

    for (unsigned degree = 1; degree <= 3; degree++) {
        for (int f = 0; f < 3; f++) {
            for (int own = 0; own < 2; own++) {
                gsn_auto(gsn_dms) space =
                    kuhn_space(cells, 0.2, degree, fraction[f], own ? GSN_DMS_OWN : GSN_DMS_SHARED);

                /* Own control points make cliffs as steep as the clouds are small. */
                compare(space, &seed, own ? 1e-12 + 2e-14 / fraction[f] : 1e-12,
                        1e-9 / fraction[f]);
            }
        }
    }
}

/* Vertices on a grid, and points on its planes: nearly every sign is undecided in floating point.
 */
TEST(points_in_mesh_planes_agree_with_the_recurrence)
{
    const size_t cells[3] = { 2, 2, 2 };

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(cells, 0, degree, 0.05, GSN_DMS_SHARED);
        const size_t controls = gsn_dms_controls(space);
        double *control = gsn_alloc_array(controls, sizeof *control);
        struct gsn_spline *spline = NULL;
        struct gsn_error err = { 0 };
        uint64_t seed = 6;

        assert_non_null(control);
        for (size_t i = 0; i < controls; i++)
            control[i] = draw(&seed);
        CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
        for (int i = 0; i < 8 * 8 * 8; i++) {
            const double u[3] = { 0.25 * (i % 8), 0.25 * (i / 8 % 8), 0.25 * (i / 64) };
            double value, slope[3], exact, steep[3];

            CHECK(sum_basis(space, control, u, &exact, steep) == GSN_OK);
            CHECK(eval(space, spline, u, &value, slope) == GSN_OK);
            CHECK_NEAR(value, exact, 1e-12);
            for (int c = 0; c < 3; c++)
                CHECK_NEAR(slope[c], steep[c], 1e-9);
        }
        gsn_spline_free(spline);
        gsn_free(control);
    }
}

/* A space whose clouds have knots in common places: t_1 = t_0, or t_2 = t_1, or all in one. */
static struct gsn_dms *coinciding(unsigned degree, int how, enum gsn_dms_sharing sharing)
{
    const size_t cells[3] = { 2, 1, 1 };
    gsn_auto(gsn_dms) model = kuhn_space(cells, 0.2, degree, 0.1, sharing);
    const size_t vertices = gsn_dms_mesh(model)->vertex_count;
    double(*knot)[3] = gsn_memdup(gsn_dms_knots(model), vertices * (degree + 1) * sizeof *knot);
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    assert_non_null(knot);
    for (size_t i = 0; i < vertices; i++) {
        double(*cloud)[3] = &knot[i * (degree + 1)];

        for (unsigned l = 1; l <= degree; l++) {
            if (how == 2 || (how == 0 && l == 1) || (how == 1 && l == degree))
                memcpy(cloud[l], cloud[l - 1], sizeof *cloud);
        }
    }
    CHECK_OK(
        gsn_dms_new(gsn_dms_mesh(model), degree, (const double(*)[3])knot, sharing, &space, &err),
        err);
    gsn_free(knot);
    return space;
}

TEST(coinciding_knots_agree_with_the_recurrence)
{
    uint64_t seed = 7;

    for (unsigned degree = 1; degree <= 3; degree++) {
        for (int how = 0; how < 3; how++) {
            for (int own = 0; own < 2; own++) {
                gsn_auto(gsn_dms) space =
                    coinciding(degree, how, own ? GSN_DMS_OWN : GSN_DMS_SHARED);

                compare(space, &seed, 1e-12, 1e-8);
            }
        }
    }
}

/* Every lane does what the scalar version does, in the same order. */
TEST(all_instruction_sets_give_the_same_bits)
{
    const size_t cells[3] = { 2, 2, 2 };
    uint64_t seed = 8;
    size_t used = 0;

    for (int i = 0; i < 6; i++) {
        const unsigned degree = 1 + (unsigned)i % 3;
        gsn_auto(gsn_dms) space =
            kuhn_space(cells, 0.2, degree, 0.1, i < 3 ? GSN_DMS_SHARED : GSN_DMS_OWN);
        double *control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);

        assert_non_null(control);
        for (size_t c = 0; c < gsn_dms_controls(space); c++)
            control[c] = draw(&seed);
        for (size_t t = 0; t < gsn_dms_mesh(space)->tet_count; t++) {
            double found[GSN_ISA_COUNT][4][11] = { 0 }, u[3][11] = { 0 };
            const double *at[3] = { u[0], u[1], u[2] };
            struct gsn_prism prism;

            if (!gsn_prism_init(space, t, 1, &prism))
                continue;
            for (size_t p = 0, tries = 0; p < 11; tries++) {
                double point[3];

                draw_near(gsn_dms_mesh(space), t, &seed, point);
                if (gsn_prism_at(&prism, point) < 0 && tries < 1000)
                    continue;
                for (int c = 0; c < 3; c++)
                    u[c][p] = point[c];
                p++;
            }
            for (int isa = 0; isa < GSN_ISA_COUNT; isa++) {
                double *slope[3] = { found[isa][1], found[isa][2], found[isa][3] };
                struct gsn_face_correction seam;

                if (!gsn_kernels_for((enum gsn_isa)isa))
                    continue;
                gsn_dms_use(space, gsn_kernels_for((enum gsn_isa)isa));
                gsn_face_correction_init(&seam, space, &prism, control);
                gsn_face_correction_add(&seam, 7, at, 11, found[isa][0], slope);
                CHECK(memcmp(found[isa], found[0], sizeof found[0]) == 0);
                used++;
            }
        }
        gsn_free(control);
    }
    CHECK(used > 100);
}

TEST(a_face_that_only_carries_the_hat_functions_has_no_seam)
{
    const size_t cells[3] = { 1, 1, 1 };
    gsn_auto(gsn_dms) space = kuhn_space(cells, 0, 1, 0.1, GSN_DMS_SHARED);
    struct gsn_prism prism;

    for (size_t t = 0; t < gsn_dms_mesh(space)->tet_count; t++) {
        for (unsigned k = 0; k < 4; k++)
            CHECK(!gsn_prism_init(space, t, k, &prism));
    }
}

/* The other tests take what there is. */
TEST(every_instruction_set_was_there_to_be_tested)
{
    static const char *const name[GSN_ISA_COUNT] = { "scalar", "AVX2", "AVX-512" };

    for (int isa = 0; isa < GSN_ISA_COUNT; isa++)
        if (!gsn_kernels_for((enum gsn_isa)isa))
            gsn_check_skip("this processor has no %s, its kernels were not tested", name[isa]);
    CHECK(gsn_kernels_best() == gsn_kernels_for(GSN_ISA_AVX512));
}
