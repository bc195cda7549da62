/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The inner loops of spline evaluation, for several points at once, one version per instruction
 * set. All versions give the same bits (simd.h). */
#ifndef GSN_MODEL_KERNELS_H
#define GSN_MODEL_KERNELS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_isa { GSN_ISA_SCALAR, GSN_ISA_AVX2, GSN_ISA_AVX512, GSN_ISA_COUNT };

enum { GSN_MAX_SIMD_WIDTH = 8 };

/* What a seam kernel computes: the sum, the sum and its gradient, or one number per T_g. */
enum gsn_face_correction_kind {
    GSN_FACE_CORRECTION_VALUE,
    GSN_FACE_CORRECTION_SLOPE,
    GSN_FACE_CORRECTION_WEIGHTS,
    GSN_FACE_CORRECTION_KINDS
};

struct gsn_face_correction_data;

/* One group of points, their coordinates in x, y and z, against one prepared face. ret has a row of
 * lanes per number. Returns a bit per lane that lies too near a knot plane for its side to be
 * certain; what ret has there is void. fixed is NULL but in the careful version
 * (face_correction.c). */
typedef unsigned gsn_face_correction_kernel(const struct gsn_face_correction_data *data,
                                            const double *x, const double *y, const double *z,
                                            double *ret, const double *fixed);

struct gsn_face_correction_choice {
    gsn_face_correction_kernel *run;
    unsigned flops; /* per point, a fused multiply-add counting 2 */
};

/* Half-spaces as rows of voxels along x see them: row (y, z) crosses the plane of one at voxel
 * at + y (y - origin[0]) + z (z - origin[1]). */
struct gsn_lines {
    unsigned count;
    double at[GSN_MAX_SIMD_WIDTH], y[GSN_MAX_SIMD_WIDTH], z[GSN_MAX_SIMD_WIDTH];
};

/* A convex body: rows lie in it from the greatest of the lines of low to the least of high. */
struct gsn_convex_body {
    struct gsn_lines low, high;
};

/* Two bodies, one inside the other. */
struct gsn_bodies {
    double origin[2];
    double range[2]; /* of voxels to consider, first and last */
    struct gsn_convex_body outer, inner;
};

enum { GSN_MOST_ROWS = 256 };

/* Rows that meet the outer body: their numbers in y and z, where they meet the bodies, from low,
 * inclusive, to high. The inner part may be empty. */
struct gsn_rows {
    size_t count;
    int32_t y[GSN_MOST_ROWS + GSN_MAX_SIMD_WIDTH], z[GSN_MOST_ROWS + GSN_MAX_SIMD_WIDTH];
    int32_t low[GSN_MOST_ROWS + GSN_MAX_SIMD_WIDTH], high[GSN_MOST_ROWS + GSN_MAX_SIMD_WIDTH];
    int32_t inner_low[GSN_MOST_ROWS + GSN_MAX_SIMD_WIDTH],
        inner_high[GSN_MOST_ROWS + GSN_MAX_SIMD_WIDTH];
};

/* A polynomial on rows of voxels. Its variables are, at voxel x of row (y, z),
 * at + x[.] x + y[.] (y - origin[0]) + z[.] (z - origin[1]). */
struct gsn_paint {
    double coefficient[20]; /* in the order of gsn_simplex_place() for (n-a-b-c, a, b, c) */
    double origin[2];
    double at[3], x[3], y[3], z[3];
};

struct gsn_kernels {
    const char *name;
    unsigned lanes;
    /* By kind, degree (0 for weights), greatest |g|, and the unclear clouds, a bit each. */
    struct gsn_face_correction_choice seam[GSN_FACE_CORRECTION_KINDS][4][4][8];
    /* The rows that meet the outer body, of those with these y and z, ys zs <= GSN_MOST_ROWS; in
     * the order of z, then y. */
    void (*rows)(const struct gsn_bodies *bodies, const double *y, size_t ys, const double *z,
                 size_t zs, struct gsn_rows *ret_rows);
    /* Writes a polynomial into the voxels from low to high of rows, by degree. Row (y, z) of those
     * with these y and z begins at ret_value[y stride[0] + z stride[1]]. */
    void (*paint[4])(const struct gsn_paint *paint, const double *y, const double *z,
                     const struct gsn_rows *rows, const size_t stride[2], double *ret_value);
    /* The values of a polynomial sum c_{abc} p^a q^b r^c, coefficients in the order of
     * gsn_simplex_place() for (n-a-b-c, a, b, c), at (p[i], q[i], r[i]); and unless ret_slope is
     * NULL its derivatives with respect to p, q and r; by degree. */
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

/* A face prepared for its kernels; what face_correction.c fills and the generated code reads. */

enum {
    GSN_FACE_CORRECTION_MAX_TOP = 3,     /* greatest |g| */
    GSN_FACE_CORRECTION_MAX_KNOTS = 12,  /* 3 (top + 1) */
    GSN_FACE_CORRECTION_MAX_PLANES = 92, /* what top 3 needs */
    GSN_FACE_CORRECTION_MAX_LEAVES = 93,
    GSN_FACE_CORRECTION_MAX_NODES = 58,
    GSN_FACE_CORRECTION_MAX_WEIGHTS = 300,
    GSN_FACE_CORRECTION_MAX_SETS = 19, /* the T_g */
    GSN_FACE_CORRECTION_MAX_POLY = 64, /* coefficients of all jumps, at most (degree 3, top 3) */
};

/* In the axes of the face: x and y in its plane, z along its normal. */
struct gsn_face_correction_data {
    double origin[3], turn[3][3];
    double bound; /* rounding error of any plane value */
    double plane[GSN_FACE_CORRECTION_MAX_PLANES]
                [4];                             /* of knot triples: normal, value at the origin */
    double leaf[GSN_FACE_CORRECTION_MAX_LEAVES]; /* 1/|det| of four knots, 0 of flat ones */
    double weight[GSN_FACE_CORRECTION_MAX_WEIGHTS][4]; /* lambda_m(. | W) as affine functions */
    double poly[GSN_FACE_CORRECTION_MAX_POLY];         /* the jumps D_g, monomials by degree */
};

/* Which member of which set of more than four knots a weight belongs to. */
struct gsn_face_correction_weight {
    uint8_t node, knot;
};

/* The knot sets of one top as tables (face_correction_kernels.py). Counts are given for faces clear
 * of all clouds and for all of them. */
struct gsn_face_correction_tables {
    unsigned knots;
    unsigned planes[2], leaves[2], nodes[2], weights[2];
    /* Rows of the determinant of a triple as differences of knots or, numbered after them, of their
     * offsets from their vertices. */
    const int *minuend[2], *subtrahend[2];
    const uint8_t (*triple)[3];
    const uint8_t (*leaf)[4], (*leaf_plane)[4], (*leaf_row)[2];
    const uint16_t *leaf_mask;       /* its knots, a bit each */
    const uint16_t *base, *base_end; /* of a node: the leaves that W may be */
    const struct gsn_face_correction_weight *weight;
    const uint8_t *corners; /* the plane of X_g */
    /* Of a set, leaves first, then nodes: the weights that lead to it, and the number of the g with
     * T_g, or that of all. */
    const uint16_t *parent, *parent_end;
    const uint8_t *gamma;
};

/* The versions of kernels_isa.c. Ask gsn_kernels_for(), which knows what the processor can do. */

extern const struct gsn_kernels gsn_kernels_scalar, gsn_kernels_avx2, gsn_kernels_avx512,
    gsn_kernels_with_care;

#ifdef __cplusplus
}
#endif
#endif
