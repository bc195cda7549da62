/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/local_polynomial.h"

#include "tests/check.h"
#include "tests/measure/draw.h"
#include "tests/measure/kuhn.h"

static const double low[3] = { -30.0, 100.0, 0.0 }, high[3] = { 60.0, 190.0, 90.0 };
static const unsigned cells[3] = { 3, 3, 3 };

enum { MOST_SLOPES = 10 }; /* of degree 3 */

static struct gsn_aabb draw_box(uint64_t *seed, double most)
{
    struct gsn_aabb box;

    for (int a = 0; a < 3; a++) {
        box.half[a] = most * (0.05 + 0.95 * draw(seed));
        box.centre[a] = low[a] + box.half[a] + (high[a] - low[a] - 2.0 * box.half[a]) * draw(seed);
    }
    return box;
}

/* The pieces of random splines enclose the spline itself, in cores and in skins. */
static void check_enclosure(unsigned degree, double fraction)
{
    struct kuhn kuhn;
    struct gsn_error err = { 0 };
    uint64_t seed = 100 + degree;
    size_t skins = 0, cores = 0;

    CHECK_OK(kuhn_random(low, high, cells, degree, fraction, 7, &kuhn, &err), err);
    gsn_auto_mem(struct gsn_local_polynomial) piece =
        gsn_alloc_array(kuhn.mesh->tet_count, sizeof *piece);
    gsn_auto_mem(struct gsn_local_polynomial_slope) slope =
        gsn_alloc_array(kuhn.mesh->tet_count, MOST_SLOPES * sizeof *slope);
    for (size_t t = 0; t < kuhn.mesh->tet_count; t++)
        gsn_local_polynomial_make(kuhn.spline, t, slope + t * MOST_SLOPES, &piece[t]);
    for (int i = 0; i < 400; i++) {
        const struct gsn_aabb box = draw_box(&seed, i % 2 ? 2.0 : 12.0);
        size_t hint = 0;

        for (int k = 0; k < 20; k++) {
            double u[3], t[3], s, least, most;
            struct gsn_local_polynomial_linear linear;
            struct gsn_local_polynomial_bend bend;
            enum gsn_local_polynomial_touch touch;
            double value;

            for (int a = 0; a < 3; a++) {
                t[a] = 2.0 * draw(&seed) - 1.0;
                u[a] = box.centre[a] + t[a] * box.half[a];
            }
            CHECK(gsn_spline_eval(kuhn.spline, u, &hint, &s, NULL) == GSN_OK);
            touch = gsn_local_polynomial_meets(&piece[hint], &box);
            CHECK(touch != GSN_LOCAL_POLYNOMIAL_APART);
            CHECK(gsn_local_polynomial_depth(&piece[hint], u) >= -1e-12);
            gsn_local_polynomial_tangent(&piece[hint], &box, &linear, &bend);
            gsn_local_polynomial_bound(&piece[hint], &box, &linear, &least, &most);
            if (touch == GSN_LOCAL_POLYNOMIAL_TOUCHES) {
                least += piece[hint].residual_low;
                most += piece[hint].residual_high;
            }
            value = linear.value;
            for (int a = 0; a < 3; a++)
                value += linear.slope[a] * t[a];
            CHECK(s >= value + least && s <= value + most);
            CHECK(s >= piece[hint].whole_low && s <= piece[hint].whole_high);
            skins += touch == GSN_LOCAL_POLYNOMIAL_TOUCHES;
            cores += touch == GSN_LOCAL_POLYNOMIAL_COVERS;
        }
    }
    CHECK(skins > 500 && cores > 100);
    kuhn_done(&kuhn);
}

TEST(a_piece_encloses_the_spline_of_degree_1)
{
    check_enclosure(1, 0.05);
}

TEST(a_piece_encloses_the_spline_of_degree_2)
{
    check_enclosure(2, 0.05);
}

TEST(a_piece_encloses_the_spline_of_degree_3)
{
    check_enclosure(3, 0.03);
}

TEST(a_linear_field_leaves_nothing_beside_its_tangent)
{
    const struct quadric q = { 3.0, { 0.5, -0.25, 0.125 }, { 0.0, 0.0, 0.0 } };
    uint64_t seed = 5;

    for (unsigned degree = 1; degree <= 3; degree++) {
        struct kuhn kuhn;
        struct gsn_error err = { 0 };

        CHECK_OK(kuhn_new(low, high, cells, degree, 0.05, &q, &kuhn, &err), err);
        for (int i = 0; i < 100; i++) {
            const struct gsn_aabb box = draw_box(&seed, 10.0);
            struct gsn_local_polynomial_slope slope[MOST_SLOPES];
            struct gsn_local_polynomial piece;
            struct gsn_local_polynomial_linear linear;
            struct gsn_local_polynomial_bend bend;
            double least, most;

            gsn_local_polynomial_make(kuhn.spline, (size_t)i, slope, &piece);
            gsn_local_polynomial_tangent(&piece, &box, &linear, &bend);
            gsn_local_polynomial_bound(&piece, &box, &linear, &least, &most);
            CHECK_NEAR(linear.value, quadric_at(&q, box.centre), 1e-11);
            for (int a = 0; a < 3; a++)
                CHECK_NEAR(linear.slope[a], q.linear[a] * box.half[a], 1e-11);
            /* The box may lie several tetrahedra away, where rounding is allowed for with the third
             * power of the distance. */
            CHECK(least <= 0.0 && least > -1e-6 && most >= 0.0 && most < 1e-6);
            for (size_t f = 0; f < gsn_local_polynomial_slopes(kuhn.space); f++) {
                for (int a = 0; a < 3; a++)
                    CHECK_NEAR(slope[f].gradient[a], q.linear[a], 1e-12);
            }
        }
        kuhn_done(&kuhn);
    }
}

TEST(a_square_is_bounded_by_its_extremes)
{
    const struct quadric q = { 0.0, { 0.0, 0.0, 0.0 }, { 0.01, 0.0, 0.0 } };
    const struct gsn_aabb box = { { 10.0, 140.0, 40.0 }, { 4.0, 3.0, 2.0 } };
    struct kuhn kuhn;
    struct gsn_error err = { 0 };
    struct gsn_local_polynomial_slope slope[MOST_SLOPES];
    struct gsn_local_polynomial piece;
    struct gsn_local_polynomial_linear linear;
    struct gsn_local_polynomial_bend bend;
    double least, most;

    for (unsigned degree = 2; degree <= 3; degree++) {
        CHECK_OK(kuhn_new(low, high, cells, degree, 0.05, &q, &kuhn, &err), err);
        gsn_local_polynomial_make(kuhn.spline, 11, slope, &piece);
        gsn_local_polynomial_tangent(&piece, &box, &linear, &bend);
        gsn_local_polynomial_bound(&piece, &box, &linear, &least, &most);
        /* 0.01 (10 + 4 t)^2 = 1 + 0.8 t + 0.16 t^2 */
        CHECK_NEAR(linear.value, 1.0, 1e-9);
        CHECK_NEAR(linear.slope[0], 0.8, 1e-9);
        CHECK_NEAR(bend.square[0], 0.16, 1e-9);
        CHECK_NEAR(bend.cross[1], 0.0, 1e-9);
        CHECK_NEAR(least, 0.0, 1e-7);
        CHECK_NEAR(most, 0.16, 1e-7);
        /* The gradient's coefficients are its values at their nodes. */
        for (size_t f = 0; f < gsn_local_polynomial_slopes(kuhn.space); f++) {
            CHECK_NEAR(slope[f].gradient[0], 0.02 * slope[f].node[0], 1e-10);
            CHECK_NEAR(slope[f].gradient[1], 0.0, 1e-10);
        }
        kuhn_done(&kuhn);
    }
}
