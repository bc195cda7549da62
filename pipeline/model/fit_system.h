/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The normal equations of a fit as one sparse symmetric matrix, and their solution. */
#ifndef GSN_MODEL_FIT_SYSTEM_H
#define GSN_MODEL_FIT_SYSTEM_H

#include "pipeline/model/fit_rows.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Compressed rows, all of the matrix: row i has the entries first[i] .. first[i + 1], their columns
 * ascending. */
struct gsn_fit_system {
    size_t unknowns;
    size_t *first;
    uint32_t *column;
    double *value;
    double *right;
};

/* Sums blocks and seam rows. Fails with GSN_E_NOMEM; end with gsn_fit_system_done() in either
 * case. */
int gsn_fit_system_assemble(struct gsn_fit_system *system, const struct gsn_fit_rows *rows,
                            unsigned threads, struct gsn_error *err);
void gsn_fit_system_done(struct gsn_fit_system *system);

/* Conjugate gradients from 0, preconditioned by the diagonal, until the residual in the norm of
 * that preconditioner is tolerance times its first. Fails with GSN_E_FIT when the iterations do
 * not suffice or the matrix is not positive, with GSN_E_NOMEM; x, of unknowns values, is then
 * undefined. */
int gsn_fit_system_solve(const struct gsn_fit_system *system, double tolerance, unsigned iterations,
                         double *x, unsigned *ret_iterations, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
