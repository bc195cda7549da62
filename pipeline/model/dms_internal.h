/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the files of the spline model share behind dms.h. */
#ifndef GSN_MODEL_DMS_INTERNAL_H
#define GSN_MODEL_DMS_INTERNAL_H

#include "pipeline/model/sorted_batch.h"
#include "pipeline/model/bvh.h"
#include "pipeline/model/dms.h"
#include "pipeline/model/barycentric.h"
#include "pipeline/model/kernels.h"
#include "pipeline/model/simplex_spline.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_DMS_ALL = 15 }; /* all four corners of a tetrahedron, a bit each */

/* Slack of tests made in floating point barycentric coordinates. They only decide what need not be
 * computed, so they lean to the side of computing; the exact signs decide the rest. */
#define GSN_DMS_SLACK 1e-11

/* A tetrahedron and how far its knots reach, in its own barycentric coordinates: low[k] is the
 * least lambda_k of all knots, high[k] the greatest of the knots of the other three corners, the
 * delta_k of docs/MATH.md. Beyond low the functions vanish, beyond all of high is the core. */
struct gsn_dms_shape {
    struct gsn_barycentric frame;
    double low[4], high[4];
};

/* What is kept of it: low rounded down, high rounded up. */
struct gsn_dms_reach {
    float low[4], high[4];
};

/* Beside the mesh and the control points there are, per tetrahedron, 4 bytes for each function, 45
 * bytes and its share of the knots. Whatever a recurrence needs beyond that is quickly made again
 * from the knots. */
struct gsn_dms {
    struct gsn_tets *mesh;
    unsigned degree;
    enum gsn_dms_sharing sharing;
    const struct gsn_kernels *kernels;
    size_t controls;
    struct gsn_simplex_sets *sets;
    double (*knot)[3];
    uint32_t *id;                /* functions per tetrahedron */
    struct gsn_dms_reach *reach; /* per tetrahedron */
    struct gsn_bvh *tree;        /* of the boxes around the knots of each tetrahedron */
    /* Per tetrahedron: all functions sum to one everywhere in it, because no knot of its boundary
     * vertices lies on the inner side of the boundary. */
    uint8_t *whole;
};

/* The knots of one tetrahedron in local order, 4 (degree + 1) of them. */
void gsn_dms_gather(const struct gsn_dms *space, size_t tet,
                    double ret_knot[GSN_SIMPLEX_MAX_KNOTS][3]);
/* Its shape, from the vertices and what is kept. */
void gsn_dms_shape_of(const struct gsn_dms *space, size_t tet, struct gsn_dms_shape *ret_shape);
/* 1 / the lowest altitude of a tetrahedron, per um: how fast its barycentric coordinates change. */
double gsn_dms_steepest(const struct gsn_tets *mesh, size_t tet);

/* The shape of a tetrahedron from its knots in local order. Fails with GSN_E_MESH, without a
 * place, when some det X_beta, |beta| <= degree, is not greater than margin times that of the
 * tetrahedron, two knots of a corner are too near to each other, or sum high is not less than
 * widest. */
int gsn_dms_shape_init(unsigned degree, const double (*knot)[3], double margin, double widest,
                       struct gsn_dms_shape *ret_shape, struct gsn_error *err);
/* Finds low and high for the frame that is there. */
void gsn_dms_measure(unsigned degree, const double (*knot)[3], struct gsn_dms_shape *shape);
/* Whether no four knots of any V_beta lie in one plane. */
int gsn_dms_is_general(const struct gsn_simplex_sets *sets, const double (*knot)[3]);
/* A bit per corner k with lambda_k > high[k]; GSN_DMS_ALL in the core. */
unsigned gsn_dms_clear(const struct gsn_dms_shape *shape, const double lambda[4]);

int gsn_dms_number(struct gsn_dms *space, struct gsn_error *err);
int gsn_dms_find_whole(struct gsn_dms *space, struct gsn_error *err);

/* Brings tetrahedra whose supports reach into home, itself included, into ascending order: those
 * that no face plane of either keeps apart. */
void gsn_dms_reaching(const struct gsn_dms *space, size_t home, struct gsn_sorted_batch *ascent);

/* The values and (unless ret_gradient is NULL) gradients at u of all functions of one tetrahedron,
 * wherever u lies. Returns 0, leaving the outputs undefined, when all are 0. */
int gsn_dms_tet_basis(const struct gsn_dms *space, size_t tet, const double u[3], double *ret_value,
                      double (*ret_gradient)[3]);

/* Calls visit for every tetrahedron with functions that do not vanish at u, ascending; u lies in
 * tetrahedron home. gradient is NULL unless with_gradient. */
void gsn_dms_each(const struct gsn_dms *space, size_t home, const double u[3], int with_gradient,
                  void (*visit)(void *context, size_t tet, const double *value,
                                const double (*gradient)[3]),
                  void *context);

#ifdef __cplusplus
}
#endif
#endif
