/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What is asked of the mesher's process and what it answers, as bytes.
 *
 * Little-endian, every array's length is checked against the message's before anything is
 * allocated. An answer is a mesh or a refusal (a code and a sentence): "this cannot be meshed" is
 * an answer, only a process that cannot answer at all exits with an error. */
#ifndef GSN_MODEL_TETGEN_WIRE_H
#define GSN_MODEL_TETGEN_WIRE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A closed surface of flat facets in micrometres: what a mesher is asked to fill. */

/* The fourth corner of a triangle. */
#define GSN_SURFACE_NONE UINT32_MAX

/* Facets are flat, convex and anticlockwise seen from outside; four corners, or three and
 * GSN_SURFACE_NONE. Behind them stand inner facets, which tetrahedra must not cross either, but
 * which need not close. Vertices of no facet become vertices of tetrahedra as well. */
struct gsn_surface {
    size_t vertex_count, facet_count, inner_count;
    double (*vertex)[3];
    uint32_t (*facet)[4]; /* facet_count + inner_count */
};

/* gives: zeroed vertices and facets. Fails with GSN_E_NOMEM. */
int gsn_surface_new(size_t vertex_count, size_t facet_count, size_t inner_count,
                    struct gsn_surface **ret_surface, struct gsn_error *err);
void gsn_surface_free(struct gsn_surface *surface);
GSN_DEFINE_AUTO(gsn_surface);

/* Corners of one facet: 3 or 4. */
size_t gsn_surface_corners(const struct gsn_surface *surface, size_t facet);

/* Passes a surface that encloses something: coordinates finite, corners in range and distinct, and
 * every edge of those that are not inner run through exactly once in each direction. Crossings are
 * the mesher's to find. Fails with GSN_E_MESH naming the vertex, facet or edge; with GSN_E_NOMEM.
 */
int gsn_surface_check(const struct gsn_surface *surface, struct gsn_error *err);

/* Vertices (um) and tetrahedra that nobody has verified yet. */
struct gsn_soup {
    size_t vertex_count, tet_count;
    double (*vertex)[3];
    uint32_t (*tet)[4];
};

/* gives: zeroed arrays. Fails with GSN_E_NOMEM. */
int gsn_soup_new(size_t vertex_count, size_t tet_count, struct gsn_soup **ret_soup,
                 struct gsn_error *err);
void gsn_soup_free(struct gsn_soup *soup);
GSN_DEFINE_AUTO(gsn_soup);

struct gsn_tetgen_options {
    double max_tet_um3;      /* no tetrahedron is larger; 0: no limit */
    double radius_edge;      /* most circumradius / shortest edge */
    double min_dihedral_deg; /* aimed at, not promised */
};

/* A surface to fill. */
struct gsn_mesh_question {
    struct gsn_tetgen_options options;
    struct gsn_surface *surface;
};

void gsn_mesh_question_done(struct gsn_mesh_question *question);

/* gives: the bytes. Fails with GSN_E_NOMEM. */
int gsn_mesh_question_pack(const struct gsn_mesh_question *question, uint8_t **ret_bytes,
                           size_t *ret_size, struct gsn_error *err);
/* gives: the parts; end with gsn_mesh_question_done(). Fails with GSN_E_INPUT, GSN_E_NOMEM. */
int gsn_mesh_question_unpack(const uint8_t *bytes, size_t size,
                             struct gsn_mesh_question *ret_question, struct gsn_error *err);

/* give: the bytes. Fail with GSN_E_NOMEM. */
int gsn_mesh_answer_pack(const struct gsn_soup *mesh, uint8_t **ret_bytes, size_t *ret_size,
                         struct gsn_error *err);
int gsn_mesh_refusal_pack(const struct gsn_error *why, uint8_t **ret_bytes, size_t *ret_size,
                          struct gsn_error *err);
/* gives: the mesh. A refusal comes back as the code and sentence it was packed with; bytes that
 * are no answer as GSN_E_MESH. */
int gsn_mesh_answer_unpack(const uint8_t *bytes, size_t size, struct gsn_soup **ret_mesh,
                           struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
