/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the steps of mark_edge.h have in common; for their files alone.
 *
 * Around the origin, which is the centre as far as it is known, pixels are sorted into cells: by
 * sector, and by ring within it. What lies away from the edge is then summed by rings, and only
 * those pixels that the edge passes through are looked at in every step of the fit. Lengths are in
 * pixels from the origin. */
#ifndef GSN_REGISTER_MARK_EDGE_FIT_H
#define GSN_REGISTER_MARK_EDGE_FIT_H

#include "pipeline/core/geom.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Shape: the centre, the radius, the lobes; then the blur, the disc's level, the tissue's plane. */
enum { GSN_EDGE_LOBES = 4, GSN_EDGE_SHAPE = 2 * GSN_EDGE_LOBES + 1 };
enum { GSN_EDGE_CX, GSN_EDGE_CY, GSN_EDGE_R };
enum {
    GSN_EDGE_BLUR = GSN_EDGE_SHAPE,
    GSN_EDGE_DISC,
    GSN_EDGE_B0,
    GSN_EDGE_BX,
    GSN_EDGE_BY,
    GSN_EDGE_UNKNOWNS
};
/* What a sector knows of: the shift of its edge, the blur, the disc's level, its tissue's level. */
enum { GSN_SECTOR_SHIFT, GSN_SECTOR_BLUR, GSN_SECTOR_DISC, GSN_SECTOR_TISSUE, GSN_SECTOR_LOCAL };

enum { GSN_EDGE_SECTORS = 48, GSN_EDGE_RINGS = 48 };

/* How far from the start pixels are gathered, in starting radii: room for a radius half as large
 * again and tissue around it. */
#define GSN_EDGE_REACH 2.0

struct gsn_edge_sector {
    double cos[GSN_EDGE_LOBES + 1], sin[GSN_EDGE_LOBES + 1]; /* of m times its angle, m = 0.. */
    double edge;   /* where a first look puts it, from the origin; NaN: nowhere */
    double b;      /* its tissue's level above the plane */
    double weight; /* 0..1: what the majority thinks of it */
    double s[GSN_SECTOR_LOCAL][GSN_SECTOR_LOCAL], t[GSN_SECTOR_LOCAL]; /* normal equations */
    double own_b;         /* b by its own account alone */
    double off, variance; /* its own edge, beyond the outline; of it */
};

/* The pixels of a cell. */
struct gsn_edge_ring {
    double n, sum, squares;
};

struct gsn_edge_fit {
    double at_x, at_y;  /* where the origin has got to, from the start */
    double level_noise; /* variance of a sector's level by its pixels' noise */
    double tolerance;   /* of a sector's edge as the first look sees it */
    size_t count, sectors;
    float *x, *y, *value;          /* of each pixel */
    float *by_x, *by_y, *by_value; /* the same by cells, once they are sorted */
    int *cell;                     /* of each pixel */
    double width;                  /* of a ring, px */
    struct gsn_edge_ring ring[GSN_EDGE_SECTORS][GSN_EDGE_RINGS];
    unsigned first[GSN_EDGE_SECTORS * GSN_EDGE_RINGS + 1]; /* pixel of each cell */
    struct gsn_edge_sector sector[GSN_EDGE_SECTORS];
    double radius; /* about that of the mark */
    double v[GSN_EDGE_UNKNOWNS];
    int near;             /* only tissue at the edge is heard from now on */
    int lobes;            /* orders that are fitted, 1 for none */
    double noise, tissue; /* variance of a pixel: noise + tissue q^2 */
    double grain, walk; /* of tissue: a pixel's variance about those next to it, and what the level
                           of a sector gains in variance per pixel outwards */
    double spread;      /* variance of the sectors' b */
    double lobe;        /* standard deviation of a lobe */
};

/* Squared residuals on either side of the edge. */
struct gsn_edge_sums {
    double inner, inner_n, outer, outer_n, outer_q;
};

/* ---- mark_edge_cells.c: pixels by cells ---------------------------------------------------- */

/* Sums the pixels of every cell; those beyond the last ring take no part. */
void gsn_edge_fill_rings(struct gsn_edge_fit *fit);
/* Sorts the pixels by their cells. The origin stays from now on. */
void gsn_edge_sort(struct gsn_edge_fit *fit);
/* Of count rings from the first on; what lies outside of 0..GSN_EDGE_RINGS is empty. */
struct gsn_edge_ring gsn_edge_rings(const struct gsn_edge_fit *fit, size_t sector, int from,
                                    int to);

/* Grain and walk of the tissue from the edge outwards. */
void gsn_edge_learn_tissue(struct gsn_edge_fit *fit);

/* ---- mark_edge_look.c: a first look -------------------------------------------------------- */

/* The outline that the sharpest fall of most sectors lies on: moves the origin into its centre,
 * sorts the pixels and weighs the sectors. Whether there is one. */
int gsn_edge_look(struct gsn_edge_fit *fit);
/* Silences sectors whose edge lies off the outline, and their neighbours. */
void gsn_edge_gate(struct gsn_edge_fit *fit);

/* ---- mark_edge_sums.c: what the pixels say ------------------------------------------------- */

/* Fills every sector's normal equations. */
void gsn_edge_accumulate(struct gsn_edge_fit *fit, struct gsn_edge_sums *ret_sums);
/* Share of the variance around the mark that the fit explains, where the edge is the mark's. */
double gsn_edge_explained(const struct gsn_edge_fit *fit);

/* ---- mark_edge_solve.c: the fit ------------------------------------------------------------ */

typedef double gsn_edge_matrix[GSN_EDGE_UNKNOWNS][GSN_EDGE_UNKNOWNS];

double gsn_edge_contrast(const struct gsn_edge_fit *fit);
/* The radius under a sector's middle, and what the tissue's plane is there. */
double gsn_edge_outline(const struct gsn_edge_fit *fit, const struct gsn_edge_sector *sector);
double gsn_edge_plane(const struct gsn_edge_fit *fit, const struct gsn_edge_sector *sector);
/* Which of a sector's quantities each unknown moves, and by how much: one each. */
extern const int gsn_edge_moves[GSN_EDGE_UNKNOWNS];
void gsn_edge_slopes(const struct gsn_edge_fit *fit, const struct gsn_edge_sector *sector,
                     double ret_slope[GSN_EDGE_UNKNOWNS]);
/* Gauss-Newton from the first look; whether it settled somewhere legal. ret_h is the information at
 * the end, its lower half. */
int gsn_edge_descend(struct gsn_edge_fit *fit, gsn_edge_matrix ret_h);

#ifdef __cplusplus
}
#endif
#endif
