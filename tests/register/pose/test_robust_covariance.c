/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/pose/outlier.h"

#include "tests/check.h"
#include "tests/register/draw.h"

enum { COUNT = 4000 };

/* Covariance diag(9, 1, 1) with the first two axes correlated; a share of the vectors is far out
 * along the third. */
static void draw_all(struct gsn_robust_vector *v, double wrong, struct draw_chance *chance)
{
    for (int i = 0; i < COUNT; i++) {
        const double a = draw_normal(chance), b = draw_normal(chance), c = draw_normal(chance);

        v[i] = (struct gsn_robust_vector){ .v = { 3 * a, 0.6 * a + 0.8 * b, c } };
        if (draw_uniform(chance, 0, 1) < wrong)
            v[i].v[2] += 50;
    }
}

static void check_recovered(const double c[3][3], double tolerance)
{
    CHECK_NEAR(c[0][0], 9, 9 * tolerance);
    CHECK_NEAR(c[0][1], 1.8, 3 * tolerance);
    CHECK_NEAR(c[1][1], 1, tolerance);
    CHECK_NEAR(c[2][2], 1, tolerance);
    CHECK_NEAR(c[1][2], 0, tolerance);
}

TEST(the_covariance_of_clean_vectors_is_recovered)
{
    static struct gsn_robust_vector v[COUNT];
    static double scratch[COUNT];
    struct draw_chance chance = { 1 };
    double c[3][3];
    size_t outside = 0;

    draw_all(v, 0, &chance);
    CHECK(gsn_robust_covariance(v, COUNT, scratch, c) == 0);
    check_recovered((const double(*)[3])c, 0.06);
    for (int i = 0; i < COUNT; i++)
        outside += !v[i].inlier;
    CHECK(outside <= 12); /* 0.1 % of 4000, and four standard deviations */
}

TEST(a_fifth_of_wrong_vectors_moves_nothing)
{
    static struct gsn_robust_vector v[COUNT];
    static double scratch[COUNT];
    struct draw_chance chance = { 2 };
    double c[3][3];

    draw_all(v, 0.2, &chance);
    CHECK(gsn_robust_covariance(v, COUNT, scratch, c) == 0);
    check_recovered((const double(*)[3])c, 0.1);
}

TEST(vectors_in_a_plane_have_no_covariance)
{
    static struct gsn_robust_vector v[COUNT];
    static double scratch[COUNT];
    struct draw_chance chance = { 3 };
    double c[3][3] = { { 77 } };

    draw_all(v, 0, &chance);
    for (int i = 0; i < COUNT; i++)
        v[i].v[2] = 0;
    CHECK(gsn_robust_covariance(v, COUNT, scratch, c) == -1);
    CHECK(c[0][0] == 77);
}
