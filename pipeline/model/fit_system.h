/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The normal equations of a fit as one sparse symmetric matrix, and their solution. */
#ifndef GSN_MODEL_FIT_SYSTEM_H
#define GSN_MODEL_FIT_SYSTEM_H

#include "pipeline/model/dms.h"
#include "pipeline/model/face_jump.h"
#include "pipeline/model/fit.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The samples of a fit, sorted by the tetrahedra they lie in, and what each contributes to the
 * normal equations.
 *
 * In the core of a tetrahedron the spline is one polynomial of that tetrahedron's control points:
 * those samples add to one small dense block. A sample in a seam, where functions of several
 * tetrahedra meet, keeps its row of basis values. Samples are seen in the order of their
 * tetrahedron and, inside it, of their index: every sum is the same for any number of threads. */

struct gsn_fit_rows {
    const struct gsn_dms *space;
    const struct gsn_samples *samples;
    const uint8_t *fold;  /* 0 or 1 for every sample; NULL: all 0 */
    size_t folds;         /* 1 or 2 */
    double mean;          /* of the values; the fit is of the deviations from it */
    size_t inside;        /* samples in the mesh, those that count */
    size_t first_outside; /* when there are others */
    uint32_t *start;      /* tetrahedron t has order[start[t] .. start[t + 1]) */
    uint32_t *order;      /* sample numbers */

    size_t packed;    /* entries of a block: f <= g, row by row */
    double *block[2]; /* of a fold, per tetrahedron: sum w N_f N_g over its core samples */
    double *right[2]; /* and function: sum w N_f (value - mean) */
    double *rough; /* per tetrahedron: integral of grad N_f . grad N_g, in um; filled by the fit */
    double *curvature; /* and what is added to the jumps, likewise; NULL: nothing */
    double mass[2];    /* the weights of a fold's samples: their number when all are 1 */
    double squares[2]; /* sum of w times their targets' squares */

    size_t seams;          /* rows */
    size_t *seam_first;    /* row r has the terms seam_first[r] .. seam_first[r + 1] */
    uint32_t *seam_sample; /* ascending in the order of `order` */
    double *seam_target;   /* value - mean * sum of the row */
    uint32_t *seam_control;
    double *seam_value;
    size_t *seam_of_tet; /* tetrahedron t has the rows seam_of_tet[t] .. seam_of_tet[t + 1] */
};

/* Sorts the samples; of the options fold, threads and forgiving count. Fails with GSN_E_INPUT
 * naming the first sample that is not finite or lies outside the mesh, or when a fold has none,
 * GSN_E_LIMIT on more than 2^31, GSN_E_NOMEM. End with gsn_fit_rows_done() in either case. keeps:
 * space, samples, fold. */
int gsn_fit_rows_sort(struct gsn_fit_rows *rows, const struct gsn_dms *space,
                      const struct gsn_samples *samples, const struct gsn_fit_options *options,
                      struct gsn_error *err);
/* Evaluates the basis at all of them. Fails with GSN_E_NOMEM. */
int gsn_fit_rows_evaluate(struct gsn_fit_rows *rows, unsigned threads, struct gsn_error *err);
/* Other values at the same samples: mean, right sides and squares become theirs. keeps: samples, of
 * the same places and weights. Fails with GSN_E_INPUT naming the first value that is not finite. */
int gsn_fit_rows_aim(struct gsn_fit_rows *rows, const struct gsn_samples *samples, unsigned threads,
                     struct gsn_error *err);
void gsn_fit_rows_done(struct gsn_fit_rows *rows);

struct gsn_fit_residual {
    double squares, mass, worst; /* sum of w times squares, of w, largest absolute value */
};

/* The residuals of each tetrahedron's samples with these control points; ret has room for all. */
int gsn_fit_rows_residuals(const struct gsn_fit_rows *rows, const double *control, unsigned threads,
                           struct gsn_fit_residual *ret, struct gsn_error *err);

/* The gradient penalty of a fit, tetrahedron by tetrahedron.
 *
 * The spline on a tetrahedron is taken as the polynomial it is when all clouds are collapsed:
 * Bernstein form, so that the integral has a closed form. That is off by the relative size of the
 * clouds, in a term that is small by design, and keeps what matters: constants cost nothing. */

/* What does not depend on the tetrahedron: mass[f][k][g][l] is the mean over any tetrahedron of the
 * product of the Bernstein polynomials beta_f - e_k and beta_g - e_l of degree n - 1. */
struct gsn_fit_smooth {
    unsigned degree;
    size_t functions;
    double mass[GSN_DMS_MAX_FUNCTIONS][4][GSN_DMS_MAX_FUNCTIONS][4];
};

void gsn_fit_smooth_init(struct gsn_fit_smooth *smooth, const struct gsn_dms *space);

/* Adds weight * integral grad N_f . grad N_g over tetrahedron tet to block, whose entries f <= g
 * are stored row by row. weight in 1/um. */
void gsn_fit_smooth_add(const struct gsn_fit_smooth *smooth, const struct gsn_tets *mesh,
                        size_t tet, double weight, double *block);

/* Adds weight * integral of the product, entry by entry, of the second derivatives of N_f and N_g
 * over tetrahedron tet to such a block. weight in um. */
void gsn_fit_curvature_add(const struct gsn_dms *space, size_t tet, double weight, double *block);

/* Compressed rows, all of the matrix: row i has the entries first[i] .. first[i + 1], their columns
 * ascending. value and right are what gsn_fit_system_combine() made of the parts. */
struct gsn_fit_system {
    size_t unknowns;
    size_t *first;
    uint32_t *column;
    double *value;
    double *right;
    size_t folds;
    int jumps;                                        /* whether there are any */
    double *fold_value[2], *rough_value, *jump_value; /* parts of value */
    double *fold_right[2];
};

/* Sums blocks and seam rows, fold by fold, the roughness, and, unless jumps is NULL, their G' G
 * with the curvature. Fails with GSN_E_NOMEM; end with gsn_fit_system_done() in either case. */
int gsn_fit_system_assemble(struct gsn_fit_system *system, const struct gsn_fit_rows *rows,
                            const struct gsn_face_jumps *jumps, unsigned threads,
                            struct gsn_error *err);
void gsn_fit_system_done(struct gsn_fit_system *system);
/* The right sides become those of the rows' values; assembling has done so already. */
void gsn_fit_system_aim(struct gsn_fit_system *system, const struct gsn_fit_rows *rows);

/* The equations of the folds with these weights (1 or 0), of roughness and jumps with those. */
void gsn_fit_system_combine(struct gsn_fit_system *system, const double fold[2], double rough,
                            double jump);

/* Sum of squares that these control points leave of a fold's samples whose targets have this sum of
 * squares. */
double gsn_fit_system_squares(const struct gsn_fit_system *system, size_t fold, double squares,
                              const double *x, double *scratch);

/* What makes conjugate gradients quick: the equations around each vertex solved by themselves, all
 * other control points held (additive Schwarz, J. Schoeberl, 1999, 10.1007/s002110050465). The
 * jumps couple what a diagonal would treat one by one. */
struct gsn_fit_patches;

/* gives: which control points belong to each vertex. Fails with GSN_E_NOMEM. */
int gsn_fit_patches_new(const struct gsn_dms *space, struct gsn_fit_patches **ret_patches,
                        struct gsn_error *err);
/* Inverts the part of each vertex of the matrix as last weighed, in single precision. Fails with
 * GSN_E_FIT naming a control point that nothing determines, GSN_E_NOMEM. */
int gsn_fit_patches_invert(struct gsn_fit_patches *patches, const struct gsn_fit_system *system,
                           unsigned threads, struct gsn_error *err);
void gsn_fit_patches_free(struct gsn_fit_patches *patches);
GSN_DEFINE_AUTO(gsn_fit_patches);
/* The sum over the vertices of their inverse times their part of x; ret is not x. */
void gsn_fit_patches_apply(const struct gsn_fit_patches *patches, const double *x, double *ret,
                           unsigned threads);

/* Conjugate gradients from x, preconditioned by the patches, until the residual in the norm of that
 * preconditioner is tolerance times that of 0. Fails with GSN_E_FIT when the iterations do not
 * suffice or the matrix is not positive, and x is then as near as it came: every step lowers the
 * sum that is minimised. Fails with GSN_E_NOMEM, x untouched. */
int gsn_fit_system_solve(const struct gsn_fit_system *system, const struct gsn_fit_patches *patches,
                         double tolerance, unsigned iterations, unsigned threads, double *x,
                         unsigned *ret_iterations, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
