/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From a mesh and samples to a fitted spline: fit, refine where the fit is poor.
 *
 * A round splits the tetrahedra whose rms residual is above the tolerance and whose samples can
 * carry more unknowns, makes new clouds and fits again from the samples; splitting into four alone
 * would never converge (docs/MATH.md, section 8). A round is taken only if it lowers the error
 * at samples not seen by a thousandth or more (fit.h): noise is not followed. */
#ifndef GSN_MODEL_REFINE_H
#define GSN_MODEL_REFINE_H

#include "pipeline/model/dms.h"
#include "pipeline/model/fit.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_ADAPT_MOST_ROUNDS = 16 };

struct gsn_adapt_options {
    struct gsn_fit_options fit; /* with folds every round chooses its own weight of the jumps */
    unsigned degree;            /* 0: 2 */
    double cloud;               /* radius / smallest altitude, see gsn_dms_clouds(); 0: 0.015 */
    double tolerance;           /* rms residual of a tetrahedron, in the unit of the samples */
    unsigned rounds;            /* of refinement, at most GSN_ADAPT_MOST_ROUNDS; 0: none */
    size_t most_unknowns;       /* that refinement may reach; 0: as many as the samples carry */
    double samples_per_unknown; /* at least; 0: 8 */
    unsigned samples_per_tet;   /* at least, on average, in a new tetrahedron; 0: 20 */
    const struct gsn_progress *progress;
};

enum gsn_adapt_end {
    GSN_ADAPT_WITHIN,   /* every tetrahedron with samples is within the tolerance */
    GSN_ADAPT_SAMPLES,  /* the samples carry no more unknowns */
    GSN_ADAPT_UNKNOWNS, /* most_unknowns is reached */
    GSN_ADAPT_ROUNDS,   /* the rounds are over */
    GSN_ADAPT_NO_GAIN,  /* the last refinement hardly lowered the rms and was not taken */
    GSN_ADAPT_FAILED,   /* the last refinement could not be made; `why` says it */
};

struct gsn_adapt_round {
    size_t tets, unknowns, empty_tets, over_tolerance;
    double rms, worst;
    double predicted; /* rms error at samples not seen */
    int accepted;
};

struct gsn_adapt_report {
    size_t rounds; /* entries of round; the first is the fit before any refinement */
    struct gsn_adapt_round round[GSN_ADAPT_MOST_ROUNDS + 1];
    enum gsn_adapt_end end;
    struct gsn_error why;      /* with GSN_ADAPT_FAILED */
    struct gsn_fit_report fit; /* of the result */
    uint32_t *tet_samples;     /* per tetrahedron of the result; 0: "no data" */
    double *tet_rms;
};
void gsn_adapt_report_done(struct gsn_adapt_report *report);

/* gives: the space, the spline on it (which keeps the space: free it first) and the report, to be
 * ended with gsn_adapt_report_done(). borrows: mesh, the first one.
 *
 * Fails as gsn_fit() does when no first fit can be made, with GSN_E_INPUT on options out of range
 * and with GSN_E_NOMEM at any time; a refinement that fails otherwise ends the rounds and leaves
 * the last good fit. */
int gsn_adapt(const struct gsn_tets *mesh, const struct gsn_samples *samples,
              const struct gsn_adapt_options *options, struct gsn_dms **ret_space,
              struct gsn_spline **ret_spline, struct gsn_adapt_report *ret_report,
              struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
