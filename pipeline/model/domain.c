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
 * sort vertices and tetrahedra by Morton code, so that a mesh has one order whoever made it.
 *
 * Failure: GSN_E_MESH when TetGen gives up or its answer does not verify, GSN_E_PROCESS when it
 * dies or exceeds a limit; nothing is believed unseen. Cost: TetGen's; verification is linear
 * in the tetrahedra. */
#include "pipeline/model/domain.h"

#include "pipeline/core/process.h"
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
