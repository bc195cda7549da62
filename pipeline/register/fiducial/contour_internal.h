/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What contour.c and its initial estimate, contour_initial.c, have in common; for these two alone.
 *
 * Around the origin, which is the centre as far as it is known, pixels are sorted into cells: by
 * sector, and by ring within it. What lies away from the edge is then summed by rings, and only
 * those pixels that the edge passes through are looked at in every step of the fit. Lengths are in
 * pixels from the origin. */
#ifndef GSN_REGISTER_FIDUCIAL_CONTOUR_INTERNAL_H
#define GSN_REGISTER_FIDUCIAL_CONTOUR_INTERNAL_H

#include "pipeline/core/geom.h"

#include <stddef.h>

/* The unknowns. Shape: the centre, the radius, the Fourier descriptor's terms of orders 2 to
 * ORDERS; then the blur, the disc's level, the tissue's plane. */
enum { ORDERS = 4, SHAPE = 2 * ORDERS + 1 };
enum { CX, CY, R };
enum { V_BLUR = SHAPE, V_DISC, V_B0, V_BX, V_BY, UNKNOWNS };
/* What a sector knows of: the shift of its edge, the blur, the disc's level, its tissue's level. */
enum { SHIFT, BLUR, DISC, TISSUE, LOCAL };
enum { SECTORS = 48, RINGS = 48 };

/* How far from the start pixels are gathered, in starting radii: room for a radius half as large
 * again and tissue around it. */
#define REACH 2.0
/* A burn's outline is round to some per cent of its radius. */
#define DESCRIPTOR_FIRST 0.015
/* Fewer sectors than this share of the rim that agree are no round edge. */
#define RIM_MIN 0.4

struct gsn_contour_sector {
    double cos[ORDERS + 1], sin[ORDERS + 1]; /* of m times its angle, m = 0.. */
    double edge;   /* where the initial estimate puts it, from the origin; NaN: nowhere */
    double b;      /* its tissue's level above the plane */
    double weight; /* 0..1: what the majority thinks of it */
    double s[LOCAL][LOCAL], t[LOCAL]; /* normal equations */
    double own_b;                     /* b by its own account alone */
    double off, variance;             /* its own edge, beyond the outline; of it */
};

/* The pixels of a cell. */
struct gsn_contour_ring {
    double n, sum, squares;
};

struct gsn_contour {
    double at_x, at_y;  /* where the origin has got to, from the start */
    double level_noise; /* variance of a sector's level by its pixels' noise */
    double tolerance;   /* of a sector's edge as the initial estimate sees it */
    size_t count, sectors;
    float *x, *y, *value;          /* of each pixel */
    float *by_x, *by_y, *by_value; /* the same by cells, once they are sorted */
    int *cell;                     /* of each pixel */
    double width;                  /* of a ring, px */
    struct gsn_contour_ring ring[SECTORS][RINGS];
    unsigned first[SECTORS * RINGS + 1]; /* pixel of each cell */
    struct gsn_contour_sector sector[SECTORS];
    double radius; /* about that of the mark */
    double v[UNKNOWNS];
    int near;             /* only tissue at the edge is heard from now on */
    int lobes;            /* highest order that is fitted, 1 for none */
    double noise, tissue; /* variance of a pixel: noise + tissue q^2 */
    double grain, walk; /* of tissue: a pixel's variance about those next to it, and what the level
                           of a sector gains in variance per pixel outwards */
    double spread;      /* variance of the sectors' b */
    double lobe;        /* standard deviation of a term of the descriptor */
};

/* The outline that the steepest fall of most sectors lies on: moves the origin into its centre,
 * sorts the pixels and weighs the sectors. Whether there is one. */
int gsn_contour_estimate(struct gsn_contour *fit);
/* Silences sectors whose edge lies off the outline, and their neighbours. */
void gsn_contour_gate(struct gsn_contour *fit);

/* The outline's radius under a sector's middle. */
double gsn_contour_radius(const struct gsn_contour *fit, const struct gsn_contour_sector *sector);
/* By how much each unknown moves what it moves of a sector. */
void gsn_contour_slopes(const struct gsn_contour *fit, const struct gsn_contour_sector *sector,
                        double ret_slope[UNKNOWNS]);

#endif
