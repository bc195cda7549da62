/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The weights of gsn_refine_solve()'s comparison (refine.c): from place to place, and by spatial
 * frequency. Private to these two files. */
#ifndef GSN_REGISTER_TISSUE_REFINE_WEIGHTS_H
#define GSN_REGISTER_TISSUE_REFINE_WEIGHTS_H

#include "pipeline/core/mem.h"
#include "pipeline/register/tissue/refine.h"

enum {
    PARTS = GSN_REFINE_PARTS,
    AROUND = 4, /* sections on either side that one is compared with */
};

/* The lowest harmonics of a square: column frequencies 0..most, row frequencies -most..most. */
struct gsn_refine_dft {
    size_t side, most;
};

/* Values of one transform: (most + 1) * (2 most + 1) pairs of real and imaginary part. */
size_t gsn_refine_dft_count(const struct gsn_refine_dft *dft);
/* How many times the i-th pair stands for in the whole plane, and the ring that it lies in; a ring
 * beyond most is none. */
double gsn_refine_dft_times(const struct gsn_refine_dft *dft, size_t i);
size_t gsn_refine_dft_ring(const struct gsn_refine_dft *dft, size_t i);
/* scratch: 2 * side * side floats. Fail as gsn_fourier() does. */
int gsn_refine_dft_forward(const struct gsn_refine_dft *dft, const float *plane, float *scratch,
                           float *ret_pairs, struct gsn_error *err);
int gsn_refine_dft_inverse(const struct gsn_refine_dft *dft, const float *pairs, float *scratch,
                           float *ret_plane, struct gsn_error *err);

/* What one section's comparison says: information about its move against its neighbours', and that
 * times the move. */
struct gsn_refine_equation {
    double information[PARTS][PARTS], right[PARTS];
};

/* What a section and its line hold of a ring: of both together, of the line, of the section. */
struct gsn_refine_common {
    double both, line, section, frequencies;
};

struct gsn_refine_comparison {
    const struct gsn_refine_stack *stack;
    size_t cells, pairs, rings; /* of a plane, of a transform, and rings 0..rings - 1 */
    struct gsn_refine_dft dft;
    float *taper;
    float *placed, *weight, *filled, *line; /* count planes each; placed: NaN where not known */
    float *off;                             /* count planes: what a vote is held on */
    float *local; /* count planes: 1 over how far sections usually are off the line there */
    float *wave;  /* count transforms */
    double *room; /* for medians */
    struct gsn_refine_common *common; /* count times rings */
    double (*response)[PARTS];        /* of a section: what its own slopes show of a move */
    double *coherence, *noise;        /* of a ring: share of the line that is tissue; power left */
    int *there, *flanked;             /* enough is known; has such neighbours on both sides */
    double scale;                     /* of a vote */
    size_t vote;
    const double (*move)[PARTS];
    struct gsn_refine_equation *equation;
};

/* Learns how unlike the line sections are from place to place. */
int gsn_refine_normalise_locally(struct gsn_refine_comparison *compare, unsigned threads,
                                 struct gsn_error *err);

/* Learns what of a line is tissue, and what sections differ from it by. */
int gsn_refine_learn_coherence(struct gsn_refine_comparison *compare, unsigned threads,
                               struct gsn_error *err);

/* Room of one section's thread. */
struct gsn_refine_buffers {
    float *plane, *gradient[2], *scratch, *pairs, *column[PARTS];
};

int gsn_refine_buffers_init(const struct gsn_refine_comparison *compare,
                            struct gsn_refine_buffers *room, struct gsn_error *err);
void gsn_refine_buffers_done(struct gsn_refine_buffers *room);
/* Of two pairs, as vectors. */
double gsn_refine_product(const float *a, const float *b);

#endif
