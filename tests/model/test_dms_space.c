/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a spline space keeps and what its searches find, against trying everything. */
#include "pipeline/model/dms_internal.h"
#include "pipeline/model/orient.h"
#include "pipeline/model/spline.h"

#include "tests/check.h"
#include "tests/model/kuhn.h"
#include "tests/model/test_domain_shapes.h"

#include <malloc.h>
#include <string.h>

enum { ROOM = 2000 };

/* gives: the space over a mesh; takes the mesh. */
static struct gsn_dms *space_over(struct gsn_tets *mesh, unsigned degree, double fraction)
{
    double(*knots)[3] = NULL;
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_dms_clouds(mesh, degree, fraction, &knots, &err), err);
    CHECK_OK(gsn_dms_new(mesh, degree, (const double(*)[3])knots, GSN_DMS_SHARED, &space, &err),
             err);
    gsn_free(knots);
    gsn_tets_free(mesh);
    return space;
}

/* gives: two blocks of cubes that do not touch, the second 7.5 edges along x, far from 0. */
static struct gsn_tets *two_blocks(double origin, double edge)
{
    const size_t cells[3] = { 2, 3, 2 };
    gsn_auto(gsn_tets) one = kuhn_mesh(cells, 0.2);
    const size_t v = one->vertex_count, t = one->tet_count;
    double(*vertex)[3] = gsn_alloc_array(2 * v, sizeof *vertex);
    uint32_t(*tet)[4] = gsn_alloc_array(2 * t, sizeof *tet);
    struct gsn_tets *mesh = NULL;
    struct gsn_error err = { 0 };

    CHECK(vertex && tet);
    for (size_t i = 0; i < 2 * v; i++) {
        for (int c = 0; c < 3; c++)
            vertex[i][c] = origin + edge * (one->vertex[i % v][c] + (i >= v && c == 0) * 7.5);
    }
    for (size_t i = 0; i < 2 * t; i++) {
        for (int k = 0; k < 4; k++)
            tet[i][k] = one->tet[i % t][k] + (uint32_t)(i >= t ? v : 0);
    }
    CHECK_OK(gsn_tets_new((const double(*)[3])vertex, 2 * v, (const uint32_t(*)[4])tet, 2 * t,
                          &mesh, &err),
             err);
    gsn_free(vertex);
    gsn_free(tet);
    return mesh;
}

TEST(clouds_that_are_too_thin_are_refused)
{
    const size_t cells[3] = { 2, 2, 2 };
    gsn_auto(gsn_tets) mesh = kuhn_mesh(cells, 0);
    gsn_auto(gsn_dms) space = NULL;
    double(*knots)[3] = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_dms_clouds(mesh, 2, 1e-11, &knots, &err) == GSN_E_MESH && !knots);
    CHECK(strstr(err.text, "less than 1e-10 is too thin"));
    CHECK_OK(gsn_dms_clouds(mesh, 2, 1e-9, &knots, &err), err);
    /* One pair of knots nearer than that, which are not the same; then the same. */
    memcpy(knots[3 * 13 + 1], knots[3 * 13 + 2], sizeof *knots);
    knots[3 * 13 + 1][0] += 1e-11;
    CHECK(gsn_dms_new(mesh, 2, (const double(*)[3])knots, GSN_DMS_SHARED, &space, &err) ==
          GSN_E_MESH);
    CHECK(strstr(err.text, "tetrahedron") && strstr(err.text, "of an edge apart"));
    memcpy(knots[3 * 13 + 1], knots[3 * 13 + 2], sizeof *knots);
    CHECK_OK(gsn_dms_new(mesh, 2, (const double(*)[3])knots, GSN_DMS_SHARED, &space, &err), err);
    gsn_free(knots);
}

/* gives: a cube of cubes, four of ten missing. */
static struct gsn_tets *cheese(void)
{
    const size_t cells[3] = { 7, 7, 7 };
    gsn_auto(gsn_tets) all = kuhn_mesh(cells, 0);
    uint32_t *place = gsn_alloc_array(all->vertex_count, sizeof *place);
    uint32_t(*tet)[4] = gsn_alloc_array(all->tet_count, sizeof *tet);
    double(*vertex)[3] = gsn_alloc_array(all->vertex_count, sizeof *vertex);
    struct gsn_tets *mesh = NULL;
    struct gsn_error err = { 0 };
    size_t tets = 0;
    uint32_t vertices = 0;

    CHECK(place && tet && vertex);
    for (size_t t = 0; t < all->tet_count; t++) {
        unsigned cell[3];

        for (int c = 0; c < 3; c++) {
            double middle = 0;

            for (int k = 0; k < 4; k++)
                middle += all->vertex[all->tet[t][k]][c] / 4;
            cell[c] = (unsigned)middle;
        }
        if ((cell[0] * 7 + cell[1] * 11 + cell[2] * 13 + cell[0] * cell[1] * cell[2]) % 10 < 4)
            continue;
        for (int k = 0; k < 4; k++) {
            uint32_t *to = &place[all->tet[t][k]];

            if (*to == 0) {
                memcpy(vertex[vertices], all->vertex[all->tet[t][k]], sizeof *vertex);
                *to = ++vertices;
            }
            tet[tets][k] = *to - 1;
        }
        tets++;
    }
    CHECK_OK(gsn_tets_new((const double(*)[3])vertex, vertices, (const uint32_t(*)[4])tet, tets,
                          &mesh, &err),
             err);
    gsn_free(place);
    gsn_free(tet);
    gsn_free(vertex);
    return mesh;
}

/* The tetrahedron with u on the inner side of all faces; tet_count when there is none. */
static size_t holder_of(const struct gsn_tets *mesh, const double u[3])
{
    static const int FACE[4][3] = { { 1, 3, 2 }, { 0, 2, 3 }, { 0, 3, 1 }, { 0, 1, 2 } };
    size_t t;

    for (t = 0; t < mesh->tet_count; t++) {
        int inside = 1;

        for (int k = 0; k < 4; k++)
            inside &= gsn_orient_side(mesh->vertex[mesh->tet[t][FACE[k][0]]],
                                      mesh->vertex[mesh->tet[t][FACE[k][1]]],
                                      mesh->vertex[mesh->tet[t][FACE[k][2]]], u) > 0;
        if (inside)
            break;
    }
    return t;
}

static void draw_in_box(const struct gsn_bvh_box *box, uint64_t *seed, double ret_u[3])
{
    for (int c = 0; c < 3; c++)
        ret_u[c] = box->low[c] + draw(seed) * (box->high[c] - box->low[c]);
}

/* Takes the mesh. */
static void check_locate(struct gsn_tets *taken)
{
    gsn_auto(gsn_dms) space = space_over(taken, 2, 0.02);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const struct gsn_bvh_box box =
        gsn_bvh_box_around((const double(*)[3])mesh->vertex, mesh->vertex_count);
    uint64_t seed = 3;
    size_t hint = 0;

    for (size_t i = 0; i < 1500; i++) {
        size_t tet = 12345, truth;
        double u[3];

        if (i < mesh->vertex_count)
            memcpy(u, mesh->vertex[i], sizeof u);
        else
            draw_in_box(&box, &seed, u);
        truth = holder_of(mesh, u);
        if (truth == mesh->tet_count) {
            CHECK(gsn_dms_locate(space, u, hint, &tet) == GSN_DMS_OUTSIDE && tet == 12345);
            continue;
        }
        CHECK(gsn_dms_locate(space, u, hint, &tet) == GSN_OK && tet == truth);
        CHECK(gsn_dms_locate(space, u, SIZE_MAX, &tet) == GSN_OK && tet == truth);
        hint = (size_t)(draw(&seed) * (double)mesh->tet_count);
    }
}

TEST(a_point_is_found_in_any_part_of_the_domain_wherever_that_lies)
{
    check_locate(two_blocks(0, 1));
    check_locate(two_blocks(1e6, 1));
    check_locate(two_blocks(-1e9, 100));
    check_locate(two_blocks(1e-3, 1e-6));
    check_locate(cheese());
}

TEST(a_point_far_away_is_outside)
{
    const double far[] = { 1e9, -1e9, 1e300, -1e300, INFINITY, -INFINITY, NAN };
    gsn_auto(gsn_dms) space = space_over(two_blocks(1e6, 1), 2, 0.1);

    for (size_t i = 0; i < 3 * sizeof far / sizeof *far; i++) {
        double u[3] = { 1e6 + 1, 1e6 + 1, 1e6 + 1 };
        size_t tet = 12345;

        u[i % 3] = far[i / 3];
        CHECK(gsn_dms_locate(space, u, i, &tet) == GSN_DMS_OUTSIDE && tet == 12345);
    }
}

/* Every term of every tetrahedron, in order. */
static void check_terms(const struct gsn_dms *space, const double u[3], size_t *hint)
{
    static struct gsn_dms_term term[ROOM];
    size_t count, at = 0;

    if (gsn_dms_basis(space, u, 0, hint, term, ROOM, &count) != GSN_OK)
        return;
    CHECK(count <= ROOM);
    for (size_t t = 0; t < gsn_dms_mesh(space)->tet_count; t++) {
        double value[GSN_DMS_MAX_FUNCTIONS];

        if (!gsn_dms_tet_basis(space, t, u, value, NULL))
            continue;
        for (size_t f = 0; f < gsn_dms_functions(space); f++) {
            if (fabs(value[f]) < 1e-14)
                continue;
            while (at < count && (term[at].tet < t || (term[at].tet == t && term[at].function < f)))
                at++;
            CHECK(at < count && term[at].tet == t && term[at].function == f);
            CHECK(term[at].value == value[f]);
        }
    }
}

TEST(no_function_that_lives_at_a_point_is_missed)
{
    const double origin[2] = { 0, 1e6 };

    for (unsigned degree = 1; degree <= 3; degree++) {
        for (int i = 0; i < 2; i++) {
            gsn_auto(gsn_dms) space = space_over(two_blocks(origin[i], 1), degree, 0.15);
            const struct gsn_tets *mesh = gsn_dms_mesh(space);
            uint64_t seed = 5;
            size_t hint = 0;

            for (size_t t = 0; t < mesh->tet_count; t += 3) {
                double u[3];

                draw_inside(mesh, t, &seed, u);
                check_terms(space, u, &hint);
                check_terms(space, mesh->vertex[mesh->tet[t][1]], &hint);
            }
        }
    }
}

/* Whatever is not 0 somewhere in a tetrahedron is in the list of what reaches it. */
TEST(no_tetrahedron_that_reaches_another_is_missed)
{
    gsn_auto(gsn_dms) space = space_over(two_blocks(0, 1), 2, 0.2);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    uint64_t seed = 7;
    size_t listed = 0;

    for (size_t home = 0; home < mesh->tet_count; home++) {
        struct gsn_sorted_batch ascent;
        uint8_t reaches[1000] = { 0 };

        gsn_sorted_batch_begin(&ascent);
        gsn_dms_reaching(space, home, &ascent);
        for (size_t i = 0; i < ascent.count; i++) {
            CHECK(i == 0 || ascent.item[i] > ascent.item[i - 1]);
            reaches[ascent.item[i]] = 1;
        }
        listed += ascent.count;
        CHECK(reaches[home] && !gsn_sorted_batch_next(&ascent));
        for (int i = 0; i < 10; i++) {
            double u[3], value[GSN_DMS_MAX_FUNCTIONS];

            draw_inside(mesh, home, &seed, u);
            for (size_t t = 0; t < mesh->tet_count; t++) {
                double sum = 0;

                if (reaches[t] || !gsn_dms_tet_basis(space, t, u, value, NULL))
                    continue;
                for (size_t f = 0; f < gsn_dms_functions(space); f++)
                    sum += value[f];
                CHECK(sum == 0);
            }
        }
    }
    /* The two blocks do not see each other. */
    CHECK(listed < mesh->tet_count * mesh->tet_count / 2);
}

/* More tetrahedra than a search brings into order at a time. */
TEST(the_mean_over_everything_adds_all_functions)
{
    const size_t cells[3] = { 6, 5, 4 };
    const double cell[4][3] = { { -2, -2, -2 }, { 40, -2, -2 }, { -2, 40, -2 }, { -2, -2, 40 } };
    gsn_auto(gsn_dms) space = kuhn_space(cells, 0.2, 1, 0.05, GSN_DMS_SHARED);
    gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
    gsn_auto(gsn_spline) spline = NULL;
    struct gsn_error err = { 0 };
    uint64_t seed = 9;
    double mean, sum = 0;

    CHECK(control && gsn_dms_mesh(space)->tet_count > GSN_SORTED_BATCH_ROOM);
    for (size_t i = 0; i < gsn_dms_controls(space); i++)
        control[i] = draw(&seed);
    CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
    for (size_t t = 0; t < gsn_dms_mesh(space)->tet_count; t++) {
        double knot[GSN_SIMPLEX_MAX_KNOTS][3];

        gsn_dms_gather(space, t, knot);
        for (size_t f = 0; f < 4; f++) {
            const struct gsn_simplex_set *x = &space->sets->set[space->sets->corners[f]];

            sum += control[gsn_dms_control_ids(space, t)[f]] *
                   gsn_simplex_det(x, (const double(*)[3])knot) / 6 / 4;
        }
    }
    CHECK_OK(gsn_spline_cell_mean(spline, cell, &mean, &err), err);
    CHECK_NEAR(mean * 42 * 42 * 42 / 6 / sum, 1, 1e-12);
}

TEST(what_is_kept_of_a_shape_is_rounded_outward)
{
    const size_t cells[3] = { 2, 2, 2 };

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(cells, 0.2, degree, 0.1, GSN_DMS_SHARED);

        for (size_t t = 0; t < gsn_dms_mesh(space)->tet_count; t++) {
            double knot[GSN_SIMPLEX_MAX_KNOTS][3], delta[4];
            struct gsn_dms_shape kept, exact;

            gsn_dms_gather(space, t, knot);
            gsn_dms_shape_of(space, t, &kept);
            exact = kept;
            gsn_dms_measure(degree, (const double(*)[3])knot, &exact);
            gsn_dms_core(space, t, delta);
            for (int k = 0; k < 4; k++) {
                CHECK(delta[k] == exact.high[k]);
                CHECK(kept.low[k] <= exact.low[k] && kept.low[k] > exact.low[k] - 1e-7);
                CHECK(kept.high[k] >= exact.high[k] && kept.high[k] < exact.high[k] + 1e-7);
            }
        }
    }
}

/* Bytes in use by the process, as the allocator counts them. */
static size_t in_use(void)
{
    const struct mallinfo2 info = mallinfo2();

    return info.uordblks + info.hblkhd;
}

TEST(a_quadratic_spline_holds_at_most_300_bytes_a_tetrahedron)
{
    gsn_auto(gsn_mask) region = shape_mask(8, 8, 8, 10, 10, 10, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 40, 1000);
    gsn_auto(gsn_dms) space = NULL;
    gsn_auto(gsn_spline) spline = NULL;
    gsn_auto_mem(double) control = gsn_alloc_array(100 * mesh->tet_count, sizeof *control);
    double(*knots)[3] = NULL;
    struct gsn_error err = { 0 };
    const size_t tets = mesh->tet_count;
    size_t before, held, controls, taken;

    CHECK_OK(gsn_dms_clouds(mesh, 2, 0.05, &knots, &err), err);
    before = in_use();
    CHECK_OK(gsn_dms_new(mesh, 2, (const double(*)[3])knots, GSN_DMS_SHARED, &space, &err), err);
    CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
    taken = in_use() - before;
    gsn_free(knots);

    controls = gsn_dms_controls(space) * sizeof *control;
    held = gsn_dms_bytes(space) + gsn_spline_bytes(spline);
    CHECK(tets > 8000);
    CHECK(held <= 300 * tets);
    CHECK((held + controls) * 100 > taken * 97);
    /* An allocator that does not count says 0. */
    CHECK(taken == 0 || (held + controls) * 99 < taken * 100);
}
