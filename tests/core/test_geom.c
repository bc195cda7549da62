/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/geom.h"

#include "tests/check.h"

/* A repeatable sequence, -1 to 1. */
static double draw(uint64_t *seed)
{
    *seed = *seed * 6364136223846793005u + 1442695040888963407u;
    return (double)(int64_t)(*seed >> 11) / (double)((int64_t)1 << 52) - 1;
}

/* Well conditioned: its matrix differs from one multiple of a rotation by less than a third. */
static struct gsn_affine draw_map(uint64_t *seed)
{
    const double angle = 3.2 * draw(seed), scale = 1.5 + 0.5 * draw(seed);
    const double mirror = draw(seed) < 0 ? -1 : 1;

    return (struct gsn_affine){ .m00 = scale * cos(angle) + 0.2 * draw(seed),
                                .m01 = -mirror * scale * sin(angle),
                                .m02 = 5000 * draw(seed),
                                .m10 = scale * sin(angle),
                                .m11 = mirror * scale * cos(angle) + 0.2 * draw(seed),
                                .m12 = 5000 * draw(seed) };
}

static void check_maps_equal(const struct gsn_affine *a, const struct gsn_affine *b)
{
    CHECK_NEAR(a->m00, b->m00, 1e-12);
    CHECK_NEAR(a->m01, b->m01, 1e-12);
    CHECK_NEAR(a->m02, b->m02, 1e-8);
    CHECK_NEAR(a->m10, b->m10, 1e-12);
    CHECK_NEAR(a->m11, b->m11, 1e-12);
    CHECK_NEAR(a->m12, b->m12, 1e-8);
}

static const struct gsn_affine STAY = { .m00 = 1, .m11 = 1 };

TEST(a_map_is_applied_as_it_is_written)
{
    const struct gsn_affine map = { 1, 2, 3, 4, 5, 6 };
    const struct gsn_point p = gsn_affine_apply(&map, (struct gsn_point){ 10, 100 });

    CHECK_NEAR(p.x, 213, 0);
    CHECK_NEAR(p.y, 546, 0);
}

TEST(a_quarter_turn_then_a_shift_is_not_a_shift_then_a_quarter_turn)
{
    const struct gsn_affine turn = { .m01 = -1, .m10 = 1 }; /* (x, y) -> (-y, x) */
    const struct gsn_affine shift = { .m00 = 1, .m02 = 7, .m11 = 1, .m12 = 0 };
    const struct gsn_affine turn_first = gsn_affine_compose(&turn, &shift);
    const struct gsn_affine shift_first = gsn_affine_compose(&shift, &turn);
    const struct gsn_point at = { 2, 3 };

    CHECK_NEAR(gsn_affine_apply(&turn_first, at).x, 4, 0);
    CHECK_NEAR(gsn_affine_apply(&turn_first, at).y, 2, 0);
    CHECK_NEAR(gsn_affine_apply(&shift_first, at).x, -3, 0);
    CHECK_NEAR(gsn_affine_apply(&shift_first, at).y, 9, 0);
}

TEST(composing_is_applying_one_after_the_other)
{
    uint64_t seed = 1;

    for (int i = 0; i < 1000; i++) {
        const struct gsn_affine first = draw_map(&seed), second = draw_map(&seed);
        const struct gsn_affine both = gsn_affine_compose(&first, &second);
        const struct gsn_point p = { 4000 * draw(&seed), 4000 * draw(&seed) };
        const struct gsn_point at_once = gsn_affine_apply(&both, p);
        const struct gsn_point step = gsn_affine_apply(&first, p);
        const struct gsn_point after = gsn_affine_apply(&second, step);

        CHECK_NEAR(at_once.x, after.x, 1e-8);
        CHECK_NEAR(at_once.y, after.y, 1e-8);
        CHECK_NEAR(gsn_affine_det(&both), gsn_affine_det(&first) * gsn_affine_det(&second), 1e-11);
    }
}

TEST(an_inverse_undoes_its_map_from_both_sides)
{
    uint64_t seed = 2;

    for (int i = 0; i < 1000; i++) {
        const struct gsn_affine map = draw_map(&seed);
        const struct gsn_affine back = gsn_affine_inverse(&map);
        const struct gsn_affine there_and_back = gsn_affine_compose(&map, &back);
        const struct gsn_affine back_and_there = gsn_affine_compose(&back, &map);
        const struct gsn_affine again = gsn_affine_inverse(&back);

        check_maps_equal(&there_and_back, &STAY);
        check_maps_equal(&back_and_there, &STAY);
        check_maps_equal(&again, &map);
        CHECK_NEAR(gsn_affine_det(&map) * gsn_affine_det(&back), 1, 1e-12);
    }
}

TEST(the_inverse_of_both_is_the_inverses_in_reverse)
{
    uint64_t seed = 3;

    for (int i = 0; i < 1000; i++) {
        const struct gsn_affine a = draw_map(&seed), b = draw_map(&seed);
        const struct gsn_affine both = gsn_affine_compose(&a, &b);
        const struct gsn_affine a_back = gsn_affine_inverse(&a), b_back = gsn_affine_inverse(&b);
        const struct gsn_affine left = gsn_affine_inverse(&both);
        const struct gsn_affine right = gsn_affine_compose(&b_back, &a_back);

        check_maps_equal(&left, &right);
    }
}

TEST(staying_is_neutral_and_its_own_inverse)
{
    uint64_t seed = 4;
    const struct gsn_affine map = draw_map(&seed), back = gsn_affine_inverse(&STAY);
    const struct gsn_affine before = gsn_affine_compose(&STAY, &map);
    const struct gsn_affine after = gsn_affine_compose(&map, &STAY);

    check_maps_equal(&before, &map);
    check_maps_equal(&after, &map);
    check_maps_equal(&back, &STAY);
}

TEST(a_flip_has_a_negative_determinant_and_a_rotation_one)
{
    const struct gsn_affine flip = { .m00 = -1, .m11 = 1 };
    const struct gsn_affine turn = { cos(1), -sin(1), 8, sin(1), cos(1), 9 };
    const struct gsn_affine flat = { 1, 2, 0, 2, 4, 0 };

    CHECK_NEAR(gsn_affine_det(&flip), -1, 0);
    CHECK_NEAR(gsn_affine_det(&turn), 1, 1e-15);
    CHECK_NEAR(gsn_affine_det(&flat), 0, 0);
}

TEST(the_cross_product_is_right_handed_and_square_to_both)
{
    const struct gsn_vec3 x = gsn_vec3_make(1, 0, 0), y = gsn_vec3_make(0, 1, 0);
    const struct gsn_vec3 z = gsn_vec3_cross(x, y);
    uint64_t seed = 5;

    CHECK(z.x == 0 && z.y == 0 && z.z == 1);
    for (int i = 0; i < 1000; i++) {
        const struct gsn_vec3 a = gsn_vec3_make(draw(&seed), draw(&seed), draw(&seed));
        const struct gsn_vec3 b = gsn_vec3_make(draw(&seed), draw(&seed), draw(&seed));
        const struct gsn_vec3 c = gsn_vec3_cross(a, b), other = gsn_vec3_cross(b, a);
        const double dot = gsn_vec3_dot(a, b);

        CHECK_NEAR(gsn_vec3_dot(a, c), 0, 1e-15);
        CHECK_NEAR(gsn_vec3_dot(b, c), 0, 1e-15);
        CHECK(c.x == -other.x && c.y == -other.y && c.z == -other.z);
        /* Lagrange: |a x b|^2 + (a.b)^2 = |a|^2 |b|^2. */
        CHECK_NEAR(gsn_vec3_dot(c, c) + dot * dot, gsn_vec3_dot(a, a) * gsn_vec3_dot(b, b), 1e-14);
    }
}

TEST(lengths_and_differences_are_those_of_euclid)
{
    const struct gsn_vec3 a = gsn_vec3_make(2, 3, 6), b = gsn_vec3_make(1, 1, 4);
    const struct gsn_vec3 d = gsn_vec3_sub(a, b);

    CHECK_NEAR(gsn_vec3_length(a), 7, 0);
    CHECK(d.x == 1 && d.y == 2 && d.z == 2);
    CHECK_NEAR(gsn_vec3_length(d), 3, 0);
    CHECK_NEAR(gsn_vec3_length(gsn_vec3_make(0, 0, 0)), 0, 0);
}
