/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether the tissue of its neighbours bears out where its marks put a section.
 *
 * Spots that happen to lie like the marks put a section with confidence in a wrong place, or
 * with the wrong face, and no residual shows it. So each section is registered once more by its
 * tissue on up to four neighbours: first around the place that its marks give and, where it then
 * fits worse or lies farther off than the stack's other sections do, at all rotations and on both
 * faces. Another place takes over only where it fits clearly better. What remains between the place
 * that the neighbours agree on and that of the marks is compared with what is usual in this stack
 * and against how far the neighbours agree. Lengths are the caller's. */
#ifndef GSN_REGISTER_TISSUE_POSE_CHECK_H
#define GSN_REGISTER_TISSUE_POSE_CHECK_H

#include "pipeline/register/tissue/pose_graph.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_tissue_finding {
    unsigned compared; /* neighbours with which it was; 0: nothing is told */
    int contradicted;  /* by most of them */
    int other_face;    /* then: whether they put it on the other face */
    double apart;      /* between their place and the marks', root mean square over its tissue */
    double limit;      /* what is beyond it happens to one good section in a million */
};

/* Looks at every section that is marked and has tissue, against those of them that are at most four
 * serial numbers away. A stack of which fewer than six can be compared shows nothing usual, and
 * nothing is told. borrows: everything; ret_findings receives count entries. Fails with GSN_E_INPUT
 * when serial numbers do not rise; GSN_E_NOMEM. */
int gsn_tissue_check(const struct gsn_tissue_section *sections, size_t count,
                     struct gsn_tissue_finding *ret_findings, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
