/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The steps of gsn_refine_solve(): sections laid and compared (refine_compare.c), weighed from
 * place to place (refine_even.c) and by spatial frequency (refine_believe.c, refine_waves.c), what
 * is left turned into equations (refine_measure.c), and all moves solved together (refine_joint.c).
 * Private to these files. */
#ifndef GSN_REGISTER_REFINE_PARTS_H
#define GSN_REGISTER_REFINE_PARTS_H

#include "pipeline/core/mem.h"
#include "pipeline/register/refine.h"

enum {
    PARTS = GSN_REFINE_PARTS,
    AROUND = 4, /* sections on either side that one is compared with */
};

/* The lowest harmonics of a square: column frequencies 0..most, row frequencies -most..most. */
struct gsn_waves {
    size_t side, most;
    float *cosine, *sine; /* owned; of 2 pi i / side */
};

int gsn_waves_init(struct gsn_waves *waves, size_t side, size_t most);
void gsn_waves_done(struct gsn_waves *waves);
/* Values of one transform: (most + 1) * (2 most + 1) pairs of real and imaginary part. */
size_t gsn_waves_count(const struct gsn_waves *waves);
/* How many times the i-th pair stands for in the whole plane, and the ring that it lies in; a ring
 * beyond most is none. */
double gsn_waves_times(const struct gsn_waves *waves, size_t i);
size_t gsn_waves_ring(const struct gsn_waves *waves, size_t i);
/* scratch: 2 * side * (most + 1) floats. */
void gsn_waves_of(const struct gsn_waves *waves, const float *plane, float *scratch,
                  float *ret_pairs);
void gsn_waves_back(const struct gsn_waves *waves, const float *pairs, float *scratch,
                    float *ret_plane);

/* What one section's comparison says: information about its move against its neighbours', and that
 * times the move. */
struct gsn_refine_equation {
    double information[PARTS][PARTS], right[PARTS];
};

/* Weights of the sections around the i-th that are there, from i - AROUND on: the value at i of the
 * straight line through them; all 0 where none is. weight[AROUND], its own, is 0. */
void gsn_refine_line(const struct gsn_refine_stack *stack, const int *there, size_t i,
                     double ret_weight[2 * AROUND + 1]);

/* The parts of a move at a cell. */
void gsn_refine_basis(const struct gsn_refine_stack *stack, double x, double y, double ret_x[PARTS],
                      double ret_y[PARTS]);

void gsn_refine_lay(const struct gsn_refine_stack *stack, const float *density,
                    const double move[PARTS], float *ret_laid);
/* Separable, of this standard deviation in cells; what lies beyond the square counts as 0. scratch:
 * as large as the plane. */
void gsn_refine_blur(size_t side, double sigma, float *scratch, float *plane);

/* What a section and its line hold of a ring: of both together, of the line, of the section. */
struct gsn_refine_common {
    double both, line, section, frequencies;
};

struct gsn_refine_compare {
    const struct gsn_refine_stack *stack;
    size_t cells, pairs, rings; /* of a plane, of a transform, and rings 0..rings - 1 */
    struct gsn_waves waves;
    float *taper;
    float *laid, *weight, *filled, *line; /* count planes each; laid: NaN where not known */
    float *off;                           /* count planes: what a vote is held on */
    float *even;  /* count planes: 1 over how far sections usually are off the line there */
    float *wave;  /* count transforms */
    double *room; /* for medians */
    struct gsn_refine_common *common; /* count times rings */
    double (*response)[PARTS];        /* of a section: what its own slopes show of a move */
    double *told, *noise;             /* of a ring: share of the line to believe; power left */
    int *there, *faced;               /* enough is known; has such neighbours on both sides */
    double scale;                     /* of a vote */
    size_t vote;
    const double (*move)[PARTS];
    struct gsn_refine_equation *equation;
};

/* gives; borrows stack. */
int gsn_refine_compare_new(const struct gsn_refine_stack *stack,
                           struct gsn_refine_compare **ret_compare, struct gsn_error *err);
void gsn_refine_compare_free(struct gsn_refine_compare *compare);
GSN_DEFINE_AUTO(gsn_refine_compare);
/* Lays all sections as the moves so far say and compares them. ret_there[i]: whether there is
 * enough of section i. */
int gsn_refine_compare_all(struct gsn_refine_compare *compare, const double (*move)[PARTS],
                           unsigned threads, int *ret_there,
                           struct gsn_refine_equation *ret_equation, double *ret_finest_um,
                           struct gsn_error *err);

/* Learns how unlike the line sections are from place to place. */
int gsn_refine_even(struct gsn_refine_compare *compare, unsigned threads, struct gsn_error *err);

/* Learns what of a line is tissue, and what sections differ from it by. */
int gsn_refine_believe(struct gsn_refine_compare *compare, unsigned threads, struct gsn_error *err);

/* Room of one section's thread. */
struct gsn_refine_room {
    float *plane, *gradient[2], *scratch, *pairs, *column[PARTS];
};

int gsn_refine_room_init(const struct gsn_refine_compare *compare, struct gsn_refine_room *room,
                         struct gsn_error *err);
void gsn_refine_room_done(struct gsn_refine_room *room);
/* Of two pairs, as vectors. */
double gsn_refine_product(const float *a, const float *b);

/* The equations of the sections as they are laid and weighed. */
int gsn_refine_measure(struct gsn_refine_compare *compare, unsigned threads,
                       struct gsn_refine_equation *ret_equation, double *ret_finest_um,
                       struct gsn_error *err);

/* Adds to the moves what all equations and priors together say, learns the two factors, and fills
 * the covariances. */
int gsn_refine_joint(const struct gsn_refine_stack *stack, const int *there,
                     const struct gsn_refine_equation *equation, double (*move)[PARTS],
                     double (*covariance)[PARTS][PARTS], struct gsn_refine_summary *summary,
                     struct gsn_error *err);

#endif
