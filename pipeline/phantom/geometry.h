/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The phantom block: a tooth root in bone, known in closed form at every point.
 *
 * Lengths are micrometres, angles radians. The block frame has x right and y down in the section
 * and z along the cutting direction; section k is the plane z = first_z + interval k. The collagen
 * density D (0..1) is the truth of the phantom. It is linear in the depth A of the lesion. GVP-D is
 * the block of the specification; another block is another struct. */
#ifndef GSN_PHANTOM_GEOMETRY_H
#define GSN_PHANTOM_GEOMETRY_H

#include "pipeline/core/geom.h"

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_phantom_layer {
    GSN_PHANTOM_CONN, /* loose connective tissue beyond the bone */
    GSN_PHANTOM_DENT, /* dentine */
    GSN_PHANTOM_PULP,
    GSN_PHANTOM_PDL, /* periodontal ligament */
    GSN_PHANTOM_BONE,
    GSN_PHANTOM_MARR, /* marrow spaces in the bone */
    GSN_PHANTOM_LAYERS
};

enum { GSN_PHANTOM_OUTLINE_WAVES = 5, GSN_PHANTOM_MARROWS = 40, GSN_PHANTOM_MARKS = 3 };

/* One wave of the outline: a cos(m phi + p + w z). */
struct gsn_phantom_wave {
    double m, a, p, w;
};

struct gsn_phantom_ellipsoid {
    struct gsn_vec3 centre, radius;
};

/* Every constant of the block; the names are those of the specification. */
struct gsn_phantom_geometry {
    int sections;
    double first_z, interval, height;
    double ax, ay, p, delta;
    double a, b, root_length, apex_z, cx, cy, tx, ty;
    double pulp_scale, pulp_start;
    double pdl_width, bone_width, bone_wave, bone_turn;
    double density[GSN_PHANTOM_LAYERS];
    double lamella, lamella_length, slope_z;
    struct gsn_vec3 lesion, lesion_radius;
    double lesion_turn, lesion_in_pdl;
    double region_depth, region_half_height, region_radius;
    struct gsn_phantom_wave outline[GSN_PHANTOM_OUTLINE_WAVES];
    struct gsn_phantom_ellipsoid marrow[GSN_PHANTOM_MARROWS];
    struct gsn_point mark[GSN_PHANTOM_MARKS];
    int marrows;  /* of the array above only so many count */
    double floor; /* no layer is paler, and the lesion takes none down to less */
};

/* What the block holds at one point. Where tissue is 0 all the rest is 0 too. */
struct gsn_phantom_field {
    double tissue;                    /* F */
    double layer[GSN_PHANTOM_LAYERS]; /* sum to 1 where there is tissue */
    double lesion;                    /* E */
    double intact, lost;              /* D = intact - A lost */
    double bone;                      /* the bone's share of intact */
};

/* GVP-D. */
const struct gsn_phantom_geometry *gsn_phantom_geometry(void);
/* "D", or "P": another anatomy. NULL for a name nobody defined. */
const struct gsn_phantom_geometry *gsn_phantom_geometry_find(const char *name);

/* Smooth step from 0 at t = -1 to 1 at t = 1. */
double gsn_phantom_step(double t);

double gsn_phantom_section_z(const struct gsn_phantom_geometry *g, int k);

/* Signed distance from the root surface, first order: below 0 inside the root. */
double gsn_phantom_root_distance(const struct gsn_phantom_geometry *g, struct gsn_vec3 at);

void gsn_phantom_field_at(const struct gsn_phantom_geometry *g, struct gsn_vec3 at,
                          struct gsn_phantom_field *ret_field);

/* Makes all bone gain times as dense, as animals differ; 1 changes nothing. */
void gsn_phantom_field_thicken(struct gsn_phantom_field *field, double gain);

/* D for the lesion depth A in 0..1. */
double gsn_phantom_density(const struct gsn_phantom_field *field, double depth);

/* 1 inside the region of interest, 0 outside. */
int gsn_phantom_in_region(const struct gsn_phantom_geometry *g, struct gsn_vec3 at);

#ifdef __cplusplus
}
#endif
#endif
