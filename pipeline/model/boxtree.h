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
 * it sorts by item (ascent.h). */
#ifndef GSN_MODEL_BOXTREE_H
#define GSN_MODEL_BOXTREE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_box {
    double low[3], high[3]; /* closed */
};

/* The box around some points. */
struct gsn_box gsn_box_around(const double (*point)[3], size_t count);
int gsn_box_meets(const struct gsn_box *a, const struct gsn_box *b);

struct gsn_boxtree;

/* gives: the tree; does not keep the boxes, which must be finite. Fails with GSN_E_NOMEM. */
int gsn_boxtree_new(const struct gsn_box *box, size_t count, struct gsn_boxtree **ret_tree,
                    struct gsn_error *err);
void gsn_boxtree_free(struct gsn_boxtree *tree);
GSN_DEFINE_AUTO(gsn_boxtree);

/* borrowed: the box around all boxes. */
const struct gsn_box *gsn_boxtree_bounds(const struct gsn_boxtree *tree);
/* Bytes of memory it holds. */
size_t gsn_boxtree_bytes(const struct gsn_boxtree *tree);

/* Called for each item found. An answer other than 0 ends the search, which returns it. */
typedef int gsn_boxtree_visit(void *context, uint32_t item);

/* Every item whose box holds u. Nothing holds a point that is not finite. */
int gsn_boxtree_at(const struct gsn_boxtree *tree, const double u[3], gsn_boxtree_visit *visit,
                   void *context);
/* Every item whose box meets the given one. */
int gsn_boxtree_meeting(const struct gsn_boxtree *tree, const struct gsn_box *box,
                        gsn_boxtree_visit *visit, void *context);
/* Every item whose box the line p + t d meets, or nearly: d has length 1 or so. */
int gsn_boxtree_along(const struct gsn_boxtree *tree, const double p[3], const double d[3],
                      gsn_boxtree_visit *visit, void *context);

#ifdef __cplusplus
}
#endif
#endif
