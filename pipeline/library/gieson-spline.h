/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* libgieson-spline: a smooth field over a tetrahedral mesh, fitted to samples.
 *
 * The field is a trivariate simplex (DMS) spline of degree 1, 2 or 3: piecewise polynomial on any
 * tetrahedral mesh, C^{n-1} across its faces (W. Dahmen, C. A. Micchelli, H.-P. Seidel, 1992;
 * docs/MATH.md has every equation). It is evaluated at millions of points a second and core, its
 * integrals are exact, and volumes above a threshold come with guaranteed bounds.
 *
 *     struct gsn_space *space = NULL;      where fields live: mesh, knots, degree
 *     struct gsn_field *field = NULL;      one of them
 *     struct gsn_error err;
 *
 *     if (gsn_space_new(point, points, tet, tets, NULL, &space, &err) < 0 ||
 *         gsn_field_fit(space, &data, NULL, &field, NULL, &err) < 0)
 *         fprintf(stderr, "%s\n", err.text);
 *
 * Rules that hold everywhere:
 *
 * - A function that can fail returns GSN_OK or a negative code, and writes one sentence into err,
 *   which may be NULL. What it would have given is then untouched.
 * - "gives" is the caller's to free, by the function named after it; "borrowed" is valid as long as
 *   what it came from; "keeps" must live as long as what keeps it: free fields before their space.
 * - Lengths are in any one unit; sentences call it um. x runs fastest in voxels.
 * - Nothing prints, exits, or keeps state of its own. Different objects may be used by different
 *   threads at once, and one object by many that only read it; files of .vtkhdf are for one thread
 *   at a time. threads 0 stands for all that the process may use: results are the same bytes for
 *   any number.
 * - Sizes and indices are trusted, values are checked.
 *
 * Structures of options are to be initialised by name, so that what is left out is 0, its default:
 * a later version may have more members, and then another soname. */
#ifndef GIESON_SPLINE_H
#define GIESON_SPLINE_H

#include "pipeline/core/error.h"
#include "pipeline/core/progress.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* --- voxels ------------------------------------------------------------------------------------
 */

/* A regular grid, and which of its voxels belong to a region. */
struct gsn_voxels {
    size_t size[3];
    double origin[3];      /* centre of the first voxel */
    double step[3];        /* from centre to centre, > 0 */
    const uint8_t *inside; /* 0 or 1 a voxel; NULL: all belong to it */
};

/* --- where fields live -------------------------------------------------------------------------
 */

struct gsn_space;

struct gsn_space_options {
    unsigned degree; /* 1..3; 0: 2 */
    double cloud;    /* radius of the knots around a vertex, by the smallest altitude of the
                        tetrahedra there, up to 0.5; 0: 0.015. Larger is smoother across faces and
                        slower */
    const double (*knots)[3]; /* degree + 1 a vertex, the vertex itself first: instead of clouds */
    const char *mesher;       /* path of gieson-mesh, for gsn_space_cover() and gsn_space_follow();
                                 NULL: as installed */
};

/* gives: the space over these tetrahedra, of copies; options may be NULL. Corners of a tetrahedron
 * may be given in any order and are kept in a positive one.
 * Fails with GSN_E_MESH naming a tetrahedron that is flat, has no such vertex, shares a face with
 * two others or whose knots fold over or are thinner than 1e-10 of an edge; GSN_E_INPUT on a degree
 * or number out of range, GSN_E_NOMEM. */
int gsn_space_new(const double (*point)[3], size_t points, const uint32_t (*tet)[4], size_t tets,
                  const struct gsn_space_options *options, struct gsn_space **ret_space,
                  struct gsn_error *err);

/* gives: the space over tetrahedra of about this edge that cover the voxels of a region, each with
 * all of its cell. The mesh is made by gieson-mesh, a program of the package gieson, in a process
 * of its own; the same region gives the same mesh. Fails with GSN_E_NOTFOUND when gieson-mesh is
 * not installed, GSN_E_PROCESS when it dies, GSN_E_INPUT on an empty region, GSN_E_LIMIT on an edge
 * too small for it, GSN_E_MESH, GSN_E_NOMEM. */
int gsn_space_cover(const struct gsn_voxels *region, double edge,
                    const struct gsn_space_options *options, struct gsn_space **ret_space,
                    struct gsn_error *err);

/* gives: the space over tetrahedra that follow what a field will be of: along walls, where the
 * value of a voxel of the region falls from one plateau to another within few voxels, their faces
 * lie in layers beside the wall. A field on it needs several times fewer unknowns than one on a
 * mesh that knows of no walls. value: of each voxel of the grid, NaN: none; edge: about, of the
 * triangles along walls and around the region. Where no wall is sharp the mesh follows the region's
 * rim alone. Fails as gsn_space_cover(), and with GSN_E_INPUT where no voxel of the region has a
 * value. */
int gsn_space_follow(const struct gsn_voxels *region, const double *value, double edge,
                     const struct gsn_space_options *options, struct gsn_space **ret_space,
                     struct gsn_error *err);
void gsn_space_free(struct gsn_space *space);

/* borrowed: the mesh as it is kept, and the knots, degree + 1 a vertex. */
size_t gsn_space_points(const struct gsn_space *space, const double (**ret_point)[3]);
size_t gsn_space_tets(const struct gsn_space *space, const uint32_t (**ret_tet)[4]);
const double (*gsn_space_knots(const struct gsn_space *space))[3];
unsigned gsn_space_degree(const struct gsn_space *space);
/* How many numbers make a field: its control values. */
size_t gsn_space_unknowns(const struct gsn_space *space);

/* --- fields and fits ---------------------------------------------------------------------------
 */

struct gsn_field;

/* Samples at any places. */
struct gsn_data {
    size_t count;
    const double (*at)[3];
    const double *value;
    const double *weight; /* of each square in the sum, >= 0; NULL: 1. A weight of 2 is the same
                             sample twice: for independent errors take 1 / variance */
    const uint8_t *fold;  /* 0 or 1 a sample: smoothing is chosen so that each half predicts the
                             other best; NULL: no choice */
};

/* The smoothing that is taken without options: it fills what holds no sample, and changes values
 * where there are some by about as much. */
#define GSN_FIT_SMOOTHING 1e-6

/* Minimised is, with d the samples per volume and h the edge of a mean tetrahedron,
 *
 *     sum w (s(u) - value)^2 + d h^2 ( smoothing * integral |grad s|^2 + jump * P(s) ),
 *
 * P the squared jumps of the gradient across faces, of degree 2 and 3 what smooths without
 * flattening, and the curvature of tetrahedra without samples, which so go on straight. */
struct gsn_field_options {
    double smoothing;    /* 0: none, and then every control value needs samples near it */
    double jump;         /* 0: none; with folds: where the search begins, 0: 1e-5 */
    double tolerance;    /* of the solver; 0: 1e-8 */
    unsigned iterations; /* at most; 0: 10000 */
    unsigned threads;
    int strict; /* a sample outside the mesh and a solver that does not reach its tolerance are
                   failures; 0: they are in the report */
    const struct gsn_progress *progress; /* NULL: none. Stage "fit" */
};

struct gsn_field_report {
    size_t unknowns, samples; /* samples: those inside the mesh */
    size_t outside;           /* samples left out because they lie outside the mesh, */
    size_t first_outside;     /* and the first of them when there are any */
    size_t empty_tets;        /* tetrahedra without samples: the field is a guess there */
    unsigned iterations;
    int unconverged;   /* the solver ended above its tolerance: this is the best it had */
    double rms, worst; /* of the residuals; rms with their weights */
    double jump;       /* the weight that was taken */
    double predicted;  /* with folds: rms error at samples of the other fold */
};

/* gives: the field that follows the samples. keeps: space. options may be NULL: smoothing
 * GSN_FIT_SMOOTHING and defaults; ret_report may be NULL.
 * Fails with GSN_E_INPUT naming the first sample that is not finite, has a negative weight or, when
 * strict, lies outside; when all lie outside. GSN_E_FIT when a control value is not determined or,
 * when strict, the solver does not reach its tolerance. GSN_E_NOMEM. */
int gsn_field_fit(const struct gsn_space *space, const struct gsn_data *data,
                  const struct gsn_field_options *options, struct gsn_field **ret_field,
                  struct gsn_field_report *ret_report, struct gsn_error *err);

/* Many values at the same samples, value[c][i] that of sample i in channel c (data->value is not
 * looked at): the equations are made once and solved once a channel, with the same answers as one
 * by one. With folds the first channel chooses for all. gives: channels fields; ret_report, unless
 * NULL, has room for as many. keeps and fails as gsn_field_fit(). */
int gsn_field_fit_many(const struct gsn_space *space, const struct gsn_data *data,
                       const double *const *value, size_t channels,
                       const struct gsn_field_options *options, struct gsn_field **ret_field,
                       struct gsn_field_report *ret_report, struct gsn_error *err);

/* What moving the knots has gained, and how often: rms with the knots as they were given, and after
 * the vertices had moved. */
struct gsn_free_report {
    double rms_fixed, rms_vertices;
    unsigned vertex_steps, cloud_steps;
};

/* gives: the field that follows the samples in a space of its own, to which the knots of this one
 * have moved until they left less of the samples: first vertices inside the mesh with their clouds,
 * in at most so many steps (0: 16), then single knots in a quarter as many. The mesh stays what it
 * covers, and how it is joined. Slow: each step is several fits. For walls that no mesh knows of;
 * where their places are known, gsn_space_follow() is better. ret_free and ret_report may be NULL.
 * Fails as gsn_field_fit(). */
int gsn_field_fit_free(const struct gsn_space *space, const struct gsn_data *data,
                       const struct gsn_field_options *options, unsigned steps,
                       struct gsn_field **ret_field, struct gsn_free_report *ret_free,
                       struct gsn_field_report *ret_report, struct gsn_error *err);

/* gives: the same field with one vertex more, in a space of its own. knots: degree + 1 places, the
 * first that of the vertex, inside of a tetrahedron, which becomes four; the others are its cloud.
 * Nothing changes anywhere: knots are inserted exactly, to be moved or fitted then. Every
 * tetrahedron of the new space has control values of its own.
 * Fails with GSN_E_INPUT on a vertex outside of the mesh or a knot that is not finite; GSN_E_MESH
 * on a vertex that lies on a face, or knots that would turn a tetrahedron over; GSN_E_NOMEM. */
int gsn_field_insert(const struct gsn_field *field, const double (*knots)[3],
                     struct gsn_field **ret_field, struct gsn_error *err);

/* gives: the field of these gsn_space_unknowns() control values. keeps: space. Fails with
 * GSN_E_INPUT on one that is not finite, GSN_E_NOMEM. */
int gsn_field_new(const struct gsn_space *space, const double *control,
                  struct gsn_field **ret_field, struct gsn_error *err);
void gsn_field_free(struct gsn_field *field);

/* borrowed. */
const struct gsn_space *gsn_field_space(const struct gsn_field *field);
const double *gsn_field_controls(const struct gsn_field *field);

/* --- values ------------------------------------------------------------------------------------
 */

/* Values at count points, and gradients unless ret_gradient is NULL; NaN outside the mesh.
 * Fails with GSN_E_NOMEM. */
int gsn_field_at(const struct gsn_field *field, const double (*at)[3], size_t count,
                 unsigned threads, double *ret_value, double (*ret_gradient)[3],
                 struct gsn_error *err);

/* Second derivatives xx, xy, xz, yy, yz, zz at count points; NaN outside the mesh. Of degree 2 they
 * jump at knot planes, of degree 1 they are 0. */
void gsn_field_hessian(const struct gsn_field *field, const double (*at)[3], size_t count,
                       double (*ret_hessian)[6]);

/* Values at all voxel centres of a grid; NaN outside the mesh. grid->inside is not looked at. Many
 * times faster than by points. Fails with GSN_E_INPUT on a grid without voxels or steps,
 * GSN_E_NOMEM. */
int gsn_field_on_grid(const struct gsn_field *field, const struct gsn_voxels *grid,
                      unsigned threads, double *ret_value, struct gsn_error *err);

/* --- integrals, all exact ----------------------------------------------------------------------
 */

/* Along the segment from a to b by arc length, and unless ret_length is NULL how long it runs
 * inside the mesh. Where it leaves the mesh the field fades to 0 within the reach of the outermost
 * clouds. Fails with GSN_E_INPUT on an end that is not finite or farther away than 1e12 times the
 * mesh; GSN_E_NOMEM. */
int gsn_field_segment(const struct gsn_field *field, const double a[3], const double b[3],
                      double *ret_integral, double *ret_length, struct gsn_error *err);

/* Along the whole line p + t d by arc length, with what fades beyond the mesh; NaN when d is 0 or a
 * number is not finite. */
double gsn_field_line(const struct gsn_field *field, const double p[3], const double d[3]);

/* Over the whole mesh, and its volume. Fails with GSN_E_NOMEM. */
int gsn_field_integral(const struct gsn_field *field, unsigned threads, double *ret_integral,
                       double *ret_volume, struct gsn_error *err);

/* The mean over each tetrahedron. Fails with GSN_E_NOMEM. */
int gsn_field_means(const struct gsn_field *field, unsigned threads, double *ret_mean,
                    struct gsn_error *err);

/* --- certain bounds ----------------------------------------------------------------------------
 */

/* lower <= volume of {u in the region: s(u) > threshold} <= upper, guaranteed. */
struct gsn_field_volume {
    double threshold, lower, upper;
};

/* For count thresholds. gap: wanted (upper - lower) / max(upper, 1 % of the region); 0: 1e-3.
 * Bounds are as true where the search ends before that, after a million boxes a threshold.
 * Fails with GSN_E_INPUT when the region is empty, one of its voxels sticks out of the mesh or a
 * threshold is not finite; GSN_E_NOMEM. */
int gsn_field_volume_above(const struct gsn_field *field, const struct gsn_voxels *region,
                           const double *threshold, size_t count, double gap, unsigned threads,
                           const struct gsn_progress *progress, struct gsn_field_volume *ret_volume,
                           struct gsn_error *err);

/* --- files -------------------------------------------------------------------------------------
 */

/* The field, to the last bit, as HDF5 in VTK's layout: ParaView opens it. By convention path ends
 * in .vtkhdf. name is kept in it. A file that is there is replaced in one step. Fails with
 * GSN_E_IO, GSN_E_NOMEM. */
int gsn_field_save(const struct gsn_field *field, const char *name, const char *path,
                   struct gsn_error *err);

/* gives: the field, which owns its space. Models of gieson are such files. Not for files of
 * strangers: HDF5 is no reader for hostile bytes.
 * Fails with GSN_E_NOTFOUND, GSN_E_IO, GSN_E_INPUT when it is no such file or its checksum is
 * wrong, GSN_E_NOMEM. */
int gsn_field_load(const char *path, struct gsn_field **ret_field, struct gsn_error *err);

/* For other programs, by the ending of path; another one is GSN_E_UNSUPPORTED. They fail with
 * GSN_E_IO and GSN_E_NOMEM.
 *
 * The tetrahedra: .vtu (Bezier tetrahedra, for viewing) or .csv (centre, volume, mean of each). */
int gsn_field_write_cells(const struct gsn_field *field, const char *path, struct gsn_error *err);
/* The surface {s = level} in triangles: .stl or .ply. Tetrahedra are split where the surface passes
 * them until no triangle lies farther from it than error, estimated from normals and in the unit of
 * coordinates; 0: a hundredth of the mean edge. GSN_E_INPUT when s crosses the level nowhere, or
 * error is negative. */
int gsn_field_write_surface(const struct gsn_field *field, double level, double error,
                            const char *path, struct gsn_error *err);
/* The values of gsn_field_on_grid(), in single precision: .nrrd, .nii or .nii.gz. */
int gsn_field_write_grid(const struct gsn_field *field, const struct gsn_voxels *grid,
                         const char *path, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
