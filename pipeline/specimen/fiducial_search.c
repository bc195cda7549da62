/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Searches the marks around the sections of an opened panel.
 *
 * 1. The window of a section is centred on its tissue and as large as the typical section reaches,
 *    at most its share of the panel: its own box may be cut by an edge or grown together with
 * another.
 * 2. In each window spots of the usual burn are detected (register/markers.h).
 * 3. Where few sections agree on a triangle of such spots, the other kinds of burn are tried, and
 * the kind that most sections agree on is taken.
 *
 * Sections are searched side by side; the result does not depend on the number of threads. */
#include "pipeline/specimen/fiducial_search.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/parallel.h"
#include "pipeline/core/robust.h"
#include "pipeline/register/fiducial/detect.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/fiducial/learn.h"
#include "pipeline/register/panel/slots.h"
#include "pipeline/stain/optical_density.h"

#include <math.h>
#include <string.h>

/* Half of a slot's width, and a tenth of it for sections that do not lie in its middle. */
static const double SHARE = 0.6;
/* Half of the longer side of a section's box, and room for its turning and for a centre that is
 * off.
 */
static const double REACH = 0.65;

double gsn_fiducial_search_side(const struct gsn_slot *slots, size_t count, double *scratch)
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

static void red_row(const void *context, uint32_t x, uint32_t y, uint32_t apart, size_t count,
                    float *to)
{
    gsn_od_reader_red(context, x, y, apart, count, to);
}

int gsn_fiducial_search_section(const struct gsn_scan *scan, const struct gsn_od_reader *absorber,
                                const struct gsn_layout *layout, double side,
                                const struct gsn_slot *slot, unsigned burn,
                                const struct gsn_triangle_prior *prior,
                                struct gsn_fiducial_candidates *ret_candidates,
                                struct gsn_error *err)
{
    const struct gsn_slot window = search_window(scan, layout, side, slot);
    const struct gsn_image *image = scan->picture->image;
    const struct gsn_density_source red = { image->width, image->height, absorber, red_row };

    return prior ? gsn_fiducials_detect_like(&red, &window, scan->px_um, prior, ret_candidates, err)
                 : gsn_fiducials_detect_burn(&red, &window, scan->px_um, burn, ret_candidates, err);
}

/* One kind of burn in all sections. */
struct kind {
    const struct gsn_fiducial_search *search;
    unsigned burn;
    struct gsn_fiducial_candidates *candidates;
};

static int search_slot(size_t index, void *context, struct gsn_error *err)
{
    const struct kind *kind = context;
    const struct gsn_fiducial_search *search = kind->search;
    const struct gsn_slot *slot = &search->slots[index];
    const int r =
        gsn_fiducial_search_section(search->scan, search->absorber, &search->layout, search->side,
                                    slot, kind->burn, NULL, &kind->candidates[index], err);

    return r < 0 ? gsn_fail_at(err, "slot %u", slot->slot + 1) : GSN_OK;
}

static int search_kind(const struct gsn_fiducial_search *search, unsigned burn,
                       struct gsn_fiducial_candidates *candidates, struct gsn_error *err)
{
    struct kind kind = { search, burn, candidates };

    return gsn_parallel_for(search->count, search->threads, search_slot, &kind, err);
}

int gsn_fiducial_search_panel(const struct gsn_fiducial_search *search,
                              const struct gsn_point *mark_um,
                              struct gsn_fiducial_candidates *ret_candidates, struct gsn_error *err)
{
    const size_t count = search->count;
    gsn_auto_mem(struct gsn_fiducial_candidates) all = NULL;
    unsigned burn = 0;
    int odd, r = search_kind(search, 0, ret_candidates, err);

    if (r >= 0)
        r = gsn_fiducials_are_odd(ret_candidates, count, mark_um, &odd, err);
    if (r < 0 || !odd)
        return r;
    all = gsn_alloc_array(GSN_BURNS * count, sizeof *all);
    if (!all)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    memcpy(all, ret_candidates, count * sizeof *all);
    for (unsigned k = 1; r >= 0 && k < GSN_BURNS; k++)
        r = search_kind(search, k, all + k * count, err);
    if (r >= 0)
        r = gsn_fiducials_choose_burn(all, count, mark_um, &burn, err);
    if (r < 0)
        return r;
    memcpy(ret_candidates, all + burn * count, count * sizeof *all);
    return GSN_OK;
}
