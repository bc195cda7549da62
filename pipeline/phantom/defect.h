/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What can befall a section between the knife and the scanner, one at a time.
 *
 * Tears, folds and lost pieces move material: they act in the block's frame (um). Everything else
 * lies on the glass and is placed on the panel (um from its upper left corner). */
#ifndef GSN_PHANTOM_DEFECT_H
#define GSN_PHANTOM_DEFECT_H

#include "pipeline/core/geom.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_phantom_defect_kind {
    GSN_PHANTOM_TEAR,
    GSN_PHANTOM_FOLD,
    GSN_PHANTOM_LOST_PIECE,
    GSN_PHANTOM_CHATTER,
    GSN_PHANTOM_HAIR,
    GSN_PHANTOM_BUBBLE,
    GSN_PHANTOM_COVERSLIP_EDGE,
    GSN_PHANTOM_PEN,
    GSN_PHANTOM_DEFOCUS,
    GSN_PHANTOM_TOUCHING,
    GSN_PHANTOM_ACCIDENTS, /* the kinds above are dealt out; those below follow from the mounting */
    GSN_PHANTOM_DUPLICATE = GSN_PHANTOM_ACCIDENTS,
    GSN_PHANTOM_EMPTY_SLOT,
    GSN_PHANTOM_MISSING_PANEL,
    GSN_PHANTOM_DEFECT_KINDS
};

enum { GSN_PHANTOM_DEFECT_POINTS = 8, GSN_PHANTOM_DUST = 5, GSN_PHANTOM_PENS = 4 };

struct gsn_phantom_disc {
    struct gsn_point at;
    double radius;
};

/* What a kind does not use is 0. */
struct gsn_phantom_defect {
    enum gsn_phantom_defect_kind kind;
    int k;               /* the section that belongs in the slot */
    double turn;         /* tear, fold: frame whose x crosses it; chatter: its direction; edge */
    struct gsn_point at; /* tear: x0, y0; fold: x0; else the centre */
    double slope;        /* tear */
    double width;        /* fold, hair, pen, edge */
    double radius;       /* bubble, defocus */
    double sigma_px;     /* defocus */
    int colour;          /* pen: red, blue, green, black */
    size_t count;        /* of point: outline of a piece about at, or a stroke */
    struct gsn_point point[GSN_PHANTOM_DEFECT_POINTS];
    struct gsn_phantom_disc dust[GSN_PHANTOM_DUST];
    struct gsn_point place; /* where the centre of a lost piece lies now, and how it is turned */
    double place_turn;
};

const char *gsn_phantom_defect_name(enum gsn_phantom_defect_kind kind);

/* What a place of the mounted section shows: glass, one layer of material, or two. */
struct gsn_phantom_reading {
    int layers;
    int moved; /* the last layer is a piece that lies where it does not belong */
    struct gsn_point at[2];
};

/* What is seen where x would be, had nothing happened. defect may be NULL. */
struct gsn_phantom_reading gsn_phantom_defect_read(const struct gsn_phantom_defect *defect,
                                                   struct gsn_point x);

/* The inverse: where material now lies. 0 when it is seen nowhere. */
int gsn_phantom_defect_find(const struct gsn_phantom_defect *defect, struct gsn_point material,
                            struct gsn_point *ret_x);

/* Half the width of a tear's gap at the height y of its frame. */
double gsn_phantom_tear_gap(const struct gsn_phantom_defect *tear, double y);

/* Into the frame turned by an angle, and back. */
struct gsn_point gsn_phantom_turn_into(struct gsn_point p, double turn);
struct gsn_point gsn_phantom_turn_back(struct gsn_point p, double turn);

/* A smooth stroke through the points of a hair or a pen, as STROKE straight pieces. */
enum { GSN_PHANTOM_STROKE = 32 };
void gsn_phantom_stroke(const struct gsn_phantom_defect *defect,
                        struct gsn_point ret_line[GSN_PHANTOM_STROKE + 1]);
double gsn_phantom_stroke_distance(const struct gsn_point line[GSN_PHANTOM_STROKE + 1],
                                   struct gsn_point p);

/* Whether something that lies on the glass covers this place of the panel (um). A bubble covers
 * all of its disc; opaque says whether a mark below could not be seen. px_um is the pixel, in
 * which the bubble's rim is measured. */
int gsn_phantom_defect_covers(const struct gsn_phantom_defect *defect, double px_um,
                              struct gsn_point panel_um);
int gsn_phantom_defect_opaque(const struct gsn_phantom_defect *defect, double px_um,
                              struct gsn_point panel_um);

#ifdef __cplusplus
}
#endif
#endif
