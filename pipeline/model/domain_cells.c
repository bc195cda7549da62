/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The cells that cover a region, their surface, and whether a mesh fills them.
 *
 * Method: the region's mask, grown by a voxel, marks the cubes of a lattice that it touches. A
 * flood from outside finds cavities, which are filled; where the surface would touch itself at a
 * vertex or an edge (a 2 x 2 x 2 neighbourhood that is no manifold) one more cell is filled, until
 * none is left. The surface is the squares between filled and empty cells.
 *
 * Verification: volume and boundary area agree to 1e-9, every face of the boundary lies between a
 * filled and an empty cell, every voxel centre of the region is in a tetrahedron, and none of these
 * is so flat that knots around its corners cannot be told apart.
 *
 * Failure: GSN_E_INPUT on an empty mask, GSN_E_LIMIT above 2^24 cells, GSN_E_MESH saying what does
 * not hold. Cost: linear in cells, voxels and tetrahedra. */
#include "pipeline/model/domain_internal.h"

#include <math.h>
#include <stdbool.h>

/* --- cells and their surface --- */

enum { MOST_CELLS = 1 << 24 };

/* Part of a cell's edge by which a box may stick out without touching the next cell: rounding. */
static const double SLACK = 1e-9;

static const double *at_axis(const struct gsn_vec3 *v, size_t axis)
{
    return axis == 0 ? &v->x : axis == 1 ? &v->y : &v->z;
}

/* The cells, counted from corner_um, that voxel i grown by one voxel touches along an axis. */
static void find_reach(size_t i, double step, double edge, long *ret_first, long *ret_last)
{
    *ret_first = (long)floor(((double)i - 1) * step / edge + SLACK);
    *ret_last = (long)ceil(((double)i + 2) * step / edge - SLACK) - 1;
}

static int lay_out(const struct gsn_lattice *at, double edge, struct gsn_cells *cells,
                   struct gsn_error *err)
{
    const size_t voxels[3] = { at->nx, at->ny, at->nz };
    double total = 1;

    cells->edge_um = edge;
    for (size_t k = 0; k < 3; k++) {
        const double step = *at_axis(&at->step_um, k), origin = *at_axis(&at->origin_um, k);
        long first, last, ignored;

        if (!(step > 0) || !isfinite(step) || !isfinite(origin))
            return gsn_fail(err, GSN_E_INPUT, "the region's lattice is not positive and finite");
        total *= ((double)voxels[k] + 2) * step / edge + 4;
        if (!(total <= MOST_CELLS))
            return gsn_fail(err, GSN_E_LIMIT,
                            "cells of %g um would cover the region's lattice in more than %d", edge,
                            MOST_CELLS);
        find_reach(0, step, edge, &first, &ignored);
        find_reach(voxels[k] - 1, step, edge, &ignored, &last);
        cells->corner_um[k] = origin - step / 2;
        cells->base[k] = first - 1;
        cells->n[k] = (size_t)(last - first + 3);
    }
    return GSN_OK;
}

static void fill_box(struct gsn_cells *cells, const size_t first[3], const size_t last[3])
{
    size_t at[3];

    for (at[2] = first[2]; at[2] <= last[2]; at[2]++)
        for (at[1] = first[1]; at[1] <= last[1]; at[1]++)
            for (at[0] = first[0]; at[0] <= last[0]; at[0]++)
                cells->filled[gsn_cells_index(cells, at)] = 1;
}

static void cover_voxel(struct gsn_cells *cells, const struct gsn_lattice *lattice,
                        const size_t voxel[3])
{
    size_t first[3], last[3];

    for (size_t k = 0; k < 3; k++) {
        long low, high;

        find_reach(voxel[k], *at_axis(&lattice->step_um, k), cells->edge_um, &low, &high);
        first[k] = (size_t)(low - cells->base[k]);
        last[k] = (size_t)(high - cells->base[k]);
    }
    fill_box(cells, first, last);
}

int gsn_cells_cover(const struct gsn_mask *region, double edge_um, struct gsn_cells **ret_cells,
                    struct gsn_error *err)
{
    const struct gsn_lattice *at = &region->at;
    gsn_auto(gsn_cells) cells = NULL;
    size_t voxel[3], i = 0;
    int r;

    if (gsn_mask_count(region) == 0)
        return gsn_fail(err, GSN_E_INPUT, "the region of interest is empty");
    cells = gsn_alloc_array(1, sizeof *cells);
    if (!cells)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the domain's cells");
    r = lay_out(at, edge_um, cells, err);
    if (r < 0)
        return r;
    cells->filled = gsn_alloc_array(cells->n[0] * cells->n[1] * cells->n[2], 1);
    if (!cells->filled)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the domain's cells");

    for (voxel[2] = 0; voxel[2] < at->nz; voxel[2]++)
        for (voxel[1] = 0; voxel[1] < at->ny; voxel[1]++)
            for (voxel[0] = 0; voxel[0] < at->nx; voxel[0]++)
                if (region->inside[i++])
                    cover_voxel(cells, at, voxel);
    *ret_cells = gsn_steal(&cells);
    return GSN_OK;
}

void gsn_cells_free(struct gsn_cells *cells)
{
    if (!cells)
        return;
    gsn_free(cells->filled);
    gsn_free(cells);
}

size_t gsn_cells_index(const struct gsn_cells *cells, const size_t at[3])
{
    return (at[2] * cells->n[1] + at[1]) * cells->n[0] + at[0];
}

double gsn_cells_plane(const struct gsn_cells *cells, size_t axis, size_t i)
{
    return cells->corner_um[axis] + (double)(cells->base[axis] + (long)i) * cells->edge_um;
}

static size_t cell_count(const struct gsn_cells *cells)
{
    return cells->n[0] * cells->n[1] * cells->n[2];
}

double gsn_cells_volume(const struct gsn_cells *cells)
{
    size_t filled = 0;

    for (size_t i = 0; i < cell_count(cells); i++)
        filled += cells->filled[i];
    return (double)filled * cells->edge_um * cells->edge_um * cells->edge_um;
}

/* The cells around a lattice vertex are the bits x + 2 y + 4 z of a byte. */

/* Whether the set bits are joined through faces of their cells. */
static bool is_connected(unsigned cells)
{
    unsigned reached = cells & (~cells + 1), before = 0;

    while (reached != before) {
        before = reached;
        reached |= ((reached & 0x55) << 1 | (reached & 0xAA) >> 1) & cells;
        reached |= ((reached & 0x33) << 2 | (reached & 0xCC) >> 2) & cells;
        reached |= ((reached & 0x0F) << 4 | (reached & 0xF0) >> 4) & cells;
    }
    return reached == cells;
}

static unsigned lowest_bit(unsigned bits)
{
    return bits & (~bits + 1);
}

/* The bit to fill at a vertex whose eight cells are filled so, or 0 where the surface is manifold.
 *
 * The four cells around each of the six lattice edges that meet here come first: two filled ones
 * that face each other across an edge. Filling inside that ring never leaves the filled cells'
 * bounding box, which keeps the outermost layer empty. */
static unsigned bit_to_fill(unsigned cells)
{
    static const struct {
        unsigned ring, diagonal;
    } EDGE[6] = { { 0x55, 0x41 }, { 0xAA, 0x82 }, { 0x33, 0x21 },
                  { 0xCC, 0x84 }, { 0x0F, 0x09 }, { 0xF0, 0x90 } };

    for (size_t e = 0; e < 6; e++) {
        const unsigned here = cells & EDGE[e].ring;

        if (here == EDGE[e].diagonal || here == (EDGE[e].ring & ~EDGE[e].diagonal))
            return lowest_bit(EDGE[e].ring & ~here);
    }
    if (!is_connected(cells) || !is_connected(~cells & 0xFF))
        return lowest_bit(~cells & 0xFF);
    return 0;
}

/* The index of the cell that a bit of the vertex at the low corner of cell `at` stands for. */
static size_t cell_of_bit(const struct gsn_cells *cells, const size_t at[3], size_t bit)
{
    const size_t cell[3] = { at[0] - 1 + (bit & 1), at[1] - 1 + (bit >> 1 & 1),
                             at[2] - 1 + (bit >> 2) };

    return gsn_cells_index(cells, cell);
}

static bool mend_vertex(struct gsn_cells *cells, const size_t at[3])
{
    bool changed = false;

    for (;;) {
        unsigned around = 0, fill;

        for (size_t bit = 0; bit < 8; bit++)
            around |= (unsigned)cells->filled[cell_of_bit(cells, at, bit)] << bit;
        fill = bit_to_fill(around);
        if (!fill)
            return changed;
        cells->filled[cell_of_bit(cells, at, (size_t)__builtin_ctz(fill))] = 1;
        changed = true;
    }
}

static bool mend_all(struct gsn_cells *cells)
{
    bool changed = false;
    size_t at[3];

    for (at[2] = 1; at[2] < cells->n[2]; at[2]++)
        for (at[1] = 1; at[1] < cells->n[1]; at[1]++)
            for (at[0] = 1; at[0] < cells->n[0]; at[0]++)
                changed |= mend_vertex(cells, at);
    return changed;
}

/* Marks the empty cells that the outside reaches through faces; stack has room for every cell. */
static void flood_outside(const struct gsn_cells *cells, uint8_t *outside, uint32_t *stack)
{
    const size_t stride[3] = { 1, cells->n[0], cells->n[0] * cells->n[1] };
    size_t depth = 0;

    outside[0] = 1;
    stack[depth++] = 0;
    while (depth > 0) {
        const size_t cell = stack[--depth];

        for (size_t k = 0; k < 3; k++) {
            const size_t at = cell / stride[k] % cells->n[k];

            for (size_t side = 0; side < 2; side++) {
                const size_t next = side ? cell + stride[k] : cell - stride[k];

                if (at == (side ? cells->n[k] - 1 : 0) || outside[next] || cells->filled[next])
                    continue;
                outside[next] = 1;
                stack[depth++] = (uint32_t)next;
            }
        }
    }
}

static int fill_cavities(struct gsn_cells *cells, struct gsn_error *err)
{
    const size_t count = cell_count(cells);
    gsn_auto_mem(uint8_t) outside = gsn_alloc_array(count, 1);
    gsn_auto_mem(uint32_t) stack = gsn_alloc_array(count, sizeof *stack);

    if (!outside || !stack)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the domain's cells");
    flood_outside(cells, outside, stack);
    for (size_t i = 0; i < count; i++)
        cells->filled[i] = !outside[i];
    return GSN_OK;
}

int gsn_cells_close(struct gsn_cells *cells, struct gsn_error *err)
{
    bool changed = true;

    /* Mending one place may break its neighbour or enclose a pocket; filling cells only ends. */
    while (changed) {
        const int r = fill_cavities(cells, err);

        if (r < 0)
            return r;
        changed = mend_all(cells);
    }
    return GSN_OK;
}

/* The corners of a cell's face, anticlockwise from outside: [axis][far side][corner]. */
static const uint8_t FACE[3][2][4][3] = {
    { { { 0, 0, 0 }, { 0, 0, 1 }, { 0, 1, 1 }, { 0, 1, 0 } },
      { { 1, 0, 0 }, { 1, 1, 0 }, { 1, 1, 1 }, { 1, 0, 1 } } },
    { { { 0, 0, 0 }, { 1, 0, 0 }, { 1, 0, 1 }, { 0, 0, 1 } },
      { { 0, 1, 0 }, { 0, 1, 1 }, { 1, 1, 1 }, { 1, 1, 0 } } },
    { { { 0, 0, 0 }, { 0, 1, 0 }, { 1, 1, 0 }, { 1, 0, 0 } },
      { { 0, 0, 1 }, { 1, 0, 1 }, { 1, 1, 1 }, { 0, 1, 1 } } },
};

static bool face_is_open(const struct gsn_cells *cells, size_t cell, size_t axis, size_t side)
{
    const size_t stride[3] = { 1, cells->n[0], cells->n[0] * cells->n[1] };

    return cells->filled[cell] && !cells->filled[side ? cell + stride[axis] : cell - stride[axis]];
}

static size_t corner_index(const struct gsn_cells *cells, const size_t at[3],
                           const uint8_t corner[3])
{
    return ((at[2] + corner[2]) * (cells->n[1] + 1) + at[1] + corner[1]) * (cells->n[0] + 1) +
           at[0] + corner[0];
}

/* Walks all open faces. Without a surface it counts vertices and facets into the first two. ids
 * holds 1 + the number a lattice vertex has in the surface, 0: none yet. */
static void trace_surface(const struct gsn_cells *cells, uint32_t *ids, size_t *vertices,
                          size_t *facets, struct gsn_surface *surface)
{
    size_t at[3], cell = 0;

    for (at[2] = 0; at[2] < cells->n[2]; at[2]++)
        for (at[1] = 0; at[1] < cells->n[1]; at[1]++)
            for (at[0] = 0; at[0] < cells->n[0]; at[0]++, cell++)
                for (size_t face = 0; face < 6; face++) {
                    if (!face_is_open(cells, cell, face / 2, face % 2))
                        continue;
                    for (size_t c = 0; c < 4; c++) {
                        const uint8_t *corner = FACE[face / 2][face % 2][c];
                        const size_t here = corner_index(cells, at, corner);

                        if (!ids[here])
                            ids[here] = (uint32_t)++ * vertices;
                        if (!surface)
                            continue;
                        surface->facet[*facets][c] = ids[here] - 1;
                        for (size_t k = 0; k < 3; k++)
                            surface->vertex[ids[here] - 1][k] =
                                gsn_cells_plane(cells, k, at[k] + corner[k]);
                    }
                    ++*facets;
                }
}

int gsn_cells_surface(const struct gsn_cells *cells, struct gsn_surface **ret_surface,
                      struct gsn_error *err)
{
    gsn_auto_mem(uint32_t) ids =
        gsn_alloc_array((cells->n[0] + 1) * (cells->n[1] + 1) * (cells->n[2] + 1), sizeof *ids);
    gsn_auto(gsn_surface) surface = NULL;
    size_t vertices = 0, facets = 0;
    int r;

    if (!ids)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the domain's surface");
    trace_surface(cells, ids, &vertices, &facets, NULL);
    r = gsn_surface_new(vertices, facets, 0, &surface, err);
    if (r < 0)
        return r;
    facets = 0;
    trace_surface(cells, ids, &vertices, &facets, surface);
    *ret_surface = gsn_steal(&surface);
    return GSN_OK;
}

/* --- whether a mesh fills them --- */

/* Relative to the whole: sums of 10^5 volumes round to 1e-12. */
static const double AGREES = 1e-9;

/* Relative to a cell's edge, or to 1 for barycentric coordinates: rounding of added points. */
static const double TOUCHES = 1e-7;

static struct gsn_vec3 corner_of(const struct gsn_tets *mesh, size_t tet, size_t k)
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
            ret[used++] = corner_of(mesh, tet, k);
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

static int check_same(double value, double truth, const char *what, struct gsn_error *err)
{
    if (fabs(value - truth) <= AGREES * truth)
        return GSN_OK;
    return gsn_fail(err, GSN_E_MESH, "the mesh has %s %.12g where %.12g was asked for", what, value,
                    truth);
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
    return check_same(gsn_domain_area(mesh),
                      (double)surface->facet_count * cells->edge_um * cells->edge_um, "surface",
                      err);
}

void gsn_domain_voxels_near(const struct gsn_tets *mesh, size_t tet, const struct gsn_lattice *at,
                            double margin, size_t ret_first[3], size_t ret_end[3])
{
    const double origin[3] = { at->origin_um.x, at->origin_um.y, at->origin_um.z };
    const double step[3] = { at->step_um.x, at->step_um.y, at->step_um.z };
    const size_t n[3] = { at->nx, at->ny, at->nz };

    for (size_t k = 0; k < 3; k++) {
        double low = INFINITY, high = -INFINITY;

        for (size_t v = 0; v < 4; v++) {
            low = fmin(low, mesh->vertex[mesh->tet[tet][v]][k]);
            high = fmax(high, mesh->vertex[mesh->tet[tet][v]][k]);
        }
        low = ceil((low - origin[k]) / step[k] - margin);
        high = floor((high - origin[k]) / step[k] + margin) + 1;
        ret_first[k] = low > 0 ? (size_t)low : 0;
        ret_end[k] = high > 0 ? (size_t)fmin(high, (double)n[k]) : 0;
    }
}

/* Marks the voxel centres that a tetrahedron holds, its boundary included. */
static void mark_tet(const struct gsn_tets *mesh, size_t tet, const struct gsn_lattice *at,
                     uint8_t *held)
{
    const struct gsn_vec3 p0 = corner_of(mesh, tet, 0),
                          a = gsn_vec3_sub(corner_of(mesh, tet, 1), p0),
                          b = gsn_vec3_sub(corner_of(mesh, tet, 2), p0),
                          c = gsn_vec3_sub(corner_of(mesh, tet, 3), p0);
    const struct gsn_vec3 bc = gsn_vec3_cross(b, c), ca = gsn_vec3_cross(c, a),
                          ab = gsn_vec3_cross(a, b);
    const double det = gsn_vec3_dot(a, bc);
    size_t first[3], end[3];

    gsn_domain_voxels_near(mesh, tet, at, TOUCHES, first, end);
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

/* Clouds of knots take some thousandths of a height, and knots less than 1e-10 of an edge apart are
 * refused (dms.c). */
static const double FLATTEST = 1e-6;

int gsn_domain_verify_heights(const struct gsn_tets *mesh, struct gsn_error *err)
{
    for (size_t t = 0; t < mesh->tet_count; t++) {
        const double height = gsn_tets_height(mesh, t);

        if (!(height > FLATTEST))
            return gsn_fail(err, GSN_E_MESH,
                            "tetrahedron %zu is %.3g of its longest edge high, less than %g is too "
                            "flat to carry knots",
                            t, height, FLATTEST);
    }
    return GSN_OK;
}

int gsn_domain_verify_voxels(const struct gsn_tets *mesh, const struct gsn_mask *region,
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
    int r = check_same(gsn_domain_volume(mesh), gsn_cells_volume(cells), "volume", err);

    if (r >= 0)
        r = verify_boundary(mesh, cells, err);
    if (r >= 0)
        r = gsn_domain_verify_heights(mesh, err);
    return r < 0 ? r : gsn_domain_verify_voxels(mesh, region, err);
}
