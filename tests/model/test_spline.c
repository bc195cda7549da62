/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/spline.h"

#include "tests/check.h"
#include "tests/model/formula.h"
#include "tests/model/kuhn.h"

#include "pipeline/model/bpatch.h"
#include "pipeline/model/dms_internal.h"

#include <string.h>

enum { ROOM = 4000 };

static const size_t SMALL[3] = { 2, 2, 2 };
static const size_t MIDDLE[3] = { 3, 3, 3 };

/* A space and a spline on it that the tests of this file share. */
struct made {
    struct gsn_dms *space;
    struct gsn_spline *spline;
};

static struct made make(struct gsn_dms *space, const double *control)
{
    struct made made = { .space = space };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spline_new(space, control, &made.spline, &err), err);
    return made;
}

static struct made make_random(struct gsn_dms *space, uint64_t *seed)
{
    gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);

    for (size_t i = 0; i < gsn_dms_controls(space); i++)
        control[i] = 2 * draw(seed) - 1;
    return make(space, control);
}

static struct made make_polynomial(struct gsn_dms *space, const struct polynomial *p)
{
    gsn_auto_mem(double) control = polynomial_controls(p, space);

    return make(space, control);
}

static void done(struct made *made)
{
    gsn_spline_free(made->spline);
    gsn_dms_free(made->space);
}

/* gives: the space of a mesh with clouds changed: those of vertices with what(v) not 0 are scaled
 * by that factor, so that 0 collapses and -1 turns them around. */
static struct gsn_dms *changed_space(double jitter, unsigned degree, double fraction,
                                     double (*factor)(const double *v))
{
    struct gsn_tets *mesh = kuhn_mesh(SMALL, jitter);
    double(*knots)[3] = NULL;
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_dms_clouds(mesh, degree, fraction, &knots, &err), err);
    for (size_t i = 0; i < mesh->vertex_count * (degree + 1); i++) {
        const double *v = mesh->vertex[i / (degree + 1)];

        for (int c = 0; c < 3; c++)
            knots[i][c] = v[c] + factor(v) * (knots[i][c] - v[c]);
    }
    CHECK_OK(gsn_dms_new(mesh, degree, (const double(*)[3])knots, GSN_DMS_SHARED, &space, &err),
             err);
    gsn_free(knots);
    gsn_tets_free(mesh);
    return space;
}

static int is_inner(const double *v)
{
    return v[0] > 0 && v[0] < 2 && v[1] > 0 && v[1] < 2 && v[2] > 0 && v[2] < 2;
}

static double collapse_all(const double *v)
{
    (void)v;
    return 0;
}

static double collapse_inner(const double *v)
{
    return is_inner(v) ? 0 : 1;
}

static double turn_boundary(const double *v)
{
    return is_inner(v) ? 1 : -1;
}

TEST(the_quick_way_in_the_core_agrees_with_the_sum_over_the_basis)
{
    uint64_t seed = 21;

    for (unsigned degree = 1; degree <= 3; degree++) {
        struct made made =
            make_random(kuhn_space(MIDDLE, 0.2, degree, 0.05, GSN_DMS_SHARED), &seed);
        const struct gsn_tets *mesh = gsn_dms_mesh(made.space);
        const double *control = gsn_spline_controls(made.spline);
        size_t hint = 0, core = 0;

        CHECK(gsn_spline_space(made.spline) == made.space);
        for (size_t i = 0; i < 8 * mesh->tet_count; i++) {
            static struct gsn_dms_term term[ROOM];
            double u[3], value, slope[3], sum = 0, slopes[3] = { 0 };
            size_t count;

            draw_in_skins(mesh, i / 8, &seed, u);
            if (gsn_spline_eval(made.spline, u, &hint, &value, slope) == GSN_DMS_OUTSIDE)
                continue;
            CHECK(gsn_dms_basis(made.space, u, 1, &hint, term, ROOM, &count) == GSN_OK);
            core += count == gsn_dms_functions(made.space);
            for (size_t j = 0; j < count; j++) {
                sum += control[term[j].control] * term[j].value;
                for (int c = 0; c < 3; c++)
                    slopes[c] += control[term[j].control] * term[j].gradient[c];
            }
            CHECK_NEAR(value, sum, 1e-12);
            for (int c = 0; c < 3; c++)
                CHECK_NEAR(slope[c], slopes[c], 1e-9);
        }
        CHECK(core > mesh->tet_count);
        done(&made);
    }
}

/* On both sides of the wall of the core, by the recurrence and by the B-patch. */
TEST(the_polynomial_and_the_recurrence_agree_across_the_edge_of_the_core)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0.2, degree, 0.05, GSN_DMS_SHARED);
        const size_t tet = 17;
        struct gsn_dms_shape shape;
        uint16_t pick[GSN_SIMPLEX_MAX_LARGE];
        double knot[GSN_SIMPLEX_MAX_KNOTS][3];

        gsn_dms_gather(space, tet, knot);
        gsn_dms_shape_of(space, tet, &shape);
        (void)gsn_simplex_pick(space->sets, (const double(*)[3])knot, pick);
        for (int k = 0; k < 4; k++) {
            for (int above = 0; above < 5; above++) {
                double lambda[4], u[3] = { 0 }, patch[20], simplex[20], slope[20][3], exact[20][3];

                for (int j = 0; j < 4; j++)
                    lambda[j] = (1 - shape.high[k] - above * 1e-7) / 3;
                lambda[k] = shape.high[k] + above * 1e-7;
                for (int j = 0; j < 4; j++) {
                    for (int c = 0; c < 3; c++)
                        u[c] += lambda[j] * knot[j * (int)(degree + 1)][c];
                }
                gsn_bpatch_basis(degree, (const double(*)[3])knot, u, patch, slope);
                gsn_simplex_basis(space->sets, (const double(*)[3])knot, pick, u, 0, simplex,
                                  exact);
                for (size_t f = 0; f < space->sets->functions; f++) {
                    CHECK_NEAR(patch[f], simplex[f], 1e-12);
                    for (int c = 0; c < 3; c++)
                        CHECK_NEAR(slope[f][c], exact[f][c], 1e-9);
                }
            }
        }
    }
}

TEST(the_gradient_is_the_limit_of_differences)
{
    const double h = 1e-6;
    uint64_t seed = 23;

    for (unsigned degree = 2; degree <= 3; degree++) {
        struct made made = make_random(kuhn_space(MIDDLE, 0.2, degree, 0.1, GSN_DMS_SHARED), &seed);
        const struct gsn_tets *mesh = gsn_dms_mesh(made.space);
        size_t hint = 0;

        for (size_t t = 0; t < mesh->tet_count; t++) {
            double u[3], slope[3], value, low, high;

            draw_in_skins(mesh, t, &seed, u);
            if (fmin(fmin(u[0], u[1]), u[2]) < 2 * h || fmax(fmax(u[0], u[1]), u[2]) > 3 - 2 * h)
                continue;
            CHECK(gsn_spline_eval(made.spline, u, &hint, &value, slope) == GSN_OK);
            for (int c = 0; c < 3; c++) {
                double a[3] = { u[0], u[1], u[2] }, b[3] = { u[0], u[1], u[2] };

                a[c] -= h;
                b[c] += h;
                CHECK(gsn_spline_eval(made.spline, a, &hint, &low, NULL) == GSN_OK);
                CHECK(gsn_spline_eval(made.spline, b, &hint, &high, NULL) == GSN_OK);
                CHECK_NEAR((high - low) / (2 * h), slope[c], 2e-4);
            }
        }
        done(&made);
    }
}

TEST(splines_of_polynomials_have_their_values_gradients_and_bernstein_form)
{
    uint64_t seed = 25;

    for (unsigned degree = 1; degree <= 3; degree++) {
        const struct polynomial p = draw_polynomial(degree, &seed);
        struct made made =
            make_polynomial(kuhn_space(MIDDLE, 0.2, degree, 0.05, GSN_DMS_SHARED), &p);
        const struct gsn_tets *mesh = gsn_dms_mesh(made.space);
        size_t hint = 0;

        for (size_t t = 0; t < mesh->tet_count; t++) {
            double u[3], slope[3], own[3], value, low, high, bernstein[20];

            draw_inside(mesh, t, &seed, u);
            CHECK(gsn_spline_eval(made.spline, u, &hint, &value, own) == GSN_OK);
            CHECK_NEAR(value, polynomial_at(&p, u, slope), 1e-11);
            for (int c = 0; c < 3; c++)
                CHECK_NEAR(own[c], slope[c], 1e-8);
            gsn_spline_bernstein(made.spline, t, bernstein);
            for (size_t f = 0; f < gsn_dms_functions(made.space); f++) {
                const uint8_t *beta = gsn_dms_beta(made.space, f);
                const double *arg[3];
                unsigned n = 0;

                for (unsigned k = 0; k < 4; k++) {
                    for (unsigned l = 0; l < beta[k]; l++)
                        arg[n++] = mesh->vertex[mesh->tet[t][k]];
                }
                CHECK_NEAR(bernstein[f], polynomial_polar(&p, arg), 1e-11);
            }
            gsn_spline_residual(made.spline, t, &low, &high);
            CHECK_NEAR(low, 0, 1e-11);
            CHECK_NEAR(high, 0, 1e-11);
        }
        done(&made);
    }
}

/* Where the line p + t d enters and leaves the cube [0, size]^3. */
static int chord(const double *p, const double *d, double size, double *ret_in, double *ret_out)
{
    *ret_in = -INFINITY;
    *ret_out = INFINITY;
    for (int c = 0; c < 3; c++) {
        const double a = -p[c] / d[c], b = (size - p[c]) / d[c];

        *ret_in = fmax(*ret_in, fmin(a, b));
        *ret_out = fmin(*ret_out, fmax(a, b));
    }
    return *ret_in < *ret_out;
}

TEST(line_integrals_of_polynomials_on_collapsed_clouds_are_those_of_the_polynomial)
{
    /* Gauss-Legendre with two points: exact to degree 3. */
    const double at[2] = { 0.5 - sqrt(3) / 6, 0.5 + sqrt(3) / 6 };
    uint64_t seed = 27;

    for (unsigned degree = 1; degree <= 3; degree++) {
        const struct polynomial p = draw_polynomial(degree, &seed);
        struct made made = make_polynomial(changed_space(0.2, degree, 0.05, collapse_all), &p);

        for (int i = 0; i < 40; i++) {
            double start[3], d[3], in, out, sum = 0;
            const double along = 40 * (draw(&seed) - 0.5);

            for (int c = 0; c < 3; c++) {
                d[c] = draw(&seed) - 0.5;
                start[c] = 3 * draw(&seed) - 0.5 + along * d[c];
            }
            if (chord(start, d, 2, &in, &out)) {
                for (int g = 0; g < 2; g++) {
                    const double t = in + at[g] * (out - in);
                    const double u[3] = { start[0] + t * d[0], start[1] + t * d[1],
                                          start[2] + t * d[2] };

                    sum += (out - in) / 2 * polynomial_at(&p, u, NULL);
                }
            }
            CHECK_NEAR(gsn_spline_line(made.spline, start, d),
                       sum * sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]), 1e-10);
        }
        done(&made);
    }
}

/* s as the formula gives it, also outside. */
static double sum_of_all(const struct made *made, const double u[3])
{
    const double *control = gsn_spline_controls(made->spline);
    double value[GSN_DMS_MAX_FUNCTIONS], sum = 0;

    for (size_t t = 0; t < gsn_dms_mesh(made->space)->tet_count; t++) {
        if (!gsn_dms_tet_basis(made->space, t, u, value, NULL))
            continue;
        for (size_t f = 0; f < gsn_dms_functions(made->space); f++)
            sum += control[gsn_dms_control_ids(made->space, t)[f]] * value[f];
    }
    return sum;
}

TEST(line_integrals_agree_with_dense_sampling_and_with_the_line_turned_around)
{
    enum { STEPS = 2000 };
    uint64_t seed = 29;

    for (unsigned degree = 1; degree <= 3; degree++) {
        struct made made = make_random(kuhn_space(SMALL, 0.2, degree, 0.1, GSN_DMS_SHARED), &seed);

        for (int i = 0; i < 3; i++) {
            const double from[3] = { 2 * draw(&seed), 2 * draw(&seed), -0.2 };
            const double to[3] = { 2 * draw(&seed), 2 * draw(&seed), 2.2 };
            const double d[3] = { to[0] - from[0], to[1] - from[1], to[2] - from[2] };
            const double back[3] = { -3 * d[0], -3 * d[1], -3 * d[2] };
            const double length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
            const double exact = gsn_spline_line(made.spline, from, d);
            double sum = 0;

            for (int k = 0; k < STEPS; k++) {
                const double t = (k + 0.5) / STEPS;
                const double u[3] = { from[0] + t * d[0], from[1] + t * d[1], from[2] + t * d[2] };

                sum += length / STEPS * sum_of_all(&made, u);
            }
            CHECK_NEAR(exact, sum, 2e-4);
            CHECK_NEAR(gsn_spline_line(made.spline, to, back), exact, 1e-12);
        }
        done(&made);
    }
}

TEST(a_line_along_mesh_edges_and_planes_is_the_limit_of_its_neighbours)
{
    uint64_t seed = 31;

    for (unsigned degree = 1; degree <= 3; degree++) {
        struct made made = make_random(kuhn_space(SMALL, 0, degree, 0.05, GSN_DMS_SHARED), &seed);
        const double from[3][3] = { { 1, 1, -1 }, { 1, 0.6, -1 }, { 0, 0, 0 } };
        const double d[3][3] = { { 0, 0, 1 }, { 0, 0, 1 }, { 1, 1, 1 } };

        for (int i = 0; i < 3; i++) {
            const double beside[3] = { from[i][0] + 3e-8, from[i][1] - 2e-8, from[i][2] + 1e-8 };

            CHECK_NEAR(gsn_spline_line(made.spline, from[i], d[i]),
                       gsn_spline_line(made.spline, beside, d[i]), 1e-5);
        }
        done(&made);
    }
}

/* Child i of eight by halving the edges: four at the corners, four around the inner diagonal. */
static void child(const double cell[4][3], int i, double ret[4][3])
{
    static const int corners[8][4][2] = {
        { { 0, 0 }, { 0, 1 }, { 0, 2 }, { 0, 3 } }, { { 0, 1 }, { 1, 1 }, { 1, 2 }, { 1, 3 } },
        { { 0, 2 }, { 1, 2 }, { 2, 2 }, { 2, 3 } }, { { 0, 3 }, { 1, 3 }, { 2, 3 }, { 3, 3 } },
        { { 0, 2 }, { 1, 3 }, { 0, 1 }, { 0, 3 } }, { { 0, 2 }, { 1, 3 }, { 0, 1 }, { 1, 2 } },
        { { 0, 2 }, { 1, 3 }, { 0, 3 }, { 2, 3 } }, { { 0, 2 }, { 1, 3 }, { 1, 2 }, { 2, 3 } },
    };

    for (int k = 0; k < 4; k++) {
        for (int c = 0; c < 3; c++)
            ret[k][c] = (cell[corners[i][k][0]][c] + cell[corners[i][k][1]][c]) / 2;
    }
}

static void tet_corners(const struct gsn_tets *mesh, size_t t, double ret[4][3])
{
    for (int k = 0; k < 4; k++)
        memcpy(ret[k], mesh->vertex[mesh->tet[t][k]], sizeof ret[k]);
}

TEST(means_over_the_eight_parts_of_a_cell_average_to_that_of_the_cell)
{
    const double tolerance[4] = { 0, 1e-12, 1e-10, 1e-9 };
    struct gsn_error err = { 0 };
    uint64_t seed = 33;

    for (unsigned degree = 1; degree <= 3; degree++) {
        struct made made = make_random(kuhn_space(SMALL, 0.2, degree, 0.05, GSN_DMS_SHARED), &seed);

        for (size_t t = 0; t < 48; t += 7) {
            double cell[4][3], mean, part, sum = 0;

            tet_corners(gsn_dms_mesh(made.space), t, cell);
            CHECK_OK(gsn_spline_tet_mean(made.spline, t, &mean, &err), err);
            for (int i = 0; i < 8; i++) {
                double small[4][3];

                child((const double(*)[3])cell, i, small);
                CHECK_OK(gsn_spline_cell_mean(made.spline, (const double(*)[3])small, &part, &err),
                         err);
                sum += part / 8;
            }
            CHECK_NEAR(sum, mean, tolerance[degree]);
        }
        done(&made);
    }
}

/* The mean of a polynomial over a tetrahedron by its Bernstein coefficients. */
static double true_mean(const struct polynomial *p, const struct gsn_dms *space,
                        const double cell[4][3])
{
    double sum = 0;

    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const uint8_t *beta = gsn_dms_beta(space, f);
        const double *arg[3];
        unsigned n = 0;

        for (unsigned k = 0; k < 4; k++) {
            for (unsigned l = 0; l < beta[k]; l++)
                arg[n++] = cell[k];
        }
        sum += polynomial_polar(p, arg);
    }
    return sum / (double)gsn_dms_functions(space);
}

static void check_means(struct gsn_dms *space, unsigned degree, double tolerance, uint64_t *seed)
{
    const struct polynomial p = draw_polynomial(degree, seed);
    struct made made = make_polynomial(space, &p);
    struct gsn_error err = { 0 };
    double cell[4][3], mean;

    for (size_t t = 0; t < 48; t += 5) {
        tet_corners(gsn_dms_mesh(space), t, cell);
        CHECK_OK(gsn_spline_tet_mean(made.spline, t, &mean, &err), err);
        CHECK_NEAR(mean, true_mean(&p, space, (const double(*)[3])cell), tolerance);
    }
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 4; k++) {
            for (int c = 0; c < 3; c++)
                cell[k][c] = 2 * draw(seed);
        }
        CHECK_OK(gsn_spline_cell_mean(made.spline, (const double(*)[3])cell, &mean, &err), err);
        CHECK_NEAR(mean, true_mean(&p, space, (const double(*)[3])cell), tolerance);
    }
    done(&made);
}

TEST(means_of_polynomials_are_their_means_over_mesh_and_other_cells)
{
    const double tolerance[4] = { 0, 1e-12, 1e-10, 1e-9 };
    uint64_t seed = 35;

    for (unsigned degree = 1; degree <= 3; degree++)
        check_means(kuhn_space(SMALL, 0.2, degree, 0.05, GSN_DMS_SHARED), degree, tolerance[degree],
                    &seed);
}

TEST(means_are_exact_for_coinciding_knots_too)
{
    uint64_t seed = 37;

    for (unsigned degree = 1; degree <= 3; degree++)
        check_means(changed_space(0.2, degree, 0.05, collapse_all), degree, 1e-10, &seed);
    check_means(changed_space(0.2, 1, 0.05, collapse_inner), 1, 1e-9, &seed);
    check_means(changed_space(0.2, 2, 0.05, collapse_inner), 2, 1e-9, &seed);
}

static void check_residual(struct made *made, uint64_t *seed)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(made->space);

    for (size_t t = 0; t < mesh->tet_count; t++) {
        struct gsn_dms_shape shape;
        double bernstein[20], low, high;

        gsn_dms_shape_of(made->space, t, &shape);
        gsn_spline_bernstein(made->spline, t, bernstein);
        gsn_spline_residual(made->spline, t, &low, &high);
        CHECK(low <= 0 && high >= 0);
        for (int i = 0; i < 60; i++) {
            double u[3], lambda[4], value, off;
            size_t hint = t;

            draw_in_skins(mesh, t, seed, u);
            if (gsn_spline_eval(made->spline, u, &hint, &value, NULL) != GSN_OK || hint != t)
                continue;
            gsn_barycentric_at(&shape.frame, u, lambda);
            off = value - gsn_bernstein_at(gsn_dms_degree(made->space), bernstein, &shape.frame,
                                           lambda, NULL);
            CHECK(off >= low - 1e-12 && off <= high + 1e-12);
        }
    }
}

TEST(the_spline_stays_within_its_residual_bounds_of_the_core_polynomial)
{
    uint64_t seed = 39;

    for (unsigned degree = 1; degree <= 3; degree++) {
        struct made shared =
            make_random(kuhn_space(MIDDLE, 0.2, degree, 0.1, GSN_DMS_SHARED), &seed);
        struct made own = make_random(kuhn_space(MIDDLE, 0.2, degree, 0.1, GSN_DMS_OWN), &seed);
        struct made leaky = make_random(changed_space(0.2, degree, 0.1, turn_boundary), &seed);

        check_residual(&shared, &seed);
        check_residual(&own, &seed);
        check_residual(&leaky, &seed);
        done(&shared);
        done(&own);
        done(&leaky);
    }
}

/* gives: random splines on a mesh whose corner lies so many edges from the origin. */
static struct made make_far(const size_t cells[3], double fraction, double far, uint64_t *seed)
{
    struct gsn_tets *mesh = kuhn_mesh(cells, 0.2);

    for (size_t i = 0; i < mesh->vertex_count; i++)
        for (size_t c = 0; c < 3; c++)
            mesh->vertex[i][c] += far;
    return make_random(kuhn_space_on(mesh, 3, fraction, GSN_DMS_SHARED), seed);
}

TEST(certificates_hold_far_from_the_origin_too)
{
    const double clouds[] = { 0.003, 0.015, 0.1, 0.3 };
    uint64_t seed = 43;

    for (size_t k = 0; k < sizeof clouds / sizeof *clouds; k++) {
        struct made made = make_far(MIDDLE, clouds[k], 1e6, &seed);
        const struct gsn_tets *mesh = gsn_dms_mesh(made.space);
        double worst = 0, widest = 0;
        size_t asked = 0;

        for (size_t round = 0; asked < 10000; round++) {
            const size_t t = round % mesh->tet_count;
            struct gsn_dms_shape shape;
            double bernstein[20], low, high, u[3], lambda[4], value, off;
            size_t hint = t;

            draw_in_skins(mesh, t, &seed, u);
            if (gsn_spline_eval(made.spline, u, &hint, &value, NULL) != GSN_OK || hint != t)
                continue;
            gsn_dms_shape_of(made.space, t, &shape);
            gsn_spline_bernstein(made.spline, t, bernstein);
            gsn_spline_residual(made.spline, t, &low, &high);
            gsn_barycentric_at(&shape.frame, u, lambda);
            off = value - gsn_bernstein_at(3, bernstein, &shape.frame, lambda, NULL);
            worst = fmax(worst, fmax(low - off, off - high));
            widest = fmax(widest, high - low);
            asked++;
        }
        CHECK(worst == 0 && widest > 1);
        done(&made);
    }
}

TEST(what_is_no_spline_and_no_cell_is_refused_and_outputs_stay_untouched)
{
    const double flat[4][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 1, 1, 0 } };
    const double broken[4][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, NAN }, { 0, 0, 1 } };
    uint64_t seed = 41;
    struct made made = make_random(kuhn_space(SMALL, 0, 2, 0.05, GSN_DMS_SHARED), &seed);
    gsn_auto_mem(double) control = gsn_memdup(gsn_spline_controls(made.spline),
                                              gsn_dms_controls(made.space) * sizeof *control);
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };
    double mean = 99;

    control[13] = INFINITY;
    CHECK(gsn_spline_new(made.space, control, &spline, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "control value 13") && spline == NULL);
    CHECK(gsn_spline_cell_mean(made.spline, flat, &mean, &err) == GSN_E_INPUT);
    CHECK(gsn_spline_cell_mean(made.spline, broken, &mean, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "corner 2"));
    CHECK(gsn_spline_tet_mean(made.spline, 48, &mean, &err) == GSN_E_INPUT);
    CHECK(mean == 99);
    done(&made);
}

static int new_spline(const struct made *made, struct gsn_error *err)
{
    gsn_auto(gsn_spline) spline = NULL;

    return gsn_spline_new(made->space, gsn_spline_controls(made->spline), &spline, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    uint64_t seed = 43;
    struct made made = make_random(kuhn_space(SMALL, 0, 2, 0.05, GSN_DMS_SHARED), &seed);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(new_spline(&made, &err), err);
    done(&made);
}
