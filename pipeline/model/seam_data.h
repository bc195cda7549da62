/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A face prepared for its kernels; what seam.c fills and the generated code reads. */
#ifndef GSN_MODEL_SEAM_DATA_H
#define GSN_MODEL_SEAM_DATA_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum {
    GSN_SEAM_MAX_TOP = 3,     /* greatest |g| */
    GSN_SEAM_MAX_KNOTS = 12,  /* 3 (top + 1) */
    GSN_SEAM_MAX_PLANES = 92, /* what top 3 needs */
    GSN_SEAM_MAX_LEAVES = 93,
    GSN_SEAM_MAX_NODES = 58,
    GSN_SEAM_MAX_WEIGHTS = 300,
    GSN_SEAM_MAX_SETS = 19, /* the T_g */
    GSN_SEAM_MAX_POLY = 64, /* coefficients of all jumps, at most (degree 3, top 3) */
};

/* In the axes of the face: x and y in its plane, z along its normal. */
struct gsn_seam_data {
    double origin[3], turn[3][3];
    double bound;                           /* rounding error of any plane value */
    double plane[GSN_SEAM_MAX_PLANES][4];   /* of knot triples: normal, value at the origin */
    double leaf[GSN_SEAM_MAX_LEAVES];       /* 1/|det| of four knots, 0 of flat ones */
    double weight[GSN_SEAM_MAX_WEIGHTS][4]; /* lambda_m(. | W) as affine functions */
    double poly[GSN_SEAM_MAX_POLY];         /* the jumps D_g, monomials by degree */
};

/* Which member of which set of more than four knots a weight belongs to. */
struct gsn_seam_weight {
    uint8_t node, knot;
};

/* The knot sets of one top as tables (seam_kernels.py). Counts are given for faces clear of all
 * clouds and for all of them. */
struct gsn_seam_tables {
    unsigned knots;
    unsigned planes[2], leaves[2], nodes[2], weights[2];
    /* Rows of the determinant of a triple as differences of knots or, numbered after them, of their
     * offsets from their vertices. */
    const int *minuend[2], *subtrahend[2];
    const uint8_t (*triple)[3];
    const uint8_t (*leaf)[4], (*leaf_plane)[4], (*leaf_row)[2];
    const uint16_t *leaf_mask;       /* its knots, a bit each */
    const uint16_t *base, *base_end; /* of a node: the leaves that W may be */
    const struct gsn_seam_weight *weight;
    const uint8_t *corners; /* the plane of X_g */
    /* Of a set, leaves first, then nodes: the weights that lead to it, and the number of the g with
     * T_g, or that of all. */
    const uint16_t *parent, *parent_end;
    const uint8_t *gamma;
};

#ifdef __cplusplus
}
#endif
#endif
