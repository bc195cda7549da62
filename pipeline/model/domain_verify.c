/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/domain_verify.h"

#include <math.h>
#include <stdbool.h>

/* Relative to the whole: sums of 10^5 volumes round to 1e-12. */
static const double AGREES = 1e-9;

/* Relative to a cell's edge, or to 1 for barycentric coordinates: rounding of added points. */
static const double TOUCHES = 1e-7;

static struct gsn_vec3 corner(const struct gsn_tets *mesh, size_t tet, size_t k)
{
    const double *v = mesh->vertex[mesh->tet[tet][k]];

    return gsn_vec3_make(v[0], v[1], v[2]);
}

/* The three corners of the face opposite a corner. */
static void face_corners(const struct gsn_tets *mesh, size_t tet, size_t opposite,
                         struct gsn_vec3 ret[3])
{
    for (size_t k = 0, used = 0; k < 4; k++)
        if (k != opposite)
            ret[used++] = corner(mesh, tet, k);
}

double gsn_domain_volume(const struct gsn_tets *mesh)
{
    double sum = 0;

    for (size_t t = 0; t < mesh->tet_count; t++)
        sum += gsn_tets_volume(mesh, t);
    return sum;
}

double gsn_domain_area(const struct gsn_tets *mesh)
{
    double sum = 0;

    for (size_t t = 0; t < mesh->tet_count; t++)
        for (size_t k = 0; k < 4; k++) {
            struct gsn_vec3 p[3];

            if (mesh->neighbour[t][k] >= 0)
                continue;
            face_corners(mesh, t, k, p);
            sum += gsn_vec3_length(
                       gsn_vec3_cross(gsn_vec3_sub(p[1], p[0]), gsn_vec3_sub(p[2], p[0]))) /
                   2;
        }
    return sum;
}

static int same(double value, double truth, const char *what, struct gsn_error *err)
{
    if (fabs(value - truth) <= AGREES * truth)
        return GSN_OK;
    return gsn_fail(err, GSN_E_MESH, "the mesh has %s %.12g where %.12g was asked for", what, value,
                    truth);
}

int gsn_domain_verify_same(const struct gsn_tets *mesh, const struct gsn_tets *before,
                           struct gsn_error *err)
{
    const int r = same(gsn_domain_volume(mesh), gsn_domain_volume(before), "volume", err);

    return r < 0 ? r : same(gsn_domain_area(mesh), gsn_domain_area(before), "surface", err);
}

/* In units of cells, counted from plane 0 of each axis. */
static void cell_units(const struct gsn_cells *cells, struct gsn_vec3 p, double ret[3])
{
    const double at[3] = { p.x, p.y, p.z };

    for (size_t k = 0; k < 3; k++)
        ret[k] = (at[k] - gsn_cells_plane(cells, k, 0)) / cells->edge_um;
}

/* Whether the face lies in a lattice plane with a filled cell on one side of its middle only. */
static bool face_on_cells(const struct gsn_cells *cells, const struct gsn_vec3 face[3])
{
    double p[3][3];

    for (size_t c = 0; c < 3; c++)
        cell_units(cells, face[c], p[c]);
    for (size_t axis = 0; axis < 3; axis++) {
        const double plane = round(p[0][axis]);
        size_t low[3], high[3];

        if (!(plane >= 1 && plane < (double)cells->n[axis]) ||
            !(fabs(p[0][axis] - plane) + fabs(p[1][axis] - plane) + fabs(p[2][axis] - plane) <
              TOUCHES))
            continue;
        for (size_t k = 0; k < 3; k++)
            low[k] = high[k] = (size_t)((p[0][k] + p[1][k] + p[2][k]) / 3);
        low[axis] = (size_t)plane - 1;
        high[axis] = (size_t)plane;
        if (cells->filled[gsn_cells_index(cells, low)] !=
            cells->filled[gsn_cells_index(cells, high)])
            return true;
    }
    return false;
}

/* The mesh's bounding box is inside the cells' lattice, so that points of it have a cell. */
static int verify_range(const struct gsn_tets *mesh, const struct gsn_cells *cells,
                        struct gsn_error *err)
{
    for (size_t v = 0; v < mesh->vertex_count; v++)
        for (size_t k = 0; k < 3; k++)
            if (!(mesh->vertex[v][k] > gsn_cells_plane(cells, k, 0)) ||
                !(mesh->vertex[v][k] < gsn_cells_plane(cells, k, cells->n[k])))
                return gsn_fail(err, GSN_E_MESH, "vertex %zu lies outside the domain", v);
    return GSN_OK;
}

static int verify_boundary(const struct gsn_tets *mesh, const struct gsn_cells *cells,
                           struct gsn_error *err)
{
    gsn_auto(gsn_surface) surface = NULL;
    int r = verify_range(mesh, cells, err);

    for (size_t t = 0; r >= 0 && t < mesh->tet_count; t++)
        for (size_t k = 0; k < 4; k++) {
            struct gsn_vec3 face[3];

            if (mesh->neighbour[t][k] >= 0)
                continue;
            face_corners(mesh, t, k, face);
            if (!face_on_cells(cells, face))
                return gsn_fail(err, GSN_E_MESH,
                                "face %zu of tetrahedron %zu is not on the surface asked for", k,
                                t);
        }
    if (r >= 0)
        r = gsn_cells_surface(cells, &surface, err);
    if (r < 0)
        return r;
    return same(gsn_domain_area(mesh),
                (double)surface->facet_count * cells->edge_um * cells->edge_um, "surface", err);
}

/* Marks the voxel centres that a tetrahedron holds, its boundary included. */
static void mark_tet(const struct gsn_tets *mesh, size_t tet, const struct gsn_lattice *at,
                     uint8_t *held)
{
    const struct gsn_vec3 p0 = corner(mesh, tet, 0), a = gsn_vec3_sub(corner(mesh, tet, 1), p0),
                          b = gsn_vec3_sub(corner(mesh, tet, 2), p0),
                          c = gsn_vec3_sub(corner(mesh, tet, 3), p0);
    const struct gsn_vec3 bc = gsn_vec3_cross(b, c), ca = gsn_vec3_cross(c, a),
                          ab = gsn_vec3_cross(a, b);
    const double det = gsn_vec3_dot(a, bc);
    const double origin[3] = { at->origin_um.x, at->origin_um.y, at->origin_um.z };
    const double step[3] = { at->step_um.x, at->step_um.y, at->step_um.z };
    const size_t n[3] = { at->nx, at->ny, at->nz };
    size_t first[3], end[3];

    for (size_t k = 0; k < 3; k++) {
        double low = INFINITY, high = -INFINITY;

        for (size_t v = 0; v < 4; v++) {
            low = fmin(low, mesh->vertex[mesh->tet[tet][v]][k]);
            high = fmax(high, mesh->vertex[mesh->tet[tet][v]][k]);
        }
        low = fmax(0, ceil((low - origin[k]) / step[k] - TOUCHES));
        high = fmin((double)n[k], floor((high - origin[k]) / step[k] + TOUCHES) + 1);
        first[k] = (size_t)low;
        end[k] = high > 0 ? (size_t)high : 0;
    }
    for (size_t z = first[2]; z < end[2]; z++)
        for (size_t y = first[1]; y < end[1]; y++)
            for (size_t x = first[0]; x < end[0]; x++) {
                const struct gsn_vec3 u = gsn_vec3_sub(gsn_lattice_centre(at, x, y, z), p0);
                const double l1 = gsn_vec3_dot(u, bc) / det, l2 = gsn_vec3_dot(u, ca) / det,
                             l3 = gsn_vec3_dot(u, ab) / det;

                if (fmin(fmin(l1, l2), fmin(l3, 1 - l1 - l2 - l3)) >= -TOUCHES)
                    held[gsn_lattice_index(at, x, y, z)] = 1;
            }
}

static int verify_voxels(const struct gsn_tets *mesh, const struct gsn_mask *region,
                         struct gsn_error *err)
{
    const size_t count = gsn_lattice_count(&region->at);
    gsn_auto_mem(uint8_t) held = gsn_alloc_array(count, 1);

    if (!held)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while verifying the domain");
    for (size_t t = 0; t < mesh->tet_count; t++)
        mark_tet(mesh, t, &region->at, held);
    for (size_t i = 0; i < count; i++)
        if (region->inside[i] && !held[i])
            return gsn_fail(err, GSN_E_MESH, "voxel %zu of the region is not in the mesh", i);
    return GSN_OK;
}

int gsn_domain_verify_cells(const struct gsn_tets *mesh, const struct gsn_cells *cells,
                            const struct gsn_mask *region, struct gsn_error *err)
{
    int r = same(gsn_domain_volume(mesh), gsn_cells_volume(cells), "volume", err);

    if (r >= 0)
        r = verify_boundary(mesh, cells, err);
    return r < 0 ? r : verify_voxels(mesh, region, err);
}
