/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The inner loops of spline evaluation, for several points at once, one version per instruction
 * set. All versions give the same bits (lanes.h). */
#ifndef GSN_MODEL_KERNELS_H
#define GSN_MODEL_KERNELS_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_isa { GSN_ISA_SCALAR, GSN_ISA_AVX2, GSN_ISA_AVX512, GSN_ISA_COUNT };

enum { GSN_MOST_LANES = 8 };

/* What a seam kernel computes: the sum, the sum and its gradient, or one number per T_g. */
enum gsn_seam_kind { GSN_SEAM_VALUE, GSN_SEAM_SLOPE, GSN_SEAM_WEIGHTS, GSN_SEAM_KINDS };

struct gsn_seam_data;

/* One group of points, their coordinates in x, y and z, against one prepared face. ret has a row of
 * lanes per number. Returns a bit per lane that lies too near a knot plane for its side to be
 * certain; what ret has there is void. fixed is NULL but in the careful version (seam.c). */
typedef unsigned gsn_seam_kernel(const struct gsn_seam_data *data, const double *x, const double *y,
                                 const double *z, double *ret, const double *fixed);

struct gsn_seam_choice {
    gsn_seam_kernel *run;
    unsigned flops; /* per point, a fused multiply-add counting 2 */
};

/* A polynomial sum c_{abc} p^a q^b r^c of three variables: coefficients in the order of
 * gsn_simplex_place() for (n-a-b-c, a, b, c). */
struct gsn_kernels {
    const char *name;
    unsigned lanes;
    /* By kind, degree (0 for weights), greatest |g|, and the unclear clouds, a bit each. */
    struct gsn_seam_choice seam[GSN_SEAM_KINDS][4][4][8];
    /* Its values at start + i step, i = 0..count - 1, by degree. */
    void (*run[4])(const double *coefficient, const double start[3], const double step[3],
                   size_t count, double *ret_value);
    /* Its values at (p[i], q[i], r[i]), and unless ret_slope is NULL its derivatives with respect
     * to p, q and r. */
    void (*points[4])(const double *coefficient, const double *const at[3], size_t count,
                      double *ret_value, double *const ret_slope[3]);
};

/* borrowed, for ever: NULL where the processor or this build lacks the instructions. */
const struct gsn_kernels *gsn_kernels_for(enum gsn_isa isa);
/* borrowed: the fastest there is. */
const struct gsn_kernels *gsn_kernels_best(void);

/* The careful version of the scalar kernels, complete but for the plane values, which come from
 * fixed. Flops are not told. */
const struct gsn_kernels *gsn_kernels_careful(void);

#ifdef __cplusplus
}
#endif
#endif
