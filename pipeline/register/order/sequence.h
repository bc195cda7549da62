/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether the sections lie in the order of their numbers, by their tissue.
 *
 * Tissue changes little from one section to the next. Two that lie in each other's places are each
 * more like those around the other's place than like those around their own. What share of
 * swaps would show is told from what the stack's own sections show.
 *
 * A section that is there twice shares with its second mount the texture that neighbours do not
 * share. It is compared half a millimetre at a time, each piece where it fits best, since every
 * mount stretches and warps a section anew. Where neighbours share nearly all, there is no such
 * texture, and nothing is proposed. One of the two may be a section that is excluded, since nothing
 * registers it: it still has its texture.
 *
 * What is found is a proposal for a person, never an action: nothing is moved in z. Which of the
 * last two at either end is the last cannot be told, and a section that was lost while the numbers
 * were closed up over it is not looked for: gaps are known from the slots. */
#ifndef GSN_REGISTER_ORDER_SEQUENCE_H
#define GSN_REGISTER_ORDER_SEQUENCE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Side of the cells: the rims of spaces move by some 10 um from one section to the next, and two
 * mounts share texture as fine as this. */
#define GSN_SEQUENCE_CELL_UM (100.0 / 3)

enum { GSN_SEQUENCE_NEAR = 3 };

/* One registered section: columns * rows densities row by row; 0 on glass, NaN where nothing is
 * known. */
struct gsn_sequence_plane {
    unsigned serial;
    const float *density;
};

enum gsn_sequence_kind {
    GSN_SEQUENCE_SWAP,               /* a's tissue belongs where b is, and b's where a is */
    GSN_SEQUENCE_DUPLICATE,          /* a and b are one section, scanned or mounted twice */
    GSN_SEQUENCE_EXCLUDED_DUPLICATE, /* the same of two of which one is not registered, or both are
                                        not */
};

struct gsn_sequence_finding {
    enum gsn_sequence_kind kind;
    unsigned a, b;   /* serial numbers, as given */
    double evidence; /* by how many standard errors both are more like those around the other's
                        place; of a duplicate the share of their texture that both have in common,
                        where one is excluded of the best quarter of it */
    double usual;    /* share of their texture that neighbours have in common, likewise */
    int held[2];     /* of a duplicate: whether a is not registered, and b */
};

struct gsn_sequence {
    size_t count;
    struct gsn_sequence_finding *finding; /* owned; the surest first within each kind */
    double shown[GSN_SEQUENCE_NEAR]; /* share of swaps of sections 1, 2, 3 apart that would show */
    unsigned reach; /* 19 of 20 swaps of two sections show from this many apart on; 1: neighbours',
                       too, 0: from no distance */
    double unseen;  /* the most that a swap which does not show carries from one place to the
                       other, as a share of all sections' density */
    int duplicates_known; /* whether sections have texture of their own by which two mounts of one
                       would be known */
};

/* gives: planes in order of their serial numbers. Fewer than 8 planes tell nothing. borrows:
 * everything. Fails with GSN_E_INPUT when serial numbers do not rise;
 * GSN_E_NOMEM. */
int gsn_sequence_examine(const struct gsn_sequence_plane *planes, size_t count, size_t columns,
                         size_t rows, struct gsn_sequence **ret_sequence, struct gsn_error *err);

/* One section that is not registered, as it lies on its slide: densities as of a plane, in cells of
 * its own. */
struct gsn_sequence_excluded {
    unsigned serial;
    size_t columns, rows;
    double side; /* of its cells, in the planes' cells: at most 1 */
    const float *density;
};

/* Adds to what gsn_sequence_examine() found of the same planes: sections that are not registered,
 * compared with the three numbers on either side, registered or not. Each is registered on the
 * other by their tissue; of a folded one it may be one side alone that comes to lie right, so the
 * best quarter of the texture counts, as of this stack's neighbours. Too little in common is no
 * finding. borrows: everything. Fails with GSN_E_NOMEM. */
int gsn_sequence_examine_excluded(const struct gsn_sequence_plane *planes, size_t count,
                                  size_t columns, size_t rows,
                                  const struct gsn_sequence_excluded *held, size_t held_count,
                                  struct gsn_sequence *sequence, struct gsn_error *err);
void gsn_sequence_free(struct gsn_sequence *sequence);
GSN_DEFINE_AUTO(gsn_sequence);

#ifdef __cplusplus
}
#endif
#endif
