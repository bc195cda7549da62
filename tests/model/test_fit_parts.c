/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The pieces a fit is made of, against closed forms and against the basis evaluated one by one. */
#include "pipeline/model/fit_system.h"

#include <string.h>

#include "tests/check.h"
#include "tests/model/test_domain_shapes.h"

static const double VERTEX[4][3] = { { 1, 2, 0 }, { 5, 2.5, 0.5 }, { 2, 6, -1 }, { 0.5, 3, 4 } };

static struct gsn_dms *one_tet(unsigned degree)
{
    const uint32_t corner[1][4] = { { 0, 1, 2, 3 } };
    gsn_auto(gsn_tets) mesh = NULL;
    double(*knots)[3] = NULL;
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tets_new(VERTEX, 4, corner, 1, &mesh, &err), err);
    CHECK_OK(gsn_dms_clouds(mesh, degree, 0.01, &knots, &err), err);
    CHECK_OK(gsn_dms_new(mesh, degree, knots, GSN_DMS_OWN, &space, &err), err);
    gsn_free(knots);
    return space;
}

/* Bernstein coefficient beta of (a . u)^power over the tetrahedron: the polar form at its corners,
 * power 1 or 2. */
static double bernstein(const struct gsn_tets *mesh, const uint8_t *beta, unsigned degree,
                        const double a[3], unsigned power)
{
    double at[3], sum = 0, pairs = 0;
    size_t count = 0;

    for (size_t k = 0; k < 4; k++)
        for (unsigned i = 0; i < beta[k]; i++) {
            const double *v = mesh->vertex[mesh->tet[0][k]];

            at[count++] = a[0] * v[0] + a[1] * v[1] + a[2] * v[2];
        }
    for (size_t i = 0; i < count; i++) {
        sum += at[i];
        for (size_t j = 0; j < i; j++)
            pairs += at[i] * at[j];
    }
    return power == 1 ? sum / degree : 2 * pairs / (degree * (degree - 1.0));
}

/* c' A c, of A the entries f <= g row by row. */
static double squares_of(const struct gsn_dms *space, const double *block, const double *c)
{
    const size_t functions = gsn_dms_functions(space);
    double sum = 0;
    size_t at = 0;

    for (size_t f = 0; f < functions; f++)
        for (size_t g = f; g < functions; g++)
            sum += (f == g ? 1 : 2) * c[f] * c[g] * block[at++];
    return sum;
}

static double energy(const struct gsn_dms *space, const double *c, double weight)
{
    double block[GSN_DMS_MAX_FUNCTIONS * (GSN_DMS_MAX_FUNCTIONS + 1) / 2] = { 0 };
    struct gsn_fit_smooth smooth;

    gsn_fit_smooth_init(&smooth, space);
    gsn_fit_smooth_add(&smooth, gsn_dms_mesh(space), 0, weight, block);
    return squares_of(space, block, c);
}

TEST(the_penalty_of_a_polynomial_is_the_integral_of_its_squared_gradient)
{
    const double a[3] = { 0.3, -1.2, 0.7 };
    const double square = a[0] * a[0] + a[1] * a[1] + a[2] * a[2];

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = one_tet(degree);
        const struct gsn_tets *mesh = gsn_dms_mesh(space);
        const double volume = gsn_tets_volume(mesh, 0);
        double one[GSN_DMS_MAX_FUNCTIONS], linear[GSN_DMS_MAX_FUNCTIONS],
            quadratic[GSN_DMS_MAX_FUNCTIONS], at[4], sum = 0, squares = 0;

        for (size_t f = 0; f < gsn_dms_functions(space); f++) {
            one[f] = 1;
            linear[f] = bernstein(mesh, gsn_dms_beta(space, f), degree, a, 1);
            quadratic[f] = degree > 1 ? bernstein(mesh, gsn_dms_beta(space, f), degree, a, 2) : 0;
        }
        for (size_t k = 0; k < 4; k++) {
            const double *v = mesh->vertex[mesh->tet[0][k]];

            at[k] = a[0] * v[0] + a[1] * v[1] + a[2] * v[2];
            sum += at[k];
            squares += at[k] * at[k];
        }
        CHECK_NEAR(energy(space, one, 2), 0, 1e-12);
        CHECK_NEAR(energy(space, linear, 2), 2 * square * volume, 1e-10);
        /* grad (a.u)^2 = 2 (a.u) a, and the mean of (a.u)^2 is ((sum)^2 + sum of squares) / 20. */
        if (degree > 1)
            CHECK_NEAR(energy(space, quadratic, 2),
                       2 * 4 * square * volume * (sum * sum + squares) / 20, 1e-8);
    }
}

static double bending(const struct gsn_dms *space, const double *c, double weight)
{
    double block[GSN_DMS_MAX_FUNCTIONS * (GSN_DMS_MAX_FUNCTIONS + 1) / 2] = { 0 };

    gsn_fit_curvature_add(space, 0, weight, block);
    return squares_of(space, block, c);
}

/* Of (a.u)^2 all second derivatives are 2 a a', and of (a.u)^3 they are 6 (a.u) a a', by the mean
 * of (a.u)^2 as above. */
TEST(the_curvature_of_a_polynomial_is_the_integral_of_its_squared_second_derivatives)
{
    const double a[3] = { 0.3, -1.2, 0.7 };
    const double square = a[0] * a[0] + a[1] * a[1] + a[2] * a[2];

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = one_tet(degree);
        const struct gsn_tets *mesh = gsn_dms_mesh(space);
        const double volume = gsn_tets_volume(mesh, 0);
        double linear[GSN_DMS_MAX_FUNCTIONS], quadratic[GSN_DMS_MAX_FUNCTIONS],
            cubic[GSN_DMS_MAX_FUNCTIONS], at[4], sum = 0, squares = 0;

        for (size_t k = 0; k < 4; k++) {
            const double *v = mesh->vertex[mesh->tet[0][k]];

            at[k] = a[0] * v[0] + a[1] * v[1] + a[2] * v[2];
            sum += at[k];
            squares += at[k] * at[k];
        }
        for (size_t f = 0; f < gsn_dms_functions(space); f++) {
            const uint8_t *beta = gsn_dms_beta(space, f);

            linear[f] = bernstein(mesh, beta, degree, a, 1);
            quadratic[f] = degree > 1 ? bernstein(mesh, beta, degree, a, 2) : 0;
            cubic[f] = 1;
            for (size_t k = 0; k < 4; k++)
                cubic[f] *= pow(at[k], beta[k]);
        }
        CHECK_NEAR(bending(space, linear, 2), 0, 1e-9);
        if (degree > 1)
            CHECK_NEAR(bending(space, quadratic, 2), 2 * 4 * square * square * volume, 1e-8);
        if (degree > 2)
            CHECK_NEAR(bending(space, cubic, 2),
                       2 * 36 * square * square * volume * (sum * sum + squares) / 20, 1e-7);
    }
}

/* The matrix and right hand side, each entry from gsn_dms_basis() at every sample. */
static void dense_equations(const struct gsn_dms *space, const struct shape_samples *grid,
                            const uint8_t *fold, const double weight[2], double mean,
                            double *matrix, double *right)
{
    const struct gsn_samples *samples = &grid->samples;
    const size_t n = gsn_dms_controls(space);
    struct gsn_dms_term term[1024];
    size_t hint = 0, count = 0;

    for (size_t i = 0; i < samples->count; i++) {
        double target = samples->value[i];

        if (weight[fold[i]] == 0)
            continue;
        CHECK(gsn_dms_basis(space, samples->at[i], 0, &hint, term, 1024, &count) == GSN_OK);
        CHECK(count <= 1024);
        for (size_t a = 0; a < count; a++)
            target -= mean * term[a].value;
        for (size_t a = 0; a < count; a++) {
            right[term[a].control] += target * term[a].value;
            for (size_t b = 0; b < count; b++)
                matrix[term[a].control * n + term[b].control] += term[a].value * term[b].value;
        }
    }
}

static double wave(const double u[3])
{
    return sin(u[0] / 13) * cos(u[1] / 17) + u[2] / 60;
}

static void check_system(const struct gsn_fit_system *system, const double *matrix,
                         const double *right)
{
    const size_t n = system->unknowns;
    gsn_auto_mem(double) row = gsn_alloc_array(n, sizeof *row);

    CHECK(row);
    for (size_t i = 0; i < n; i++) {
        memset(row, 0, n * sizeof *row);
        for (size_t k = system->first[i]; k < system->first[i + 1]; k++) {
            CHECK(k == system->first[i] || system->column[k] > system->column[k - 1]);
            row[system->column[k]] = system->value[k];
        }
        for (size_t j = 0; j < n; j++)
            CHECK_NEAR(row[j], matrix[i * n + j], 1e-9);
        CHECK_NEAR(system->right[i], right[i], 1e-9);
    }
}

/* Both folds, and each by itself. */
static void check_folds(struct gsn_fit_system *system, const struct gsn_dms *space,
                        const struct shape_samples *grid, const uint8_t *fold, double mean)
{
    static const double WEIGHT[3][2] = { { 1, 0 }, { 0, 1 }, { 1, 1 } };
    const size_t n = gsn_dms_controls(space);

    for (size_t w = 0; w < 3; w++) {
        gsn_auto_mem(double) matrix = gsn_alloc_array(n * n, sizeof *matrix);
        gsn_auto_mem(double) right = gsn_alloc_array(n, sizeof *right);

        CHECK(matrix && right);
        gsn_fit_system_combine(system, WEIGHT[w], 0, 0);
        dense_equations(space, grid, fold, WEIGHT[w], mean, matrix, right);
        check_system(system, matrix, right);
    }
}

static uint8_t *alternate_planes(const struct shape_samples *grid, size_t plane)
{
    uint8_t *fold = gsn_alloc_array(grid->samples.count, 1);

    CHECK(fold);
    for (size_t i = 0; i < grid->samples.count; i++)
        fold[i] = i / plane % 2;
    return fold;
}

static void check_assembly(unsigned degree, double cloud)
{
    gsn_auto(gsn_dms) space = shape_space(degree, cloud, 60000);
    struct shape_samples grid = shape_grid(0, 80, 16, wave);
    gsn_auto_mem(uint8_t) fold = alternate_planes(&grid, 16 * 16);
    struct gsn_fit_rows rows;
    struct gsn_fit_system system;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_fit_rows_sort(&rows, space, &grid.samples,
                               &(struct gsn_fit_options){ .fold = fold, .threads = 2 }, &err),
             err);
    CHECK_OK(gsn_fit_rows_evaluate(&rows, 2, &err), err);
    CHECK_OK(gsn_fit_system_assemble(&system, &rows, NULL, 2, &err), err);
    CHECK(rows.seams > 0 && rows.seams < grid.samples.count);
    check_folds(&system, space, &grid, fold, rows.mean);
    gsn_fit_system_done(&system);
    gsn_fit_rows_done(&rows);
    shape_samples_done(&grid);
}

TEST(the_equations_are_those_of_the_basis_sample_by_sample)
{
    check_assembly(1, 0.02);
    check_assembly(2, 0.02);
    check_assembly(2, 0.1);
    check_assembly(3, 0.02);
}

/* Equations of a fit with jumps, weighed so that they are as stiff as any. */
static void make_equations(const struct gsn_dms *space, const struct gsn_samples *samples,
                           double jump, struct gsn_fit_system *system)
{
    static const double ALL[2] = { 1, 0 };
    gsn_auto(gsn_face_jumps) jumps = NULL;
    struct gsn_fit_rows rows;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_face_jumps_new(space, &jumps, &err), err);
    CHECK_OK(
        gsn_fit_rows_sort(&rows, space, samples, &(struct gsn_fit_options){ .threads = 2 }, &err),
        err);
    CHECK_OK(gsn_fit_rows_evaluate(&rows, 2, &err), err);
    CHECK_OK(gsn_fit_system_assemble(system, &rows, jumps, 2, &err), err);
    gsn_fit_system_combine(system, ALL, 0, jump);
    gsn_fit_rows_done(&rows);
}

static double multiply_row(const struct gsn_fit_system *system, size_t i, const double *x)
{
    double sum = 0;

    for (size_t k = system->first[i]; k < system->first[i + 1]; k++)
        sum += system->value[k] * x[system->column[k]];
    return sum;
}

TEST(conjugate_gradients_find_the_answer_they_were_given)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = shape_space(degree, 0.02, 60000);
        struct shape_samples grid = shape_grid(-40, 120, 24, wave);
        const size_t n = gsn_dms_controls(space);
        gsn_auto_mem(double) x = gsn_alloc_array(n, sizeof *x);
        gsn_auto_mem(double) truth = gsn_alloc_array(n, sizeof *truth);
        gsn_auto(gsn_fit_patches) patches = NULL;
        struct gsn_fit_system system;
        struct gsn_error err = { 0 };
        unsigned iterations = 0;
        uint64_t dice = 7;

        CHECK(x && truth);
        make_equations(space, &grid.samples, 10, &system);
        for (size_t i = 0; i < n; i++)
            truth[i] = shape_normal(&dice);
        for (size_t i = 0; i < n; i++)
            system.right[i] = multiply_row(&system, i, truth);
        CHECK_OK(gsn_fit_patches_new(space, &patches, &err), err);
        CHECK_OK(gsn_fit_patches_invert(patches, &system, 2, &err), err);
        CHECK_OK(gsn_fit_system_solve(&system, patches, 1e-12, 2000, 2, x, &iterations, &err), err);
        for (size_t i = 0; i < n; i++)
            CHECK_NEAR(x[i], truth[i], 1e-6);
        /* a good start needs fewer */
        CHECK_OK(gsn_fit_system_solve(&system, patches, 1e-9, 2, 2, x, &iterations, &err), err);
        memset(x, 0, n * sizeof *x);
        CHECK(gsn_fit_system_solve(&system, patches, 1e-12, 3, 2, x, &iterations, &err) ==
              GSN_E_FIT);
        CHECK(strstr(err.text, "3 iterations"));
        /* equations that no least squares have */
        for (size_t k = 0; k < system.first[n]; k++)
            system.value[k] = -system.value[k];
        memset(x, 0, n * sizeof *x);
        CHECK(gsn_fit_system_solve(&system, patches, 1e-12, 3, 2, x, &iterations, &err) ==
              GSN_E_FIT);
        CHECK(strstr(err.text,
                     "not positive definite: iteration 1 meets a direction of curvature -"));
        gsn_fit_system_done(&system);
        shape_samples_done(&grid);
    }
}

TEST(a_control_point_that_nothing_determines_is_named)
{
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 60000);
    struct shape_samples grid = shape_grid(0, 10, 4, wave);
    gsn_auto(gsn_fit_patches) patches = NULL;
    struct gsn_fit_system system;
    struct gsn_error err = { 0 };

    make_equations(space, &grid.samples, 0, &system);
    CHECK_OK(gsn_fit_patches_new(space, &patches, &err), err);
    CHECK(gsn_fit_patches_invert(patches, &system, 2, &err) == GSN_E_FIT);
    CHECK(strstr(err.text, "is not determined by anything"));
    gsn_fit_system_done(&system);
    shape_samples_done(&grid);
}

/* The error at the other fold is a quadratic form of its equations. */
TEST(the_squares_that_control_points_leave_are_those_of_the_samples)
{
    gsn_auto(gsn_dms) space = shape_space(2, 0.05, 60000);
    struct shape_samples grid = shape_grid(0, 80, 20, wave);
    gsn_auto_mem(uint8_t) fold = alternate_planes(&grid, 20 * 20);
    const size_t n = gsn_dms_controls(space);
    gsn_auto_mem(double) x = gsn_alloc_array(n, sizeof *x);
    gsn_auto_mem(double) scratch = gsn_alloc_array(n, sizeof *scratch);
    gsn_auto(gsn_spline) spline = NULL;
    double truth[2] = { 0 };
    struct gsn_fit_rows rows;
    struct gsn_fit_system system;
    struct gsn_error err = { 0 };
    uint64_t dice = 3;
    size_t hint = 0;

    CHECK(x && scratch);
    CHECK_OK(gsn_fit_rows_sort(&rows, space, &grid.samples,
                               &(struct gsn_fit_options){ .fold = fold, .threads = 2 }, &err),
             err);
    CHECK_OK(gsn_fit_rows_evaluate(&rows, 2, &err), err);
    CHECK_OK(gsn_fit_system_assemble(&system, &rows, NULL, 2, &err), err);
    for (size_t i = 0; i < n; i++)
        x[i] = rows.mean + shape_normal(&dice);
    CHECK_OK(gsn_spline_new(space, x, &spline, &err), err);
    for (size_t i = 0; i < n; i++)
        x[i] -= rows.mean;
    for (size_t i = 0; i < grid.samples.count; i++) {
        double value;

        CHECK(gsn_spline_eval(spline, grid.at[i], &hint, &value, NULL) == GSN_OK);
        truth[fold[i]] += pow(value - (double)grid.value[i], 2);
    }
    for (size_t k = 0; k < 2; k++)
        CHECK_NEAR(gsn_fit_system_squares(&system, k, rows.squares[k], x, scratch) / truth[k], 1,
                   1e-10);
    gsn_fit_system_done(&system);
    gsn_fit_rows_done(&rows);
    shape_samples_done(&grid);
}
