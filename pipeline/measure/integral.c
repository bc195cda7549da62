/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method. A box: the voxels whose centre it holds. A plane: in each voxel that it cuts, the polygon
 * of the plane and the voxel's box, as a fan of triangles with Dunavant's rule of degree 4. The
 * domain: equation (9), tetrahedron by tetrahedron. A segment: its interval in each tetrahedron,
 * sorted and put together.
 * Reference: Dunavant 1985, 10.1002/nme.1620210612 (6 points); docs/MATH.md, sections 4 and 5.
 *
 * Steps of the plane: signed distances of a voxel's corners; where they change sign along its edges
 * are the polygon's corners, put in order by their angle around their mean; the points of the rule,
 * row of voxels by row; all values at once (model/batch.h); sums in the order of the voxels.
 *
 * Failure: GSN_E_INPUT names the first point without data. Cost: some 12 to 24 values a cut voxel;
 * 56 bytes each. */
#include "pipeline/measure/integral.h"

#include "pipeline/core/geom.h"
#include "pipeline/core/parallel.h"
#include "pipeline/measure/sum.h"
#include "pipeline/model/batch.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_CORNERS = 6, RULE = 6 };

/* ---- a box --------------------------------------------------------------------------------- */

int gsn_region_in_box(const struct gsn_mask *region, const double low[3], const double high[3],
                      struct gsn_mask **ret_part, struct gsn_error *err)
{
    const struct gsn_lattice *at = &region->at;
    gsn_auto(gsn_mask) part = NULL;
    size_t count = 0;
    int r;

    assert(ret_part);

    for (int c = 0; c < 3; c++)
        if (!isfinite(low[c]) || !isfinite(high[c]))
            return gsn_fail(err, GSN_E_INPUT, "a side of the box is not a number");
    r = gsn_mask_new(at, &part, err);
    if (r < 0)
        return r;
    for (size_t i = 0, z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++) {
                const struct gsn_vec3 u = gsn_lattice_centre(at, x, y, z);

                part->inside[i] = region->inside[i] && u.x >= low[0] && u.x < high[0] &&
                                  u.y >= low[1] && u.y < high[1] && u.z >= low[2] && u.z < high[2];
                count += part->inside[i];
            }
    if (count == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "the box from (%g, %g, %g) to (%g, %g, %g) um holds no voxel of the region",
                        low[0], low[1], low[2], high[0], high[1], high[2]);
    *ret_part = gsn_steal(&part);
    return GSN_OK;
}

/* ---- a plane ------------------------------------------------------------------------------- */

/* Points and weights; grows. */
struct points {
    size_t count, room;
    double (*at)[3];
    double *weight; /* um^2 */
};

static void points_done(struct points *p)
{
    gsn_free(p->at);
    gsn_free(p->weight);
}

static int make_room(struct points *p, size_t more, struct gsn_error *err)
{
    const size_t room = 2 * p->room + more;
    void *grown;

    if (p->count + more <= p->room)
        return GSN_OK;
    grown = gsn_realloc_array(p->at, room, sizeof *p->at);
    if (grown)
        p->at = grown;
    if (grown)
        grown = gsn_realloc_array(p->weight, room, sizeof *p->weight);
    if (!grown)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the cut of a plane");
    p->weight = grown;
    p->room = room;
    return GSN_OK;
}

/* Barycentric points and weights of Dunavant's rule of degree 4. */
static void add_triangle(struct points *p, const double a[3], const double b[3], const double c[3])
{
    static const double inner[2] = { 0.108103018168070, 0.816847572980459 };
    static const double outer[2] = { 0.445948490915965, 0.091576213509771 };
    static const double weight[2] = { 0.223381589678011, 0.109951743655322 };
    double edge[2][3], cross[3], area;

    for (int k = 0; k < 3; k++) {
        edge[0][k] = b[k] - a[k];
        edge[1][k] = c[k] - a[k];
    }
    gsn_cross3(edge[0], edge[1], cross);
    area = gsn_length3(cross) / 2;
    for (int i = 0; i < RULE; i++, p->count++) {
        double share[3] = { outer[i / 3], outer[i / 3], outer[i / 3] };

        share[i % 3] = inner[i / 3];
        for (int k = 0; k < 3; k++)
            p->at[p->count][k] = share[0] * a[k] + share[1] * b[k] + share[2] * c[k];
        p->weight[p->count] = weight[i / 3] * area;
    }
}

struct plane {
    double point[3], normal[3], axis[2][3]; /* normal and axes of length 1 */
};

/* The corners of the plane's polygon in a voxel, in order; how many. */
static int find_polygon(const struct plane *plane, const struct gsn_vec3 *centre,
                        const struct gsn_vec3 *step, double corner[MOST_CORNERS][3])
{
    const double middle[3] = { centre->x, centre->y, centre->z };
    const double half[3] = { step->x / 2, step->y / 2, step->z / 2 };
    double distance[8], mean[3] = { 0 }, angle[MOST_CORNERS];
    int above = 0, count = 0;

    for (int v = 0; v < 8; v++) {
        distance[v] = 0;
        for (int c = 0; c < 3; c++)
            distance[v] += plane->normal[c] *
                           (middle[c] + (v >> c & 1 ? half[c] : -half[c]) - plane->point[c]);
        above += distance[v] > 0;
    }
    if (above == 0 || above == 8)
        return 0;
    /* An edge is crossed where one end is above and the other is not. */
    for (int v = 0; v < 8; v++)
        for (int c = 0; c < 3; c++) {
            const int other = v | 1 << c;
            double t;

            if (other == v || (distance[v] > 0) == (distance[other] > 0) || count == MOST_CORNERS)
                continue;
            t = distance[v] / (distance[v] - distance[other]);
            for (int k = 0; k < 3; k++)
                corner[count][k] = middle[k] + (k == c       ? (2 * t - 1) * half[k]
                                                : v >> k & 1 ? half[k]
                                                             : -half[k]);
            count++;
        }
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 3; k++)
            mean[k] += corner[i][k] / count;
    for (int i = 0; i < count; i++) {
        double along[2] = { 0 };

        for (int a = 0; a < 2; a++)
            for (int k = 0; k < 3; k++)
                along[a] += plane->axis[a][k] * (corner[i][k] - mean[k]);
        angle[i] = atan2(along[1], along[0]);
    }
    for (int i = 1; i < count; i++)
        for (int j = i; j > 0 && angle[j - 1] > angle[j]; j--) {
            const double swap = angle[j];
            double moved[3];

            angle[j] = angle[j - 1];
            angle[j - 1] = swap;
            memcpy(moved, corner[j], sizeof moved);
            memcpy(corner[j], corner[j - 1], sizeof moved);
            memcpy(corner[j - 1], moved, sizeof moved);
        }
    return count;
}

static int orient_plane(const double point[3], const double normal[3], struct plane *plane,
                        struct gsn_error *err)
{
    const double length = gsn_length3(normal);
    int least = 0;
    double along[3] = { 0 }, scale;

    if (!(length > 0) || !isfinite(length) || !isfinite(gsn_length3(point)))
        return gsn_fail(err, GSN_E_INPUT, "a plane is a point and a normal that is not (0, 0, 0)");
    for (int c = 0; c < 3; c++) {
        plane->point[c] = point[c];
        plane->normal[c] = normal[c] / length;
        if (fabs(plane->normal[c]) < fabs(plane->normal[least]))
            least = c;
    }
    along[least] = 1;
    gsn_cross3(plane->normal, along, plane->axis[0]);
    scale = gsn_length3(plane->axis[0]);
    for (int c = 0; c < 3; c++)
        plane->axis[0][c] /= scale;
    gsn_cross3(plane->normal, plane->axis[0], plane->axis[1]);
    return GSN_OK;
}

static int gather_points(const struct plane *plane, const struct gsn_mask *region, struct points *p,
                         struct gsn_error *err)
{
    const struct gsn_lattice *at = &region->at;

    for (size_t i = 0, z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++) {
                const struct gsn_vec3 centre = gsn_lattice_centre(at, x, y, z);
                double corner[MOST_CORNERS][3];
                int count, r;

                if (!region->inside[i])
                    continue;
                count = find_polygon(plane, &centre, &at->step_um, corner);
                r = make_room(p, MOST_CORNERS * RULE, err);
                if (r < 0)
                    return r;
                for (int k = 2; k < count; k++)
                    add_triangle(p, corner[0], corner[k - 1], corner[k]);
            }
    if (p->count == 0)
        return gsn_fail(err, GSN_E_INPUT, "the plane misses the region");
    return GSN_OK;
}

int gsn_region_cut(const struct gsn_spline *spline, const struct gsn_mask *region,
                   const double point[3], const double normal[3], unsigned threads,
                   struct gsn_plane_cut *ret_cut, struct gsn_error *err)
{
    struct points p __attribute__((cleanup(points_done))) = { .count = 0 };
    gsn_auto_mem(double) value = NULL;
    struct gsn_sum area = { 0 }, integral = { 0 };
    struct plane plane;
    int r = orient_plane(point, normal, &plane, err);

    assert(ret_cut);

    if (r >= 0)
        r = gather_points(&plane, region, &p, err);
    if (r < 0)
        return r;
    value = gsn_alloc_array(p.count, sizeof *value);
    if (!value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the cut of a plane");
    r = gsn_spline_eval_many(spline, (const double(*)[3])p.at, p.count, threads, value, NULL, err);
    for (size_t i = 0; r >= 0 && i < p.count; i++) {
        if (isnan(value[i]))
            r = gsn_fail(err, GSN_E_INPUT,
                         "(%g, %g, %g) um is of the region and outside the domain", p.at[i][0],
                         p.at[i][1], p.at[i][2]);
        gsn_sum_add(&area, p.weight[i]);
        gsn_sum_add(&integral, p.weight[i] * value[i]);
    }
    if (r < 0)
        return r;
    *ret_cut = (struct gsn_plane_cut){ area.value + area.rest, integral.value + integral.rest };
    return GSN_OK;
}

/* ---- the domain ---------------------------------------------------------------------------- */

struct means {
    const struct gsn_spline *spline;
    double *mean;
};

static int find_mean(size_t tet, void *context, struct gsn_error *err)
{
    const struct means *m = context;

    return gsn_spline_tet_mean(m->spline, tet, &m->mean[tet], err);
}

int gsn_domain_integral(const struct gsn_spline *spline, unsigned threads, double *ret_volume_um3,
                        double *ret_integral, struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(gsn_spline_space(spline));
    gsn_auto_mem(double) mean = gsn_alloc_array(mesh->tet_count, sizeof *mean);
    struct gsn_sum volume = { 0 }, integral = { 0 };
    struct means means = { spline, mean };
    int r;

    assert(ret_volume_um3 && ret_integral);

    if (!mean)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu means", mesh->tet_count);
    r = gsn_parallel_for(mesh->tet_count, threads, find_mean, &means, err);
    if (r < 0)
        return r;
    for (size_t t = 0; t < mesh->tet_count; t++) {
        gsn_sum_add(&volume, gsn_tets_volume(mesh, t));
        gsn_sum_add(&integral, gsn_tets_volume(mesh, t) * mean[t]);
    }
    *ret_volume_um3 = volume.value + volume.rest;
    *ret_integral = integral.value + integral.rest;
    return GSN_OK;
}

/* ---- a segment ----------------------------------------------------------------------------- */

struct span {
    double from, to; /* 0..1 along the segment */
};

static int compare_spans(const void *a, const void *b)
{
    const struct span *const one = a, *const two = b;

    return (one->from > two->from) - (one->from < two->from);
}

/* The part of a + t (b - a) on the inner side of all four faces. */
static struct span find_span(const struct gsn_tets *mesh, size_t tet, const double a[3],
                             const double b[3])
{
    struct span span = { 0, 1 };

    for (int k = 0; k < 4; k++) {
        const double *const corner = mesh->vertex[mesh->tet[tet][(k + 1) % 4]];
        double edge[2][3], normal[3], at[3] = { 0 }; /* a, b and the corner opposite: signed */

        for (int e = 0; e < 2; e++)
            for (int c = 0; c < 3; c++)
                edge[e][c] = mesh->vertex[mesh->tet[tet][(k + 2 + e) % 4]][c] - corner[c];
        gsn_cross3(edge[0], edge[1], normal);
        for (int c = 0; c < 3; c++) {
            at[0] += normal[c] * (a[c] - corner[c]);
            at[1] += normal[c] * (b[c] - corner[c]);
            at[2] += normal[c] * (mesh->vertex[mesh->tet[tet][k]][c] - corner[c]);
        }
        if (at[2] < 0)
            for (int i = 0; i < 2; i++)
                at[i] = -at[i];
        if (at[0] < 0 && at[1] < 0)
            return (struct span){ 1, 0 };
        if (at[0] < 0)
            span.from = fmax(span.from, at[0] / (at[0] - at[1]));
        else if (at[1] < 0)
            span.to = fmin(span.to, at[0] / (at[0] - at[1]));
    }
    return span;
}

int gsn_segment_inside(const struct gsn_tets *mesh, const double a[3], const double b[3],
                       double *ret_um, struct gsn_error *err)
{
    gsn_auto_mem(struct span) span = gsn_alloc_array(mesh->tet_count, sizeof *span);
    const double d[3] = { b[0] - a[0], b[1] - a[1], b[2] - a[2] };
    double end = 0, share = 0;
    size_t count = 0;

    assert(ret_um);

    if (!span)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", mesh->tet_count);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        span[count] = find_span(mesh, t, a, b);
        count += span[count].from < span[count].to;
    }
    qsort(span, count, sizeof *span, compare_spans);
    for (size_t i = 0; i < count; i++)
        if (span[i].to > end) {
            share += span[i].to - fmax(end, span[i].from);
            end = span[i].to;
        }
    *ret_um = share * gsn_length3(d);
    return GSN_OK;
}

static int compare_numbers(const void *a, const void *b)
{
    const double *const one = a, *const two = b;

    return (*one > *two) - (*one < *two);
}

/* Where the segment crosses the faces of voxels, from 0 to 1 in order; how many. */
static int list_crossings(const struct gsn_lattice *at, const double a[3], const double b[3],
                          double **ret_t, size_t *ret_count, struct gsn_error *err)
{
    const size_t voxels[3] = { at->nx, at->ny, at->nz };
    const double origin[3] = { at->origin_um.x, at->origin_um.y, at->origin_um.z };
    const double step[3] = { at->step_um.x, at->step_um.y, at->step_um.z };
    double *t = gsn_alloc_array(at->nx + at->ny + at->nz + 5, sizeof *t);
    size_t count = 1;

    if (!t)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a segment");
    for (int c = 0; c < 3; c++)
        for (size_t i = 0; b[c] != a[c] && i <= voxels[c]; i++) { /* else it meets no face */
            const double face = origin[c] + ((double)i - 0.5) * step[c];
            const double here = (face - a[c]) / (b[c] - a[c]);

            if (here > 0 && here < 1)
                t[count++] = here;
        }
    t[count++] = 1;
    qsort(t, count, sizeof *t, compare_numbers);
    *ret_t = t;
    *ret_count = count;
    return GSN_OK;
}

int gsn_region_segment(const struct gsn_spline *spline, const struct gsn_mask *region,
                       const double a[3], const double b[3], double *ret_um, double *ret_integral,
                       struct gsn_error *err)
{
    const double d[3] = { b[0] - a[0], b[1] - a[1], b[2] - a[2] };
    gsn_auto_mem(double) t = NULL;
    double um = 0, integral = 0, begin = -1; /* of the part in the region; < 0: not in it */
    size_t count = 0;
    int r = list_crossings(&region->at, a, b, &t, &count, err);

    assert(ret_um && ret_integral);

    for (size_t i = 0; r >= 0 && i < count; i++) {
        const double middle = i + 1 < count ? (t[i] + t[i + 1]) / 2 : 2;
        const int inside =
            i + 1 < count &&
            gsn_mask_has(region, gsn_vec3_make(a[0] + middle * d[0], a[1] + middle * d[1],
                                               a[2] + middle * d[2]));

        if (inside && begin < 0)
            begin = t[i];
        if (!inside && begin >= 0) {
            double from[3], to[3], part;

            for (int c = 0; c < 3; c++) {
                from[c] = a[c] + begin * d[c];
                to[c] = a[c] + t[i] * d[c];
            }
            r = gsn_spline_segment(spline, from, to, &part, err);
            if (r < 0)
                break;
            integral += part;
            um += (t[i] - begin) * gsn_length3(d);
            begin = -1;
        }
    }
    if (r < 0)
        return r;
    *ret_um = um;
    *ret_integral = integral;
    return GSN_OK;
}
