/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/domain_mesher.h"

#include "pipeline/core/process.h"
#include "pipeline/model/domain_order.h"

#include <math.h>
#include <stdbool.h>

/* Quality asked of every mesh: the radii of clouds follow the smallest altitudes, and slivers would
 * shrink them. */
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
static int converse(const struct gsn_domain_options *options,
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

    question.options.radius_edge = RADIUS_EDGE;
    question.options.min_dihedral_deg = MIN_DIHEDRAL_DEG;
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
    int r = converse(options, question, &soup, err);

    if (r >= 0)
        r = check_soup(soup, err);
    if (r >= 0)
        r = gsn_domain_order(soup, err);
    if (r < 0)
        return r;
    return gsn_tets_new(soup->vertex, soup->vertex_count, soup->tet, soup->tet_count, ret_mesh,
                        err);
}
