/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What on a panel is one section each: pieces of tissue, pieces cut apart where sections touch, and
 * pieces of one torn section taken together. Units are cells of the reduced panel. */
#ifndef GSN_REGISTER_PANEL_UNITS_H
#define GSN_REGISTER_PANEL_UNITS_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/mem.h"
#include "pipeline/register/split.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Some cells; [x0, x1) by [y0, y1). */
struct gsn_part {
    size_t area;
    int x0, y0, x1, y1;
    double sum_x, sum_y;
};

struct gsn_panel_unit {
    struct gsn_part part; /* empty: taken together with another unit */
    size_t piece;         /* the first of its pieces */
    int cut;              /* it is part of a piece that holds several */
    /* Where cut: the unit at the other side of its widest neck, that neck's width and ends. */
    size_t beside;
    double neck;
    struct gsn_point end[2];
};

struct gsn_panel_units {
    size_t count;
    struct gsn_panel_unit *unit;
};

void gsn_panel_units_free(struct gsn_panel_units *units);
GSN_DEFINE_AUTO(gsn_panel_units);

/* area: of one section, in cells. most: a piece larger than so many sections holds several.
 * near: pieces nearer to each other than this that make up no more than one section are one unit.
 * gives: ret_units; every piece is part of one at least. Fails with GSN_E_NOMEM. */
int gsn_panel_units_find(const struct gsn_components *pieces, double area, double most, double near,
                         struct gsn_panel_units **ret_units, struct gsn_error *err);

/* Adds the cells of one part to another. */
void gsn_part_add(struct gsn_part *sum, const struct gsn_part *part);
struct gsn_point gsn_part_centre(const struct gsn_part *part);
/* Between the boxes; 0 when they meet. */
double gsn_part_distance(const struct gsn_part *a, const struct gsn_part *b);

#ifdef __cplusplus
}
#endif
#endif
