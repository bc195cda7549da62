/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether the sections lie in the order of their numbers, by their tissue.
 *
 * Tissue changes little from one section to the next, so a section fits best between its true
 * neighbours: it is compared with the straight line through the sections around each place, itself
 * left out. All is done on coarse planes in the block frame (cells of some 100 um, many sections'
 * texture averaged out), scaled to one mean, so that stain does not matter. How far apart two
 * sections must be for a swap of them to show is measured on the stack itself.
 *
 * A section that is there twice shares with its second mount the texture that neighbours do not
 * share. It is compared half a millimetre at a time, each piece where it fits best, since every
 * mount stretches and warps a section anew. Where neighbours share nearly all, there is no such
 * texture, and nothing is proposed.
 *
 * What is found is a proposal for a person, never an action: nothing is moved in z. Which of the
 * last two at either end is the last cannot be told, and a section that was lost while the numbers
 * were closed up over it is not looked for: gaps are known from the slots. */
#ifndef GSN_REGISTER_SEQUENCE_H
#define GSN_REGISTER_SEQUENCE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_SEQUENCE_FINER = 3 };

/* One laid section: columns * rows densities row by row; 0 on glass, NaN where nothing is known.
 * detail: the same in GSN_SEQUENCE_FINER times as many columns and rows. */
struct gsn_sequence_plane {
    unsigned serial;
    const float *density, *detail;
};

enum gsn_sequence_kind {
    GSN_SEQUENCE_SWAP,      /* a's tissue belongs where b is, and b's where a is */
    GSN_SEQUENCE_DUPLICATE, /* a and b are one section, scanned or mounted twice */
};

struct gsn_sequence_finding {
    enum gsn_sequence_kind kind;
    unsigned a, b;   /* serial numbers, as given */
    double evidence; /* logarithm of the likelihood ratio against the order as numbered; of a
                        duplicate the share of their texture that both have in common */
    double smoother; /* share of the roughness along z around both that a swap would take away */
    double usual;    /* share of their texture that neighbours have in common */
};

struct gsn_sequence {
    size_t count;
    struct gsn_sequence_finding *finding; /* owned; the surest first within each kind */
    double change;  /* from one section to the next, over the noise of one: root mean square */
    unsigned reach; /* a swap of two sections shows from this many apart on; 1: neighbours', too,
                       0: no swap shows */
    double unseen;  /* the most that a swap which does not show carries from one place to the
                       other, as a share of all sections' density */
    int twice_told; /* whether sections have texture of their own by which two mounts of one would
                       be known */
};

/* gives: planes in order of their serial numbers. Fewer than 8 planes tell nothing. borrows:
 * everything. Fails with GSN_E_INPUT when serial numbers do not rise;
 * GSN_E_NOMEM. */
int gsn_sequence_examine(const struct gsn_sequence_plane *planes, size_t count, size_t columns,
                         size_t rows, struct gsn_sequence **ret_sequence, struct gsn_error *err);
void gsn_sequence_free(struct gsn_sequence *sequence);
GSN_DEFINE_AUTO(gsn_sequence);

#ifdef __cplusplus
}
#endif
#endif
