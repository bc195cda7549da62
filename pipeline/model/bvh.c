/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A bounding volume hierarchy of axis-aligned boxes, packed along a Hilbert curve.
 *
 * Method: as a packed R-tree (I. Kamel, C. Faloutsos, "On packing R-trees", 1993), here with binary
 * nodes in the order of a heap, so that no node has a pointer and a search needs no stack. Curve:
 * J. Skilling, "Programming the Hilbert curve", 2004.
 *
 * Steps: (1) the box around all, and a scale that is a power of two, which does not round; (2) the
 * centres' places on the curve, 21 bits an axis, sorted, equals by their number; (3) leaves of six
 * items, nodes from the last to the first, in single precision rounded outwards; (4) a search goes
 * down where a node passes and else to the next node beside it. A line is told from a box by the
 * separating axes across the line.
 *
 * Failure: GSN_E_NOMEM while it is made, none in a search. Cost: n log n to make, 12 bytes an item.
 */
#include "pipeline/model/bvh.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    LEAF = 6,        /* items of a leaf */
    CURVE_BITS = 21, /* of an axis */
};

/* Coordinates of a node are those of space less origin, times scale. All boxes lie in about
 * [-1, 1]; what a search asks for is clamped to this. */
#define FAR 4.0

/* Of the rounding in a search along a line, relative to how far its start lies from the origin. */
#define LINE_SLACK 1e-13

struct node {
    float low[3], high[3];
};

/* Nodes are numbered as in a heap: 1 is the root, 2 i and 2 i + 1 are below i, and leaves .. 2
 * leaves - 1 are the leaves. */
struct gsn_bvh {
    struct gsn_bvh_box bounds;
    double origin[3], scale;
    size_t count, leaves;
    size_t deepest; /* the first node of the deepest level, which is the first leaf in space */
    struct node *node;
    uint32_t *item; /* along the curve */
};

struct place {
    uint64_t code;
    uint32_t item;
};

struct gsn_bvh_box gsn_bvh_box_around(const double (*point)[3], size_t count)
{
    struct gsn_bvh_box box;

    memcpy(box.low, point[0], sizeof box.low);
    memcpy(box.high, point[0], sizeof box.high);
    for (size_t i = 1; i < count; i++) {
        for (int c = 0; c < 3; c++) {
            box.low[c] = point[i][c] < box.low[c] ? point[i][c] : box.low[c];
            box.high[c] = point[i][c] > box.high[c] ? point[i][c] : box.high[c];
        }
    }
    return box;
}

int gsn_bvh_box_meets(const struct gsn_bvh_box *a, const struct gsn_bvh_box *b)
{
    for (int c = 0; c < 3; c++) {
        if (a->low[c] > b->high[c] || a->high[c] < b->low[c])
            return 0;
    }
    return 1;
}

static void bound_leaf(struct gsn_bvh *tree, const struct gsn_bvh_box *box)
{
    double half = 0;
    int exponent = 0;

    tree->bounds = box[0];
    for (size_t i = 1; i < tree->count; i++) {
        for (int c = 0; c < 3; c++) {
            tree->bounds.low[c] = fmin(tree->bounds.low[c], box[i].low[c]);
            tree->bounds.high[c] = fmax(tree->bounds.high[c], box[i].high[c]);
        }
    }
    for (int c = 0; c < 3; c++) {
        tree->origin[c] = tree->bounds.low[c] / 2 + tree->bounds.high[c] / 2;
        half = fmax(half, tree->bounds.high[c] / 2 - tree->bounds.low[c] / 2);
    }
    /* A power of two, so that it does not round. */
    (void)frexp(half, &exponent);
    tree->scale = ldexp(1, exponent < -1000 ? 1000 : -exponent);
}

/* A coordinate of a node. This grows with x, rounding and all, which is why rounding it outward is
 * enough to keep every box within its nodes. What is not a number goes outside of everything. */
static double node_coordinate(const struct gsn_bvh *tree, double x, int axis)
{
    const double y = (x - tree->origin[axis]) * tree->scale;

    return y > -FAR ? (y < FAR ? y : FAR) : -FAR;
}

static float round_down(double x)
{
    const float nearest = (float)x;

    return (double)nearest > x ? nextafterf(nearest, -INFINITY) : nearest;
}

static float round_up(double x)
{
    return -round_down(-x);
}

static struct node node_of(const struct gsn_bvh *tree, const struct gsn_bvh_box *box)
{
    struct node node;

    for (int c = 0; c < 3; c++) {
        node.low[c] = round_down(node_coordinate(tree, box->low[c], c));
        node.high[c] = round_up(node_coordinate(tree, box->high[c], c));
    }
    return node;
}

static void widen_node(struct node *node, const struct node *by)
{
    for (int c = 0; c < 3; c++) {
        node->low[c] = by->low[c] < node->low[c] ? by->low[c] : node->low[c];
        node->high[c] = by->high[c] > node->high[c] ? by->high[c] : node->high[c];
    }
}

/* Two zero bits after each of 21. */
static uint64_t spread_bits(uint64_t x)
{
    x = (x | x << 32) & 0x1F00000000FFFF;
    x = (x | x << 16) & 0x1F0000FF0000FF;
    x = (x | x << 8) & 0x100F00F00F00F00F;
    x = (x | x << 4) & 0x10C30C30C30C30C3;
    return (x | x << 2) & 0x1249249249249249;
}

/* The place of a cell along Hilbert's curve, by Skilling's "Programming the Hilbert curve" (2004):
 * coordinates, most significant bits first, are turned and mirrored into the bits of the place. */
static uint64_t hilbert_code(uint32_t x[3])
{
    uint32_t turn = 0;

    for (uint32_t bit = 1u << (CURVE_BITS - 1); bit > 1; bit >>= 1) {
        for (int c = 0; c < 3; c++) {
            const uint32_t swapped = (x[0] ^ x[c]) & (bit - 1);

            if (x[c] & bit) {
                x[0] ^= bit - 1;
            } else {
                x[0] ^= swapped;
                x[c] ^= swapped;
            }
        }
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    for (uint32_t bit = 1u << (CURVE_BITS - 1); bit > 1; bit >>= 1)
        turn ^= x[2] & bit ? bit - 1 : 0;
    return spread_bits(x[0] ^ turn) << 2 | spread_bits(x[1] ^ turn) << 1 | spread_bits(x[2] ^ turn);
}

/* Where the middle of a box lies along the curve. */
static uint64_t code_of(const struct gsn_bvh *tree, const struct gsn_bvh_box *box)
{
    const double cells = (double)(1 << CURVE_BITS);
    uint32_t cell[3];

    for (int c = 0; c < 3; c++) {
        const double middle = box->low[c] / 2 + box->high[c] / 2;
        const double place = (node_coordinate(tree, middle, c) + 1) / 2 * cells;

        cell[c] = (uint32_t)fmin(fmax(place, 0), cells - 1);
    }
    return hilbert_code(cell);
}

static int by_code(const void *left, const void *right)
{
    const struct place *a = left, *b = right;

    if (a->code != b->code)
        return a->code < b->code ? -1 : 1;
    return (a->item > b->item) - (a->item < b->item);
}

static int sort_items(struct gsn_bvh *tree, const struct gsn_bvh_box *box, struct gsn_error *err)
{
    gsn_auto_mem(struct place) place = gsn_alloc_array(tree->count, sizeof *place);

    if (!place)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu boxes", tree->count);
    for (size_t i = 0; i < tree->count; i++)
        place[i] = (struct place){ code_of(tree, &box[i]), (uint32_t)i };
    qsort(place, tree->count, sizeof *place, by_code);
    for (size_t i = 0; i < tree->count; i++)
        tree->item[i] = place[i].item;
    return GSN_OK;
}

/* The items of a leaf node: returns the first, and how many. Along the curve the leaves of
 * the deepest level come before those one above it. */
static const uint32_t *items_of(const struct gsn_bvh *tree, size_t node, size_t *ret_count)
{
    const size_t deepest = tree->deepest;
    const size_t place = node >= deepest ? node - deepest : node + tree->leaves - deepest;
    const size_t first = place * LEAF;

    *ret_count = tree->count - first < LEAF ? tree->count - first : LEAF;
    return &tree->item[first];
}

static void fill_nodes(struct gsn_bvh *tree, const struct gsn_bvh_box *box)
{
    for (size_t i = 2 * tree->leaves - 1; i > 0; i--) {
        if (i >= tree->leaves) {
            size_t count;
            const uint32_t *item = items_of(tree, i, &count);

            tree->node[i] = node_of(tree, &box[item[0]]);
            for (size_t k = 1; k < count; k++) {
                const struct node next = node_of(tree, &box[item[k]]);

                widen_node(&tree->node[i], &next);
            }
        } else {
            tree->node[i] = tree->node[2 * i];
            widen_node(&tree->node[i], &tree->node[2 * i + 1]);
        }
    }
}

int gsn_bvh_new(const struct gsn_bvh_box *box, size_t count, struct gsn_bvh **ret_tree,
                struct gsn_error *err)
{
    gsn_auto(gsn_bvh) tree = gsn_alloc_array(1, sizeof *tree);
    int r;

    assert(box && count > 0 && count < UINT32_MAX && ret_tree);

    if (tree) {
        tree->count = count;
        tree->leaves = (count + LEAF - 1) / LEAF;
        for (tree->deepest = 1; tree->deepest < tree->leaves;)
            tree->deepest *= 2;
        tree->node = gsn_alloc_array(2 * tree->leaves, sizeof *tree->node);
        tree->item = gsn_alloc_array(count, sizeof *tree->item);
    }
    if (!tree || !tree->node || !tree->item)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu boxes", count);
    bound_leaf(tree, box);
    r = sort_items(tree, box, err);
    if (r < 0)
        return r;
    fill_nodes(tree, box);
    *ret_tree = gsn_steal(&tree);
    return GSN_OK;
}

void gsn_bvh_free(struct gsn_bvh *tree)
{
    if (!tree)
        return;
    gsn_free(tree->node);
    gsn_free(tree->item);
    gsn_free(tree);
}

const struct gsn_bvh_box *gsn_bvh_bounds(const struct gsn_bvh *tree)
{
    return &tree->bounds;
}

size_t gsn_bvh_bytes(const struct gsn_bvh *tree)
{
    return sizeof *tree + 2 * tree->leaves * sizeof *tree->node + tree->count * sizeof *tree->item;
}

/* The node to look at after i when nothing below i is of interest; 0 at the end. */
static size_t next_beside(size_t i)
{
    while (i & 1)
        i >>= 1;
    return i ? i + 1 : 0;
}

static int visit_leaf(const struct gsn_bvh *tree, size_t node, gsn_bvh_visit *visit, void *context)
{
    size_t count;
    const uint32_t *item = items_of(tree, node, &count);
    int r = 0;

    for (size_t k = 0; k < count && r == 0; k++)
        r = visit(context, item[k]);
    return r;
}

static int boxes_meet(const struct node *a, const struct node *b)
{
    return (a->low[0] <= b->high[0]) & (a->high[0] >= b->low[0]) & (a->low[1] <= b->high[1]) &
           (a->high[1] >= b->low[1]) & (a->low[2] <= b->high[2]) & (a->high[2] >= b->low[2]);
}

/* All leaves below nodes that pass the question, from left to right. */
static inline int search_leaves(const struct gsn_bvh *tree,
                                int (*passes)(const void *asked, const struct node *node),
                                const void *asked, gsn_bvh_visit *visit, void *context)
{
    int r = 0;

    for (size_t i = 1; i > 0 && r == 0;) {
        if (!passes(asked, &tree->node[i])) {
            i = next_beside(i);
        } else if (i < tree->leaves) {
            i = 2 * i;
        } else {
            r = visit_leaf(tree, i, visit, context);
            i = next_beside(i);
        }
    }
    return r;
}

static int meets_box(const void *asked, const struct node *node)
{
    return boxes_meet(node, asked);
}

int gsn_bvh_meeting(const struct gsn_bvh *tree, const struct gsn_bvh_box *box, gsn_bvh_visit *visit,
                    void *context)
{
    const struct node asked = node_of(tree, box);

    return search_leaves(tree, meets_box, &asked, visit, context);
}

int gsn_bvh_at(const struct gsn_bvh *tree, const double u[3], gsn_bvh_visit *visit, void *context)
{
    const struct gsn_bvh_box point = { { u[0], u[1], u[2] }, { u[0], u[1], u[2] } };

    return gsn_bvh_meeting(tree, &point, visit, context);
}

/* A line in the coordinates of the nodes. */
struct line {
    double start[3], along[3], slack;
};

/* A line misses a box when it does so seen along an axis of the box crossed with the line. */
static int is_near(const struct line *line, const struct node *node)
{
    double to[3], half[3];

    for (int c = 0; c < 3; c++) {
        to[c] = ((double)node->low[c] + (double)node->high[c]) / 2 - line->start[c];
        half[c] = ((double)node->high[c] - (double)node->low[c]) / 2;
    }
    for (int c = 0; c < 3; c++) {
        const int i = (c + 1) % 3, j = (c + 2) % 3;
        const double apart = fabs(to[i] * line->along[j] - to[j] * line->along[i]);
        const double wide = half[i] * fabs(line->along[j]) + half[j] * fabs(line->along[i]);

        if (!(apart <= wide + line->slack))
            return 0;
    }
    return 1;
}

static int is_near_line(const void *asked, const struct node *node)
{
    return is_near(asked, node);
}

int gsn_bvh_along(const struct gsn_bvh *tree, const double p[3], const double d[3],
                  gsn_bvh_visit *visit, void *context)
{
    struct line line;
    double size = 1;

    for (int c = 0; c < 3; c++) {
        line.start[c] = (p[c] - tree->origin[c]) * tree->scale;
        line.along[c] = d[c];
        size += fabs(line.start[c]);
    }
    line.slack = LINE_SLACK * size;
    return search_leaves(tree, is_near_line, &line, visit, context);
}
