/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The sections' tissue in fine cells, each plane registered onto the median of those around it.
 * What the searches for swapped sections (swap.c) and the prediction from neighbours (predict.h)
 * work on. */
#ifndef GSN_REGISTER_ORDER_ALIGN_H
#define GSN_REGISTER_ORDER_ALIGN_H

#include "pipeline/register/order/sequence.h"

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

/* What a square of cells says: of the plane at the first place, of that at the second, predicted.
 */
struct gsn_sequence_square {
    double first, second, predicted;
};

/* A shift along x in cells, its change over half the frame along x and y, and the same along y. */
enum { GSN_SEQUENCE_MOTION = 6 };

/* The sections in fine cells, registered onto each other by their tissue. All is the caller's. */
struct gsn_sequence_tissue {
    size_t n, columns, rows;
    const double *z;                       /* n */
    size_t *place;                         /* n: the plane that lies at each place */
    float *value;                          /* n * cells: in shares of the tissue's density */
    float *filled;                         /* as many: as they came, holes filled */
    unsigned char *whole;                  /* as many: where filled was known */
    unsigned char *known;                  /* as many: where value is */
    unsigned char *predictable;            /* cells: where a place is predicted: scratch */
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
int gsn_sequence_register(struct gsn_sequence_tissue *tissue, struct gsn_error *err);
/* Moves the plane at a place anew, onto what lies around it there. */
void gsn_sequence_register_again(struct gsn_sequence_tissue *tissue, size_t place);

/* The median of at most GSN_SEQUENCE_AROUND planes of value, cell by cell. */
void gsn_sequence_median(const struct gsn_sequence_tissue *tissue, const size_t *plane,
                         size_t count, float *ret_median);

/* Densities of two planes that differ by more than this share of the tissue's are no error of
 * registration. */
#define GSN_SEQUENCE_GROSS 0.6
enum { GSN_SEQUENCE_DIFFERENCES = 3 };

/* How planes differ because of how they were registered and stained: by the slopes of what they lie
 * in and by its density, in amounts that change slowly. Told where both sections are known and
 * differ by no more than an edge registered wrong does. */
struct gsn_sequence_modes {
    const float *onto, *gross;
    const unsigned char *known[2];
};
/* Takes what these modes explain from up to GSN_SEQUENCE_DIFFERENCES differences of planes. */
void gsn_sequence_remove_modes(const struct gsn_sequence_tissue *tissue,
                               const struct gsn_sequence_modes *modes, float *const *off,
                               size_t count);
size_t gsn_sequence_modes_size(size_t columns, size_t rows);

#ifdef __cplusplus
}
#endif
#endif
