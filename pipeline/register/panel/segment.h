/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What on a scanned panel is one section each: tissue is told from glass, torn from threads and
 * taken apart where sections grew together.
 *
 * The panel comes as cells of some 50 um (reduce.h); all lengths and areas here are in cells. */
#ifndef GSN_REGISTER_PANEL_SEGMENT_H
#define GSN_REGISTER_PANEL_SEGMENT_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/image.h"
#include "pipeline/core/mem.h"
#include "pipeline/imaging/components.h"

#ifdef __cplusplus
extern "C" {
#endif

/* In areas of a typical section: components alike within this factor vote for each other. */
#define GSN_PANEL_SAME_AREA 1.6
/* What joins two sections and is thinner than this is no tissue of theirs. */
#define GSN_PANEL_THREAD_UM 250.0

/* Closes gaps of up to two cells, then separates what touches in none of the 8 directions.
 *
 * mask holds width * height bytes, rows from top to bottom, 0 outside and 1 inside. thread: what
 * is at most so many cells wide joins nothing: where a hair or the edge of a coverslip runs from
 * one thing to the next, it is left out between them; a thing that is that thin all over is a
 * component of its own and marked so. 0 keeps everything together.
 * gives: components, in the order in which their first cells come, and for each whether no place of
 * it is wider than a thread (ret_thin; NULL where nobody asks). Fails with GSN_E_NOMEM. */
int gsn_segment_mask(const uint8_t *mask, uint32_t width, uint32_t height, unsigned thread,
                     struct gsn_components **ret_components, uint8_t **ret_thin,
                     struct gsn_error *err);

/* The same of what is darker than glass. tissue: optical densities, about 0 on glass; NaN counts as
 * glass. Fails with GSN_E_NOMEM. */
int gsn_segment_tissue(const struct gsn_plane *tissue, double cell_um,
                       struct gsn_components **ret_components, uint8_t **ret_thin,
                       struct gsn_error *err);

int gsn_segment_is_dust(const struct gsn_component *component, double cell_um);

/* The area that sections share: the size class of components that covers most of the panel. A label
 * may be larger than a section, and print is more numerous, but neither covers as much. 0: there is
 * nothing but dust. */
double gsn_segment_section_area(const struct gsn_components *components, double cell_um);

/* Some cells; [x0, x1) by [y0, y1). */
struct gsn_part {
    size_t area;
    int x0, y0, x1, y1;
    double sum_x, sum_y;
};

/* One section's cells, or those of something else: a component, a part of one that holds several
 * sections, or the components of a torn section. */
struct gsn_panel_region {
    struct gsn_part part; /* empty: joined to another region */
    size_t component;     /* the first of its components */
    int cut;              /* it is part of a component that holds several */
    /* Where cut: the region at the other side of its widest neck, that neck's width and ends. */
    size_t beside;
    double neck;
    struct gsn_point end[2];
};

struct gsn_panel_regions {
    size_t count;
    struct gsn_panel_region *region;
};

void gsn_panel_regions_free(struct gsn_panel_regions *regions);
GSN_DEFINE_AUTO(gsn_panel_regions);

/* area: of one section. most: a component larger than so many sections holds several. near:
 * components nearer to each other than this that make up no more than one section are one region.
 * gives: ret_regions; every component is part of one at least. Fails with GSN_E_NOMEM. */
int gsn_segment_regions(const struct gsn_components *components, double area, double most,
                        double near, struct gsn_panel_regions **ret_regions, struct gsn_error *err);

/* Adds the cells of one part to another. */
void gsn_part_add(struct gsn_part *sum, const struct gsn_part *part);
struct gsn_point gsn_part_centre(const struct gsn_part *part);
/* Between the boxes; 0 when they meet. */
double gsn_part_distance(const struct gsn_part *a, const struct gsn_part *b);

#ifdef __cplusplus
}
#endif
#endif
