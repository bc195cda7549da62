/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: candidates by multi-scale blobs (blob.h), each then localised (localise.h).
 *
 * Steps of gsn_fiducials_detect(). 1. The slot is reduced to cells of some 25 um by a few pixels
 * of each; where burns may be holes, all pixels are read and what a dark rim encloses is filled
 * (grey-value closing by pipeline/imaging, and reconstruction, which OpenCV's core and imgproc do
 * not have). 2. Edges of coverslips are bridged (line.h), the thumbnail of the tissue is taken. 3.
 * Blobs, the strongest first, or, once it is learnt what marks look like, those that look most like
 * them first. 4. Each is localised from the pixels around it; where the fit wandered so far that it
 * saw too little tissue, it is begun anew from there. 5. Of two in one place the stronger stays; of
 * too many, the least round goes.
 *
 * Fails when the pixel size or the slot is out of range, and when memory runs out. Cost: the
 * wavelet's pass over the cells and the fits of at most 64 blobs. */
#include "pipeline/register/fiducial/detect.h"

#include "pipeline/core/mem.h"
#include "pipeline/imaging/morphology.h"
#include "pipeline/register/fiducial/blob.h"
#include "pipeline/register/fiducial/localise.h"
#include "pipeline/register/fiducial/line.h"
#include "pipeline/register/fiducial/thumbnail.h"
#include "pipeline/register/fiducial/appearance.h"
#include "pipeline/register/fiducial/fiducial.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- holes with a dark rim ------------------------------------------------------------------- */

/* Radius of a structuring element of 3 x 3 cells. */
static const double SQUARE = 1.5;

/* The level that a way over a neighbour needs: no less than the cell's own. */
static inline float way_level(float own, float level, float neighbour)
{
    const float way = neighbour > own ? neighbour : own;

    return way < level ? way : level;
}

/* From a row's neighbour on one side, then along the row, both ways. */
static int sweep_row(const float *own, const float *beside, size_t width, float *level)
{
    int changed = 0;

    for (size_t x = 0; x < width; x++) {
        float now = way_level(own[x], level[x], beside[x]);

        now = x > 0 ? way_level(own[x], now, level[x - 1]) : now;
        changed |= now < level[x];
        level[x] = now;
    }
    for (size_t x = width - 1; x-- > 0;) {
        const float now = way_level(own[x], level[x], level[x + 1]);

        changed |= now < level[x];
        level[x] = now;
    }
    return changed;
}

/* Raises level, which is infinite inside, until every cell has its way out. */
static void flood_from_edge(const float *own, size_t width, size_t height, float *level)
{
    int changed = 1;

    while (changed) {
        changed = 0;
        for (size_t y = 1; y < height; y++)
            changed |=
                sweep_row(own + y * width, level + (y - 1) * width, width, level + y * width);
        for (size_t y = height - 1; y-- > 0;)
            changed |=
                sweep_row(own + y * width, level + (y + 1) * width, width, level + y * width);
    }
}

int gsn_fill_dark_rims(float *value, size_t width, size_t height, struct gsn_error *err)
{
    gsn_auto_mem(float) room = NULL;
    float *own, *level;
    int r;

    assert(value);

    if (width < 3 || height < 3)
        return GSN_OK;
    room = gsn_alloc(2 * width * height * sizeof *room);
    if (!room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for holes with a dark rim");
    own = room;
    level = room + width * height;
    for (size_t i = 0; i < width * height; i++)
        own[i] = isnan(value[i]) ? -INFINITY : value[i];
    r = gsn_dilate_values(own, (uint32_t)width, (uint32_t)height, SQUARE, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < width * height; i++) {
        const size_t x = i % width, y = i / width;
        const int edge = x == 0 || y == 0 || x + 1 == width || y + 1 == height;

        level[i] = edge ? own[i] : INFINITY;
    }
    flood_from_edge(own, width, height, level);
    r = gsn_erode_values(level, (uint32_t)width, (uint32_t)height, SQUARE, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < width * height; i++)
        if (!isnan(value[i]))
            value[i] = level[i];
    return GSN_OK;
}

/* ---- from pixels to cells -------------------------------------------------------------------- */

/* Pixels read of a cell along each side: a blur over a dozen cells follows, so that four of a cell
 * of 5 x 5 show every blob that all of them show. */
enum { TAPS = 2 };

/* Fits that are begun anew where one has wandered to; one that never rests is of no mark. */
enum { AGAIN = 3 };

/* A window reaches a little further than the fit's, which is 2.3 radii. */
static const double WINDOW = 2.4;

/* Pixels that lie alike on either side of a cell's middle. */
static uint32_t tap_offset(size_t step, size_t i)
{
    return (uint32_t)(i == 0 ? step / 4 : step - 1 - step / 4);
}

/* The sum of what is not masked, and how many that are. */
static void add_tap(const float *restrict from, size_t count, float *restrict sum,
                    float *restrict n)
{
    for (size_t i = 0; i < count; i++) {
        const int is = isfinite(from[i]);

        sum[i] += is ? from[i] : 0;
        n[i] += is ? 1.0f : 0.0f;
    }
}

/* A hole in the data must not look like a blob: it takes the mean of the section. */
static void fill_holes(struct gsn_blob_field *field)
{
    const size_t cells = field->width * field->height;
    double sum = 0, n = 0;

    for (size_t i = 0; i < cells; i++)
        if (!isnan(field->od[i])) {
            sum += (double)field->od[i];
            n += 1;
        }
    for (size_t i = 0; i < cells && n < (double)cells; i++)
        if (isnan(field->od[i]))
            field->od[i] = n > 0 ? (float)(sum / n) : 0;
}

int gsn_density_reduce(const struct gsn_density_source *density, const struct gsn_slot *slot,
                       size_t step, struct gsn_blob_field *field, struct gsn_error *err)
{
    const size_t taps = step < TAPS ? step : TAPS, width = field->width;
    gsn_auto_mem(float) room = gsn_alloc_array(2 * width + 1, sizeof *room);

    if (!room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    for (size_t y = 0; y < field->height; y++) {
        float *sum = field->od + y * width, *row = room, *n = room + width;

        memset(sum, 0, width * sizeof *sum);
        memset(n, 0, width * sizeof *n);
        for (size_t k = 0; k < taps * taps; k++) {
            density->row(density->context, (uint32_t)slot->x + tap_offset(step, k % taps),
                         (uint32_t)slot->y + (uint32_t)(y * step) + tap_offset(step, k / taps),
                         (uint32_t)step, width, row);
            add_tap(row, width, sum, n);
        }
        for (size_t x = 0; x < width; x++)
            sum[x] = n[x] > 0 ? sum[x] / n[x] : NAN;
    }
    fill_holes(field);
    return GSN_OK;
}

/* The darkest of the pixels of each small cell of side px; those masked take no part. */
static void find_darkest(const struct gsn_density_source *density, const struct gsn_slot *slot,
                         size_t side, size_t y, size_t count, float *row, float *ret_darkest)
{
    for (size_t i = 0; i < count; i++)
        ret_darkest[i] = NAN;
    for (size_t k = 0; k < side * side; k++) {
        density->row(density->context, (uint32_t)(slot->x + (int)(k % side)),
                     (uint32_t)(slot->y + (int)(y * side + k / side)), (uint32_t)side, count, row);
        for (size_t i = 0; i < count; i++)
            ret_darkest[i] = fmaxf(ret_darkest[i], row[i]);
    }
}

int gsn_density_reduce_filled(const struct gsn_density_source *density, const struct gsn_slot *slot,
                              size_t step, struct gsn_blob_field *field, struct gsn_error *err)
{
    /* Cells of a third of a cell, or of a pixel. */
    const size_t side = step % 3 == 0 ? step / 3 : 1, per = step / side;
    const size_t width = field->width * per, height = field->height * per;
    gsn_auto_mem(float) small = gsn_alloc((width * height + width + 1) * sizeof *small);
    int r;

    if (!small)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    for (size_t y = 0; y < height; y++)
        find_darkest(density, slot, side, y, width, small + width * height, small + y * width);
    r = gsn_fill_dark_rims(small, width, height, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < field->width * field->height; i++) {
        const float *from = small + i / field->width * per * width + i % field->width * per;
        float sum = 0, n = 0;

        for (size_t k = 0; k < per * per; k++)
            add_tap(from + k / per * width + k % per, 1, &sum, &n);
        field->od[i] = n > 0 ? sum / n : NAN;
    }
    fill_holes(field);
    return GSN_OK;
}

/* ---- one fit --------------------------------------------------------------------------------- */

/* One fit, with the pixels around its start. */
static int fit_once(const struct gsn_density_source *density, const struct gsn_slot *slot,
                    struct gsn_point start, double radius_px, int holes,
                    struct gsn_fiducial *ret_mark, struct gsn_error *err)
{
    const double reach = WINDOW * radius_px + 2;
    const int x0 = (int)fmax(floor(start.x - reach), slot->x);
    const int y0 = (int)fmax(floor(start.y - reach), slot->y);
    const int x1 = (int)fmin(ceil(start.x + reach), slot->x + slot->width);
    const int y1 = (int)fmin(ceil(start.y + reach), slot->y + slot->height);
    gsn_auto_mem(float) value = gsn_alloc((size_t)(x1 - x0) * (size_t)(y1 - y0) * sizeof *value);
    const struct gsn_plane window = { (uint32_t)(x1 - x0), (uint32_t)(y1 - y0), value };
    struct gsn_fiducial mark;
    int r;

    assert(x1 > x0 && y1 > y0);

    if (!value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the window of a mark");
    for (int y = y0; y < y1; y++)
        density->row(density->context, (uint32_t)x0, (uint32_t)y, 1, window.width,
                     value + (size_t)(y - y0) * window.width);
    if (holes && (r = gsn_fill_dark_rims(value, window.width, window.height, err)) < 0)
        return r;
    r = gsn_fiducial_localise(&window, (struct gsn_point){ start.x - x0, start.y - y0 }, radius_px,
                              &mark, err);
    if (r < 0)
        return r;
    if (mark.found) {
        mark.px.x += x0;
        mark.px.y += y0;
    }
    *ret_mark = mark;
    return GSN_OK;
}

/* Whether the pixels that a fit looked at reach as far around the mark that it found as around one
 * whose radius was guessed as wrongly as it may be. Of tissue that was hardly seen, the level is
 * what a slope from elsewhere makes of it, and with it the contrast. */
static int is_seen(struct gsn_point start, double radius_px, const struct gsn_fiducial *mark)
{
    const double moved = hypot(mark->px.x - start.x, mark->px.y - start.y);

    return moved + GSN_LOCALISE_REACH / GSN_LOCALISE_FACTOR * mark->radius_px <=
           GSN_LOCALISE_REACH * radius_px;
}

static int is_inside(const struct gsn_slot *slot, struct gsn_point at)
{
    return at.x >= slot->x && at.x <= slot->x + slot->width && at.y >= slot->y &&
           at.y <= slot->y + slot->height;
}

int gsn_density_localise(const struct gsn_density_source *density, const struct gsn_slot *slot,
                         struct gsn_point start, double radius_px, int holes,
                         struct gsn_fiducial *ret_mark, struct gsn_error *err)
{
    struct gsn_fiducial mark;
    int r = fit_once(density, slot, start, radius_px, holes, &mark, err);

    for (int again = 0; r >= 0 && mark.found && !is_seen(start, radius_px, &mark); again++) {
        if (again == AGAIN || !is_inside(slot, mark.px)) {
            mark = (struct gsn_fiducial){ 0 };
            break;
        }
        start = mark.px;
        radius_px = mark.radius_px;
        r = fit_once(density, slot, start, radius_px, holes, &mark, err);
    }
    if (r < 0)
        return r;
    *ret_mark = mark;
    return GSN_OK;
}

/* ---- candidates ------------------------------------------------------------------------------ */

static const double PX_MOST_UM = 40;
const struct gsn_burn gsn_burns[GSN_BURNS] = { { 1, 0 }, { 0.35, 0 }, { 3, 0 },
                                               { 1, 1 }, { 0.35, 1 }, { 3, 1 },
                                               { 4.5, 1 } };

/* Blobs that are measured: ink over the tissue has dozens that are darker than any mark, and few of
 * them are round. */
enum { BLOBS = 64 };

/* A blob this much fainter than a mark is none of three burnt alike: half of what a mark that is
 * half burnt in and half bleached may be. */
static const double FAINTEST = 0.125;

/* Those among which the ones like a known mark are looked for. */
enum { BLOBS_KNOWN = 1024 };

static double strength_of(const struct gsn_fiducial *mark)
{
    return mark->contrast * mark->score;
}

static void drop_candidate(struct gsn_fiducial_candidates *candidates, size_t at)
{
    for (size_t k = at; k + 1 < candidates->count; k++)
        candidates->mark[k] = candidates->mark[k + 1];
    candidates->count--;
}

/* Of too many, the one that is least of a disc goes, however dark: ink is dark. Whether the new one
 * may come. */
static int make_room(struct gsn_fiducial_candidates *candidates, const struct gsn_fiducial *mark)
{
    size_t worst = 0;

    for (size_t i = 1; i < candidates->count; i++)
        if (candidates->mark[i].score < candidates->mark[worst].score)
            worst = i;
    if (candidates->mark[worst].score >= mark->score)
        return 0;
    drop_candidate(candidates, worst);
    return 1;
}

/* Puts a mark in its place by strength; of two on one blob the stronger stays. */
static void add_mark(struct gsn_fiducial_candidates *candidates, const struct gsn_fiducial *mark)
{
    size_t at;

    for (size_t i = 0; i < candidates->count; i++) {
        const struct gsn_fiducial *other = &candidates->mark[i];
        const double apart = hypot(other->px.x - mark->px.x, other->px.y - mark->px.y);

        if (apart >= fmax(other->radius_px, mark->radius_px))
            continue;
        if (strength_of(other) >= strength_of(mark))
            return;
        drop_candidate(candidates, i--);
    }
    if (candidates->count == GSN_FIDUCIAL_CANDIDATES && !make_room(candidates, mark))
        return;
    for (at = candidates->count++; at > 0; at--) {
        if (strength_of(&candidates->mark[at - 1]) >= strength_of(mark))
            break;
        candidates->mark[at] = candidates->mark[at - 1];
    }
    candidates->mark[at] = *mark;
}

/* The strength below which a blob is none of the marks, as far as they have been measured: three
 * are burnt alike, and the third strongest is one of them unless it is ink. */
static double least_strength(const struct gsn_fiducial_candidates *candidates)
{
    return candidates->count < GSN_FIDUCIALS
               ? 0
               : FAINTEST * strength_of(&candidates->mark[GSN_FIDUCIALS - 1]);
}

/* Of blobs that come the likeliest first, there need be no more than there is room for; of those
 * that come the strongest first, none that is too faint. */
static int is_enough(const struct gsn_fiducial_candidates *candidates,
                     const struct gsn_fiducial *next, int likeliest_first)
{
    return likeliest_first ? candidates->count == GSN_FIDUCIAL_CANDIDATES
                           : strength_of(next) < least_strength(candidates);
}

static int localise_blobs(const struct gsn_density_source *density, const struct gsn_slot *slot,
                          const struct gsn_fiducial *blobs, size_t count, int likeliest_first,
                          struct gsn_fiducial_candidates *candidates, struct gsn_error *err)
{
    const struct gsn_burn *burn = &gsn_burns[candidates->burn];

    for (size_t i = 0; i < count && !is_enough(candidates, &blobs[i], likeliest_first); i++) {
        struct gsn_fiducial mark;
        const int r = gsn_density_localise(density, slot, blobs[i].px, blobs[i].radius_px,
                                           burn->holes, &mark, err);
        const double um = mark.radius_px * candidates->px_um / burn->scale;

        if (r < 0)
            return r;
        if (mark.found && mark.contrast >= gsn_blob_contrast_min && um >= gsn_burn_radius_min_um &&
            um <= gsn_burn_radius_max_um)
            add_mark(candidates, &mark);
    }
    return GSN_OK;
}

static double appearance_distance(const struct gsn_fiducial *blob, double px_um,
                                  const struct gsn_triangle_prior *prior)
{
    return gsn_appearance_distance(blob, px_um, prior) + gsn_appearance_residual(blob);
}

/* Brings the blobs that are most like the known marks to the front; how many may be any. */
static size_t sort_by_appearance(struct gsn_fiducial *blobs, size_t count, double px_um,
                                 const struct gsn_triangle_prior *prior)
{
    const size_t wanted = count < BLOBS ? count : BLOBS;

    for (size_t i = 0; i < wanted; i++) {
        struct gsn_fiducial kept;
        size_t best = i;

        for (size_t k = i + 1; k < count; k++)
            if (appearance_distance(&blobs[k], px_um, prior) <
                appearance_distance(&blobs[best], px_um, prior))
                best = k;
        kept = blobs[best];
        memmove(blobs + i + 1, blobs + i, (best - i) * sizeof *blobs);
        blobs[i] = kept;
    }
    return wanted;
}

/* prior: what marks look like, or NULL. */
static int search_slot(const struct gsn_density_source *density, const struct gsn_slot *slot,
                       const struct gsn_triangle_prior *prior,
                       struct gsn_fiducial_candidates *candidates, struct gsn_error *err)
{
    const struct gsn_burn *burn = &gsn_burns[candidates->burn];
    /* Larger burns in larger cells are the ordinary kind again. */
    const double px_um = candidates->px_um / burn->scale;
    const size_t step = gsn_blob_cell_px(px_um);
    struct gsn_blob_field field = { .width = (size_t)slot->width / step,
                                    .height = (size_t)slot->height / step,
                                    .cell_px = (double)step,
                                    .origin_px = { slot->x, slot->y } };
    gsn_auto_mem(float) values = gsn_alloc_array(field.width * field.height + 1, sizeof *values);
    gsn_auto_mem(struct gsn_fiducial) blobs =
        gsn_alloc_array(prior ? BLOBS_KNOWN : BLOBS, sizeof *blobs);
    struct gsn_lined_density lined = { .density = density };
    const struct gsn_density_source open = gsn_density_without_lines(&lined);
    size_t count;
    int r;

    if (!values || !blobs)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    field.od = values;
    r = burn->holes ? gsn_density_reduce_filled(density, slot, step, &field, err)
                    : gsn_density_reduce(density, slot, step, &field, err);
    if (r < 0)
        return r;
    lined.count = gsn_coverslip_lines_bridge(&field, candidates->px_um, lined.line);
    gsn_thumbnail_take(&field, &candidates->map);
    r = gsn_blobs_find(&field, px_um, prior ? BLOBS_KNOWN : BLOBS, blobs, &count, err);
    if (r >= 0 && prior)
        count = sort_by_appearance(blobs, count, candidates->px_um, prior);
    return r < 0 ? r : localise_blobs(&open, slot, blobs, count, prior != NULL, candidates, err);
}

static int detect_in_slot(const struct gsn_density_source *red_od, const struct gsn_slot *slot,
                          double px_um, unsigned burn, const struct gsn_triangle_prior *prior,
                          struct gsn_fiducial_candidates *ret_candidates, struct gsn_error *err)
{
    struct gsn_fiducial_candidates candidates = { .px_um = px_um, .burn = burn };
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
    r = search_slot(red_od, slot, prior, &candidates, err);
    if (r < 0)
        return r;
    *ret_candidates = candidates;
    return GSN_OK;
}

int gsn_fiducials_detect(const struct gsn_density_source *red_od, const struct gsn_slot *slot,
                         double px_um, struct gsn_fiducial_candidates *ret_candidates,
                         struct gsn_error *err)
{
    return gsn_fiducials_detect_burn(red_od, slot, px_um, 0, ret_candidates, err);
}

int gsn_fiducials_detect_burn(const struct gsn_density_source *red_od, const struct gsn_slot *slot,
                              double px_um, unsigned burn,
                              struct gsn_fiducial_candidates *ret_candidates, struct gsn_error *err)
{
    assert(red_od && slot && burn < GSN_BURNS && ret_candidates);

    return detect_in_slot(red_od, slot, px_um, burn, NULL, ret_candidates, err);
}

int gsn_fiducials_detect_like(const struct gsn_density_source *red_od, const struct gsn_slot *slot,
                              double px_um, const struct gsn_triangle_prior *prior,
                              struct gsn_fiducial_candidates *ret_candidates, struct gsn_error *err)
{
    assert(red_od && slot && prior && ret_candidates);

    return detect_in_slot(red_od, slot, px_um, prior->burn, prior->learnt ? prior : NULL,
                          ret_candidates, err);
}
