/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: the Hungarian method (Kuhn 1955) by shortest augmenting paths (Jonker and Volgenant
 * 1987).
 *
 * Steps. 1. A row starts a tree of columns. 2. The column of the least reduced cost joins it, and
 * the potentials are moved so that it costs nothing. 3. At a free column the path back to the start
 * is turned over. It is short, and alone: the slots of a panel are assigned by it.
 *
 * Fails when memory runs out. Cost: count^2 x columns steps. */
#include "pipeline/core/assignment.h"

#include "pipeline/core/mem.h"

#include <assert.h>
#include <math.h>

/* Rows and columns are counted from 1; column 0 is where a new row starts. */
struct work {
    const double *cost;
    size_t rows, columns;
    double *of_row, *of_column; /* potentials: cost - of_row - of_column is never negative */
    double *slack;              /* the least of that from the tree to each column */
    size_t *row;                /* the row of each column; 0: free */
    size_t *before;             /* the column before it on the path */
    char *in_tree;
};

/* Takes the nearest column into the tree; returns it. */
static size_t grow_tree(struct work *w, size_t from)
{
    const size_t row = w->row[from];
    double least = INFINITY;
    size_t next = 0;

    w->in_tree[from] = 1;
    for (size_t c = 1; c <= w->columns; c++) {
        double now;

        if (w->in_tree[c])
            continue;
        now = w->cost[(row - 1) * w->columns + c - 1] - w->of_row[row] - w->of_column[c];
        if (now < w->slack[c]) {
            w->slack[c] = now;
            w->before[c] = from;
        }
        if (w->slack[c] < least) {
            least = w->slack[c];
            next = c;
        }
    }
    for (size_t c = 0; c <= w->columns; c++) {
        if (w->in_tree[c]) {
            w->of_row[w->row[c]] += least;
            w->of_column[c] -= least;
        } else {
            w->slack[c] -= least;
        }
    }
    return next;
}

static void assign_row(struct work *w, size_t row)
{
    size_t at = 0;

    for (size_t c = 0; c <= w->columns; c++) {
        w->slack[c] = INFINITY;
        w->in_tree[c] = 0;
    }
    w->row[0] = row;
    do
        at = grow_tree(w, at);
    while (w->row[at] != 0);
    while (at != 0) {
        w->row[at] = w->row[w->before[at]];
        at = w->before[at];
    }
}

int gsn_assign(const double *cost, size_t count, size_t columns, int *ret_column,
               struct gsn_error *err)
{
    gsn_auto_mem(double) of_row = gsn_alloc_array(count + 1, sizeof *of_row);
    gsn_auto_mem(double) of_column = gsn_alloc_array(columns + 1, sizeof *of_column);
    gsn_auto_mem(double) slack = gsn_alloc_array(columns + 1, sizeof *slack);
    gsn_auto_mem(size_t) row = gsn_alloc_array(columns + 1, sizeof *row);
    gsn_auto_mem(size_t) before = gsn_alloc_array(columns + 1, sizeof *before);
    gsn_auto_mem(char) in_tree = gsn_alloc_array(columns + 1, 1);
    struct work w = { cost, count, columns, of_row, of_column, slack, row, before, in_tree };

    assert(cost && columns >= count && ret_column);

    if (!of_row || !of_column || !slack || !row || !before || !in_tree)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for an assignment");
    for (size_t r = 1; r <= count; r++)
        assign_row(&w, r);
    for (size_t c = 1; c <= columns; c++)
        if (row[c] > 0)
            ret_column[row[c] - 1] = (int)c - 1;
    return GSN_OK;
}
