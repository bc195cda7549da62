/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the files of register/sequence.h share: the sections' coarse cells side by side, and the
 * stack as inner products of them, in which every comparison along z is a short sum. */
#ifndef GSN_REGISTER_SEQUENCE_PARTS_H
#define GSN_REGISTER_SEQUENCE_PARTS_H

#include "pipeline/register/sequence.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Sections on either side that a place is judged by: with fewer their grain counts, with more the
 * tissue's curvature does. */
enum { GSN_SEQUENCE_SIDE = 3, GSN_SEQUENCE_AROUND = 2 * GSN_SEQUENCE_SIDE };

/* Up to GSN_SEQUENCE_SIDE sections on either side of place i of n, those at i and j left out. */
size_t gsn_sequence_around(size_t n, size_t i, size_t j, size_t ret_at[GSN_SEQUENCE_AROUND]);

/* A sum of sections with weights: a straight line through those around a place, taken somewhere,
 * or its slope. */
struct gsn_sequence_line {
    size_t count, at[GSN_SEQUENCE_AROUND];
    double weight[GSN_SEQUENCE_AROUND];
};

/* Least squares through the sections around place i without i and j, taken at z; its slope. */
struct gsn_sequence_line gsn_sequence_line_at(const double *z, size_t n, size_t i, size_t j,
                                              double at);
struct gsn_sequence_line gsn_sequence_slope_at(const double *z, size_t n, size_t i, size_t j);
/* Sum of its squared weights: its noise, in sections'. */
double gsn_sequence_line_noise(const struct gsn_sequence_line *line);

/* ---- cells -------------------------------------------------------------------------------- */

struct gsn_sequence_cells {
    size_t n, columns, rows;
    double *z;    /* n */
    float *value; /* n * columns * rows */
    float *next;  /* as many: scratch */
    double *mean; /* columns * rows: scratch */
};

/* Holes are filled from the neighbours, each plane is scaled to a mean of 1. */
void gsn_sequence_gather(const struct gsn_sequence_plane *planes, struct gsn_sequence_cells *cells);
/* Errors of laying and stain are no change of tissue: each plane is brought to its surroundings in
 * those modes, all at once, a few times, as the surroundings have such errors too. */
void gsn_sequence_align(struct gsn_sequence_cells *cells);
/* By (1 2 1) / 4 along both axes, a few times. */
void gsn_sequence_smooth(struct gsn_sequence_cells *cells);

/* ---- the stack ---------------------------------------------------------------------------- */

struct gsn_sequence_stack {
    size_t n;
    const double *z;
    double *gram; /* n * n */
    double *room; /* 2 * n * n + 4 * n: scratch */
};

/* Inner products of all planes. */
void gsn_sequence_multiply(const struct gsn_sequence_cells *cells,
                           struct gsn_sequence_stack *stack);
double gsn_sequence_line_plane(const struct gsn_sequence_stack *s,
                               const struct gsn_sequence_line *line, size_t plane);
double gsn_sequence_line_line(const struct gsn_sequence_stack *s, const struct gsn_sequence_line *a,
                              const struct gsn_sequence_line *b);
/* Squared distance of plane k from the line through its neighbours, as one section's noise. */
double gsn_sequence_off_line(const struct gsn_sequence_stack *s, size_t k);
/* Exchanges two planes for all that follows. */
void gsn_sequence_exchange(struct gsn_sequence_stack *s, size_t i, size_t j);

/* Keeps the few directions in which the stack changes beyond grain (principal components), so that
 * the grain of all the others does not drown it. */
void gsn_sequence_reduce(struct gsn_sequence_stack *s);

/* ---- findings ----------------------------------------------------------------------------- */

/* By the planes' detail, of columns * rows cells. Fails with GSN_E_NOMEM. */
int gsn_sequence_find_duplicates(const struct gsn_sequence_plane *planes, size_t n, size_t columns,
                                 size_t rows, struct gsn_sequence *found, struct gsn_error *err);
/* Of the stack's tissue, after the duplicates. Fails with GSN_E_NOMEM. */
int gsn_sequence_find_swaps(struct gsn_sequence_stack *tissue,
                            const struct gsn_sequence_plane *planes, struct gsn_sequence *found,
                            struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
