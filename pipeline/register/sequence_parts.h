/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the files of register/sequence.h share: the sections' cells side by side, and the stack's
 * change along z cell by cell. */
#ifndef GSN_REGISTER_SEQUENCE_PARTS_H
#define GSN_REGISTER_SEQUENCE_PARTS_H

#include "pipeline/register/sequence.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Unlike fminf() these are worked out for several cells at once. */
static inline float gsn_sequence_least(float a, float b)
{
    return a < b ? a : b;
}

static inline float gsn_sequence_greatest(float a, float b)
{
    return a > b ? a : b;
}

static inline float gsn_sequence_clip(float value, float most)
{
    return gsn_sequence_least(gsn_sequence_greatest(value, -most), most);
}

/* Sections on either side that a place is judged by: with fewer their grain counts, with more the
 * tissue's curvature does. */
enum { GSN_SEQUENCE_SIDE = 3, GSN_SEQUENCE_AROUND = 2 * GSN_SEQUENCE_SIDE };

/* Up to GSN_SEQUENCE_SIDE sections on either side of place i of n, those at i and j left out. */
size_t gsn_sequence_around(size_t n, size_t i, size_t j, size_t ret_at[GSN_SEQUENCE_AROUND]);

/* A sum of sections with weights: a straight line through those around a place, taken
 * somewhere. */
struct gsn_sequence_line {
    size_t count, at[GSN_SEQUENCE_AROUND];
    double weight[GSN_SEQUENCE_AROUND];
};

/* Least squares through the sections around place i without i and j, taken at z. */
struct gsn_sequence_line gsn_sequence_line_at(const double *z, size_t n, size_t i, size_t j,
                                              double at);
/* Sum of its squared weights: its noise, in sections'. */
double gsn_sequence_line_noise(const struct gsn_sequence_line *line);

/* ---- cells -------------------------------------------------------------------------------- */

struct gsn_sequence_cells {
    size_t n, columns, rows;
    double *z;    /* n */
    float *value; /* n * columns * rows */
    float *next;  /* as many: scratch */
};

/* Holes are filled from the neighbours, each plane is scaled to a mean of 1. */
void gsn_sequence_gather(const struct gsn_sequence_plane *planes, struct gsn_sequence_cells *cells);
/* By (1 2 1) / 4 along both axes, some times; ends held. */
void gsn_sequence_smooth(float *cells, size_t columns, size_t rows, int times);

/* ---- the tissue's change along z ------------------------------------------------------------ */

/* What a square of cells says: of the plane at the first place, of that at the second, foretold. */
struct gsn_sequence_square {
    double first, second, foretold;
};

/* A shift along x in cells, its change over half the frame along x and y, and the same along y. */
enum { GSN_SEQUENCE_MOTION = 6 };

/* The sections in fine cells, laid onto each other by their tissue. All is the caller's. */
struct gsn_sequence_tissue {
    size_t n, columns, rows;
    const double *z;                       /* n */
    size_t *place;                         /* n: the plane that lies at each place */
    float *value;                          /* n * cells: in shares of the tissue's density */
    float *filled;                         /* as many: as they came, holes filled */
    unsigned char *whole;                  /* as many: where filled was known */
    unsigned char *known;                  /* as many: where value is */
    unsigned char *told;                   /* cells: where a place is foretold: scratch */
    double (*motion)[GSN_SEQUENCE_MOTION]; /* n: from value to filled, in cells */
    float *noise2, *deviation;             /* cells: of one section, and its root */
    float *change, *energy;                /* cells: scratch */
    float *onto, *off, *off_too;           /* cells: scratch */
    struct gsn_sequence_square *square;    /* cells: scratch */
    void *modes;                           /* gsn_sequence_modes_size() bytes: scratch */
};

/* Moves filled onto each other into value: an affine motion of each plane, then what is left along
 * its slopes and of its stain over some hundred um. What grows or shrinks within less stays. Fails
 * with GSN_E_NOMEM. */
int gsn_sequence_lay(struct gsn_sequence_tissue *tissue, struct gsn_error *err);
/* Moves the plane at a place anew, onto what lies around it there. */
void gsn_sequence_lay_again(struct gsn_sequence_tissue *tissue, size_t place);

/* The median of at most GSN_SEQUENCE_AROUND planes of value, cell by cell. */
void gsn_sequence_median(const struct gsn_sequence_tissue *tissue, const size_t *plane,
                         size_t count, float *ret_median);

/* Densities of two planes that differ by more than this share of the tissue's are no error of
 * laying. */
#define GSN_SEQUENCE_GROSS 0.6
enum { GSN_SEQUENCE_DIFFERENCES = 3 };

/* How planes differ because of how they were laid and stained: by the slopes of what they lie in
 * and by its density, in amounts that change slowly. Told where both sections are known and differ
 * by no more than an edge laid wrong does. */
struct gsn_sequence_modes {
    const float *onto, *gross;
    const unsigned char *known[2];
};
/* Takes what these modes explain from up to GSN_SEQUENCE_DIFFERENCES differences of planes. */
void gsn_sequence_take_off(const struct gsn_sequence_tissue *tissue,
                           const struct gsn_sequence_modes *modes, float *const *off, size_t count);
size_t gsn_sequence_modes_size(size_t columns, size_t rows);

/* What the planes of a line foretell of the place that it belongs to, of every step-th cell; of all
 * cells, three on one side are held to their middle. A cell that some of them do not know is the
 * others' on that side: it was filled from beside, and would foretell of what lies there now that
 * it lies right. Clears told where no plane of a side knows it. */
void gsn_sequence_foretell(const struct gsn_sequence_tissue *tissue,
                           const struct gsn_sequence_line *line, size_t place, size_t step,
                           float *ret_value, unsigned char *told);

/* What sets a section apart from the line through its neighbours, cell by cell, in the median.
 * Fails with GSN_E_NOMEM. */
int gsn_sequence_learn_noise(struct gsn_sequence_tissue *tissue, struct gsn_error *err);

/* The change from the plane at place i to that at place j, i < j, along the change that the
 * sections around foretell, both in standard errors. In each other's places the two would show
 * the contrary. Errors are told from what squares of cells say each for itself; nothing is shown
 * and nothing foretold where all rests on a few of them. */
struct gsn_sequence_change {
    double shown, foretold;
    double first, second; /* how far the one lies before the middle, and the other behind it */
};
struct gsn_sequence_change gsn_sequence_change_between(const struct gsn_sequence_tissue *tissue,
                                                       size_t i, size_t j);

/* ---- findings ----------------------------------------------------------------------------- */

/* Swaps, duplicates, those of which one is held; the surest first within each kind. */
void gsn_sequence_sort(struct gsn_sequence *sequence);

/* Fails with GSN_E_NOMEM. */
int gsn_sequence_find_duplicates(const struct gsn_sequence_plane *planes, size_t n, size_t columns,
                                 size_t rows, struct gsn_sequence *found, struct gsn_error *err);
/* Of the stack's tissue; sections that are out are in no swap. Fails with GSN_E_NOMEM. */
int gsn_sequence_find_swaps(struct gsn_sequence_tissue *tissue,
                            const struct gsn_sequence_plane *planes, const char *out,
                            struct gsn_sequence *found, struct gsn_error *err);

/* Of every section that was found there twice the first mount, or the second. */
void gsn_sequence_leave_out(const struct gsn_sequence_plane *planes,
                            const struct gsn_sequence *found, int second, char *ret_out, size_t n);
/* Whether both mounts of every such section lie side by side, and in none of the swaps found with
 * one of them left out. Else either may be the one that lies wrong. */
int gsn_sequence_is_settled(const struct gsn_sequence_plane *planes,
                            const struct gsn_sequence *found);
/* Of the swaps found with the one mount and those with the other left out those stand that bring
 * the two together, and those found both ways that do not part them. room: of as many findings as
 * both have. */
void gsn_sequence_agree(const struct gsn_sequence_plane *planes, const struct gsn_sequence *other,
                        struct gsn_sequence *found, char *room);

#ifdef __cplusplus
}
#endif
#endif
