/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A fitted spline as one HDF5 file, "model.vtkhdf", that is both picture and model.
 *
 * /VTKHDF holds it as VTK and ParaView open it (VTKHDF 1.0, UnstructuredGrid): one Bezier
 * tetrahedron of the spline's degree (cell type 78) a tetrahedron of the mesh, with points of its
 * own, in micrometres. Point data "s" are the Bernstein coefficients b_beta of p_I, the polynomial
 * that the spline is on the core of tetrahedron I,
 *
 *     p_I(lambda) = sum over |beta| = n of b_beta (n! / beta!) lambda^beta;
 *
 * in the seams around the faces the spline is not p_I, and gsn_spline_residual() bounds by how
 * much. Cell data are what is known of each tetrahedron.
 *
 * /gieson holds the model itself, to the last bit: mesh, knots, control values, those of red, green
 * and blue where the specimen has colours, degree and sharing, the region of interest, the
 * parameters of the run, and a SHA-256 over all of them. The same model gives the same bytes with
 * the same version of the HDF5 library; no time is kept. */
#ifndef GSN_MODEL_MODEL_FILE_H
#define GSN_MODEL_MODEL_FILE_H

#include "pipeline/core/grid.h"
#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What is known of each tetrahedron; an array that is NULL is not in the file. */
struct gsn_model_cells {
    double *density; /* mean of the spline over it, equation (9); NaN: no tissue of the region */
    double *inside_share; /* part of its volume in the region, 0..1 */
    double *residual;     /* rms of its samples */
    uint32_t *samples;    /* how many voxels it holds; 0: the spline is interpolation there */
};

struct gsn_model_notes {
    const char *name;       /* the specimen */
    const char *parameters; /* of the run, as JSON */
    const char *version;    /* of the program that fitted it */
};

/* gives: the bytes of a file. borrows: everything; colour: red, green and blue on the same space as
 * light, 0..1, or NULL; region: the voxels that the figures of the run are over, or NULL. Fails
 * with GSN_E_IO when the HDF5 library does, naming what was written, and with GSN_E_NOMEM. Not for
 * two threads at once. */
int gsn_model_file_write(const struct gsn_spline *spline, const struct gsn_spline *const *colour,
                         const struct gsn_model_cells *cells, const struct gsn_mask *region,
                         const struct gsn_model_notes *notes, uint8_t **ret_bytes, size_t *ret_size,
                         struct gsn_error *err);

/* A model that was read: the splines keep the space; cells are NULL where the file has none, and so
 * are the region (files of format 1 have none) and the colours (nor has format 2). */
struct gsn_model {
    struct gsn_dms *space;
    struct gsn_spline *spline;
    struct gsn_spline *colour[3];
    struct gsn_model_cells cells;
    struct gsn_mask *region;
    char *name, *parameters, *version;
};
void gsn_model_free(struct gsn_model *model);
GSN_DEFINE_AUTO(gsn_model);

/* borrowed: the three colours; NULL: the model has none. */
const struct gsn_spline *const *gsn_model_colours(const struct gsn_model *model);

/* gives: the model, every number as it was written. borrows: bytes, which the caller has held
 * against the hash that the run keeps of them: HDF5 is no reader for hostile or damaged files.
 * Fails with GSN_E_INPUT when they are no such file, are of a newer format or do not match their
 * checksum, and as gsn_dms_new() does. */
int gsn_model_file_read(const uint8_t *bytes, size_t size, struct gsn_model **ret_model,
                        struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
