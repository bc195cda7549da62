/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A spline along a line, as the polynomials it consists of.
 *
 * Along start + t into, |into| = 1, s is a sum of polynomials of t, each on an interval of its own:
 * one a tetrahedron that the line crosses, and those that the faces add near them
 * (face_correction.h; docs/MATH.md, section 13). Integrals of s, and of what is made from it piece
 * by piece, need no steps. Outside the mesh there is no data, whatever faces add there. */
#ifndef GSN_MODEL_PIECES_H
#define GSN_MODEL_PIECES_H

#include "pipeline/model/face_correction.h"

#ifdef __cplusplus
extern "C" {
#endif

/* sum value[i] v^i with v = (t - from) / (to - from), for from < t < to; slope: the gradient in
 * space, component by component, in the same way. Unused powers are 0. */
struct gsn_line_piece {
    double from, to;
    double value[4], slope[3][4];
};

/* A tetrahedron made ready for lines. Plain memory. */
struct gsn_tet_line {
    unsigned degree;
    struct gsn_barycentric frame;
    double coefficient[GSN_DMS_MAX_FUNCTIONS];
};
void gsn_tet_line_init(const struct gsn_spline *spline, size_t tet, struct gsn_tet_line *ret_line);

/* What the tetrahedron has of the line between from and to; slope is left as it is unless
 * with_slope. Returns 0, leaving ret_piece as it is, when the line passes by. */
int gsn_tet_line_piece(const struct gsn_tet_line *line, const double start[3],
                       const double into[3], double from, double to, int with_slope,
                       struct gsn_line_piece *ret_piece);

/* Where the jumps D_g of a face begin among its coefficients, and their degrees. */
struct gsn_jump_places {
    uint8_t at[GSN_FACE_CORRECTION_MAX_SETS], degree[GSN_FACE_CORRECTION_MAX_SETS];
};

/* A face made ready for lines. Large; borrows the spline's space. */
struct gsn_face_line {
    struct gsn_prism prism;
    struct gsn_face_correction seam;
    struct gsn_barycentric leaf[GSN_FACE_CORRECTION_MAX_LEAVES]; /* in the axes of the face */
    struct gsn_jump_places jumps;
};

/* The face opposite corner of tet, in place: it must not be moved. Returns 0 when it adds nothing,
 * or belongs to the tetrahedron on its other side. */
int gsn_face_line_init(const struct gsn_spline *spline, size_t tet, unsigned corner,
                       struct gsn_face_line *ret_line);

/* What the face adds to the line between from and to; returns the number of pieces, which may
 * overlap. */
size_t gsn_face_line_pieces(const struct gsn_face_line *line, const double start[3],
                            const double into[3], double from, double to, int with_slope,
                            struct gsn_line_piece ret_piece[GSN_FACE_CORRECTION_MAX_LEAVES]);

#ifdef __cplusplus
}
#endif
#endif
