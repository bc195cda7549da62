/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/markers.h"

#include "pipeline/register/mark_density.h"
#include "pipeline/register/mark_field.h"
#include "pipeline/register/mark_map.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

static const double PX_MOST_UM = 40;
/* Spots that are measured: ink over the tissue has dozens that are darker than any mark, and few of
 * them are round. */
enum { SPOTS = 64 };
/* A spot this much fainter than a mark is none of three burnt alike: half of what a mark that is
 * half burnt in and half bleached may be. */
static const double FAINTEST = 0.125;

static double strength(const struct gsn_mark *mark)
{
    return mark->contrast * mark->score;
}

static void drop(struct gsn_mark_candidates *candidates, size_t at)
{
    for (size_t k = at; k + 1 < candidates->count; k++)
        candidates->mark[k] = candidates->mark[k + 1];
    candidates->count--;
}

/* Of too many, the one that is least of a disc goes, however dark: ink is dark. Whether the new one
 * may come. */
static int make_room(struct gsn_mark_candidates *candidates, const struct gsn_mark *mark)
{
    size_t worst = 0;

    for (size_t i = 1; i < candidates->count; i++)
        if (candidates->mark[i].score < candidates->mark[worst].score)
            worst = i;
    if (candidates->mark[worst].score >= mark->score)
        return 0;
    drop(candidates, worst);
    return 1;
}

/* Puts a mark in its place by strength; of two on one spot the stronger stays. */
static void add_mark(struct gsn_mark_candidates *candidates, const struct gsn_mark *mark)
{
    size_t at;

    for (size_t i = 0; i < candidates->count; i++) {
        const struct gsn_mark *other = &candidates->mark[i];
        const double apart = hypot(other->px.x - mark->px.x, other->px.y - mark->px.y);

        if (apart >= fmax(other->radius_px, mark->radius_px))
            continue;
        if (strength(other) >= strength(mark))
            return;
        drop(candidates, i--);
    }
    if (candidates->count == GSN_MARK_CANDIDATES && !make_room(candidates, mark))
        return;
    for (at = candidates->count++; at > 0; at--) {
        if (strength(&candidates->mark[at - 1]) >= strength(mark))
            break;
        candidates->mark[at] = candidates->mark[at - 1];
    }
    candidates->mark[at] = *mark;
}

/* The strength below which a spot is none of the marks, as far as they have been measured: three
 * are burnt alike, and the third strongest is one of them unless it is ink. */
static double least_strength(const struct gsn_mark_candidates *candidates)
{
    return candidates->count < GSN_MARKS ? 0
                                         : FAINTEST * strength(&candidates->mark[GSN_MARKS - 1]);
}

/* Spots come the strongest first. */
static int measure_spots(const struct gsn_mark_density *density, const struct gsn_slot *slot,
                         const struct gsn_mark *spots, size_t count,
                         struct gsn_mark_candidates *candidates, struct gsn_error *err)
{
    for (size_t i = 0; i < count && strength(&spots[i]) >= least_strength(candidates); i++) {
        struct gsn_mark mark;
        const int r =
            gsn_mark_density_fit(density, slot, spots[i].px, spots[i].radius_px, &mark, err);
        const double um = mark.radius_px * candidates->px_um;

        if (r < 0)
            return r;
        if (mark.found && mark.contrast >= gsn_mark_contrast_least &&
            um >= gsn_mark_radius_least_um && um <= gsn_mark_radius_most_um)
            add_mark(candidates, &mark);
    }
    return GSN_OK;
}

static int search(const struct gsn_mark_density *density, const struct gsn_slot *slot,
                  struct gsn_mark_candidates *candidates, struct gsn_error *err)
{
    const size_t step = gsn_mark_field_step(candidates->px_um);
    struct gsn_mark_field field = { .width = (size_t)slot->width / step,
                                    .height = (size_t)slot->height / step,
                                    .cell_px = (double)step,
                                    .origin_px = { slot->x, slot->y } };
    gsn_auto_mem(float) values = gsn_alloc_array(field.width * field.height + 1, sizeof *values);
    struct gsn_mark spots[SPOTS];
    size_t count;
    int r;

    if (!values)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    field.od = values;
    r = gsn_mark_density_reduce(density, slot, step, &field, err);
    if (r < 0)
        return r;
    gsn_mark_map_take(&field, &candidates->map);
    r = gsn_mark_field_spots(&field, candidates->px_um, SPOTS, spots, &count, err);
    return r < 0 ? r : measure_spots(density, slot, spots, count, candidates, err);
}

int gsn_markers_candidates(const struct gsn_mark_density *red_od, const struct gsn_slot *slot,
                           double px_um, struct gsn_mark_candidates *ret_candidates,
                           struct gsn_error *err)
{
    struct gsn_mark_candidates candidates = { .px_um = px_um };
    int r;

    assert(red_od && slot && ret_candidates);

    if (!(px_um > 0 && px_um <= PX_MOST_UM))
        return gsn_fail(err, GSN_E_INPUT,
                        "a pixel of %g um: marks need a pixel size above 0 and up to %g um", px_um,
                        PX_MOST_UM);
    if (!slot->found)
        return gsn_fail(err, GSN_E_INPUT, "slot %u is empty: it has no marks", slot->slot + 1);
    if (slot->x < 0 || slot->y < 0 || slot->width < 1 || slot->height < 1 ||
        (uint32_t)slot->width > red_od->width || (uint32_t)slot->height > red_od->height ||
        (uint32_t)slot->x > red_od->width - (uint32_t)slot->width ||
        (uint32_t)slot->y > red_od->height - (uint32_t)slot->height)
        return gsn_fail(err, GSN_E_INPUT, "the box of slot %u reaches outside the panel",
                        slot->slot + 1);
    candidates.tissue_px = slot->centre_px;
    r = search(red_od, slot, &candidates, err);
    if (r < 0)
        return r;
    *ret_candidates = candidates;
    return GSN_OK;
}
