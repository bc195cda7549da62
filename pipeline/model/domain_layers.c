/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A domain around a shape that its tetrahedra follow, cut down to the region.
 *
 * Method: constrained Delaunay tetrahedralisation of a box with the shape inside, then the
 * tetrahedra that touch no voxel of the region are dropped. Reference: H. Si, "TetGen, a
 * Delaunay-based quality tetrahedral mesh generator", ACM TOMS 41, 2015; a tetrahedron and a box
 * are apart when an axis separates them (S. Gottschalk, M. C. Lin, D. Manocha, "OBBTree", 1996,
 * 10.1145/237170.237244).
 *
 * Steps: (1) the box of the points and of the region's voxels, with room around; (2) ask the
 * mesher; (3) its answer fills the box; (4) drop what touches no voxel of the region; (5) lift what
 * is flat; (6) every voxel centre of it lies in what is left, and nothing is flat. Layers that the
 * mesher refuses are made once more, finer; after that a cover of cubes must do (domain.c).
 *
 * Failure: GSN_E_MESH, GSN_E_PROCESS. Cost: TetGen's. */
#include "pipeline/model/domain.h"
#include "pipeline/model/domain_internal.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>
#include <string.h>

/* Room around, in edges of a voxel. */
static const double ROOM_VOXELS = 8;

struct span {
    double low[3], high[3];
};

static void hold_point(struct span *box, const double u[3], double room)
{
    for (size_t k = 0; k < 3; k++) {
        box->low[k] = fmin(box->low[k], u[k] - room);
        box->high[k] = fmax(box->high[k], u[k] + room);
    }
}

static struct span find_box(const struct gsn_mask *region, const struct gsn_wall_layers *shape)
{
    const struct gsn_lattice *at = &region->at;
    const double room = ROOM_VOXELS * cbrt(gsn_lattice_voxel_um3(at));
    struct span box = { { INFINITY, INFINITY, INFINITY }, { -INFINITY, -INFINITY, -INFINITY } };

    for (size_t i = 0; i < shape->walls + shape->rims; i++)
        hold_point(&box, shape->at[i], room);
    for (size_t i = 0, z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++) {
                const struct gsn_vec3 c = gsn_lattice_centre(at, x, y, z);

                if (region->inside[i])
                    hold_point(&box, (const double[3]){ c.x, c.y, c.z }, room);
            }
    return box;
}

/* gives: the six squares of a box, and the shape inside. */
static int surround_layers(const struct span *box, const struct gsn_wall_layers *shape,
                           struct gsn_surface **ret_surface, struct gsn_error *err)
{
    static const uint32_t SQUARE[6][4] = { { 0, 2, 3, 1 }, { 4, 5, 7, 6 }, { 0, 1, 5, 4 },
                                           { 2, 6, 7, 3 }, { 0, 4, 6, 2 }, { 1, 3, 7, 5 } };
    const size_t points = shape->walls + shape->rims;
    gsn_auto(gsn_surface) surface = NULL;
    const int r = gsn_surface_new(8 + points, 6, shape->facets, &surface, err);

    if (r < 0)
        return r;
    for (size_t v = 0; v < 8; v++)
        for (size_t k = 0; k < 3; k++)
            surface->vertex[v][k] = (v >> k & 1) ? box->high[k] : box->low[k];
    if (points > 0)
        memcpy(surface->vertex[8], shape->at, points * sizeof *shape->at);
    memcpy(surface->facet, SQUARE, sizeof SQUARE);
    for (size_t f = 0; f < shape->facets; f++) {
        for (size_t k = 0; k < 3; k++)
            surface->facet[6 + f][k] = 8 + shape->facet[f][k];
        surface->facet[6 + f][3] = GSN_SURFACE_NONE;
    }
    *ret_surface = gsn_steal(&surface);
    return GSN_OK;
}

/* --- what touches the region --- */

/* Whether the box of these half sides around 0 and the tetrahedron lie on two sides of a plane with
 * this normal. */
static bool is_apart_along(const double normal[3], const double (*corner)[3], const double half[3])
{
    const double reach =
        fabs(normal[0]) * half[0] + fabs(normal[1]) * half[1] + fabs(normal[2]) * half[2];
    double low = INFINITY, high = -INFINITY;

    for (size_t k = 0; k < 4; k++) {
        const double at = gsn_dot3(normal, corner[k]);

        low = fmin(low, at);
        high = fmax(high, at);
    }
    return low >= reach || high <= -reach;
}

static void subtract(const double a[3], const double b[3], double ret[3])
{
    for (size_t k = 0; k < 3; k++)
        ret[k] = a[k] - b[k];
}

/* Whether a tetrahedron and the box of these half sides around 0 share more than their surfaces. */
static bool touches_box(const double (*corner)[3], const double half[3])
{
    static const size_t EDGE[6][2] = { { 0, 1 }, { 0, 2 }, { 0, 3 }, { 1, 2 }, { 1, 3 }, { 2, 3 } };
    static const size_t FACE[4][3] = { { 0, 1, 2 }, { 0, 1, 3 }, { 0, 2, 3 }, { 1, 2, 3 } };
    static const double AXIS[3][3] = { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } };

    for (size_t k = 0; k < 3; k++)
        if (is_apart_along(AXIS[k], corner, half))
            return false;
    for (size_t f = 0; f < 4; f++) {
        double a[3], b[3], normal[3];

        subtract(corner[FACE[f][1]], corner[FACE[f][0]], a);
        subtract(corner[FACE[f][2]], corner[FACE[f][0]], b);
        gsn_cross3(a, b, normal);
        if (is_apart_along(normal, corner, half))
            return false;
    }
    for (size_t e = 0; e < 6; e++)
        for (size_t k = 0; k < 3; k++) {
            double edge[3], normal[3];

            subtract(corner[EDGE[e][1]], corner[EDGE[e][0]], edge);
            gsn_cross3(edge, AXIS[k], normal);
            if (gsn_dot3(normal, normal) > 0 && is_apart_along(normal, corner, half))
                return false;
        }
    return true;
}

static bool touches_region(const struct gsn_tets *mesh, size_t tet, const struct gsn_mask *region)
{
    const struct gsn_lattice *at = &region->at;
    const double half[3] = { at->step_um.x / 2, at->step_um.y / 2, at->step_um.z / 2 };
    size_t first[3], end[3];

    gsn_domain_voxels_near(mesh, tet, at, 0.5, first, end);
    for (size_t z = first[2]; z < end[2]; z++)
        for (size_t y = first[1]; y < end[1]; y++)
            for (size_t x = first[0]; x < end[0]; x++) {
                const struct gsn_vec3 c = gsn_lattice_centre(at, x, y, z);
                double corner[4][3];

                if (!region->inside[gsn_lattice_index(at, x, y, z)])
                    continue;
                for (size_t v = 0; v < 4; v++)
                    subtract(mesh->vertex[mesh->tet[tet][v]], (const double[3]){ c.x, c.y, c.z },
                             corner[v]);
                if (touches_box((const double(*)[3])corner, half))
                    return true;
            }
    return false;
}

/* gives: the tetrahedra that touch the region, and their vertices, in the order they had. */
static int keep_region(const struct gsn_tets *mesh, const struct gsn_mask *region,
                       struct gsn_tets **ret_mesh, struct gsn_error *err)
{
    gsn_auto_mem(uint32_t) number = gsn_alloc_array(mesh->vertex_count, sizeof *number);
    gsn_auto(gsn_soup) soup = NULL;
    size_t tets = 0, vertices = 0;
    int r = gsn_soup_new(mesh->vertex_count, mesh->tet_count, &soup, err);

    if (r < 0)
        return r;
    if (!number)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while cutting a mesh down");
    for (size_t t = 0; t < mesh->tet_count; t++)
        if (touches_region(mesh, t, region)) {
            memcpy(soup->tet[tets++], mesh->tet[t], sizeof *mesh->tet);
            for (size_t k = 0; k < 4; k++)
                number[mesh->tet[t][k]] = 1;
        }
    for (size_t v = 0; v < mesh->vertex_count; v++)
        if (number[v]) {
            memcpy(soup->vertex[vertices], mesh->vertex[v], sizeof *mesh->vertex);
            number[v] = (uint32_t)vertices++;
        }
    for (size_t t = 0; t < tets; t++)
        for (size_t k = 0; k < 4; k++)
            soup->tet[t][k] = number[soup->tet[t][k]];
    return gsn_tets_new((const double(*)[3])soup->vertex, vertices, (const uint32_t(*)[4])soup->tet,
                        tets, ret_mesh, err);
}

/* --- what is flat --- */

/* Tetrahedra lower than the first part of their longest edge are lifted by the second. Between
 * layers the mesher leaves slivers, and, where it puts a point on a facet, one between that point
 * and the facet itself, whose height is a rounding error. */
static const double FLAT = 1e-3, LIFT = 0.03;
enum { LIFTS = 3 };

/* The lowest of the tetrahedra around a vertex. */
static double lowest_around(const struct gsn_tets *mesh, uint32_t vertex)
{
    double least = INFINITY;

    for (size_t t = 0; t < mesh->tet_count; t++)
        for (size_t k = 0; k < 4; k++)
            if (mesh->tet[t][k] == vertex)
                least = fmin(least, gsn_tets_height(mesh, t));
    return least;
}

/* Moves that corner of a flat tetrahedron off the plane of the others, to the side, which leaves
 * the tetrahedra around it highest; none, where that is no gain. */
static void lift_corner(struct gsn_tets *mesh, size_t tet)
{
    double best = gsn_tets_height(mesh, tet), at[3];
    uint32_t moved = 0;
    bool found = false;

    for (size_t k = 0; k < 8; k++) {
        const uint32_t *v = mesh->tet[tet];
        const double *base = mesh->vertex[v[(k + 1) % 4]];
        double *corner = mesh->vertex[v[k % 4]], was[3], a[3], b[3], normal[3], length, height;

        subtract(mesh->vertex[v[(k + 2) % 4]], base, a);
        subtract(mesh->vertex[v[(k + 3) % 4]], base, b);
        gsn_cross3(a, b, normal);
        length = sqrt(gsn_dot3(normal, normal));
        memcpy(was, corner, sizeof was);
        for (size_t c = 0; c < 3; c++)
            corner[c] += (k < 4 ? LIFT : -LIFT) * sqrt(fmax(gsn_dot3(a, a), gsn_dot3(b, b))) *
                         normal[c] / length;
        height = lowest_around(mesh, v[k % 4]);
        if (height > best) {
            best = height;
            moved = v[k % 4];
            memcpy(at, corner, sizeof at);
            found = true;
        }
        memcpy(corner, was, sizeof was);
    }
    if (found)
        memcpy(mesh->vertex[moved], at, sizeof at);
}

static void lift_flat(struct gsn_tets *mesh)
{
    for (unsigned round = 0; round < LIFTS; round++)
        for (size_t t = 0; t < mesh->tet_count; t++)
            if (gsn_tets_height(mesh, t) < FLAT)
                lift_corner(mesh, t);
}

static int verify_box(const struct gsn_tets *mesh, const struct span *box, struct gsn_error *err)
{
    const double a = box->high[0] - box->low[0], b = box->high[1] - box->low[1],
                 c = box->high[2] - box->low[2];

    if (!(fabs(gsn_domain_volume(mesh) / (a * b * c) - 1) < 1e-9) ||
        !(fabs(gsn_domain_area(mesh) / (2 * (a * b + b * c + c * a)) - 1) < 1e-9))
        return gsn_fail(err, GSN_E_MESH, "the mesh does not fill its box");
    return GSN_OK;
}

/* gives: a mesh of the region around these layers. */
static int build_around(const struct gsn_mask *region, const struct gsn_wall_layers *layers,
                        const struct gsn_domain_options *options, struct gsn_tets **ret_mesh,
                        struct gsn_error *err)
{
    const struct span box = find_box(region, layers);
    struct gsn_mesh_question question = { .options.max_tet_um3 = options->max_tet_um3 };
    gsn_auto(gsn_surface) surface = NULL;
    gsn_auto(gsn_tets) whole = NULL;
    gsn_auto(gsn_tets) mesh = NULL;
    int r = surround_layers(&box, layers, &surface, err);

    if (r < 0)
        return r;
    question.surface = surface;
    r = gsn_domain_ask(options, &question, &whole, err);
    if (r >= 0)
        r = verify_box(whole, &box, err);
    if (r >= 0)
        r = keep_region(whole, region, &mesh, err);
    if (r >= 0) {
        lift_flat(mesh);
        r = gsn_domain_verify_heights(mesh, err);
    }
    if (r >= 0)
        r = gsn_domain_verify_voxels(mesh, region, err);
    if (r >= 0)
        *ret_mesh = gsn_steal(&mesh);
    return r;
}

/* --- with less asked for where that is refused --- */

/* Quality: layers are nearer to each other than their points are, and better tetrahedra would cost
 * points between them. */
static const double RADIUS_EDGE = 1.8, DIHEDRAL_DEG = 5;
static const double FINER = 0.8;
enum { TRIES = 2 };

static bool is_refusal(int code)
{
    return code == GSN_E_MESH || code == GSN_E_PROCESS;
}

static void describe_layers(const struct gsn_wall_layers *layers, struct gsn_domain_report *report)
{
    report->kind = layers->walls > 0 ? GSN_DOMAIN_WALLS : GSN_DOMAIN_RIM;
    report->low = layers->low;
    report->high = layers->high;
    report->noise = layers->noise;
    report->blur_um = layers->blur_um;
    report->wall_points = layers->walls;
    report->radius_edge = RADIUS_EDGE;
    report->dihedral_deg = DIHEDRAL_DEG;
}

int gsn_domain_follow(const struct gsn_grid *grid, const struct gsn_mask *region,
                      const struct gsn_wall_options *walls,
                      const struct gsn_domain_options *options, struct gsn_tets **ret_mesh,
                      struct gsn_domain_report *ret_report, struct gsn_error *err)
{
    struct gsn_domain_options quality = *options;
    struct gsn_wall_options finer = *walls;
    struct gsn_domain_report report = { .kind = GSN_DOMAIN_CUBES };
    int r = GSN_E_MESH;

    assert(grid && region && walls && options && options->mesher && ret_mesh && ret_report);
    quality.radius_edge = RADIUS_EDGE;
    quality.dihedral_deg = DIHEDRAL_DEG;
    for (unsigned attempt = 0; attempt < TRIES && is_refusal(r); attempt++) {
        gsn_auto(gsn_wall_layers) layers = NULL;

        r = gsn_wall_layers_find(grid, region, &finer, &layers, err);
        if (r < 0)
            return r;
        describe_layers(layers, &report);
        r = build_around(region, layers, &quality, ret_mesh, &report.why);
        finer.edge_um = FINER * layers->edge_um;
    }
    if (is_refusal(r)) {
        report.kind = GSN_DOMAIN_CUBES;
        report.radius_edge = report.dihedral_deg = 0;
        r = gsn_domain_build(region, options, ret_mesh, err);
    } else if (r < 0) {
        return gsn_fail(err, r, "%s", report.why.text);
    }
    if (r >= 0)
        *ret_report = report;
    return r;
}
