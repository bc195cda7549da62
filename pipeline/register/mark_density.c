/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_density.h"

#include "pipeline/core/mem.h"
#include "pipeline/register/mark_fill.h"
#include "pipeline/register/mark_fit.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* Pixels read of a cell along each side: a blur over a dozen cells follows, so that four of a cell
 * of 5 x 5 show every spot that all of them show. */
enum { TAPS = 2 };
/* Fits that are begun anew where one has wandered to; one that never rests is of no mark. */
enum { AGAIN = 3 };
/* A window reaches a little further than the fit's, which is 2.3 radii. */
static const double WINDOW = 2.4;

/* Pixels that lie alike on either side of a cell's middle. */
static uint32_t tap(size_t step, size_t i)
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

/* A hole in the data must not look like a spot: it takes the mean of the section. */
static void fill_holes(struct gsn_mark_field *field)
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

int gsn_mark_density_reduce(const struct gsn_mark_density *density, const struct gsn_slot *slot,
                            size_t step, struct gsn_mark_field *field, struct gsn_error *err)
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
            density->row(density->context, (uint32_t)slot->x + tap(step, k % taps),
                         (uint32_t)slot->y + (uint32_t)(y * step) + tap(step, k / taps),
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
static void take_darkest(const struct gsn_mark_density *density, const struct gsn_slot *slot,
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

int gsn_mark_density_reduce_filled(const struct gsn_mark_density *density,
                                   const struct gsn_slot *slot, size_t step,
                                   struct gsn_mark_field *field, struct gsn_error *err)
{
    /* Cells of a third of a cell, or of a pixel. */
    const size_t side = step % 3 == 0 ? step / 3 : 1, per = step / side;
    const size_t width = field->width * per, height = field->height * per;
    gsn_auto_mem(float) small = gsn_alloc((width * height + width + 1) * sizeof *small);
    int r;

    if (!small)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    for (size_t y = 0; y < height; y++)
        take_darkest(density, slot, side, y, width, small + width * height, small + y * width);
    r = gsn_mark_fill(small, width, height, err);
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

/* One fit, with the pixels around its start. */
static int fit_from(const struct gsn_mark_density *density, const struct gsn_slot *slot,
                    struct gsn_point start, double radius_px, int holes, struct gsn_mark *ret_mark,
                    struct gsn_error *err)
{
    const double reach = WINDOW * radius_px + 2;
    const int x0 = (int)fmax(floor(start.x - reach), slot->x);
    const int y0 = (int)fmax(floor(start.y - reach), slot->y);
    const int x1 = (int)fmin(ceil(start.x + reach), slot->x + slot->width);
    const int y1 = (int)fmin(ceil(start.y + reach), slot->y + slot->height);
    gsn_auto_mem(float) value = gsn_alloc((size_t)(x1 - x0) * (size_t)(y1 - y0) * sizeof *value);
    const struct gsn_plane window = { (uint32_t)(x1 - x0), (uint32_t)(y1 - y0), value };
    struct gsn_mark mark;
    int r;

    assert(x1 > x0 && y1 > y0);

    if (!value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the window of a mark");
    for (int y = y0; y < y1; y++)
        density->row(density->context, (uint32_t)x0, (uint32_t)y, 1, window.width,
                     value + (size_t)(y - y0) * window.width);
    if (holes && (r = gsn_mark_fill(value, window.width, window.height, err)) < 0)
        return r;
    r = gsn_mark_fit(&window, (struct gsn_point){ start.x - x0, start.y - y0 }, radius_px, &mark,
                     err);
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
static int is_seen(struct gsn_point start, double radius_px, const struct gsn_mark *mark)
{
    const double moved = hypot(mark->px.x - start.x, mark->px.y - start.y);

    return moved + GSN_MARK_FIT_REACH / GSN_MARK_FIT_FACTOR * mark->radius_px <=
           GSN_MARK_FIT_REACH * radius_px;
}

static int is_inside(const struct gsn_slot *slot, struct gsn_point at)
{
    return at.x >= slot->x && at.x <= slot->x + slot->width && at.y >= slot->y &&
           at.y <= slot->y + slot->height;
}

int gsn_mark_density_fit(const struct gsn_mark_density *density, const struct gsn_slot *slot,
                         struct gsn_point start, double radius_px, int holes,
                         struct gsn_mark *ret_mark, struct gsn_error *err)
{
    struct gsn_mark mark;
    int r = fit_from(density, slot, start, radius_px, holes, &mark, err);

    for (int again = 0; r >= 0 && mark.found && !is_seen(start, radius_px, &mark); again++) {
        if (again == AGAIN || !is_inside(slot, mark.px)) {
            mark = (struct gsn_mark){ 0 };
            break;
        }
        start = mark.px;
        radius_px = mark.radius_px;
        r = fit_from(density, slot, start, radius_px, holes, &mark, err);
    }
    if (r < 0)
        return r;
    *ret_mark = mark;
    return GSN_OK;
}
