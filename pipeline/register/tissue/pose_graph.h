/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Many sections registered by their tissue and their marks: one pose graph, solved together.
 *
 * Each section is compared with the next three; the comparisons are the graph's edges, as stiff as
 * each is certain, and a section with marks is held where its marks say, as firmly as they are
 * known. Then a section between two with marks is as good as its neighbours make it, while beyond
 * the last one errors add up: that is predicted for every section and never hidden.
 *
 * How much a comparison errs is not what its own least squares say, which takes every difference
 * between two sections for noise of single cells: it is told by how far columns of tissue pull it
 * apart, and, where it is more, by what is left around closed ways over one, two and three
 * sections. What no comparison can show is what all columns do alike: a structure that slants or
 * bends as a whole comes out upright and straight, and a shape that changes along z is taken for a
 * motion. */
#ifndef GSN_REGISTER_TISSUE_POSE_GRAPH_H
#define GSN_REGISTER_TISSUE_POSE_GRAPH_H

#include "pipeline/register/tissue/pairwise.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_tissue_section {
    unsigned serial;                 /* rising */
    const struct gsn_tissue *tissue; /* NULL: not there; it is not registered */
    int marked;                      /* whether the following two are known */
    struct gsn_affine to_block;      /* rigid or rigid and mirrored, determinant 1 or -1 */
    double covariance[3][3];         /* shift in x and y at the tissue's centre, and turn, in the
                                        block's frame */
};

struct gsn_tissue_pose {
    int laid;
    struct gsn_affine to_block; /* determinant 1 or -1 */
    double error;     /* predicted, root mean square over its tissue, against what holds */
    unsigned from;    /* sections between it and the nearest held one: 0 when it is held itself */
    double disagrees; /* of a marked section: how far its comparisons with the neighbours would
                         put it elsewhere, as a multiple of what is usual; 0: no comparison */
    int unsure;       /* another rotation or face fits it almost as well: a person should look */
};

struct gsn_tissue_summary {
    size_t held;      /* sections with marks; 0: the section `reference` is held instead */
    size_t reference; /* its index */
    size_t laid, matches, refused; /* refused: comparisons that the others contradict */
    double usual; /* what a comparison with the next section errs by, over its tissue: median */
    double drift; /* of the section predicted worst, its error over the sections from what holds */
};

/* As reference: the middle one of the most sections that hang together. */
#define GSN_TISSUE_MIDDLE ((size_t)-1)

/* Registers all sections. Sections whose marks are stated keep about their place. reference: the
 * index of the section that is held where none has marks, whose tissue the caller guarantees; or
 * GSN_TISSUE_MIDDLE. borrows: everything; ret_poses receives count entries, in the block's frame,
 * or in that of the reference where none has marks. Sections with nothing in common with any other
 * are not registered. Fails with GSN_E_INPUT when serial numbers do not rise; GSN_E_NOMEM. */
int gsn_tissue_register(const struct gsn_tissue_section *sections, size_t count, size_t reference,
                        struct gsn_tissue_pose *ret_poses, struct gsn_tissue_summary *ret_summary,
                        struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
