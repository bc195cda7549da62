/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/resample.h"

#include "tests/check.h"
#include "tests/model/kuhn.h"

#include <string.h>

enum { TERMS = 4000 };

/* s by its definition, the sum of all functions; NaN outside. */
static double by_definition(const struct kuhn_made *made, const double u[3], size_t *hint)
{
    static struct gsn_dms_term term[TERMS];
    size_t count;
    double sum = 0;

    if (gsn_dms_basis(made->space, u, 0, hint, term, TERMS, &count) != GSN_OK)
        return NAN;
    CHECK(count <= TERMS);
    for (size_t i = 0; i < count; i++)
        sum += gsn_spline_controls(made->spline)[term[i].control] * term[i].value;
    return sum;
}

static double *resampled(const struct kuhn_made *made, const struct gsn_lattice *at,
                         unsigned threads)
{
    double *value = gsn_alloc_array(gsn_lattice_count(at), sizeof *value);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spline_resample(made->spline, at, threads, value, &err), err);
    return value;
}

/* Returns how many voxels are outside. */
static size_t check_all(const struct kuhn_made *made, const struct gsn_lattice *at)
{
    gsn_auto_mem(double) value = resampled(made, at, 1);
    size_t hint = 0, outside = 0;

    for (size_t i = 0; i < gsn_lattice_count(at); i++) {
        const struct gsn_vec3 p =
            gsn_lattice_centre(at, i % at->nx, i / at->nx % at->ny, i / at->nx / at->ny);
        const double truth = by_definition(made, (const double[3]){ p.x, p.y, p.z }, &hint);

        CHECK(isnan(truth) == isnan(value[i]));
        if (!isnan(truth))
            CHECK_NEAR(value[i], truth, 1e-11);
        outside += isnan(truth) != 0;
    }
    return outside;
}

static const size_t CUBES[3] = { 2, 2, 2 };

TEST(a_grid_has_the_sum_of_all_functions_at_every_voxel)
{
    const struct gsn_lattice at = { 23, 19, 17, { -0.13, -0.11, -0.05 }, { 0.101, 0.12, 0.13 } };

    for (unsigned degree = 1; degree <= 3; degree++) {
        for (int own = 0; own < 2; own++) {
            struct kuhn_made made =
                kuhn_make(kuhn_space(CUBES, 0.1, degree, 0.2, own ? GSN_DMS_OWN : GSN_DMS_SHARED));
            const size_t outside = check_all(&made, &at);

            CHECK(outside > 0 && outside < gsn_lattice_count(&at) / 2);
            kuhn_unmake(&made);
        }
    }
}

/* Voxel centres on all vertices, edges, faces and diagonals of the mesh, and on its boundary. */
TEST(voxels_in_mesh_planes_belong_to_one_tetrahedron)
{
    const struct gsn_lattice at = { 13, 13, 13, { -0.5, -0.5, -0.5 }, { 0.25, 0.25, 0.25 } };

    for (unsigned degree = 1; degree <= 3; degree++) {
        struct kuhn_made made = kuhn_make(kuhn_space(CUBES, 0, degree, 0.2, GSN_DMS_SHARED));

        /* The half-open rule leaves 8 of the 9 planes of each axis. */
        CHECK(check_all(&made, &at) == 13 * 13 * 13 - 8 * 8 * 8);
        kuhn_unmake(&made);
    }
}

/* 0.1 is no double: the centres scatter by a rounding error about the planes of the mesh. */
TEST(voxels_a_rounding_error_from_mesh_planes_too)
{
    const struct gsn_lattice at = { 21, 21, 21, { 0, 0, 0 }, { 0.1, 0.1, 0.1 } };
    struct kuhn_made made = kuhn_make(kuhn_space(CUBES, 0, 2, 0.2, GSN_DMS_SHARED));

    (void)check_all(&made, &at);
    kuhn_unmake(&made);
}

static struct gsn_dms *one_tetrahedron(unsigned degree)
{
    static const double VERTEX[4][3] = {
        { 1000, -2000, 300 }, { 1001, -2000, 300 }, { 1000, -1999, 300 }, { 1000, -2000, 301 }
    };
    static const uint32_t TET[1][4] = { { 0, 1, 2, 3 } };
    struct gsn_tets *mesh = NULL;
    struct gsn_dms *space = NULL;
    double(*knots)[3] = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tets_new(VERTEX, 4, TET, 1, &mesh, &err), err);
    CHECK_OK(gsn_dms_clouds(mesh, degree, 0.1, &knots, &err), err);
    CHECK_OK(gsn_dms_new(mesh, degree, (const double(*)[3])knots, GSN_DMS_SHARED, &space, &err),
             err);
    gsn_free(knots);
    gsn_tets_free(mesh);
    return space;
}

TEST(one_tetrahedron_far_from_the_origin_keeps_its_digits)
{
    const struct gsn_lattice at = {
        17, 9, 9, { 999.5, -2000.25, 299.75 }, { 0.125, 0.1875, 0.1875 }
    };

    for (unsigned degree = 1; degree <= 3; degree++) {
        struct kuhn_made made = kuhn_make(one_tetrahedron(degree));

        CHECK(check_all(&made, &at) < 17 * 9 * 9);
        kuhn_unmake(&made);
    }
}

TEST(a_grid_beside_the_mesh_has_no_data)
{
    const struct gsn_lattice at = { 4, 5, 6, { 3, 3, 3 }, { 0.1, 0.1, 0.1 } };
    struct kuhn_made made = kuhn_make(kuhn_space(CUBES, 0.1, 2, 0.2, GSN_DMS_SHARED));

    CHECK(check_all(&made, &at) == 4 * 5 * 6);
    kuhn_unmake(&made);
}

TEST(a_grid_of_one_voxel_is_the_value_at_a_point)
{
    const struct gsn_lattice at = { 1, 1, 1, { 0.97, 1.02, 1.01 }, { 1, 1, 1 } };
    struct kuhn_made made = kuhn_make(kuhn_space(CUBES, 0.1, 3, 0.2, GSN_DMS_SHARED));

    CHECK(check_all(&made, &at) == 0);
    kuhn_unmake(&made);
}

TEST(where_all_control_values_are_one_so_is_the_grid)
{
    const struct gsn_lattice at = { 40, 40, 40, { 0.025, 0.025, 0.025 }, { 0.05, 0.05, 0.05 } };

    for (int own = 0; own < 2; own++) {
        struct gsn_dms *space = kuhn_space(CUBES, 0.1, 3, 0.2, own ? GSN_DMS_OWN : GSN_DMS_SHARED);
        gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
        gsn_auto_mem(double) value = NULL;
        struct kuhn_made made = { .space = space };
        struct gsn_error err = { 0 };

        for (size_t i = 0; i < gsn_dms_controls(space); i++)
            control[i] = 1;
        CHECK_OK(gsn_spline_new(space, control, &made.spline, &err), err);
        value = resampled(&made, &at, 1);
        for (size_t i = 0; i < gsn_lattice_count(&at); i++)
            CHECK_NEAR(value[i], 1, 1e-12);
        kuhn_unmake(&made);
    }
}

TEST(threads_and_instruction_sets_give_the_same_bits)
{
    const struct gsn_lattice at = { 37, 41, 100, { -0.1, 0.013, 0.01 }, { 0.06, 0.05, 0.0203 } };

    for (unsigned degree = 1; degree <= 3; degree++) {
        struct kuhn_made made = kuhn_make(kuhn_space(CUBES, 0.1, degree, 0.2, GSN_DMS_SHARED));
        gsn_auto_mem(double) first = resampled(&made, &at, 1);

        for (int isa = 0; isa < GSN_ISA_COUNT; isa++) {
            if (!gsn_kernels_for((enum gsn_isa)isa))
                continue;
            gsn_dms_use(made.space, gsn_kernels_for((enum gsn_isa)isa));
            for (unsigned threads = 1; threads <= 3; threads++) {
                gsn_auto_mem(double) again = resampled(&made, &at, threads);

                CHECK(memcmp(again, first, gsn_lattice_count(&at) * sizeof *first) == 0);
            }
        }
        kuhn_unmake(&made);
    }
}

TEST(a_grid_that_is_none_is_refused_and_the_output_stays_untouched)
{
    const struct gsn_lattice wrong[] = {
        { 0, 2, 2, { 0, 0, 0 }, { 1, 1, 1 } },        { 2, 0, 2, { 0, 0, 0 }, { 1, 1, 1 } },
        { 2, 2, 0, { 0, 0, 0 }, { 1, 1, 1 } },        { 2, 2, 2, { NAN, 0, 0 }, { 1, 1, 1 } },
        { 2, 2, 2, { 0, INFINITY, 0 }, { 1, 1, 1 } }, { 2, 2, 2, { 0, 0, 0 }, { 1, NAN, 1 } },
        { 2, 2, 2, { 0, 0, 0 }, { 1, 1, 0 } },        { 2, 2, 2, { 0, 0, 0 }, { -1, 1, 1 } },
        { 2, 2, 2, { 0, 0, 0 }, { 1, 1, 1e308 } },
    };
    struct kuhn_made made = kuhn_make(kuhn_space(CUBES, 0.1, 1, 0.2, GSN_DMS_SHARED));

    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        struct gsn_error err = { 0 };
        double value[8] = { 5, 5, 5, 5, 5, 5, 5, 5 };

        CHECK(gsn_spline_resample(made.spline, &wrong[i], 1, value, &err) == GSN_E_INPUT);
        CHECK(strstr(err.text, "grid") != NULL);
        for (int j = 0; j < 8; j++)
            CHECK(value[j] == 5);
    }
    kuhn_unmake(&made);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct gsn_lattice at = { 5, 5, 40, { 0, 0, 0 }, { 0.4, 0.4, 0.05 } };
    struct kuhn_made made = kuhn_make(kuhn_space(CUBES, 0.1, 2, 0.2, GSN_DMS_SHARED));
    gsn_auto_mem(double) value = gsn_alloc_array(gsn_lattice_count(&at), sizeof *value);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(gsn_spline_resample(made.spline, &at, 2, value, &err), err);
    kuhn_unmake(&made);
}
