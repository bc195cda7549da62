/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/markers.h"

#include "pipeline/register/mark_fit.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

/* A mark is a burn of 40 to 150 um radius; spots are looked for on a ladder of radii that goes one
 * rung beyond either end, since a maximum needs two neighbours. */
static const double RADIUS_LEAST_UM = 40, RADIUS_MOST_UM = 150;
enum { RUNGS = 8, BLURS = RUNGS + 2 };
static const double RUNG = 1.3;
/* The difference of two Gaussians, sigma and 1.69 sigma, answers most strongly, with 0.369 of the
 * contrast, to a disc of radius 1.797 sigma: exp(-u/k^2) - exp(-u), u = R^2/(2 sigma^2). */
static const double RADIUS_PER_SIGMA = 1.797, RESPONSE = 0.369;
/* Optical density below which nothing is called a spot. */
static const double CONTRAST_LEAST = 0.05;
/* Spots are looked for in cells of at most this size; the fit goes back to the pixels. */
static const double CELL_UM = 25;
static const double PX_MOST_UM = 40;

struct field {
    size_t width, height;
    double cell_px; /* panel pixels per cell */
    float *value;
};

struct spot {
    double response;
    size_t x, y, rung;
};

static double rung_um(size_t rung)
{
    return RADIUS_LEAST_UM * pow(RUNG, (double)rung - 1);
}

/* Averages step x step pixels to a cell; masked pixels take no part. */
static void reduce(const struct gsn_plane *plane, const struct gsn_slot *slot, size_t step,
                   struct field *field)
{
    double sum = 0, n = 0;

    for (size_t i = 0; i < field->width * field->height; i++) {
        const size_t x0 = (size_t)slot->x + i % field->width * step;
        const size_t y0 = (size_t)slot->y + i / field->width * step;
        double cell = 0, cell_n = 0;

        for (size_t k = 0; k < step * step; k++) {
            const float value = plane->value[(y0 + k / step) * plane->width + x0 + k % step];

            if (isfinite(value)) {
                cell += value;
                cell_n += 1;
            }
        }
        sum += cell;
        n += cell_n;
        field->value[i] = cell_n > 0 ? (float)(cell / cell_n) : NAN;
    }
    /* A hole in the data must not look like a spot: it takes the mean of the section. */
    for (size_t i = 0; i < field->width * field->height; i++) {
        if (isnan(field->value[i]))
            field->value[i] = n > 0 ? (float)(sum / n) : 0;
    }
}

static size_t kernel_radius(double sigma)
{
    return (size_t)ceil(3 * sigma);
}

/* One pass of a Gaussian along rows, written transposed: twice gives the blur. Edges repeat. */
static void blur_rows(const float *from, size_t width, size_t height, const float *kernel,
                      size_t radius, float *padded, float *onto)
{
    for (size_t y = 0; y < height; y++) {
        const float *row = from + y * width;

        for (size_t i = 0; i < width + 2 * radius; i++) {
            const size_t x = i < radius ? 0 : i - radius;

            padded[i] = row[x < width ? x : width - 1];
        }
        for (size_t x = 0; x < width; x++) {
            float sum = 0;

            for (size_t k = 0; k <= 2 * radius; k++)
                sum += kernel[k] * padded[x + k];
            onto[x * height + y] = sum;
        }
    }
}

static void kernel_of(double sigma, float *kernel)
{
    const size_t radius = kernel_radius(sigma);
    double sum = 0;

    for (size_t k = 0; k <= 2 * radius; k++)
        sum += exp(-0.5 * pow(((double)k - (double)radius) / sigma, 2));
    for (size_t k = 0; k <= 2 * radius; k++)
        kernel[k] = (float)(exp(-0.5 * pow(((double)k - (double)radius) / sigma, 2)) / sum);
}

/* level[0] holds the field blurred for rung 0, level[1] for rung 1, ... each from the one before.
 */
static int blur_ladder(const struct field *field, double cell_um, float **level,
                       struct gsn_error *err)
{
    const size_t count = field->width * field->height;
    const size_t longest = field->width > field->height ? field->width : field->height;
    const double last = rung_um(BLURS - 1) / RADIUS_PER_SIGMA / cell_um;
    const size_t taps = 2 * kernel_radius(last) + 1;
    gsn_auto_mem(float) kernel = gsn_alloc_array(taps, sizeof *kernel);
    gsn_auto_mem(float) padded = gsn_alloc_array(longest + taps, sizeof *padded);
    gsn_auto_mem(float) turned = gsn_alloc_array(count, sizeof *turned);
    const float *from = field->value;
    double done = 0;

    if (!kernel || !padded || !turned)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    for (size_t rung = 0; rung < BLURS; rung++) {
        const double sigma = rung_um(rung) / RADIUS_PER_SIGMA / cell_um;
        const double step = sqrt(sigma * sigma - done * done);

        kernel_of(step, kernel);
        blur_rows(from, field->width, field->height, kernel, kernel_radius(step), padded, turned);
        blur_rows(turned, field->height, field->width, kernel, kernel_radius(step), padded,
                  level[rung]);
        from = level[rung];
        done = sigma;
    }
    return GSN_OK;
}

static double response_at(float *const *level, size_t index, size_t rung)
{
    return (double)level[rung][index] - (double)level[rung + 2][index];
}

/* Whether no neighbour in place or size answers more strongly; of equals the first counts. */
static int is_peak(float *const *level, const struct field *field, struct spot spot)
{
    for (size_t k = 0; k < 27; k++) {
        const size_t x = spot.x + k % 3 - 1, y = spot.y + k / 3 % 3 - 1,
                     rung = spot.rung + k / 9 - 1;
        const double other = response_at(level, y * field->width + x, rung);

        if (k != 13 && (other > spot.response || (other == spot.response && k < 13)))
            return 0;
    }
    return 1;
}

/* Keeps the strongest most spots, strongest first. */
static void keep(struct spot *kept, size_t *count, size_t most, struct spot spot)
{
    size_t at = *count;

    if (at == most && kept[at - 1].response >= spot.response)
        return;
    if (at < most)
        at = (*count)++;
    else
        at--;
    for (; at > 0 && kept[at - 1].response < spot.response; at--)
        kept[at] = kept[at - 1];
    kept[at] = spot;
}

static size_t find_peaks(float *const *level, const struct field *field, struct spot *ret_spots,
                         size_t most)
{
    size_t count = 0;

    for (size_t rung = 1; rung + 1 < RUNGS; rung++) {
        for (size_t y = 1; y + 1 < field->height; y++) {
            for (size_t x = 1; x + 1 < field->width; x++) {
                const double response = response_at(level, y * field->width + x, rung);
                const struct spot spot = { response, x, y, rung };

                if (response >= RESPONSE * CONTRAST_LEAST && is_peak(level, field, spot))
                    keep(ret_spots, &count, most, spot);
            }
        }
    }
    return count;
}

static double strength(const struct gsn_mark *mark)
{
    return mark->contrast * mark->score;
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
        for (size_t k = i; k + 1 < candidates->count; k++)
            candidates->mark[k] = candidates->mark[k + 1];
        candidates->count--;
        i--;
    }
    for (at = candidates->count++; at > 0; at--) {
        if (strength(&candidates->mark[at - 1]) >= strength(mark))
            break;
        candidates->mark[at] = candidates->mark[at - 1];
    }
    candidates->mark[at] = *mark;
}

static int measure_spots(const struct gsn_plane *plane, const struct gsn_slot *slot,
                         const struct field *field, const struct spot *spots, size_t count,
                         struct gsn_mark_candidates *candidates, struct gsn_error *err)
{
    for (size_t i = 0; i < count; i++) {
        const double radius = rung_um(spots[i].rung) / candidates->px_um;
        const struct gsn_point start = { slot->x + ((double)spots[i].x + 0.5) * field->cell_px,
                                         slot->y + ((double)spots[i].y + 0.5) * field->cell_px };
        struct gsn_mark mark;
        const int r = gsn_mark_fit(plane, start, radius, &mark, err);
        const double um = mark.radius_px * candidates->px_um;

        if (r < 0)
            return r;
        if (mark.found && mark.contrast >= CONTRAST_LEAST && um >= RADIUS_LEAST_UM &&
            um <= RADIUS_MOST_UM)
            add_mark(candidates, &mark);
    }
    return GSN_OK;
}

static int search(const struct gsn_plane *plane, const struct gsn_slot *slot,
                  struct gsn_mark_candidates *candidates, struct gsn_error *err)
{
    const size_t step = (size_t)fmax(floor(CELL_UM / candidates->px_um), 1);
    struct field field = { .width = (size_t)slot->width / step,
                           .height = (size_t)slot->height / step,
                           .cell_px = (double)step };
    const size_t cells = field.width * field.height;
    gsn_auto_mem(float) values = gsn_alloc_array(cells * (BLURS + 1), sizeof *values);
    struct spot spots[GSN_MARK_CANDIDATES];
    float *level[BLURS];
    int r;

    if (!values)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    if (cells == 0)
        return GSN_OK;
    field.value = values;
    for (size_t i = 0; i < BLURS; i++)
        level[i] = values + cells * (i + 1);
    reduce(plane, slot, step, &field);
    r = blur_ladder(&field, field.cell_px * candidates->px_um, level, err);
    if (r < 0)
        return r;
    return measure_spots(plane, slot, &field, spots,
                         find_peaks(level, &field, spots, GSN_MARK_CANDIDATES), candidates, err);
}

int gsn_markers_candidates(const struct gsn_plane *red_od, const struct gsn_slot *slot,
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
