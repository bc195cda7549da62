/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/tet_cut.h"

#include <math.h>
#include <string.h>

#include "pipeline/model/barycentric.h"

double gsn_tet_cell_volume(const struct gsn_tet_cell *cell)
{
    return fabs(gsn_det(cell->corner[0], cell->corner[1], cell->corner[2], cell->corner[3])) / 6.0;
}

/* Corner numbers, those with a value above 0 first. */
static int sort_sides(const double value[4], int ret_order[4])
{
    int above = 0, below = 4;

    for (int k = 0; k < 4; k++) {
        if (value[k] > 0.0)
            ret_order[above++] = k;
    }
    for (int k = 3; k >= 0; k--) {
        if (!(value[k] > 0.0))
            ret_order[--below] = k;
    }
    return above;
}

/* Two corners above: a prism of three tetrahedra. near[i][j] is where the plane cuts the edge from
 * corner i above to corner j below, as a share of the edge. */
static double wedge_share(const double value[4], const int order[4])
{
    double near[2][2], far[2][2];

    for (int i = 0; i < 2; i++) {
        for (int j = 0; j < 2; j++) {
            const double above = value[order[i]], below = value[order[2 + j]];

            near[i][j] = above / (above - below);
            far[i][j] = -below / (above - below);
        }
    }
    return near[0][0] * near[0][1] + far[0][0] * near[0][1] * near[1][0] +
           far[0][1] * near[1][0] * near[1][1];
}

double gsn_tet_share_above(const double value[4])
{
    int order[4];
    const int above = sort_sides(value, order);
    /* One corner on its side of the plane: a small tetrahedron. */
    const double tip = above == 1 ? value[order[0]] : value[order[3]];
    double share = 1.0;

    if (above == 0 || above == 4)
        return above == 0 ? 0.0 : 1.0;
    if (above == 2)
        return fmin(1.0, wedge_share(value, order));
    for (int k = 0; k < 3; k++)
        share *= tip / (tip - value[order[above == 1 ? k + 1 : k]]);
    return above == 1 ? share : 1.0 - share;
}

/* Where the plane cuts the edge from corner in, at distance above 0, to corner out. */
static void cut_edge(const struct gsn_tet_cell *cell, const double distance[4], int in, int out,
                     double ret[3])
{
    const double t = distance[in] / (distance[in] - distance[out]);

    for (int a = 0; a < 3; a++)
        ret[a] = cell->corner[in][a] + t * (cell->corner[out][a] - cell->corner[in][a]);
}

/* The part of a cell where the linear function with these corner values is above 0: up to three
 * tetrahedra. Returns how many. */
static int part_above(const struct gsn_tet_cell *cell, const double distance[4],
                      struct gsn_tet_cell ret_part[3])
{
    int order[4];
    const int above = sort_sides(distance, order);
    double at[6][3];
    int n = 0;

    ret_part[0] = *cell;
    if (above == 0 || above == 4)
        return above / 4;
    /* The body's corners in a row such that every four in succession are one of its parts. */
    for (int i = 0; i < above; i++) {
        if (above != 2 || i == 0)
            memcpy(at[n++], cell->corner[order[i]], sizeof at[0]);
    }
    for (int i = 0; i < above; i++) {
        for (int j = above; j < 4; j++) {
            if (above == 2 && i == 1 && j == above)
                memcpy(at[n++], cell->corner[order[1]], sizeof at[0]);
            cut_edge(cell, distance, order[i], order[j], at[n++]);
        }
    }
    for (int i = 0; i + 3 < n; i++)
        memcpy(ret_part[i].corner, at[i], sizeof ret_part[i].corner);
    return n - 3;
}

/* Planes of a tetrahedron still to be cut by, and where the parts go. */
struct cutting {
    double normal[4][3], origin[4][3];
    double crumb;
    struct gsn_tet_parts *parts;
};

static void find_planes(const struct gsn_tet_cell *other, struct cutting *cutting)
{
    for (int k = 0; k < 4; k++) {
        const double *a = other->corner[(k + 1) % 4];
        double b[3], c[3], top[3], *normal = cutting->normal[k];

        gsn_subtract(other->corner[(k + 2) % 4], a, b);
        gsn_subtract(other->corner[(k + 3) % 4], a, c);
        gsn_subtract(other->corner[k], a, top);
        gsn_cross(b, c, normal);
        if (gsn_dot(normal, top) < 0.0) {
            for (int i = 0; i < 3; i++)
                normal[i] = -normal[i];
        }
        memcpy(cutting->origin[k], a, sizeof cutting->origin[k]);
    }
}

static int keep_part(struct gsn_tet_parts *parts, const struct gsn_tet_cell *cell,
                     struct gsn_error *err)
{
    if (parts->count == parts->room) {
        const size_t room = parts->room > 0 ? 2 * parts->room : 16;
        struct gsn_tet_cell *grown = gsn_realloc_array(parts->cell, room, sizeof *grown);

        if (!grown)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu parts of a cell", room);
        parts->cell = grown;
        parts->room = room;
    }
    parts->cell[parts->count++] = *cell;
    return GSN_OK;
}

static int cut_cell(const struct cutting *cutting, const struct gsn_tet_cell *cell, int plane,
                    struct gsn_error *err)
{
    struct gsn_tet_cell part[3];
    double distance[4];
    int count;

    if (!(gsn_tet_cell_volume(cell) > cutting->crumb))
        return GSN_OK;
    if (plane == 4)
        return keep_part(cutting->parts, cell, err);
    for (int k = 0; k < 4; k++) {
        double from[3];

        gsn_subtract(cell->corner[k], cutting->origin[plane], from);
        distance[k] = gsn_dot(cutting->normal[plane], from);
    }
    count = part_above(cell, distance, part);
    for (int i = 0; i < count; i++) {
        const int r = cut_cell(cutting, &part[i], plane + 1, err);

        if (r < 0)
            return r;
    }
    return GSN_OK;
}

int gsn_tet_cell_common(const struct gsn_tet_cell *cell, const struct gsn_tet_cell *other,
                        double crumb, struct gsn_tet_parts *parts, struct gsn_error *err)
{
    struct cutting cutting = { .crumb = crumb, .parts = parts };

    find_planes(other, &cutting);
    return cut_cell(&cutting, cell, 0, err);
}
