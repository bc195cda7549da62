/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The surface {s = level} as triangles, closed where a region ends, and its picture.
 *
 * Marching tetrahedra on the domain, cells that the surface passes being split until its triangles
 * are as near to it as asked; values and normals are those of the spline itself, vertices are moved
 * along their edge until the spline is at the level. With a region it bounds the solid {s >= level}
 * in it: where the region ends (region_border.h) the surface follows its border. Open where it
 * meets the domain's boundary. In um. */
#ifndef GSN_RENDER_ISOSURFACE_H
#define GSN_RENDER_ISOSURFACE_H

#include "pipeline/core/grid.h"
#include "pipeline/core/image.h"
#include "pipeline/model/spline.h"
#include "pipeline/render/block_axes.h"
#include "pipeline/render/canvas.h"
#include "pipeline/render/region_border.h"
#include "pipeline/render/view.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Triangles are wound so that the normal by the right hand, like those of the vertices, points to
 * smaller s: out of the denser side. */
struct gsn_trimesh {
    size_t vertex_count, triangle_count;
    double (*vertex)[3];
    float (*normal)[3]; /* of length 1 */
    uint32_t (*triangle)[3];
    uint8_t *closing; /* of each vertex: 1 on the border of the region, 0 at the level */
    double error_um;  /* no triangle is estimated to lie farther from the surface */
};

void gsn_trimesh_free(struct gsn_trimesh *surface);
GSN_DEFINE_AUTO(gsn_trimesh);

struct gsn_isosurface_options {
    double level;
    const struct gsn_border *border; /* of a region; NULL: all of the domain */
    double error_um;                 /* that triangles may lie from the surface; 0: not asked */
    double edge_um; /* of a cell that the surface passes, at most; 0: not asked. Neither asked: an
                      * error of a hundredth of the mean edge of the mesh */
    size_t most_cells; /* with more it is split no further; 0: 2^23 */
    unsigned threads;  /* 0: all; the same bytes on any number */
};

/* gives: the surface; it has no triangles when s does not cross the level. Closed pieces smaller
 * than an eighth of the mean edge of the mesh may be missed. Where most_cells ends it, error_um of
 * the surface says what was reached; edges that are asked for and not reached are GSN_E_LIMIT.
 * Fails with GSN_E_INPUT when a number is out of range, and with GSN_E_NOMEM. */
int gsn_isosurface(const struct gsn_spline *spline, const struct gsn_isosurface_options *options,
                   struct gsn_trimesh **ret_surface, struct gsn_error *err);

/* um^2; of the triangles that close the region, those whose corners all lie on its border, in
 * *ret_closing unless NULL. */
double gsn_trimesh_area(const struct gsn_trimesh *surface, double *ret_closing);

struct gsn_trimesh_style {
    struct gsn_colour colour;           /* of the surface; all 0: bone white */
    const char *title;                  /* NULL: none */
    int outline;                        /* 1: draw the domain's boundary edges faintly behind */
    const struct gsn_block_box_um *box; /* whose axes are drawn; NULL: the cube alone */
};

/* gives: the picture: z-buffer, two-sided diffuse light with a soft highlight, 2x2 samples a pixel,
 * light grey background, scale bar, the block's cube. mesh frames the view and is outlined where
 * style asks for it: without, its vertices are enough. style may be NULL. Fails with GSN_E_INPUT on
 * an unusable view, GSN_E_NOMEM. */
int gsn_trimesh_paint(const struct gsn_trimesh *surface, const struct gsn_tets *mesh,
                      const struct gsn_view *view, const struct gsn_trimesh_style *style,
                      unsigned threads, struct gsn_image **ret_image, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
