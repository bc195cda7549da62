/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Every tetrahedron of a mesh cut into 8^level alike: the finer mesh has one point per place,
 * however many tetrahedra meet there. */
#ifndef GSN_RENDER_SUBDIVIDE_H
#define GSN_RENDER_SUBDIVIDE_H

#include "pipeline/model/tets.h"

#ifdef __cplusplus
extern "C" {
#endif

enum {
    GSN_FINE_MOST_LEVEL = 3,
    GSN_FINE_MOST_PARTS = 8 * 8 * 8,        /* of one tetrahedron */
    GSN_FINE_MOST_PLACES = 9 * 10 * 11 / 6, /* lattice points of one tetrahedron */
};

struct gsn_fine {
    size_t tet_count, point_count;
    double (*point)[3];
    uint8_t *outer;      /* of each point: 1 on the boundary of the mesh */
    uint32_t *home;  /* a tetrahedron of the mesh that holds the point */
    uint32_t *place; /* point of lattice place p of tetrahedron t at [t * places + p] */
    unsigned places, parts;
    /* The parts of every tetrahedron, as lattice places; positively oriented. */
    uint8_t part[GSN_FINE_MOST_PARTS][4];
};

/* gives; level is at most GSN_FINE_MOST_LEVEL. Fails with GSN_E_NOMEM, and with GSN_E_LIMIT when
 * there would be more than 2^31 parts. */
int gsn_fine_new(const struct gsn_tets *mesh, unsigned level, struct gsn_fine **ret_fine,
                 struct gsn_error *err);
void gsn_fine_free(struct gsn_fine *fine);
GSN_DEFINE_AUTO(gsn_fine);

#ifdef __cplusplus
}
#endif
#endif
