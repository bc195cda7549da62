/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: a straight line by hypotheses of two points (as RANSAC, but over all pairs of the darkest
 * places of five columns), then least squares over the darkest places along it.
 *
 * Steps of gsn_coverslip_lines_bridge(), for lines along x and along y. 1. A place stands out by
 * how much darker it is than both of its sides. 2. Of the lines through two such places of
 * different columns the one that shows along most of its way. 3. It is fitted anew three times, and
 * refused unless it shows along four fifths of the way. 4. Its width is where its darkness ends, by
 * the mean over its length; the cells under it are replaced by a straight way from one side to the
 * other.
 *
 * Cannot fail. Cost: little beside the wavelet. */
#include "pipeline/register/fiducial/line.h"
#include "pipeline/register/fiducial/detect.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* The edge of a glass is some 40 um of shadow; so far to either side it is over. */
static const double BESIDE_UM = 80;
/* Darker than both sides by this, in optical density... */
static const double EXCESS = 0.1;
/* ...along this share of the way: where it crosses a burn or ink it does not show. */
static const double SHOWN = 0.8;
/* What is left of its own darkness where it ends, across. */
static const double ENDS = 0.15;

/* Where lines are begun from: the darkest places of some columns, two by two. */
enum { COLUMNS = 5, PEAKS = 4, FITS = 3, GLANCE = 8 };

/* The field seen so that the line runs along u. */
struct view {
    const struct gsn_blob_field *field;
    int steep;
    ptrdiff_t length, across, beside; /* cells */
};

struct trace {
    double start, slope; /* cells; the middle of the first cell is 0 */
};

static double value_at(const struct view *view, ptrdiff_t u, ptrdiff_t v)
{
    const size_t x = (size_t)(view->steep ? v : u), y = (size_t)(view->steep ? u : v);

    return (double)view->field->od[y * view->field->width + x];
}

/* How much darker a place is than both sides; less than nothing at the field's border. */
static double excess_at(const struct view *view, ptrdiff_t u, ptrdiff_t v)
{
    if (v < view->beside || v >= view->across - view->beside)
        return -1;
    return value_at(view, u, v) -
           fmax(value_at(view, u, v - view->beside), value_at(view, u, v + view->beside));
}

/* The darkest place within a cell of the trace. */
static double darkest_near(const struct view *view, const struct trace *trace, ptrdiff_t u,
                           ptrdiff_t *ret_v)
{
    const ptrdiff_t at = (ptrdiff_t)lround(trace->start + trace->slope * (double)u);
    double most = -1;

    for (ptrdiff_t v = at - 1; v <= at + 1; v++) {
        const double e = excess_at(view, u, v);

        if (e > most) {
            most = e;
            *ret_v = v;
        }
    }
    return most;
}

/* By every apart-th place of it. */
static double share_shown(const struct view *view, const struct trace *trace, ptrdiff_t apart)
{
    size_t shown = 0, seen = 0;
    ptrdiff_t v;

    for (ptrdiff_t u = apart / 2; u < view->length; u += apart, seen++)
        shown += darkest_near(view, trace, u, &v) >= EXCESS;
    return (double)shown / (double)seen;
}

/* The places of a column that stand out most, each the first of its surroundings. */
static size_t peaks_of(const struct view *view, ptrdiff_t u, ptrdiff_t ret_v[PEAKS])
{
    double height[PEAKS];
    size_t count = 0;

    for (ptrdiff_t v = view->beside; v < view->across - view->beside; v++) {
        const double e = excess_at(view, u, v);
        size_t at;

        if (e < EXCESS || e < excess_at(view, u, v - 1) || e <= excess_at(view, u, v + 1))
            continue;
        if (count == PEAKS && height[PEAKS - 1] >= e)
            continue;
        at = count < PEAKS ? count++ : PEAKS - 1;
        for (; at > 0 && height[at - 1] < e; at--) {
            height[at] = height[at - 1];
            ret_v[at] = ret_v[at - 1];
        }
        height[at] = e;
        ret_v[at] = v;
    }
    return count;
}

/* Least squares through the darkest places along the trace. */
static struct trace refit_trace(const struct view *view, const struct trace *trace)
{
    double n = 0, su = 0, sv = 0, suu = 0, suv = 0, det;

    for (ptrdiff_t u = 0; u < view->length; u++) {
        ptrdiff_t v = 0;

        if (darkest_near(view, trace, u, &v) < EXCESS)
            continue;
        n += 1;
        su += (double)u;
        sv += (double)v;
        suu += (double)u * (double)u;
        suv += (double)u * (double)v;
    }
    det = n * suu - su * su;
    if (!(det > 0))
        return *trace;
    return (struct trace){ (sv * suu - su * suv) / det, (n * suv - su * sv) / det };
}

/* The best trace through two peaks of different columns. */
static double best_trace(const struct view *view, struct trace *ret_trace)
{
    ptrdiff_t at[COLUMNS], v[COLUMNS][PEAKS];
    size_t count[COLUMNS];
    double best = 0;

    for (size_t k = 0; k < COLUMNS; k++) {
        at[k] = view->length * (2 * (ptrdiff_t)k + 1) / (2 * COLUMNS);
        count[k] = peaks_of(view, at[k], v[k]);
    }
    for (size_t a = 0; a < COLUMNS; a++)
        for (size_t b = a + 1; b < COLUMNS; b++)
            for (size_t pair = 0; pair < count[a] * count[b]; pair++) {
                const ptrdiff_t va = v[a][pair / count[b]], vb = v[b][pair % count[b]];
                const double slope = (double)(vb - va) / (double)(at[b] - at[a]);
                const struct trace trace = { (double)va - slope * (double)at[a], slope };
                const double shown = fabs(slope) <= 1 ? share_shown(view, &trace, GLANCE) : 0;

                if (shown > best) {
                    best = shown;
                    *ret_trace = trace;
                }
            }
    return best;
}

/* How far from its middle a line is still dark, in cells: by the mean over its length. */
static double half_width(const struct view *view, const struct trace *trace)
{
    double peak = 0;

    for (ptrdiff_t d = 0; d <= view->beside; d++) {
        double sum = 0, n = 0;

        for (ptrdiff_t u = 0; u < view->length; u++) {
            const ptrdiff_t v = (ptrdiff_t)lround(trace->start + trace->slope * (double)u);

            if (excess_at(view, u, v) < EXCESS)
                continue;
            for (int side = -1; side <= 1; side += 2)
                sum += value_at(view, u, v + side * d) - value_at(view, u, v + side * view->beside);
            n += 2;
        }
        if (d == 0)
            peak = sum / n;
        else if (!(sum / n > ENDS * peak))
            return (double)d - 0.5;
    }
    return (double)view->beside;
}

/* A straight way from one side of the line to the other. */
static void bridge_cells(const struct view *view, const struct trace *trace, double half, float *od)
{
    const ptrdiff_t reach = (ptrdiff_t)ceil(half) + 1;

    for (ptrdiff_t u = 0; u < view->length; u++) {
        const ptrdiff_t at = (ptrdiff_t)lround(trace->start + trace->slope * (double)u);
        const ptrdiff_t from = at - reach, to = at + reach;
        double near, far;

        if (from < 0 || to >= view->across)
            continue;
        near = value_at(view, u, from);
        far = value_at(view, u, to);
        for (ptrdiff_t v = from + 1; v < to; v++) {
            const size_t x = (size_t)(view->steep ? v : u), y = (size_t)(view->steep ? u : v);

            od[y * view->field->width + x] =
                (float)(near + (far - near) * (double)(v - from) / (double)(to - from));
        }
    }
}

static int find_along(const struct view *view, struct gsn_coverslip_line *ret_line)
{
    const struct gsn_blob_field *field = view->field;
    const double along = view->steep ? field->origin_px.y : field->origin_px.x;
    const double other = view->steep ? field->origin_px.x : field->origin_px.y;
    const double cell = field->cell_px;
    struct trace trace = { 0 };
    double half;

    if (view->length < 4 * COLUMNS || view->across <= 2 * view->beside + 2)
        return 0;
    if (best_trace(view, &trace) < 0.5 * SHOWN)
        return 0;
    for (int k = 0; k < FITS; k++)
        trace = refit_trace(view, &trace);
    if (share_shown(view, &trace, 1) < SHOWN)
        return 0;
    half = half_width(view, &trace);
    bridge_cells(view, &trace, half, field->od);
    *ret_line = (struct gsn_coverslip_line){
        .steep = view->steep,
        .slope = trace.slope,
        .half_px = half * cell,
        .start = other + (trace.start + 0.5) * cell - trace.slope * (along + 0.5 * cell),
    };
    return 1;
}

size_t gsn_coverslip_lines_bridge(struct gsn_blob_field *field, double px_um,
                                  struct gsn_coverslip_line ret_line[GSN_COVERSLIP_LINES])
{
    const ptrdiff_t beside = (ptrdiff_t)ceil(BESIDE_UM / (field->cell_px * px_um));
    size_t count = 0;

    for (int steep = 0; steep < 2; steep++) {
        const struct view view = {
            .field = field,
            .steep = steep,
            .length = (ptrdiff_t)(steep ? field->height : field->width),
            .across = (ptrdiff_t)(steep ? field->width : field->height),
            .beside = beside,
        };

        count += (size_t)find_along(&view, &ret_line[count]);
    }
    return count;
}

static void row_without(const void *context, uint32_t x, uint32_t y, uint32_t apart, size_t count,
                        float *to)
{
    const struct gsn_lined_density *lined = context;

    lined->density->row(lined->density->context, x, y, apart, count, to);
    for (size_t k = 0; k < lined->count; k++) {
        const struct gsn_coverslip_line *line = &lined->line[k];

        for (size_t i = 0; i < count; i++) {
            const double px = (double)x + (double)(i * apart) + 0.5, py = (double)y + 0.5;
            const double off = line->steep ? px - line->start - line->slope * py
                                           : py - line->start - line->slope * px;

            if (fabs(off) <= line->half_px)
                to[i] = NAN;
        }
    }
}

struct gsn_density_source gsn_density_without_lines(const struct gsn_lined_density *lined)
{
    assert(lined && lined->density);

    return (struct gsn_density_source){ lined->density->width, lined->density->height, lined,
                                        row_without };
}
