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
 * it sorts by item, with struct gsn_ascent. */
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

/* Brings what searches find into ascending order without memory of its own for any number of
 * items: it holds the least ones from `from` on, and when there are more, the search is made again
 * for the next.
 *
 *     struct gsn_ascent ascent = { 0 };
 *
 *     gsn_ascent_begin(&ascent);
 *     do {
 *         (search, with gsn_ascent_add() for each item found)
 *         (use item[0] .. item[count - 1])
 *     } while (gsn_ascent_next(&ascent));
 */
enum { GSN_ASCENT_ROOM = 512 };

struct gsn_ascent {
    uint32_t from, limit; /* what it takes: from <= item < limit */
    size_t count;
    uint32_t item[GSN_ASCENT_ROOM];
};

void gsn_ascent_begin(struct gsn_ascent *ascent);
/* A gsn_boxtree_visit; returns 0. An item is added once in a search. */
int gsn_ascent_add(void *ascent, uint32_t item);
/* Empties it for the items after those it had; 0 when there are none. */
int gsn_ascent_next(struct gsn_ascent *ascent);

#ifdef __cplusplus
}
#endif
#endif
