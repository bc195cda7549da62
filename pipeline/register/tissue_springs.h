/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The least squares of tissue_graph.h: sections as nodes, comparisons as springs. Private to it. */
#ifndef GSN_REGISTER_TISSUE_SPRINGS_H
#define GSN_REGISTER_TISSUE_SPRINGS_H

#include "pipeline/register/tissue.h"

#include <stddef.h>

/* Section a on section b, b > a. */
struct gsn_tissue_spring {
    size_t a, b;
    struct gsn_tissue_match match;
    double chi2;   /* of what is left of it, under its covariance times the common factor */
    double weight; /* by its chi2: 1 for one that agrees, towards 0 */
    int dropped;   /* the other face than the two sections have */
};

struct gsn_tissue_node {
    struct gsn_point centre; /* in the section */
    double radius;
    int held;
    struct gsn_affine hold; /* where it is held */
    double holding[3][3];   /* information of that */
    int placed;
    struct gsn_affine to_block;
    double covariance[3][3];
    double error;
};

struct gsn_tissue_springs {
    size_t nodes, springs;
    struct gsn_tissue_node *node;
    struct gsn_tissue_spring *spring;
    double factor; /* by which variances are larger than the curvature says */
};

/* Symmetric and positive: 0, or -1 where it is not. */
int gsn_tissue_invert(double m[3][3]);
/* Solves from the places given; unplaced nodes stay so. Fails with GSN_E_NOMEM. */
int gsn_tissue_relax(struct gsn_tissue_springs *s, struct gsn_error *err);

#endif
