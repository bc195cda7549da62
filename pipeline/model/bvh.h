/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which boxes hold this point, meet this box, come near this line? A small tree over axis-parallel
 * boxes.
 *
 * The boxes are sorted along a Hilbert curve through their centres and taken six at a time; over
 * these leaves stands a balanced binary tree without pointers. A node knows the box around what is
 * below it, in single precision about the middle of everything, rounded outward. The boxes
 * themselves are not kept: a search may name items whose own box just fails the question, never
 * leave out one whose box does not, and the caller decides. That takes 12 bytes an item.
 *
 * The order of a search depends on the boxes alone. Where the caller's result depends on the order
 * it sorts by item (sorted_batch.h). */
#ifndef GSN_MODEL_BVH_H
#define GSN_MODEL_BVH_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_bvh_box {
    double low[3], high[3]; /* closed */
};

/* The box around some points. */
struct gsn_bvh_box gsn_bvh_box_around(const double (*point)[3], size_t count);
int gsn_bvh_box_meets(const struct gsn_bvh_box *a, const struct gsn_bvh_box *b);

struct gsn_bvh;

/* gives: the tree; does not keep the boxes, which must be finite. Fails with GSN_E_NOMEM. */
int gsn_bvh_new(const struct gsn_bvh_box *box, size_t count, struct gsn_bvh **ret_tree,
                struct gsn_error *err);
void gsn_bvh_free(struct gsn_bvh *tree);
GSN_DEFINE_AUTO(gsn_bvh);

/* borrowed: the box around all boxes. */
const struct gsn_bvh_box *gsn_bvh_bounds(const struct gsn_bvh *tree);
/* Bytes of memory it holds. */
size_t gsn_bvh_bytes(const struct gsn_bvh *tree);

/* Called for each item found. An answer other than 0 ends the search, which returns it. */
typedef int gsn_bvh_visit(void *context, uint32_t item);

/* Every item whose box holds u. Nothing holds a point that is not finite. */
int gsn_bvh_at(const struct gsn_bvh *tree, const double u[3], gsn_bvh_visit *visit, void *context);
/* Every item whose box meets the given one. */
int gsn_bvh_meeting(const struct gsn_bvh *tree, const struct gsn_bvh_box *box, gsn_bvh_visit *visit,
                    void *context);
/* Every item whose box the line p + t d meets, or nearly: d has length 1 or so. */
int gsn_bvh_along(const struct gsn_bvh *tree, const double p[3], const double d[3],
                  gsn_bvh_visit *visit, void *context);

#ifdef __cplusplus
}
#endif
#endif
