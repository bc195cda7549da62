/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/slot_marks.h"

#include "pipeline/register/median.h"
#include "pipeline/stain/absorb.h"

#include <math.h>

/* Half of a slot's width, and a tenth of it for sections that do not lie in its middle. */
static const double SHARE = 0.6;
/* Half of the longer side of a section's box, and room for its turning and for a centre that is
 * off.
 */
static const double REACH = 0.65;

static void shift(struct gsn_point *point, const struct gsn_slot *slot)
{
    point->x += slot->x;
    point->y += slot->y;
}

double gsn_slot_typical_side(const struct gsn_slot *slots, size_t count, double *scratch)
{
    for (size_t i = 0; i < count; i++)
        scratch[i] = slots[i].width > slots[i].height ? slots[i].width : slots[i].height;
    return count > 0 ? gsn_median(scratch, count) : 0;
}

/* Where the marks of a section are looked for: around its tissue as far as the typical section
 * reaches, within its share of the panel. Its own box may end where an edge of glass cuts it or
 * where it has grown together with another, or reach over others that a line of ink ties to it. */
static struct gsn_slot search_window(const struct gsn_scan *scan, const struct gsn_layout *layout,
                                     double side, const struct gsn_slot *slot)
{
    const struct gsn_image *image = scan->picture->image;
    const double reach_x = fmin(SHARE * image->width / layout->columns, REACH * side);
    const double reach_y = fmin(SHARE * image->height / layout->rows, REACH * side);
    struct gsn_slot window = *slot;

    window.x = (int)fmax(slot->centre_px.x - reach_x, 0);
    window.y = (int)fmax(slot->centre_px.y - reach_y, 0);
    window.width = (int)fmin(slot->centre_px.x + reach_x, image->width) - window.x;
    window.height = (int)fmin(slot->centre_px.y + reach_y, image->height) - window.y;
    return window;
}

/* Red density is worked out inside the section's window alone. */
static int find_candidates(const struct gsn_scan *scan, const struct gsn_slot *slot,
                           struct gsn_mark_candidates *ret_candidates, struct gsn_error *err)
{
    const struct gsn_pixel_box box = { slot->x, slot->y, slot->width, slot->height };
    struct gsn_slot inside = *slot;
    struct gsn_plane *od[3] = { NULL };
    gsn_auto(gsn_plane) red = NULL;
    int r = gsn_absorb_box(scan->picture->image, &scan->glass, &box, 1, od, err);

    if (r < 0)
        return r;
    red = od[0];
    inside.x = inside.y = 0;
    inside.centre_px.x -= slot->x;
    inside.centre_px.y -= slot->y;
    r = gsn_markers_candidates(red, &inside, scan->px_um, ret_candidates, err);
    if (r < 0)
        return r;
    shift(&ret_candidates->tissue_px, slot);
    shift(&ret_candidates->map.origin, slot);
    for (size_t i = 0; i < ret_candidates->count; i++)
        shift(&ret_candidates->mark[i].px, slot);
    return GSN_OK;
}

int gsn_slot_marks(const struct gsn_scan *scan, const struct gsn_layout *layout, double side,
                   const struct gsn_slot *slot, struct gsn_mark_candidates *ret_candidates,
                   struct gsn_error *err)
{
    const struct gsn_slot window = search_window(scan, layout, side, slot);

    return find_candidates(scan, &window, ret_candidates, err);
}
