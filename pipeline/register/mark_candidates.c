/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/markers.h"

#include "pipeline/core/mem.h"
#include "pipeline/register/mark_density.h"
#include "pipeline/register/mark_field.h"
#include "pipeline/register/mark_line.h"
#include "pipeline/register/mark_map.h"
#include "pipeline/register/mark_odds.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

static const double PX_MOST_UM = 40;
const struct gsn_mark_burn gsn_mark_burns[GSN_MARK_BURNS] = { { 1, 0 }, { 0.35, 0 }, { 3, 0 },
                                                              { 1, 1 }, { 0.35, 1 }, { 3, 1 } };
/* Spots that are measured: ink over the tissue has dozens that are darker than any mark, and few of
 * them are round. */
enum { SPOTS = 64 };
/* A spot this much fainter than a mark is none of three burnt alike: half of what a mark that is
 * half burnt in and half bleached may be. */
static const double FAINTEST = 0.125;
/* Those among which the ones like a known mark are looked for. */
enum { SPOTS_KNOWN = 1024 };

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

/* Of spots that come the likeliest first, there need be no more than there is room for; of those
 * that come the strongest first, none that is too faint. */
static int enough(const struct gsn_mark_candidates *candidates, const struct gsn_mark *next,
                  int likeliest_first)
{
    return likeliest_first ? candidates->count == GSN_MARK_CANDIDATES
                           : strength(next) < least_strength(candidates);
}

static int measure_spots(const struct gsn_mark_density *density, const struct gsn_slot *slot,
                         const struct gsn_mark *spots, size_t count, int likeliest_first,
                         struct gsn_mark_candidates *candidates, struct gsn_error *err)
{
    const struct gsn_mark_burn *burn = &gsn_mark_burns[candidates->burn];

    for (size_t i = 0; i < count && !enough(candidates, &spots[i], likeliest_first); i++) {
        struct gsn_mark mark;
        const int r = gsn_mark_density_fit(density, slot, spots[i].px, spots[i].radius_px,
                                           burn->holes, &mark, err);
        const double um = mark.radius_px * candidates->px_um / burn->scale;

        if (r < 0)
            return r;
        if (mark.found && mark.contrast >= gsn_mark_contrast_least &&
            um >= gsn_mark_radius_least_um && um <= gsn_mark_radius_most_um)
            add_mark(candidates, &mark);
    }
    return GSN_OK;
}

static double unlike(const struct gsn_mark *spot, double px_um,
                     const struct gsn_triangle_prior *prior)
{
    return gsn_mark_unlike(spot, px_um, prior) + gsn_mark_dirt(spot);
}

/* Brings the spots that are most like the known marks to the front; how many may be any. */
static size_t sort_by_looks(struct gsn_mark *spots, size_t count, double px_um,
                            const struct gsn_triangle_prior *prior)
{
    const size_t wanted = count < SPOTS ? count : SPOTS;

    for (size_t i = 0; i < wanted; i++) {
        struct gsn_mark kept;
        size_t best = i;

        for (size_t k = i + 1; k < count; k++)
            if (unlike(&spots[k], px_um, prior) < unlike(&spots[best], px_um, prior))
                best = k;
        kept = spots[best];
        memmove(spots + i + 1, spots + i, (best - i) * sizeof *spots);
        spots[i] = kept;
    }
    return wanted;
}

/* prior: what marks look like, or NULL. */
static int search(const struct gsn_mark_density *density, const struct gsn_slot *slot,
                  const struct gsn_triangle_prior *prior, struct gsn_mark_candidates *candidates,
                  struct gsn_error *err)
{
    const struct gsn_mark_burn *burn = &gsn_mark_burns[candidates->burn];
    /* Larger burns in larger cells are the ordinary kind again. */
    const double px_um = candidates->px_um / burn->scale;
    const size_t step = gsn_mark_field_step(px_um);
    struct gsn_mark_field field = { .width = (size_t)slot->width / step,
                                    .height = (size_t)slot->height / step,
                                    .cell_px = (double)step,
                                    .origin_px = { slot->x, slot->y } };
    gsn_auto_mem(float) values = gsn_alloc_array(field.width * field.height + 1, sizeof *values);
    gsn_auto_mem(struct gsn_mark) spots =
        gsn_alloc_array(prior ? SPOTS_KNOWN : SPOTS, sizeof *spots);
    struct gsn_mark_lined lined = { .density = density };
    const struct gsn_mark_density open = gsn_mark_density_without(&lined);
    size_t count;
    int r;

    if (!values || !spots)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    field.od = values;
    r = burn->holes ? gsn_mark_density_reduce_filled(density, slot, step, &field, err)
                    : gsn_mark_density_reduce(density, slot, step, &field, err);
    if (r < 0)
        return r;
    lined.count = gsn_mark_lines_bridge(&field, candidates->px_um, lined.line);
    gsn_mark_map_take(&field, &candidates->map);
    r = gsn_mark_field_spots(&field, px_um, prior ? SPOTS_KNOWN : SPOTS, spots, &count, err);
    if (r >= 0 && prior)
        count = sort_by_looks(spots, count, candidates->px_um, prior);
    return r < 0 ? r : measure_spots(&open, slot, spots, count, prior != NULL, candidates, err);
}

static int look(const struct gsn_mark_density *red_od, const struct gsn_slot *slot, double px_um,
                unsigned burn, const struct gsn_triangle_prior *prior,
                struct gsn_mark_candidates *ret_candidates, struct gsn_error *err)
{
    struct gsn_mark_candidates candidates = { .px_um = px_um, .burn = burn };
    int r;

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
    r = search(red_od, slot, prior, &candidates, err);
    if (r < 0)
        return r;
    *ret_candidates = candidates;
    return GSN_OK;
}

int gsn_markers_candidates(const struct gsn_mark_density *red_od, const struct gsn_slot *slot,
                           double px_um, struct gsn_mark_candidates *ret_candidates,
                           struct gsn_error *err)
{
    return gsn_markers_candidates_of(red_od, slot, px_um, 0, ret_candidates, err);
}

int gsn_markers_candidates_of(const struct gsn_mark_density *red_od, const struct gsn_slot *slot,
                              double px_um, unsigned burn,
                              struct gsn_mark_candidates *ret_candidates, struct gsn_error *err)
{
    assert(red_od && slot && burn < GSN_MARK_BURNS && ret_candidates);

    return look(red_od, slot, px_um, burn, NULL, ret_candidates, err);
}

int gsn_markers_seek(const struct gsn_mark_density *red_od, const struct gsn_slot *slot,
                     double px_um, const struct gsn_triangle_prior *prior,
                     struct gsn_mark_candidates *ret_candidates, struct gsn_error *err)
{
    assert(red_od && slot && prior && ret_candidates);

    return look(red_od, slot, px_um, prior->burn, prior->learnt ? prior : NULL, ret_candidates,
                err);
}
