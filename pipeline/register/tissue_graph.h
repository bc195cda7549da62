/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Many sections laid by tissue, solved together.
 *
 * Each section is compared with the next and with the one after it; the comparisons are springs
 * between the sections, as stiff as each is certain, and the sections with marks are held where
 * their marks say. Then a section between two with marks is as good as its two neighbours make it,
 * while beyond the last one errors add up: that drift is predicted for every section and never
 * hidden. How much the comparisons err is measured where they contradict each other or the marks.
 * What they cannot show is a structure that slants through the whole stack: without any marks it
 * comes out upright. */
#ifndef GSN_REGISTER_TISSUE_GRAPH_H
#define GSN_REGISTER_TISSUE_GRAPH_H

#include "pipeline/register/tissue.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_tissue_section {
    unsigned serial;                 /* rising */
    const struct gsn_tissue *tissue; /* NULL: not there; it is not laid */
    int marked;                      /* whether the following two are known */
    struct gsn_affine to_block;      /* rigid or rigid and mirrored, determinant 1 or -1 */
    double covariance[3][3];         /* shift in x and y at the tissue's centre, and turn, in the
                                        block's frame */
};

struct gsn_tissue_pose {
    int laid;
    struct gsn_affine to_block; /* determinant 1 or -1 */
    double error;               /* predicted, root mean square over its tissue */
    unsigned from;    /* sections between it and the nearest held one: 0 when it is held itself */
    double disagrees; /* of a marked section: how far its comparisons with the neighbours would
                         lay it elsewhere, as a multiple of what is usual; 0: no comparison */
    int unsure;       /* another rotation or face fits it almost as well: a person should look */
};

struct gsn_tissue_summary {
    size_t held;      /* sections with marks; 0: the section `reference` is held instead */
    size_t reference; /* its index: the middle one of the most that hang together */
    size_t laid, matches, refused; /* refused: comparisons that the others contradict */
    double usual; /* what a comparison errs by, over its tissue: root mean square */
    double drift; /* what two sections further adds beyond chance, as one section's share: errors
                     of this size do not average out, they add up with the distance */
};

/* Lays all sections. Sections whose marks are stated keep about their place. borrows: everything;
 * ret_poses receives count entries, in the block's frame, or in that of the reference section where
 * none has marks. Sections with nothing in common with any other are not laid. Fails with
 * GSN_E_INPUT when serial numbers do not rise; GSN_E_NOMEM. */
int gsn_tissue_lay(const struct gsn_tissue_section *sections, size_t count,
                   struct gsn_tissue_pose *ret_poses, struct gsn_tissue_summary *ret_summary,
                   struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
