/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/isosurface.h"

#include <stdlib.h>
#include <string.h>

#include "pipeline/core/geom.h"
#include "tests/check.h"
#include "tests/measure/kuhn.h"

static const double low[3] = { -1000.0, -1000.0, -1000.0 }, high[3] = { 1000.0, 1000.0, 1000.0 };
static const unsigned cells[3] = { 4, 4, 4 };
static const double radius = 733.0;
/* radius^2 - |u|^2, in radius^2 */
static const struct quadric ball = { 1.0,
                                     { 0.0, 0.0, 0.0 },
                                     { -1.0 / (733.0 * 733.0), -1.0 / (733.0 * 733.0),
                                       -1.0 / (733.0 * 733.0) } };

static int by_edge(const void *a, const void *b)
{
    return memcmp(a, b, 2 * sizeof(uint32_t));
}

/* How many directed edges have no partner the other way round; -1 when one comes twice. */
static long open_edges(const struct gsn_trimesh *surface)
{
    const size_t count = 3 * surface->triangle_count;
    uint32_t(*edge)[2] = gsn_alloc_array(count, sizeof *edge);
    long alone = 0;

    for (size_t i = 0; i < count; i++) {
        edge[i][0] = surface->triangle[i / 3][i % 3];
        edge[i][1] = surface->triangle[i / 3][(i + 1) % 3];
    }
    qsort(edge, count, sizeof *edge, by_edge);
    for (size_t i = 0; i < count && alone >= 0; i++) {
        const uint32_t back[2] = { edge[i][1], edge[i][0] };

        if (i > 0 && by_edge(edge[i - 1], edge[i]) == 0)
            alone = -1;
        else
            alone += bsearch(back, edge, count, sizeof *edge, by_edge) == NULL;
    }
    gsn_free(edge);
    return alone;
}

/* By the divergence theorem: signed tetrahedra to a vertex of the surface. */
static double enclosed_volume(const struct gsn_trimesh *surface)
{
    double volume = 0.0;

    for (size_t t = 0; t < surface->triangle_count; t++) {
        double edge[3][3], normal[3];

        for (int k = 0; k < 3; k++)
            for (int a = 0; a < 3; a++)
                edge[k][a] = surface->vertex[surface->triangle[t][k]][a] - surface->vertex[0][a];
        gsn_cross3(edge[1], edge[2], normal);
        volume += gsn_dot3(edge[0], normal) / 6.0;
    }
    return volume;
}

static int surface_of(const struct gsn_spline *spline, double level, double error_um,
                      unsigned threads, struct gsn_trimesh **ret_surface, struct gsn_error *err)
{
    const struct gsn_isosurface_options options = { .level = level,
                                                    .error_um = error_um,
                                                    .threads = threads };

    return gsn_isosurface(spline, &options, ret_surface, err);
}

TEST(the_surface_of_a_ball_is_closed_and_lies_on_it)
{
    double area_error = INFINITY, volume_error = INFINITY;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &ball, &kuhn, &err), err);
    for (double within = 40; within > 1; within /= 4) {
        gsn_auto(gsn_trimesh) surface = NULL;
        double area, volume;

        CHECK_OK(surface_of(kuhn.spline, 0, within, 0, &surface, &err), err);
        CHECK(surface->error_um <= within);
        CHECK(surface->triangle_count > 100);
        for (size_t v = 0; v < surface->vertex_count; v++) {
            const double *p = surface->vertex[v];
            const double r = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);

            CHECK_NEAR(r, radius, 1e-6 * radius);
            for (int a = 0; a < 3; a++)
                CHECK_NEAR((double)surface->normal[v][a], p[a] / r, 1e-6);
        }
        CHECK(open_edges(surface) == 0);
        /* Euler: V - E + F = 2 for a sphere, with 2 E = 3 F. */
        CHECK(2 * surface->vertex_count == 4 + surface->triangle_count);
        area = fabs(gsn_trimesh_area(surface, NULL) - 4.0 * M_PI * radius * radius);
        volume = fabs(enclosed_volume(surface) - 4.0 / 3.0 * M_PI * pow(radius, 3));
        CHECK(area < 0.5 * area_error && volume < 0.5 * volume_error);
        area_error = area;
        volume_error = volume;
    }
    CHECK(area_error < 0.005 * 4.0 * M_PI * radius * radius);
    CHECK(volume_error < 0.008 * 4.0 / 3.0 * M_PI * pow(radius, 3));
    kuhn_done(&kuhn);
}

/* The farthest that middles of triangles and of their edges lie from the sphere around c. */
static double farthest_from_sphere(const struct gsn_trimesh *surface, const double c[3], double r)
{
    double farthest = 0;

    for (size_t t = 0; t < surface->triangle_count; t++) {
        const uint32_t *v = surface->triangle[t];

        for (int k = 0; k < 4; k++) {
            double u[3];

            for (int a = 0; a < 3; a++)
                u[a] =
                    (k == 3 ? (surface->vertex[v[0]][a] + surface->vertex[v[1]][a] +
                               surface->vertex[v[2]][a]) /
                                  3
                            : (surface->vertex[v[k]][a] + surface->vertex[v[(k + 1) % 3]][a]) / 2) -
                    c[a];
            farthest = fmax(farthest, fabs(gsn_length3(u) - r));
        }
    }
    return farthest;
}

TEST(no_triangle_is_farther_from_the_surface_than_asked)
{
    const double centre[3] = { 0, 0, 0 };
    size_t triangles = 0;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &ball, &kuhn, &err), err);
    for (double within = 32; within >= 0.5; within /= 4) {
        gsn_auto(gsn_trimesh) surface = NULL;
        double farthest;

        CHECK_OK(surface_of(kuhn.spline, 0, within, 0, &surface, &err), err);
        farthest = farthest_from_sphere(surface, centre, radius);
        /* On a sphere an edge's middle is off by what is estimated, a triangle's by 4/3 of it. */
        CHECK(farthest <= 4.01 / 3 * within);
        CHECK(surface->error_um <= within && surface->error_um > 0.3 * farthest);
        /* Errors go with the square of a length, triangles with its inverse square. */
        CHECK(triangles == 0 ||
              (surface->triangle_count > 2 * triangles && surface->triangle_count < 8 * triangles));
        triangles = surface->triangle_count;
        CHECK(open_edges(surface) == 0);
    }
    kuhn_done(&kuhn);
}

/* One ball of a tenth of a cell, anywhere: in a cell, across a face, at an edge; no corner is in
 * it. */
TEST(a_piece_that_no_corner_shows_is_found)
{
    static const double middle[][3] = {
        { 120, 330, 210 }, { 250, 250, 120 }, { 250, 250, 250 }, { 250, 13, 7 }, { 333, 333, 80 }
    };
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < sizeof middle / sizeof middle[0]; i++) {
        const double *c = middle[i], s = -1.0 / (50 * 50);
        const struct quadric small = { 1 + s * gsn_dot3(c, c),
                                       { -2 * s * c[0], -2 * s * c[1], -2 * s * c[2] },
                                       { s, s, s } };
        gsn_auto(gsn_trimesh) surface = NULL;
        struct kuhn kuhn;

        CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &small, &kuhn, &err), err);
        CHECK_OK(surface_of(kuhn.spline, 0, 1, 0, &surface, &err), err);
        CHECK(surface->triangle_count > 20);
        CHECK(open_edges(surface) == 0);
        CHECK(2 * surface->vertex_count == 4 + surface->triangle_count);
        CHECK(farthest_from_sphere(surface, c, 50) <= 4.01 / 3);
        kuhn_done(&kuhn);
    }
}

TEST(edges_are_as_short_as_asked_where_the_surface_is_and_long_elsewhere)
{
    struct gsn_isosurface_options options = { .edge_um = 125 };
    gsn_auto(gsn_trimesh) surface = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &ball, &kuhn, &err), err);
    CHECK_OK(gsn_isosurface(kuhn.spline, &options, &surface, &err), err);
    CHECK(open_edges(surface) == 0);
    for (size_t t = 0; t < surface->triangle_count; t++)
        for (int k = 0; k < 3; k++) {
            const double *p = surface->vertex[surface->triangle[t][k]],
                         *q = surface->vertex[surface->triangle[t][(k + 1) % 3]];
            const double edge[3] = { p[0] - q[0], p[1] - q[1], p[2] - q[2] };

            CHECK(gsn_length3(edge) <= 125.001);
        }
    kuhn_done(&kuhn);
}

TEST(too_many_cells_end_it_with_what_was_reached_or_refuse_edges)
{
    struct gsn_isosurface_options options = { .error_um = 0.01, .most_cells = 4000 };
    gsn_auto(gsn_trimesh) surface = NULL;
    struct gsn_trimesh *refused = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &ball, &kuhn, &err), err);
    CHECK_OK(gsn_isosurface(kuhn.spline, &options, &surface, &err), err);
    CHECK(surface->error_um > 0.01 && surface->error_um < 10 && open_edges(surface) == 0);
    options = (struct gsn_isosurface_options){ .edge_um = 1, .most_cells = 4000 };
    CHECK(gsn_isosurface(kuhn.spline, &options, &refused, &err) == GSN_E_LIMIT);
    CHECK(refused == NULL && strstr(err.text, "edges of 1 um") != NULL);
    kuhn_done(&kuhn);
}

/* gives: the ball's surface, closed where these voxels end. The border and the spline's mesh are
 * the caller's to release. */
static struct gsn_trimesh *ball_within(const struct gsn_lattice *at, struct kuhn *ret_kuhn,
                                       struct gsn_border **ret_border)
{
    struct gsn_isosurface_options options = { .error_um = 5 };
    gsn_auto(gsn_mask) region = NULL;
    struct gsn_trimesh *surface = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_mask_new(at, &region, &err), err);
    memset(region->inside, 1, gsn_lattice_count(at));
    CHECK_OK(gsn_border_new(region, 1, ret_border, &err), err);
    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &ball, ret_kuhn, &err), err);
    options.border = *ret_border;
    CHECK_OK(gsn_isosurface(ret_kuhn->spline, &options, &surface, &err), err);
    return surface;
}

/* Half a ball: of a region that ends at x = 0. */
TEST(a_surface_is_closed_where_the_region_ends)
{
    const struct gsn_lattice at = { 20, 40, 40, { 25, -975, -975 }, { 50, 50, 50 } };
    gsn_auto(gsn_border) border = NULL;
    struct kuhn kuhn;
    gsn_auto(gsn_trimesh) surface = ball_within(&at, &kuhn, &border);
    double area, closing;

    CHECK(open_edges(surface) == 0);
    CHECK(2 * surface->vertex_count == 4 + surface->triangle_count);
    area = gsn_trimesh_area(surface, &closing);
    CHECK_NEAR((area - closing) / (2 * M_PI * radius * radius), 1, 0.05);
    CHECK_NEAR(closing / (M_PI * radius * radius), 1, 0.1);
    CHECK_NEAR(enclosed_volume(surface) / (2.0 / 3.0 * M_PI * pow(radius, 3)), 1, 0.02);
    for (size_t v = 0; v < surface->vertex_count; v++) {
        const double *p = surface->vertex[v];

        CHECK(p[0] > -1); /* a thousandth of an edge */
        if (surface->closing[v])
            CHECK(fabs(p[0]) < 1 && surface->normal[v][0] < -0.99F);
        else
            CHECK_NEAR(sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]), radius, 1e-6 * radius);
    }
    kuhn_done(&kuhn);
}

/* A slice of the ball between two planes of corners: none of them lies in it. */
TEST(a_region_in_which_no_corner_lies_is_found)
{
    const struct gsn_lattice at = { 3, 40, 40, { 125, -975, -975 }, { 50, 50, 50 } };
    const double from = 100, to = 250;
    const double truth = M_PI * (radius * radius * (to - from) - (pow(to, 3) - pow(from, 3)) / 3);
    gsn_auto(gsn_border) border = NULL;
    struct kuhn kuhn;
    gsn_auto(gsn_trimesh) surface = ball_within(&at, &kuhn, &border);

    for (size_t v = 0; v < kuhn.mesh->vertex_count; v++)
        CHECK(gsn_border_at(border, kuhn.mesh->vertex[v], NULL) < 0);
    CHECK(surface->triangle_count > 100 && open_edges(surface) == 0);
    CHECK(2 * surface->vertex_count == 4 + surface->triangle_count);
    CHECK_NEAR(enclosed_volume(surface) / truth, 1, 0.03);
    kuhn_done(&kuhn);
}

TEST(triangles_turn_with_their_normals)
{
    gsn_auto(gsn_trimesh) surface = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &ball, &kuhn, &err), err);
    CHECK_OK(surface_of(kuhn.spline, 0.3, 5, 0, &surface, &err), err);
    for (size_t t = 0; t < surface->triangle_count; t++) {
        const uint32_t *v = surface->triangle[t];
        const double *p = surface->vertex[v[0]], *q = surface->vertex[v[1]],
                     *r = surface->vertex[v[2]];
        double turn = 0.0;

        for (int a = 0; a < 3; a++) {
            const int m = (a + 1) % 3, n = (a + 2) % 3;

            turn += ((q[m] - p[m]) * (r[n] - p[n]) - (q[n] - p[n]) * (r[m] - p[m])) *
                    (double)surface->normal[v[0]][a];
        }
        CHECK(turn > -1e-6);
    }
    /* Outward: the enclosed volume is positive. */
    CHECK(enclosed_volume(surface) > 0.0);
    kuhn_done(&kuhn);
}

TEST(a_plane_through_lattice_points_is_one_sheet_clipped_at_the_domain)
{
    /* Passes exactly through mesh vertices, edges and faces. */
    const struct quadric plane = { 0.0, { 0.0, 0.0, 1.0 }, { 0.0, 0.0, 0.0 } };
    gsn_auto(gsn_trimesh) surface = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &plane, &kuhn, &err), err);
    CHECK_OK(surface_of(kuhn.spline, 0.0, 5, 0, &surface, &err), err);
    CHECK_NEAR(gsn_trimesh_area(surface, NULL), 4e6, 1.0);
    for (size_t v = 0; v < surface->vertex_count; v++)
        CHECK_NEAR(surface->vertex[v][2], 0.0, 1e-6);
    CHECK(open_edges(surface) > 0);
    gsn_trimesh_free(surface);
    surface = NULL;
    CHECK_OK(surface_of(kuhn.spline, 123.4, 5, 0, &surface, &err), err);
    CHECK_NEAR(gsn_trimesh_area(surface, NULL), 4e6, 1.0);
    for (size_t v = 0; v < surface->vertex_count; v++) {
        CHECK_NEAR(surface->vertex[v][2], 123.4, 1e-6);
        CHECK_NEAR((double)surface->normal[v][2], -1.0, 1e-5);
    }
    kuhn_done(&kuhn);
}

TEST(a_level_that_is_never_met_gives_no_triangles)
{
    gsn_auto(gsn_trimesh) surface = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &ball, &kuhn, &err), err);
    CHECK_OK(surface_of(kuhn.spline, 5, 5, 0, &surface, &err), err);
    CHECK(surface->triangle_count == 0 && surface->vertex_count == 0);
    CHECK_NEAR(gsn_trimesh_area(surface, NULL), 0.0, 0.0);
    CHECK_NEAR(enclosed_volume(surface), 0.0, 0.0);
    kuhn_done(&kuhn);
}

TEST(a_rough_surface_is_closed_where_it_does_not_meet_the_boundary)
{
    gsn_auto(gsn_trimesh) surface = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    uint32_t(*edge)[2];
    size_t count, inner = 0;

    CHECK_OK(kuhn_random(low, high, cells, 2, 0.05, 6, &kuhn, &err), err);
    CHECK_OK(surface_of(kuhn.spline, 0.05, 20, 0, &surface, &err), err);
    count = 3 * surface->triangle_count;
    edge = gsn_alloc_array(count, sizeof *edge);
    for (size_t i = 0; i < count; i++) {
        edge[i][0] = surface->triangle[i / 3][i % 3];
        edge[i][1] = surface->triangle[i / 3][(i + 1) % 3];
    }
    qsort(edge, count, sizeof *edge, by_edge);
    for (size_t i = 0; i < count; i++) {
        const uint32_t back[2] = { edge[i][1], edge[i][0] };
        int on_box = 0;

        CHECK(i == 0 || by_edge(edge[i - 1], edge[i]) != 0);
        if (bsearch(back, edge, count, sizeof *edge, by_edge)) {
            inner++;
            continue;
        }
        /* An open edge lies in a face of the box. */
        for (int a = 0; a < 3; a++) {
            const double p = surface->vertex[back[0]][a], q = surface->vertex[back[1]][a];

            on_box |= fabs(fabs(p) - 1000.0) < 1e-6 && fabs(p - q) < 1e-6;
        }
        CHECK(on_box);
    }
    CHECK(inner > 1000);
    gsn_free(edge);
    kuhn_done(&kuhn);
}

/* s and its gradient, on the domain's boundary a nanometre further in. */
static double spline_near(const struct gsn_spline *spline, const double at[3], double gradient[3])
{
    double u[3], value = NAN;
    size_t hint = 0;

    for (int a = 0; a < 3; a++)
        u[a] = fmin(fmax(at[a], low[a] + 1e-6), high[a] - 1e-6);
    CHECK(gsn_spline_eval(spline, u, &hint, &value, gradient) == GSN_OK);
    return value;
}

TEST(every_vertex_of_a_rough_surface_is_at_the_level_with_the_gradient_s_normal)
{
    gsn_auto(gsn_trimesh) surface = NULL;
    gsn_auto(gsn_trimesh) other = NULL;
    struct gsn_error err = { 0 };
    const unsigned more[3] = { 6, 6, 6 };
    struct gsn_isosurface_options options = { .level = 0.05, .edge_um = 90, .threads = 1 };
    struct kuhn kuhn;
    size_t on_box = 0;

    CHECK_OK(kuhn_random(low, high, more, 3, 0.05, 6, &kuhn, &err), err);
    CHECK_OK(gsn_isosurface(kuhn.spline, &options, &surface, &err), err);
    /* More than are evaluated together. */
    CHECK(surface->vertex_count > 70000);
    for (size_t v = 0; v < surface->vertex_count; v++) {
        const double *at = surface->vertex[v];
        double gradient[3], length;

        CHECK_NEAR(spline_near(kuhn.spline, at, gradient), 0.05, 1e-7);
        length =
            sqrt(gradient[0] * gradient[0] + gradient[1] * gradient[1] + gradient[2] * gradient[2]);
        for (int a = 0; a < 3; a++) {
            CHECK_NEAR((double)surface->normal[v][a], -gradient[a] / length, 1e-5);
            on_box += fabs(at[a]) >= 1000.0;
        }
    }
    CHECK(on_box > 100);
    options.threads = 2;
    CHECK_OK(gsn_isosurface(kuhn.spline, &options, &other, &err), err);
    CHECK(other->vertex_count == surface->vertex_count);
    CHECK(memcmp(other->vertex, surface->vertex, surface->vertex_count * sizeof *surface->vertex) ==
          0);
    CHECK(memcmp(other->normal, surface->normal, surface->vertex_count * sizeof *surface->normal) ==
          0);
    kuhn_done(&kuhn);
}

static const struct gsn_view view = { .direction = { -0.5, 0.4, 0.77 },
                                      .up = { 0.0, -1.0, 0.0 },
                                      .eye_distance = 4.0,
                                      .width = 120,
                                      .height = 100 };

static int draw_within(const struct kuhn *kuhn, const struct gsn_view *from, double error_um,
                       unsigned threads, struct gsn_image **ret_image, struct gsn_error *err)
{
    const struct gsn_trimesh_style style = { .title = "level 0", .outline = 1 };
    gsn_auto(gsn_trimesh) surface = NULL;
    int r = surface_of(kuhn->spline, 0, error_um, threads, &surface, err);

    if (r == GSN_OK)
        r = gsn_trimesh_paint(surface, kuhn->mesh, from, &style, threads, ret_image, err);
    return r;
}

static int picture(const struct kuhn *kuhn, const struct gsn_view *from, unsigned threads,
                   struct gsn_image **ret_image, struct gsn_error *err)
{
    return draw_within(kuhn, from, 11, threads, ret_image, err);
}

TEST(the_picture_of_a_ball_is_a_disc_of_the_right_size_on_any_number_of_threads)
{
    const struct gsn_view flat = {
        .direction = { 0, 0, 1 }, .up = { 0, -1, 0 }, .width = 200, .height = 200
    };
    gsn_auto(gsn_image) one = NULL;
    gsn_auto(gsn_image) two = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    size_t bone = 0;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &ball, &kuhn, &err), err);
    CHECK_OK(picture(&kuhn, &flat, 1, &one, &err), err);
    CHECK_OK(picture(&kuhn, &flat, 2, &two, &err), err);
    CHECK(gsn_image_bytes(one) == gsn_image_bytes(two));
    CHECK(memcmp(one->samples, two->samples, gsn_image_bytes(one)) == 0);
    /* Bone is warm, the background and the outline are not. */
    for (uint32_t y = 0; y < one->height; y++) {
        for (uint32_t x = 0; x < one->width; x++)
            bone += gsn_image_at(one, x, y, 0) > gsn_image_at(one, x, y, 2) + 8;
    }
    /* 2000 um are 176 px; the surface is inside the ball by 1.5 % at most. */
    CHECK_NEAR((double)bone, M_PI * pow(radius * 176.0 / 2000.0, 2), 0.02 * 13080.0);
    kuhn_done(&kuhn);
}

TEST(the_light_comes_from_above_left_and_both_sides_of_a_sheet_are_lit)
{
    const struct quadric sheet = { 0.0, { 0.0, 0.0, 1.0 }, { 0.0, 0.0, 0.0 } };
    struct gsn_view flat = {
        .direction = { 0, 0, 1 }, .up = { 0, -1, 0 }, .width = 60, .height = 60
    };
    gsn_auto(gsn_image) lit = NULL;
    gsn_auto(gsn_image) front = NULL;
    gsn_auto(gsn_image) back = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn, flat_kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &ball, &kuhn, &err), err);
    CHECK_OK(picture(&kuhn, &flat, 1, &lit, &err), err);
    CHECK(gsn_image_at(lit, 12 + 22, 26 + 20, 1) > gsn_image_at(lit, 12 + 38, 26 + 40, 1) + 30);

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &sheet, &flat_kuhn, &err), err);
    CHECK_OK(picture(&flat_kuhn, &flat, 1, &front, &err), err);
    flat.direction[2] = -1.0;
    CHECK_OK(picture(&flat_kuhn, &flat, 1, &back, &err), err);
    for (uint32_t channel = 0; channel < 3; channel++)
        CHECK(gsn_image_at(front, 42, 56, channel) == gsn_image_at(back, 42, 56, channel));
    CHECK(gsn_image_at(front, 42, 56, 0) > 120);
    kuhn_done(&kuhn);
    kuhn_done(&flat_kuhn);
}

TEST(what_cannot_be_drawn_is_refused)
{
    struct gsn_view nowhere = view;
    struct gsn_trimesh *surface = NULL;
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &ball, &kuhn, &err), err);
    CHECK(surface_of(kuhn.spline, NAN, 5, 0, &surface, &err) == GSN_E_INPUT);
    CHECK(surface_of(kuhn.spline, 0, -5, 0, &surface, &err) == GSN_E_INPUT);
    CHECK(surface_of(kuhn.spline, 0, NAN, 0, &surface, &err) == GSN_E_INPUT);
    CHECK(surface == NULL && strstr(err.text, "within nan um") != NULL);
    nowhere.direction[0] = nowhere.direction[1] = nowhere.direction[2] = 0.0;
    CHECK(picture(&kuhn, &nowhere, 1, &image, &err) == GSN_E_INPUT);
    CHECK(image == NULL);
    kuhn_done(&kuhn);
}

static int once(const struct kuhn *kuhn, struct gsn_error *err)
{
    gsn_auto(gsn_image) image = NULL;

    return draw_within(kuhn, &view, 100, 1, &image, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const unsigned two[3] = { 2, 2, 2 };
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, two, 2, 0.05, &ball, &kuhn, &err), err);
    CHECK_EVERY_OOM(once(&kuhn, &err), err);
    kuhn_done(&kuhn);
}
