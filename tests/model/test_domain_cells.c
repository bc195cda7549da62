/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/domain_internal.h"

#include <string.h>

#include "tests/check.h"
#include "tests/model/test_domain_shapes.h"

static struct gsn_cells *covered(const struct gsn_mask *region, double edge)
{
    struct gsn_cells *cells = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_cells_cover(region, edge, &cells, &err), err);
    return cells;
}

/* An empty box of cells of edge 1 to draw into. */
static struct gsn_cells *empty(size_t n)
{
    gsn_auto(gsn_mask) region = shape_mask(n, n, n, 1, 1, 1, shape_everywhere);
    struct gsn_cells *cells = covered(region, 1);

    memset(cells->filled, 0, cells->n[0] * cells->n[1] * cells->n[2]);
    return cells;
}

static void fill(struct gsn_cells *cells, size_t x, size_t y, size_t z)
{
    cells->filled[gsn_cells_index(cells, (const size_t[3]){ x, y, z })] = 1;
}

static size_t filled(const struct gsn_cells *cells)
{
    size_t sum = 0;

    for (size_t i = 0; i < cells->n[0] * cells->n[1] * cells->n[2]; i++)
        sum += cells->filled[i];
    return sum;
}

/* The facets around a vertex: one walk from neighbour to neighbour must see them all. */
static int vertex_is_manifold(const struct gsn_surface *surface, uint32_t v)
{
    uint32_t facets[64], seen = 0, total = 0, at;

    for (uint32_t f = 0; f < surface->facet_count; f++)
        for (size_t k = 0; k < 4; k++)
            if (surface->facet[f][k] == v && total < 64)
                facets[total++] = f;
    at = facets[0];
    do {
        uint32_t previous = 0, next = UINT32_MAX;

        for (size_t k = 0; k < 4; k++)
            if (surface->facet[at][k] == v)
                previous = surface->facet[at][(k + 3) % 4];
        /* The next facet runs from v along the edge by which this one came to v. */
        for (uint32_t i = 0; i < total; i++)
            for (size_t k = 0; k < 4; k++)
                if (surface->facet[facets[i]][k] == v &&
                    surface->facet[facets[i]][(k + 1) % 4] == previous)
                    next = facets[i];
        if (next == UINT32_MAX)
            return 0;
        at = next;
        seen++;
    } while (at != facets[0] && seen <= total);
    return seen == total;
}

static void check_manifold(const struct gsn_cells *cells)
{
    gsn_auto(gsn_surface) surface = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_cells_surface(cells, &surface, &err), err);
    CHECK_OK(gsn_surface_check(surface, &err), err);
    for (uint32_t v = 0; v < surface->vertex_count; v++)
        CHECK(vertex_is_manifold(surface, v));
}

static void close_cells(struct gsn_cells *cells)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_cells_close(cells, &err), err);
    check_manifold(cells);
}

/* Volume by the divergence theorem: facets are squares seen from outside. */
static double enclosed(const struct gsn_surface *surface)
{
    double sum = 0;

    for (size_t f = 0; f < surface->facet_count; f++)
        for (size_t k = 1; k < 3; k++) {
            const double *a = surface->vertex[surface->facet[f][0]];
            const double *b = surface->vertex[surface->facet[f][k]];
            const double *c = surface->vertex[surface->facet[f][k + 1]];

            sum += a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
                   a[2] * (b[0] * c[1] - b[1] * c[0]);
        }
    return sum / 6;
}

static int middle(size_t x, size_t y, size_t z)
{
    return x == 2 && y == 3 && z == 1;
}

TEST(a_voxel_is_covered_with_the_voxels_around_it)
{
    gsn_auto(gsn_mask) region = shape_mask(5, 5, 5, 16, 16, 24, middle);
    gsn_auto(gsn_cells) cells = covered(region, 8);

    /* 3 x 3 x 3 voxels of 16 x 16 x 24 um in cells of 8 um. */
    CHECK(filled(cells) == 6 * 6 * 9);
    CHECK_NEAR(gsn_cells_volume(cells), 48 * 48 * 72, 1e-9);
    for (size_t x = 0; x < cells->n[0]; x++)
        CHECK(gsn_cells_plane(cells, 0, x) >= -16 - 8 - 1e-9);
}

TEST(cells_that_do_not_divide_the_voxels_reach_beyond_them)
{
    gsn_auto(gsn_mask) region = shape_mask(5, 5, 5, 16, 16, 24, middle);
    gsn_auto(gsn_cells) cells = covered(region, 20);

    /* x: 16..64 um needs the planes 0..80; y: 32..80 needs 20..80; z: 0..72 needs 0..80. */
    CHECK(filled(cells) == 4 * 3 * 4);
}

TEST(the_surface_encloses_the_volume_of_the_cells)
{
    gsn_auto(gsn_mask) region = shape_mask(4, 3, 5, 16, 16, 24, shape_everywhere);
    gsn_auto(gsn_cells) cells = covered(region, 13);
    gsn_auto(gsn_surface) surface = NULL;
    struct gsn_error err = { 0 };

    close_cells(cells);
    CHECK_OK(gsn_cells_surface(cells, &surface, &err), err);
    CHECK_NEAR(enclosed(surface), gsn_cells_volume(cells), 1e-6);
}

TEST(an_l_shape_is_manifold_as_it_is)
{
    gsn_auto(gsn_cells) cells = empty(4);

    fill(cells, 2, 2, 2);
    fill(cells, 3, 2, 2);
    fill(cells, 2, 3, 2);
    close_cells(cells);
    CHECK(filled(cells) == 3);
}

TEST(two_cells_across_an_edge_get_a_third)
{
    gsn_auto(gsn_cells) cells = empty(4);

    fill(cells, 2, 2, 2);
    fill(cells, 3, 3, 2);
    close_cells(cells);
    CHECK(filled(cells) == 3);
}

TEST(two_cells_across_a_vertex_get_two_more)
{
    gsn_auto(gsn_cells) cells = empty(4);

    fill(cells, 2, 2, 2);
    fill(cells, 3, 3, 3);
    close_cells(cells);
    CHECK(filled(cells) == 4);
}

TEST(a_saddle_around_a_vertex_is_closed)
{
    gsn_auto(gsn_cells) cells = empty(4);

    /* A full block but for two opposite corners: the empty space touches itself at a point. */
    for (size_t i = 1; i < 7; i++)
        fill(cells, 2 + (i & 1), 2 + (i >> 1 & 1), 2 + (i >> 2));
    close_cells(cells);
    CHECK(filled(cells) == 7);
}

TEST(an_enclosed_cavity_is_filled)
{
    gsn_auto(gsn_cells) cells = empty(5);

    for (size_t i = 0; i < 27; i++)
        if (i != 13)
            fill(cells, 2 + i % 3, 2 + i / 3 % 3, 2 + i / 9);
    close_cells(cells);
    CHECK(filled(cells) == 27);
}

TEST(any_heap_of_cells_becomes_manifold_and_loses_none)
{
    uint64_t dice = 7;

    for (unsigned heap = 0; heap < 40; heap++) {
        gsn_auto(gsn_cells) cells = empty(5);
        gsn_auto_mem(uint8_t) before = NULL;
        const size_t count = cells->n[0] * cells->n[1] * cells->n[2];
        const double least = -1.5 + 0.07 * heap;

        for (size_t z = 1; z + 1 < cells->n[2]; z++)
            for (size_t y = 1; y + 1 < cells->n[1]; y++)
                for (size_t x = 1; x + 1 < cells->n[0]; x++)
                    if (shape_normal(&dice) > least)
                        fill(cells, x, y, z);
        before = gsn_memdup(cells->filled, count);
        CHECK(before);
        close_cells(cells);
        for (size_t i = 0; i < count; i++)
            CHECK(cells->filled[i] >= before[i]);
    }
}

static int nowhere(size_t x, size_t y, size_t z)
{
    (void)x;
    (void)y;
    (void)z;
    return 0;
}

TEST(an_empty_region_and_too_many_cells_are_refused)
{
    gsn_auto(gsn_mask) none = shape_mask(3, 3, 3, 1, 1, 1, nowhere);
    gsn_auto(gsn_mask) some = shape_mask(3, 3, 3, 1, 1, 1, shape_everywhere);
    gsn_auto(gsn_cells) cells = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_cells_cover(none, 1, &cells, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "empty"));
    CHECK(gsn_cells_cover(some, 1e-5, &cells, &err) == GSN_E_LIMIT);
    some->at.step_um.y = -1;
    CHECK(gsn_cells_cover(some, 1, &cells, &err) == GSN_E_INPUT);
    CHECK(cells == NULL);
}

/* One tetrahedron of this height over a triangle of edges 1 and more. */
static int verify_height(double height, struct gsn_error *err)
{
    const double point[4][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0.3, 0.3, height } };
    const uint32_t tet[1][4] = { { 0, 1, 2, 3 } };
    gsn_auto(gsn_tets) mesh = NULL;

    CHECK_OK(gsn_tets_new(point, 4, tet, 1, &mesh, err), *err);
    return gsn_domain_verify_heights(mesh, err);
}

TEST(a_tetrahedron_too_flat_for_knots_is_refused_though_it_is_no_degenerate_one)
{
    struct gsn_error err = { 0 };

    CHECK_OK(verify_height(1e-4, &err), err);
    CHECK_OK(verify_height(1.5e-6, &err), err);
    CHECK(verify_height(1.4e-6, &err) == GSN_E_MESH);
    CHECK(verify_height(1e-20, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "tetrahedron 0") && strstr(err.text, "too flat"));
}

TEST(an_open_surface_and_impossible_corners_are_refused)
{
    gsn_auto(gsn_surface) cube = shape_cube(1);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_surface_check(cube, &err), err);
    cube->facet_count--;
    CHECK(gsn_surface_check(cube, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "not closed"));
    cube->facet_count++;
    cube->facet[2][1] = 8;
    CHECK(gsn_surface_check(cube, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "facet 2"));
    cube->facet[2][1] = 1;
    cube->vertex[5][2] = NAN;
    CHECK(gsn_surface_check(cube, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "vertex 5"));
}

static int cells_once(const struct gsn_mask *region, struct gsn_error *err)
{
    gsn_auto(gsn_cells) cells = NULL;
    gsn_auto(gsn_surface) surface = NULL;
    int r = gsn_cells_cover(region, 1, &cells, err);

    if (r >= 0)
        r = gsn_cells_close(cells, err);
    if (r >= 0)
        r = gsn_cells_surface(cells, &surface, err);
    return r < 0 ? r : gsn_surface_check(surface, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_mask) region = shape_mask(3, 3, 3, 1, 1, 1, shape_everywhere);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(cells_once(region, &err), err);
}
