/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/spline.h"

#include "tests/check.h"
#include "tests/model/formula.h"
#include "tests/model/kuhn.h"

#include "pipeline/model/dms_internal.h"

#include <string.h>

static const size_t SMALL[3] = { 2, 2, 2 };
/* Clouds as they are, tiny ones, and coinciding knots. */
static const double factors[3] = { 1, 1e-6, 0 };

static double integral(const struct gsn_spline *spline, const double a[3], const double b[3])
{
    struct gsn_error err = { 0 };
    double value = NAN;

    CHECK_OK(gsn_spline_segment(spline, a, b, &value, &err), err);
    return value;
}

static void mix(const double a[3], const double b[3], double t, double ret[3])
{
    for (int c = 0; c < 3; c++)
        ret[c] = a[c] + t * (b[c] - a[c]);
}

static void draw_around(uint64_t *seed, double ret[3])
{
    for (int c = 0; c < 3; c++)
        ret[c] = 3 * draw(seed) - 0.5;
}

TEST(parts_add_up_and_there_and_back_is_the_same)
{
    uint64_t seed = 51;

    for (unsigned i = 0; i < 9; i++) {
        gsn_auto(gsn_dms) space = shrunk_space(SMALL, 0.2, i / 3 + 1, factors[i % 3],
                                               i % 2 ? GSN_DMS_OWN : GSN_DMS_SHARED);
        gsn_auto(gsn_spline) spline = random_spline(space, &seed);

        for (int k = 0; k < 12; k++) {
            double a[3], b[3], c[3], whole;

            draw_around(&seed, a);
            draw_around(&seed, c);
            mix(a, c, draw(&seed), b);
            whole = integral(spline, a, c);
            CHECK_NEAR(integral(spline, a, b) + integral(spline, b, c), whole, 1e-12);
            CHECK_NEAR(integral(spline, c, a), whole, 1e-13);
        }
    }
}

TEST(a_long_segment_is_the_whole_line_of_the_projection_formula)
{
    uint64_t seed = 53;

    for (unsigned i = 0; i < 9; i++) {
        gsn_auto(gsn_dms) space = shrunk_space(SMALL, 0.2, i / 3 + 1, factors[i % 3], GSN_DMS_OWN);
        gsn_auto(gsn_spline) spline = random_spline(space, &seed);

        for (int k = 0; k < 8; k++) {
            double a[3], b[3], d[3], from[3], to[3];

            draw_around(&seed, a);
            draw_around(&seed, b);
            gsn_subtract(b, a, d);
            mix(a, b, -50, from);
            mix(a, b, 60, to);
            CHECK_NEAR(integral(spline, from, to), gsn_spline_line(spline, a, d), 1e-11);
        }
    }
}

/* Ends that are multiples of 2^-20 and 2^30 away along such a direction lie exactly on the line. */
TEST(ends_may_be_a_thousand_million_away)
{
    uint64_t seed = 55;

    for (unsigned i = 0; i < 9; i++) {
        gsn_auto(gsn_dms) space = shrunk_space(SMALL, 0.2, i / 3 + 1, factors[i % 3], GSN_DMS_OWN);
        gsn_auto(gsn_spline) spline = random_spline(space, &seed);

        for (int k = 0; k < 8; k++) {
            double a[3], b[3], near[2][3], far[2][3];

            draw_around(&seed, a);
            draw_around(&seed, b);
            for (int c = 0; c < 3; c++) {
                const double start = floor(a[c] * 0x1p20) * 0x1p-20;
                const double step = (k % 4 == c ? 0 : floor((b[c] - a[c]) * 0x1p20) * 0x1p-20);

                near[0][c] = start - 32 * step;
                near[1][c] = start + 32 * step;
                far[0][c] = start - 0x1p31 * step;
                far[1][c] = start + 0x1p30 * step;
            }
            CHECK_NEAR(integral(spline, far[0], far[1]), integral(spline, near[0], near[1]), 1e-12);
        }
    }
}

/* The share of the segment a b inside the tetrahedron of four knots. */
static double chord(const struct gsn_dms *space, const double (*knot)[3], size_t quad,
                    const double a[3], const double b[3])
{
    const uint8_t *m = space->sets->set[quad].member;
    struct gsn_barycentric frame;
    double at_a[4], at_b[4], from = 0, to = 1;

    gsn_barycentric_init(&frame, knot[m[0]], knot[m[1]], knot[m[2]], knot[m[3]]);
    gsn_barycentric_at(&frame, a, at_a);
    gsn_barycentric_at(&frame, b, at_b);
    for (int k = 0; k < 4; k++) {
        const double zero = at_a[k] / (at_a[k] - at_b[k]);

        if (at_a[k] < 0 && at_b[k] < 0)
            return 0;
        if (at_a[k] < 0)
            from = fmax(from, zero);
        if (at_b[k] < 0)
            to = fmin(to, zero);
    }
    return fmax(0, to - from);
}

/* (n + 1) A(V) = n sum_j lambda_j(a | W) A(V \ k_j) + M(b | V), for knots in general position. */
static double corrected(const struct gsn_dms *space, const double (*knot)[3], const uint16_t *pick,
                        size_t s, const double a[3], const double b[3])
{
    const struct gsn_simplex_set *set = &space->sets->set[s];
    const struct gsn_simplex_set *w;
    struct gsn_simplex_at at;
    struct gsn_barycentric frame;
    double lambda[4], sum;

    if (set->size == 4)
        return chord(space, knot, s, a, b) / fabs(gsn_simplex_det(set, knot));
    w = &space->sets->set[pick[s]];
    gsn_barycentric_init(&frame, knot[w->member[0]], knot[w->member[1]], knot[w->member[2]],
                         knot[w->member[3]]);
    gsn_barycentric_at(&frame, a, lambda);
    gsn_simplex_at_init(&at, space->sets, knot, pick, b, 0);
    sum = gsn_simplex_value(&at, s);
    for (unsigned i = 0, m = 0; i < 4; i++) {
        while (set->member[m] != w->member[i])
            m++;
        sum += (set->size - 4) * lambda[i] * corrected(space, knot, pick, set->without[m], a, b);
    }
    return sum / (set->size - 3);
}

static double by_recurrence(const struct gsn_spline *spline, const double a[3], const double b[3])
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    double d[3], sum = 0;

    for (size_t t = 0; t < gsn_dms_mesh(space)->tet_count; t++) {
        const uint32_t *id = gsn_dms_control_ids(space, t);
        double own[GSN_SIMPLEX_MAX_KNOTS][3];
        const double(*knot)[3] = (const double(*)[3])own;
        uint16_t pick[GSN_SIMPLEX_MAX_LARGE];

        gsn_dms_gather(space, t, own);
        gsn_simplex_pick(space->sets, knot, pick);
        for (size_t f = 0; f < gsn_dms_functions(space); f++)
            sum += gsn_spline_controls(spline)[id[f]] *
                   fabs(gsn_simplex_det(&space->sets->set[space->sets->corners[f]], knot)) *
                   corrected(space, knot, pick, f, a, b);
    }
    gsn_subtract(b, a, d);
    return sum * sqrt(gsn_dot(d, d));
}

TEST(the_corrected_recurrence_agrees_where_it_holds)
{
    const double tolerance[4] = { 0, 1e-12, 1e-10, 1e-8 };
    uint64_t seed = 57;

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0.2, degree, 0.2, GSN_DMS_OWN);
        gsn_auto(gsn_spline) spline = random_spline(space, &seed);

        for (int k = 0; k < 4; k++) {
            double a[3], b[3];

            draw_around(&seed, a);
            draw_around(&seed, b);
            CHECK_NEAR(integral(spline, a, b), by_recurrence(spline, a, b), tolerance[degree]);
        }
    }
}

/* Within tiny clouds, of size e, the functions are as steep as 1/e, and along a mesh edge a
 * rounding of the coordinates counts that much. */
TEST(a_polynomial_has_its_own_integral_along_edges_faces_and_voxel_lines_too)
{
    const double from[5][3] = {
        { 1, 1, 1 }, { 0, 0, 0 }, { 0.25, 1, 0.25 }, { 0.125, 0.5, 1 }, { 1.5, 0.3, 0.7 }
    };
    const double to[5][3] = {
        { 1, 1, 0 }, { 2, 2, 2 }, { 1.75, 1, 1 }, { 1.875, 0.5, 1 }, { 0.2, 1.1, 1.9 }
    };
    const double tolerance[3] = { 1e-12, 1e-6, 1e-12 };
    uint64_t seed = 59;

    for (unsigned i = 0; i < 9; i++) {
        gsn_auto(gsn_dms) space = shrunk_space(SMALL, 0, i / 3 + 1, factors[i % 3], GSN_DMS_SHARED);
        const struct polynomial p = draw_polynomial(i / 3 + 1, &seed);
        gsn_auto_mem(double) control = polynomial_controls(&p, space);
        gsn_auto(gsn_spline) spline = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
        for (int k = 0; k < 5; k++) {
            double middle[3], d[3];

            mix(from[k], to[k], 0.5, middle);
            gsn_subtract(to[k], from[k], d);
            /* Simpson's rule. */
            CHECK_NEAR(integral(spline, from[k], to[k]),
                       sqrt(gsn_dot(d, d)) / 6 *
                           (polynomial_at(&p, from[k], NULL) + 4 * polynomial_at(&p, middle, NULL) +
                            polynomial_at(&p, to[k], NULL)),
                       tolerance[i % 3]);
        }
    }
}

/* With coinciding knots and own control points s jumps at faces, so the side matters. */
TEST(a_segment_in_mesh_planes_is_the_limit_from_the_side_of_the_half_open_rule)
{
    const double from[4][3] = {
        { 1, 1, 0.5 }, { 0.25, 1, 0.25 }, { 0.5, 0.5, 0.5 }, { 0.3, 1, 1 }
    };
    const double to[4][3] = { { 1, 1, 1.5 }, { 1.75, 1, 1 }, { 1.5, 1.5, 1.5 }, { 1.6, 1, 1 } };
    uint64_t seed = 61;

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = shrunk_space(SMALL, 0, degree, 0, GSN_DMS_OWN);
        gsn_auto(gsn_spline) spline = random_spline(space, &seed);

        for (int k = 0; k < 4; k++) {
            const double push[3] = { 1e-6, 1e-9, 1e-12 };
            double a[3], b[3];

            for (int c = 0; c < 3; c++) {
                a[c] = from[k][c] + push[c];
                b[c] = to[k][c] + push[c];
            }
            CHECK_NEAR(integral(spline, from[k], to[k]), integral(spline, a, b), 1e-4);
        }
    }
}

TEST(in_slivers_parts_add_up_to_the_projection_formula)
{
    uint64_t seed = 62;

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = flat_space(SMALL, 0.2, degree, 1e-4, GSN_DMS_OWN);
        gsn_auto(gsn_spline) spline = random_spline(space, &seed);

        for (int k = 0; k < 12; k++) {
            double a[3], b[3], c[3], d[3], whole;

            draw_around(&seed, a);
            draw_around(&seed, c);
            if (k % 2) {
                a[2] *= 1e-4;
                c[2] *= 1e-4;
            }
            mix(a, c, draw(&seed), b);
            gsn_subtract(c, a, d);
            mix(a, b, -9, a);
            mix(b, c, 9, c);
            whole = integral(spline, a, c);
            CHECK_NEAR(integral(spline, a, b) + integral(spline, b, c), whole, 1e-11);
            CHECK_NEAR(whole, gsn_spline_line(spline, b, d), 1e-10);
        }
    }
}

TEST(one_has_the_length_inside_the_domain)
{
    gsn_auto(gsn_dms) space = shrunk_space(SMALL, 0.2, 2, 0, GSN_DMS_SHARED);
    gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
    gsn_auto(gsn_spline) spline = NULL;
    struct gsn_error err = { 0 };
    const double ends[4][2][3] = {
        { { -1, 0.5, 0.5 }, { 5, 0.5, 0.5 } },
        { { 1, 1, 1 }, { 4, 5, 1 } },
        { { 1, -1e9, 1 }, { 1, 1e9, 1 } },
        { { -1, 3, 0 }, { 3, 3, 2 } },
    };
    const double truth[4] = { 2, 1.25, 2, 0 };

    for (size_t i = 0; i < gsn_dms_controls(space); i++)
        control[i] = 1;
    CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
    for (int i = 0; i < 4; i++)
        CHECK_NEAR(integral(spline, ends[i][0], ends[i][1]), truth[i], 1e-14);
}

TEST(what_is_no_segment_is_refused_and_a_point_has_no_length)
{
    uint64_t seed = 63;
    gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0.2, 2, 0.05, GSN_DMS_SHARED);
    gsn_auto(gsn_spline) spline = random_spline(space, &seed);
    const double good[3] = { 1, 0.5, 1 };
    const double bad[5][3] = { { NAN, 1, 1 },
                               { 1, INFINITY, 1 },
                               { 1, 1, -INFINITY },
                               { 1e300, 0, 0 },
                               { -1.7e308, 1.7e308, 1 } };
    struct gsn_error err = { 0 };
    double value = 99;

    for (int i = 0; i < 5; i++) {
        CHECK(gsn_spline_segment(spline, bad[i], good, &value, &err) == GSN_E_INPUT);
        CHECK(strstr(err.text, i < 3 ? "end a" : "farther away"));
        CHECK(gsn_spline_segment(spline, good, bad[i], &value, &err) == GSN_E_INPUT);
        CHECK(strstr(err.text, i < 3 ? "end b" : "farther away"));
    }
    CHECK(value == 99);
    CHECK(integral(spline, good, good) == 0);
    CHECK(integral(spline, (const double[3]){ 1e9, 1e9, 1e9 }, (const double[3]){ 2e9, 1, 1 }) ==
          0);
    CHECK_NEAR(integral(spline, good, (const double[3]){ 1, 0.5, 1 + 0x1p-52 }), 0, 1e-15);
    CHECK_NEAR(integral(spline, good, (const double[3]){ 1, 0.5 + 1e-300, 1 }), 0, 1e-15);
}
