/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The tetrahedral domain over a region: covered, closed, meshed elsewhere, verified, ordered.
 *
 * Method: cubes of a coarse lattice around the region, the manifold surface of their union, and a
 * constrained Delaunay tetrahedralisation of it by TetGen in a process of its own (gieson-mesh).
 * Reference: H. Si, "TetGen, a Delaunay-based quality tetrahedral mesh generator", ACM TOMS 41,
 * 2015.
 *
 * Steps: (1) cover and close (domain_cells.c); (2) ask the mesher over pipes, with limits of time
 * and memory; (3) verify orientation, volume, boundary and every voxel centre by our own code; (4)
 * sort vertices and tetrahedra by Morton code, so that a mesh has one order whoever made it. A
 * refinement asks with limits per tetrahedron and reads them again after each pass, from where the
 * new tetrahedra lie, since TetGen hands them on to ones that only touch.
 *
 * Failure: GSN_E_MESH when TetGen gives up or its answer does not verify, GSN_E_PROCESS when it
 * dies or exceeds a limit; nothing is believed unseen. Cost: TetGen's; verification is linear
 * in the tetrahedra. */
#include "pipeline/model/domain.h"

#include "pipeline/core/process.h"
#include "pipeline/model/bvh.h"
#include "pipeline/model/domain_internal.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

/* --- the mesher --- */

/* Quality asked where the caller asks for none: the radii of clouds follow the smallest altitudes,
 * and slivers would shrink them. */
static const double RADIUS_EDGE = 1.4, MIN_DIHEDRAL_DEG = 14;

enum { WALL_S = 120 };
static const size_t MEMORY_BYTES = (size_t)2 << 30, MOST_ANSWER_BYTES = (size_t)1 << 30;

/* The sanitizers reserve terabytes of address space and would not start under a limit. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
static const bool LIMITS_MEMORY = false;
#else
static const bool LIMITS_MEMORY = true;
#endif

/* gives: what the mesher answered, its corners checked to exist and its vertices to be finite. */
static int ask_mesher(const struct gsn_domain_options *options,
                      const struct gsn_mesh_question *asking, struct gsn_soup **ret_soup,
                      struct gsn_error *err)
{
    struct gsn_mesh_question question = *asking;
    const char *const argv[] = { options->mesher, NULL };
    const struct gsn_process_limits limits = {
        .memory_bytes = !LIMITS_MEMORY          ? 0
                        : options->memory_bytes ? options->memory_bytes
                                                : MEMORY_BYTES,
        .wall_s = options->wall_s ? options->wall_s : WALL_S,
        .answer_bytes = MOST_ANSWER_BYTES,
    };
    gsn_auto_mem(uint8_t) asked = NULL;
    gsn_auto_mem(uint8_t) answer = NULL;
    size_t asked_size = 0, answer_size = 0;
    int r;

    question.options.radius_edge = options->radius_edge > 0 ? options->radius_edge : RADIUS_EDGE;
    question.options.min_dihedral_deg =
        options->dihedral_deg > 0 ? options->dihedral_deg : MIN_DIHEDRAL_DEG;
    r = gsn_mesh_question_pack(&question, &asked, &asked_size, err);

    if (r >= 0)
        r = gsn_process_ask(argv, &limits, asked, asked_size, &answer, &answer_size, err);
    return r < 0 ? r : gsn_mesh_answer_unpack(answer, answer_size, ret_soup, err);
}

static int check_soup(const struct gsn_soup *soup, struct gsn_error *err)
{
    for (size_t v = 0; v < soup->vertex_count; v++)
        for (size_t k = 0; k < 3; k++)
            if (!isfinite(soup->vertex[v][k]))
                return gsn_fail(err, GSN_E_MESH, "vertex %zu is not finite", v);
    for (size_t t = 0; t < soup->tet_count; t++)
        for (size_t k = 0; k < 4; k++)
            if (soup->tet[t][k] >= soup->vertex_count)
                return gsn_fail(err, GSN_E_MESH, "tetrahedron %zu has no such corner", t);
    return GSN_OK;
}

int gsn_domain_ask(const struct gsn_domain_options *options,
                   const struct gsn_mesh_question *question, struct gsn_tets **ret_mesh,
                   struct gsn_error *err)
{
    gsn_auto(gsn_soup) soup = NULL;
    int r = ask_mesher(options, question, &soup, err);

    if (r >= 0)
        r = check_soup(soup, err);
    if (r >= 0)
        r = gsn_domain_order(soup, err);
    if (r < 0)
        return r;
    return gsn_tets_new(soup->vertex, soup->vertex_count, soup->tet, soup->tet_count, ret_mesh,
                        err);
}

/* --- order in space --- */

enum { BITS = 21 };

struct box {
    double low[3], extent;
};

struct place {
    uint64_t code;
    uint32_t index;
};

static struct box bounding_box(const struct gsn_soup *soup)
{
    struct box box = { { INFINITY, INFINITY, INFINITY }, 0 };
    double high[3] = { -INFINITY, -INFINITY, -INFINITY };

    for (size_t v = 0; v < soup->vertex_count; v++)
        for (size_t k = 0; k < 3; k++) {
            box.low[k] = fmin(box.low[k], soup->vertex[v][k]);
            high[k] = fmax(high[k], soup->vertex[v][k]);
        }
    for (size_t k = 0; k < 3; k++)
        box.extent = fmax(box.extent, high[k] - box.low[k]);
    return box;
}

static uint64_t morton_code(const struct box *box, const double p[3])
{
    uint64_t code = 0;

    for (size_t k = 0; k < 3; k++) {
        const double scaled = (p[k] - box->low[k]) / box->extent * (1 << BITS);
        const uint64_t cell = scaled <= 0                 ? 0
                              : scaled >= (1 << BITS) - 1 ? (1 << BITS) - 1
                                                          : (uint64_t)scaled;

        for (unsigned bit = 0; bit < BITS; bit++)
            code |= (cell >> bit & 1) << (3 * bit + k);
    }
    return code;
}

static int compare_places(const void *a, const void *b)
{
    const struct place *left = a, *right = b;

    if (left->code != right->code)
        return left->code < right->code ? -1 : 1;
    return (left->index > right->index) - (left->index < right->index);
}

static int order_vertices(struct gsn_soup *soup, const struct box *box, struct gsn_error *err)
{
    const size_t count = soup->vertex_count;
    gsn_auto_mem(struct place) place = gsn_alloc_array(count, sizeof *place);
    gsn_auto_mem(uint32_t) now = gsn_alloc_array(count, sizeof *now);
    gsn_auto_mem(double) old = gsn_memdup(soup->vertex, count * sizeof *soup->vertex);

    if (!place || !now || !old)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while ordering a mesh");
    for (size_t v = 0; v < count; v++)
        place[v] = (struct place){ morton_code(box, soup->vertex[v]), (uint32_t)v };
    qsort(place, count, sizeof *place, compare_places);
    for (size_t v = 0; v < count; v++) {
        now[place[v].index] = (uint32_t)v;
        memcpy(soup->vertex[v], old + 3 * (size_t)place[v].index, sizeof soup->vertex[v]);
    }
    for (size_t t = 0; t < soup->tet_count; t++)
        for (size_t k = 0; k < 4; k++)
            soup->tet[t][k] = now[soup->tet[t][k]];
    return GSN_OK;
}

static void sort_corners(uint32_t corner[4])
{
    for (size_t i = 1; i < 4; i++)
        for (size_t j = i; j > 0 && corner[j] < corner[j - 1]; j--) {
            const uint32_t swap = corner[j];

            corner[j] = corner[j - 1];
            corner[j - 1] = swap;
        }
}

static int order_tets(struct gsn_soup *soup, const struct box *box, struct gsn_error *err)
{
    const size_t count = soup->tet_count;
    gsn_auto_mem(struct place) place = gsn_alloc_array(count, sizeof *place);
    gsn_auto_mem(uint32_t) old = gsn_memdup(soup->tet, count * sizeof *soup->tet);

    if (!place || !old)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while ordering a mesh");
    for (size_t t = 0; t < count; t++) {
        double middle[3] = { 0 };

        sort_corners(old + 4 * t);
        for (size_t c = 0; c < 4; c++)
            for (size_t k = 0; k < 3; k++)
                middle[k] += soup->vertex[old[4 * t + c]][k] / 4;
        place[t] = (struct place){ morton_code(box, middle), (uint32_t)t };
    }
    qsort(place, count, sizeof *place, compare_places);
    for (size_t t = 0; t < count; t++)
        memcpy(soup->tet[t], old + 4 * (size_t)place[t].index, sizeof soup->tet[t]);
    return GSN_OK;
}

int gsn_domain_order(struct gsn_soup *soup, struct gsn_error *err)
{
    const struct box box = bounding_box(soup);
    const int r = order_vertices(soup, &box, err);

    return r < 0 ? r : order_tets(soup, &box, err);
}

/* --- a mesh of a region --- */

static int check_options(const struct gsn_domain_options *options, struct gsn_error *err)
{
    if (!(options->cell_um > 0) || !isfinite(options->cell_um) || !(options->max_tet_um3 > 0) ||
        !isfinite(options->max_tet_um3))
        return gsn_fail(err, GSN_E_INPUT,
                        "cells of %g um and tetrahedra of %g um^3: both must be above 0",
                        options->cell_um, options->max_tet_um3);
    return GSN_OK;
}

int gsn_domain_build(const struct gsn_mask *region, const struct gsn_domain_options *options,
                     struct gsn_tets **ret_mesh, struct gsn_error *err)
{
    struct gsn_mesh_question question = { .options.max_tet_um3 = options->max_tet_um3 };
    gsn_auto(gsn_cells) cells = NULL;
    gsn_auto(gsn_surface) surface = NULL;
    gsn_auto(gsn_tets) mesh = NULL;
    int r;

    assert(region && options && options->mesher && ret_mesh);
    r = check_options(options, err);
    if (r >= 0)
        r = gsn_cells_cover(region, options->cell_um, &cells, err);
    if (r >= 0)
        r = gsn_cells_close(cells, err);
    if (r >= 0)
        r = gsn_cells_surface(cells, &surface, err);
    if (r < 0)
        return r;
    question.surface = surface;
    r = gsn_domain_ask(options, &question, &mesh, err);
    if (r >= 0)
        r = gsn_domain_verify_cells(mesh, cells, region, err);
    if (r >= 0)
        *ret_mesh = gsn_steal(&mesh);
    return r;
}

/* --- a finer mesh --- */

/* TetGen hands the limits of split tetrahedra on to new ones that only touch their place, so
 * after each pass the limits are read again from where the new tetrahedra lie. */
enum { PASSES = 8 };

/* Least barycentric coordinate of a point that counts as inside: the middle of a new tetrahedron
 * may lie on an old face. */
static const double TOUCHES = 1e-7;

/* Relative to a volume limit: rounding of a volume. */
static const double SLACK = 1e-9;

/* gives: the bounding boxes of the tetrahedra, findable by a point. */
static int boxes_of(const struct gsn_tets *mesh, struct gsn_bvh **ret_tree, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_bvh_box) box = gsn_alloc_array(mesh->tet_count, sizeof *box);

    if (!box)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while refining a mesh");
    for (size_t t = 0; t < mesh->tet_count; t++)
        for (size_t k = 0; k < 3; k++) {
            const double first = mesh->vertex[mesh->tet[t][0]][k];
            double low = first, high = first;

            for (size_t c = 1; c < 4; c++) {
                low = fmin(low, mesh->vertex[mesh->tet[t][c]][k]);
                high = fmax(high, mesh->vertex[mesh->tet[t][c]][k]);
            }
            box[t].low[k] = low - TOUCHES * (high - low);
            box[t].high[k] = high + TOUCHES * (high - low);
        }
    return gsn_bvh_new(box, mesh->tet_count, ret_tree, err);
}

static double signed_volume(const double *o, const double *a, const double *b, const double *c)
{
    const struct gsn_vec3 u = gsn_vec3_make(a[0] - o[0], a[1] - o[1], a[2] - o[2]),
                          v = gsn_vec3_make(b[0] - o[0], b[1] - o[1], b[2] - o[2]),
                          w = gsn_vec3_make(c[0] - o[0], c[1] - o[1], c[2] - o[2]);

    return gsn_vec3_dot(u, gsn_vec3_cross(v, w));
}

/* The least barycentric coordinate of u. */
static double find_depth(const struct gsn_tets *mesh, size_t tet, const double u[3])
{
    const double *a = mesh->vertex[mesh->tet[tet][0]], *b = mesh->vertex[mesh->tet[tet][1]],
                 *c = mesh->vertex[mesh->tet[tet][2]], *d = mesh->vertex[mesh->tet[tet][3]];
    const double least = fmin(fmin(signed_volume(u, b, c, d), signed_volume(a, u, c, d)),
                              fmin(signed_volume(a, b, u, d), signed_volume(a, b, c, u)));

    return least / signed_volume(a, b, c, d);
}

/* A point, and the tetrahedron found so far in which it lies deepest. */
struct deepest {
    const struct gsn_tets *mesh;
    const double *u;
    double depth;
    uint32_t tet;
    bool found;
};

static int look_into(void *context, uint32_t tet)
{
    struct deepest *best = context;
    const double here = find_depth(best->mesh, tet, best->u);

    if (here > best->depth || (best->found && here == best->depth && tet < best->tet)) {
        best->depth = here;
        best->tet = tet;
        best->found = true;
    }
    return 0;
}

/* The tetrahedron in which u lies deepest; false when it lies in none. */
static bool find_deepest(const struct gsn_bvh *tree, const struct gsn_tets *mesh, const double u[3],
                         size_t *ret_tet)
{
    struct deepest best = { .mesh = mesh, .u = u, .depth = -TOUCHES };

    (void)gsn_bvh_at(tree, u, look_into, &best);
    if (best.found)
        *ret_tet = best.tet;
    return best.found;
}

/* The limit of the place where each tetrahedron of a refinement lies, and how many break theirs. */
static int read_limits(const struct gsn_bvh *tree, const struct gsn_tets *mesh,
                       const double *max_um3, const struct gsn_tets *fine, double *ret_limit,
                       size_t *ret_broken, struct gsn_error *err)
{
    size_t broken = 0;

    for (size_t t = 0; t < fine->tet_count; t++) {
        double middle[3] = { 0 };
        size_t place = 0;

        for (size_t c = 0; c < 4; c++)
            for (size_t k = 0; k < 3; k++)
                middle[k] += fine->vertex[fine->tet[t][c]][k] / 4;
        if (!find_deepest(tree, mesh, middle, &place))
            return gsn_fail(err, GSN_E_MESH, "tetrahedron %zu lies outside the mesh it refines", t);
        ret_limit[t] = max_um3[place];
        broken += ret_limit[t] > 0 && gsn_tets_volume(fine, t) > ret_limit[t] * (1 + SLACK);
    }
    *ret_broken = broken;
    return GSN_OK;
}

/* One pass: asks for a refinement of `from`, replaces `limit` by that of the answer. */
static int refine_once(const struct gsn_tets *mesh, const struct gsn_bvh *tree,
                       const double *max_um3, const struct gsn_domain_options *options,
                       const struct gsn_tets *from, double **limit, struct gsn_tets **ret_fine,
                       size_t *ret_broken, struct gsn_error *err)
{
    struct gsn_soup soup = { from->vertex_count, from->tet_count, from->vertex, from->tet };
    const struct gsn_mesh_question question = { .mesh = &soup, .max_um3 = *limit };
    gsn_auto(gsn_tets) fine = NULL;
    gsn_auto_mem(double) next = NULL;
    int r = gsn_domain_ask(options, &question, &fine, err);

    if (r >= 0)
        r = gsn_domain_verify_same(fine, mesh, err);
    if (r < 0)
        return r;
    next = gsn_alloc_array(fine->tet_count, sizeof *next);
    if (!next)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while refining a mesh");
    r = read_limits(tree, mesh, max_um3, fine, next, ret_broken, err);
    if (r < 0)
        return r;
    gsn_free(*limit);
    *limit = gsn_steal(&next);
    *ret_fine = gsn_steal(&fine);
    return GSN_OK;
}

static int refine_mesh(const struct gsn_tets *mesh, const struct gsn_bvh *tree,
                       const double *max_um3, const struct gsn_domain_options *options,
                       struct gsn_tets **ret_mesh, struct gsn_error *err)
{
    gsn_auto_mem(double) limit = gsn_memdup(max_um3, mesh->tet_count * sizeof *limit);
    gsn_auto(gsn_tets) fine = NULL;
    size_t broken = 1;

    if (!limit)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while refining a mesh");
    for (unsigned pass = 0; pass < PASSES && broken > 0; pass++) {
        struct gsn_tets *finer = NULL;
        const int r = refine_once(mesh, tree, max_um3, options, fine ? fine : mesh, &limit, &finer,
                                  &broken, err);

        if (r < 0)
            return r;
        gsn_tets_free(fine);
        fine = finer;
    }
    if (broken > 0)
        return gsn_fail(err, GSN_E_MESH, "%zu tetrahedra stay above their limit after %d passes",
                        broken, PASSES);
    *ret_mesh = gsn_steal(&fine);
    return GSN_OK;
}

int gsn_domain_refine(const struct gsn_tets *mesh, const double *max_um3,
                      const struct gsn_domain_options *options, struct gsn_tets **ret_mesh,
                      struct gsn_error *err)
{
    gsn_auto(gsn_bvh) tree = NULL;
    int r;

    assert(mesh && max_um3 && options && options->mesher && ret_mesh);
    for (size_t t = 0; t < mesh->tet_count; t++)
        if (!isfinite(max_um3[t]) || max_um3[t] < 0)
            return gsn_fail(err, GSN_E_INPUT, "the limit %g um^3 of tetrahedron %zu", max_um3[t],
                            t);
    r = boxes_of(mesh, &tree, err);
    return r < 0 ? r : refine_mesh(mesh, tree, max_um3, options, ret_mesh, err);
}
