/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Exact values of simplex splines, computed in rational arithmetic: the folders of CSV files in
 * tests/fixtures/model/golden, or in $GIESON_GOLDEN. */
#ifndef GSN_TESTS_MODEL_GOLDEN_H
#define GSN_TESTS_MODEL_GOLDEN_H

#include "pipeline/model/spline.h"

/* Numbers row by row; a cell that is no number is NaN. kind is the text of the one among the first
 * two columns that is no number. */
struct golden_table {
    size_t rows, columns;
    double *cell;
    _Float128 *fine; /* the same, all the digits of the file */
    char (*kind)[24];
};

const double *golden_row(const struct golden_table *table, size_t row);

/* A case: its space with own control points, and its control values in the space's order. */
struct golden_case {
    char folder[512];
    struct gsn_tets *mesh;
    struct gsn_dms *space;
    double *control;
    unsigned degree;
};

/* Runs test on every case that has this file: folders of files at any depth. Fails when there is
 * none, skips loudly when $GIESON_GOLDEN does not exist or has none. */
void golden_each(const char *file, void (*test)(const struct golden_case *golden));

/* gives: the table of one file of the case. */
struct golden_table golden_read(const struct golden_case *golden, const char *file);
void golden_done(struct golden_table *table);

/* The largest derivative in a table "spline". */
double golden_steepest(const struct golden_table *spline);

/* gives: the spline of a case. */
struct gsn_spline *golden_spline(const struct golden_case *golden);

/* The same spline on a larger mesh: a copy of the boundary blown up from the middle, with clouds
 * drawn together, prisms of three tetrahedra between the two, and control values 0. Own control
 * points make that the formula's values beyond the mesh, where the product has no data. */
struct golden_larger {
    struct gsn_tets *mesh;
    struct gsn_dms *space;
    struct gsn_spline *spline;
};

/* gives. */
struct golden_larger golden_enlarge(const struct golden_case *golden);
void golden_larger_done(struct golden_larger *larger);

/* The function of a space with this beta, given as numbers of a table. */
size_t golden_function(const struct gsn_dms *space, const double beta[4]);

#endif
