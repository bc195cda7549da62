/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Sections registered by their marks, moved on by what their tissue has in common with its
 * neighbours'.
 *
 * Marks that lie far from the region say where it is to many um, independently from section to
 * section; tissue says how a section lies against its neighbours, but not whether the block slants.
 * Both together: the marks' pose, with its covariance, is each section's prior, and what a section
 * is compared with is the straight line through up to four sections on either side, which a slant
 * passes unchanged. All sections' moves are solved together. A move is affine,
 *     d(x) = B(u) m,   u = (x - centre) / unit,   B = [1 0 -v u u v; 0 1 u v -v u],
 * (shift x, shift y, turn, common stretch, x against y, shear; all in um at the unit's distance),
 * and says how far right and down of its place the pose shows the tissue.
 *
 * The comparison is least squares in the low spatial frequencies, each weighed by what neighbours
 * share in it and by what is left, there and from place to place; cells that fit no neighbour are
 * voted down. How far sections answer to a move, and what the errors of the marks and of the
 * comparisons are worth, is learnt from all sections together. How a section is bent beyond its
 * move is not followed, but is part of the printed error. */
#ifndef GSN_REGISTER_TISSUE_REFINE_H
#define GSN_REGISTER_TISSUE_REFINE_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_REFINE_PARTS = 6 };

struct gsn_refine_section {
    unsigned serial;
    const float *density; /* side x side cells, rows one after the other, as the pose places
                             them; NaN: not known. NULL: the section is not there */
    double prior[GSN_REFINE_PARTS][GSN_REFINE_PARTS]; /* covariance of its move, um2 */
};

/* A square about the region's centre. */
struct gsn_refine_stack {
    struct gsn_point centre; /* block um */
    double cell_um, unit_um;
    double bent_um2; /* variance per axis by which sections are bent as no move can follow; >= 0 */
    size_t side, count;
    const struct gsn_refine_section *section; /* in the order of their serial numbers, each once */
};

struct gsn_refined {
    int compared; /* 0: its tissue says nothing, and the prior is all there is */
    double move[GSN_REFINE_PARTS];
    double covariance[GSN_REFINE_PARTS][GSN_REFINE_PARTS];
};

struct gsn_refine_summary {
    size_t compared;
    double prior_factor;      /* the marks' variances are so many times what was stated, */
    double comparison_factor; /* and those of the comparisons; neither is below 1 */
    double finest_um;         /* wavelength to which neighbours have something in common; 0: none */
};

/* borrows: stack. ret_refined receives count entries. The result does not depend on threads (0:
 * all). Fails with GSN_E_INPUT when the square has fewer than 16 cells a side, the cell or the unit
 * is no length, bent_um2 is no variance, serial numbers do not rise or a prior is no covariance;
 * GSN_E_NOMEM. */
int gsn_refine_solve(const struct gsn_refine_stack *stack, unsigned threads,
                     struct gsn_refined *ret_refined, struct gsn_refine_summary *ret_summary,
                     struct gsn_error *err);

/* The map from the block as the pose has it to the block as it is. */
struct gsn_affine gsn_refine_map(const struct gsn_refine_stack *stack,
                                 const double move[GSN_REFINE_PARTS]);

#ifdef __cplusplus
}
#endif
#endif
