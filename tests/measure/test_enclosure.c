/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/enclosure.h"

#include "tests/check.h"
#include "tests/measure/draw.h"
#include "tests/measure/kuhn.h"

static const double low[3] = { -30.0, 100.0, 0.0 }, high[3] = { 60.0, 190.0, 90.0 };
static const unsigned cells[3] = { 3, 3, 3 };

static struct gsn_aabb draw_box(uint64_t *seed, double most)
{
    struct gsn_aabb box;

    for (int a = 0; a < 3; a++) {
        box.half[a] = most * (0.05 + 0.95 * draw(seed));
        box.centre[a] = low[a] + box.half[a] + (high[a] - low[a] - 2.0 * box.half[a]) * draw(seed);
    }
    return box;
}

/* The bracket of a box from all tetrahedra that reach it. */
static struct gsn_enclosure bracket_of(const struct gsn_local_polynomials *pieces,
                                       const struct gsn_aabb *box)
{
    gsn_auto_mem(uint32_t) tet = gsn_alloc_array(pieces->count, sizeof *tet);
    struct gsn_enclosure bracket;
    uint32_t deepest = 0;
    size_t count = 0;

    for (size_t t = 0; t < pieces->count; t++) {
        if (gsn_local_polynomial_reaches(&pieces->piece[t], box))
            tet[count++] = (uint32_t)t;
    }
    gsn_enclosure_hull(pieces, tet, count, box, &bracket, &deepest);
    gsn_enclosure_tighten(pieces, tet, count, box, deepest, &bracket);
    return bracket;
}

/* s at random points, corners and the centre of the box is where the bracket says. */
static void check_points(const struct gsn_spline *spline, const struct gsn_aabb *box,
                         const struct gsn_enclosure *bracket, uint64_t *seed)
{
    size_t hint = 0;

    for (int k = 0; k < 25; k++) {
        double u[3], s, linear = bracket->linear.value;

        for (int a = 0; a < 3; a++) {
            double t = 2.0 * draw(seed) - 1.0;

            /* Not the very corner, which may lie on the domain's boundary. */
            if (k < 8)
                t = (k >> a & 1) ? 1.0 - 1e-9 : -1.0 + 1e-9;
            u[a] = box->centre[a] + t * box->half[a];
            linear += bracket->linear.slope[a] * t;
        }
        CHECK(gsn_spline_eval(spline, u, &hint, &s, NULL) == GSN_OK);
        CHECK(s >= linear + bracket->low && s <= linear + bracket->high);
        CHECK(s >= bracket->least && s <= bracket->most);
    }
}

static void check_spline(const struct gsn_spline *spline, uint64_t seed)
{
    const double size[4] = { 0.3, 2.0, 8.0, 25.0 };
    gsn_auto(gsn_local_polynomials) pieces = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_local_polynomials_new(spline, 1, &pieces, &err), err);
    for (int i = 0; i < 1200; i++) {
        const struct gsn_aabb box = draw_box(&seed, size[i % 4]);
        const struct gsn_enclosure bracket = bracket_of(pieces, &box);

        check_points(spline, &box, &bracket, &seed);
    }
}

static void check_random(unsigned degree, double fraction)
{
    struct kuhn kuhn;
    struct gsn_error err = { 0 };

    CHECK_OK(kuhn_random(low, high, cells, degree, fraction, 70 + degree, &kuhn, &err), err);
    check_spline(kuhn.spline, degree);
    kuhn_done(&kuhn);
}

TEST(a_bracket_encloses_random_splines_of_every_degree)
{
    check_random(1, 0.05);
    check_random(2, 0.05);
    check_random(3, 0.03);
}

TEST(a_bracket_encloses_splines_with_large_clouds)
{
    check_random(2, 0.2);
    check_random(3, 0.1);
}

TEST(brackets_shrink_with_the_box_in_cores_and_in_skins)
{
    struct kuhn kuhn;
    struct gsn_error err = { 0 };
    gsn_auto(gsn_local_polynomials) pieces = NULL;
    uint64_t seed = 4;

    CHECK_OK(kuhn_random(low, high, cells, 2, 0.05, 5, &kuhn, &err), err);
    CHECK_OK(gsn_local_polynomials_new(kuhn.spline, 1, &pieces, &err), err);
    CHECK(pieces->shared);
    for (int i = 0; i < 300; i++) {
        struct gsn_aabb box = draw_box(&seed, 4.0);
        double before = INFINITY;

        for (int k = 0; k < 6; k++) {
            const struct gsn_enclosure bracket = bracket_of(pieces, &box);

            /* In proportion at least; the factor leaves room for the linear part to move. */
            CHECK(bracket.high - bracket.low <= 0.6 * before);
            before = bracket.high - bracket.low;
            for (int a = 0; a < 3; a++)
                box.half[a] *= 0.5;
        }
    }
    kuhn_done(&kuhn);
}

/* The gradient of degree 2 is made of the functions of degree 1 on the first two knots of each
 * cloud: the least of the caps is that function, and not only above it. */
TEST(the_caps_of_the_gradients_functions_are_those_functions)
{
    struct kuhn kuhn;
    struct gsn_error err = { 0 };
    gsn_auto(gsn_dms) first = NULL;
    gsn_auto(gsn_local_polynomials) pieces = NULL;
    gsn_auto_mem(double) knot = NULL;
    uint64_t seed = 31;
    size_t hint = 0, checked = 0;

    CHECK_OK(kuhn_random(low, high, cells, 2, 0.2, 5, &kuhn, &err), err);
    knot = gsn_alloc_array(6 * kuhn.mesh->vertex_count, sizeof *knot);
    for (size_t i = 0; i < 6 * kuhn.mesh->vertex_count; i++)
        knot[i] = gsn_dms_knots(kuhn.space)[3 * (i / 6) + i / 3 % 2][i % 3];
    CHECK_OK(gsn_dms_new(kuhn.mesh, 1, (const double(*)[3])knot, GSN_DMS_OWN, &first, &err), err);
    CHECK_OK(gsn_local_polynomials_new(kuhn.spline, 1, &pieces, &err), err);
    for (int i = 0; i < 4000; i++) {
        const struct gsn_aabb box = draw_box(&seed, 0.0);
        struct gsn_dms_term term[256];
        double sum = 0.0;
        size_t count;

        CHECK(gsn_dms_basis(first, box.centre, 0, &hint, term, 256, &count) == GSN_OK);
        CHECK(count <= 256);
        for (size_t k = 0; k < count; k++) {
            const struct gsn_local_polynomial *piece = &pieces->piece[term[k].tet];

            /* Functions of degree 1 are in the order of their corner; slopes in that of g. */
            CHECK_NEAR(
                gsn_local_polynomial_slope_weight(piece, &piece->slope[3 - term[k].function], &box),
                term[k].value, 1e-9);
        }
        for (size_t t = 0; t < pieces->count; t++) {
            for (size_t f = 0; f < 4; f++)
                sum += gsn_local_polynomial_slope_weight(&pieces->piece[t],
                                                         &pieces->piece[t].slope[f], &box);
        }
        CHECK_NEAR(sum, 1.0, 1e-8);
        checked += count;
    }
    CHECK(checked > 16000);
    kuhn_done(&kuhn);
}

/* Control points of each tetrahedron's own: cliffs at faces, where the gradient says nothing. */
TEST(a_bracket_encloses_a_spline_with_cliffs)
{
    struct kuhn kuhn;
    struct gsn_error err = { 0 };
    gsn_auto(gsn_dms) space = NULL;
    gsn_auto(gsn_spline) spline = NULL;
    gsn_auto(gsn_local_polynomials) pieces = NULL;
    gsn_auto_mem(double) control = NULL;
    uint64_t seed = 12;

    CHECK_OK(kuhn_random(low, high, cells, 2, 0.05, 5, &kuhn, &err), err);
    CHECK_OK(gsn_dms_new(kuhn.mesh, 2, gsn_dms_knots(kuhn.space), GSN_DMS_OWN, &space, &err), err);
    control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
    for (size_t i = 0; i < gsn_dms_controls(space); i++)
        control[i] = 2.0 * draw(&seed) - 1.0;
    CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
    CHECK_OK(gsn_local_polynomials_new(spline, 1, &pieces, &err), err);
    CHECK(!pieces->shared);
    check_spline(spline, 8);
    gsn_spline_free(gsn_steal(&spline));
    gsn_dms_free(gsn_steal(&space));
    kuhn_done(&kuhn);
}

/* Boundary clouds mirrored to the inside: the gradient's missing terms reach into the domain. */
TEST(a_bracket_encloses_a_spline_whose_boundary_clouds_point_inward)
{
    struct kuhn kuhn;
    struct gsn_error err = { 0 };
    gsn_auto(gsn_dms) space = NULL;
    gsn_auto(gsn_spline) spline = NULL;
    gsn_auto_mem(double) knot = NULL;
    size_t count;

    CHECK_OK(kuhn_random(low, high, cells, 2, 0.05, 5, &kuhn, &err), err);
    count = 3 * kuhn.mesh->vertex_count;
    knot = gsn_alloc_array(3 * count, sizeof *knot);
    for (size_t v = 0; v < kuhn.mesh->vertex_count; v++) {
        for (size_t l = 0; l < 3; l++) {
            for (size_t a = 0; a < 3; a++) {
                const double at = kuhn.mesh->vertex[v][a];
                double to = gsn_dms_knots(kuhn.space)[3 * v + l][a];

                if ((at <= low[a] && to < at) || (at >= high[a] && to > at))
                    to = 2.0 * at - to;
                knot[3 * (3 * v + l) + a] = to;
            }
        }
    }
    CHECK_OK(gsn_dms_new(kuhn.mesh, 2, (const double(*)[3])knot, GSN_DMS_SHARED, &space, &err),
             err);
    CHECK_OK(gsn_spline_new(space, gsn_spline_controls(kuhn.spline), &spline, &err), err);
    check_spline(spline, 9);
    gsn_spline_free(gsn_steal(&spline));
    gsn_dms_free(gsn_steal(&space));
    kuhn_done(&kuhn);
}
