/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/domain.h"

#include "pipeline/model/boxtree.h"
#include "pipeline/model/domain_mesher.h"
#include "pipeline/model/domain_verify.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>

/* TetGen hands the limits of split tetrahedra on to new ones that only touch their place, so
 * after each pass the limits are read again from where the new tetrahedra lie. */
enum { PASSES = 8 };

/* Least barycentric coordinate of a point that counts as inside: the middle of a new tetrahedron
 * may lie on an old face. */
static const double TOUCHES = 1e-7;

/* Relative to a volume limit: rounding of a volume. */
static const double SLACK = 1e-9;

/* gives: the bounding boxes of the tetrahedra, findable by a point. */
static int boxes_of(const struct gsn_tets *mesh, struct gsn_boxtree **ret_tree,
                    struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_box) box = gsn_alloc_array(mesh->tet_count, sizeof *box);

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
    return gsn_boxtree_new(box, mesh->tet_count, ret_tree, err);
}

static double det(const double *o, const double *a, const double *b, const double *c)
{
    const struct gsn_vec3 u = gsn_vec3_make(a[0] - o[0], a[1] - o[1], a[2] - o[2]),
                          v = gsn_vec3_make(b[0] - o[0], b[1] - o[1], b[2] - o[2]),
                          w = gsn_vec3_make(c[0] - o[0], c[1] - o[1], c[2] - o[2]);

    return gsn_vec3_dot(u, gsn_vec3_cross(v, w));
}

/* The least barycentric coordinate of u. */
static double depth(const struct gsn_tets *mesh, size_t tet, const double u[3])
{
    const double *a = mesh->vertex[mesh->tet[tet][0]], *b = mesh->vertex[mesh->tet[tet][1]],
                 *c = mesh->vertex[mesh->tet[tet][2]], *d = mesh->vertex[mesh->tet[tet][3]];
    const double least =
        fmin(fmin(det(u, b, c, d), det(a, u, c, d)), fmin(det(a, b, u, d), det(a, b, c, u)));

    return least / det(a, b, c, d);
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
    const double here = depth(best->mesh, tet, best->u);

    if (here > best->depth || (best->found && here == best->depth && tet < best->tet)) {
        best->depth = here;
        best->tet = tet;
        best->found = true;
    }
    return 0;
}

/* The tetrahedron in which u lies deepest; false when it lies in none. */
static bool find(const struct gsn_boxtree *tree, const struct gsn_tets *mesh, const double u[3],
                 size_t *ret_tet)
{
    struct deepest best = { .mesh = mesh, .u = u, .depth = -TOUCHES };

    (void)gsn_boxtree_at(tree, u, look_into, &best);
    if (best.found)
        *ret_tet = best.tet;
    return best.found;
}

/* The limit of the place where each tetrahedron of a refinement lies, and how many break theirs. */
static int read_limits(const struct gsn_boxtree *tree, const struct gsn_tets *mesh,
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
        if (!find(tree, mesh, middle, &place))
            return gsn_fail(err, GSN_E_MESH, "tetrahedron %zu lies outside the mesh it refines", t);
        ret_limit[t] = max_um3[place];
        broken += ret_limit[t] > 0 && gsn_tets_volume(fine, t) > ret_limit[t] * (1 + SLACK);
    }
    *ret_broken = broken;
    return GSN_OK;
}

/* One pass: asks for a refinement of `from`, replaces `limit` by that of the answer. */
static int refine_once(const struct gsn_tets *mesh, const struct gsn_boxtree *tree,
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

static int refine(const struct gsn_tets *mesh, const struct gsn_boxtree *tree,
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
    gsn_auto(gsn_boxtree) tree = NULL;
    int r;

    assert(mesh && max_um3 && options && options->mesher && ret_mesh);
    for (size_t t = 0; t < mesh->tet_count; t++)
        if (!isfinite(max_um3[t]) || max_um3[t] < 0)
            return gsn_fail(err, GSN_E_INPUT, "the limit %g um^3 of tetrahedron %zu", max_um3[t],
                            t);
    r = boxes_of(mesh, &tree, err);
    return r < 0 ? r : refine(mesh, tree, max_um3, options, ret_mesh, err);
}
