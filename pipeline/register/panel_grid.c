/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel_grid.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

/* In sizes of a section: centres further apart than this stand in different lines; lines nearer to
 * each other than this would make sections overlap. */
static const double LINE_GAP = 0.6, PITCH_LEAST = 0.9;
/* In pitches: how near to the border of the panel a slot's centre may lie, and how far a line may
 * lie from its place. */
static const double BORDER = 0.3, STRAY = 0.3;

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

/* Merges sorted centres into lines, in place: centre[i] becomes the mean of line i. */
static size_t merge_lines(double *centre, size_t count, double gap)
{
    size_t lines = 0, in_line = 0;
    double sum = 0, last = 0;

    for (size_t i = 0; i < count; i++) {
        const double now = centre[i];

        if (in_line > 0 && now - last > gap) {
            centre[lines++] = sum / (double)in_line;
            sum = 0;
            in_line = 0;
        }
        sum += now;
        in_line++;
        last = now;
    }
    if (in_line > 0)
        centre[lines++] = sum / (double)in_line;
    return lines;
}

/* The regular grid nearest to the lines when neighbours are about pitch apart: ret_first is where
 * the first line found lies, ret_span the number of pitches from it to the last. 0: not regular. */
static int straighten(const double *line, size_t count, double *pitch, double *ret_first,
                      unsigned *ret_span)
{
    const double n = (double)count;
    double sum_i = 0, sum_ii = 0, sum_c = 0, sum_ic = 0, slope;

    for (size_t k = 0; k < count; k++) {
        const double i = round((line[k] - line[0]) / *pitch);

        sum_i += i;
        sum_ii += i * i;
        sum_c += line[k];
        sum_ic += i * line[k];
    }
    slope = (n * sum_ic - sum_i * sum_c) / (n * sum_ii - sum_i * sum_i);
    *ret_first = (sum_c - slope * sum_i) / n;
    *ret_span = (unsigned)round((line[count - 1] - line[0]) / *pitch);
    for (size_t k = 0; k < count; k++) {
        const double i = round((line[k] - line[0]) / *pitch);

        if (fabs(line[k] - *ret_first - i * slope) > STRAY * slope)
            return 0;
    }
    *pitch = slope;
    return 1;
}

/* In how many ways the grid can be laid on the panel so that the lines found are lines span apart;
 * ret_before is the number of empty lines before the first found, in the last of those ways. */
static unsigned ways(double first, double pitch, unsigned span, unsigned lines, double length,
                     unsigned *ret_before)
{
    unsigned count = 0;

    for (unsigned before = 0; before + span < lines; before++) {
        const double start = first - before * pitch;
        const double end = start + (lines - 1) * pitch;

        if (span + 1 < lines && (start < BORDER * pitch || end > length - BORDER * pitch))
            continue;
        count++;
        *ret_before = before;
    }
    return count;
}

static int undecided(unsigned count, size_t found, unsigned lines, const char *what,
                     struct gsn_error *err)
{
    if (count == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "the %zu %ss of tissue found do not fit a regular grid of %u on this panel",
                        found, what, lines);
    return gsn_fail(
        err, GSN_E_INPUT,
        "only %zu of %u %ss hold tissue, and which ones cannot be told from their place", found,
        lines, what);
}

/* Two lines or more: the widest pitch for which the grid has room. */
static int fit_lines(const double *line, size_t found, unsigned lines, double size, double length,
                     const char *what, struct gsn_panel_axis *ret_axis, struct gsn_error *err)
{
    double least = INFINITY;

    for (size_t k = 1; k < found; k++)
        least = fmin(least, line[k] - line[k - 1]);
    for (unsigned parts = 1; least / parts >= PITCH_LEAST * size; parts++) {
        double pitch = least / parts, first;
        unsigned span, before = 0, count;

        if (!straighten(line, found, &pitch, &first, &span))
            continue;
        count = ways(first, pitch, span, lines, length, &before);
        if (count > 1)
            return undecided(count, found, lines, what, err);
        if (count == 1) {
            *ret_axis = (struct gsn_panel_axis){ lines, first - before * pitch, pitch };
            return GSN_OK;
        }
    }
    return undecided(0, found, lines, what, err);
}

int gsn_panel_axis_fit(double *centre, size_t count, unsigned lines, double size, double length,
                       double pitch, const char *what, struct gsn_panel_axis *ret_axis,
                       struct gsn_error *err)
{
    unsigned before = 0, number;
    size_t found;

    assert(centre && count > 0 && lines > 0 && size > 0 && ret_axis);

    qsort(centre, count, sizeof *centre, ascending);
    found = merge_lines(centre, count, LINE_GAP * size);
    if (found > lines)
        return gsn_fail(err, GSN_E_INPUT, "tissue lies in %zu %ss, the protocol says %u", found,
                        what, lines);
    if (lines == 1) {
        *ret_axis = (struct gsn_panel_axis){ 1, centre[0], length };
        return GSN_OK;
    }
    if (found > 1)
        return fit_lines(centre, found, lines, size, length, what, ret_axis, err);
    if (!(pitch > 0))
        return gsn_fail(err, GSN_E_INPUT,
                        "only 1 of %u %ss holds tissue, and which one cannot be told", lines, what);
    number = ways(centre[0], pitch, 0, lines, length, &before);
    if (number != 1)
        return undecided(number, found, lines, what, err);
    *ret_axis = (struct gsn_panel_axis){ lines, centre[0] - before * pitch, pitch };
    return GSN_OK;
}

int gsn_panel_axis_line(const struct gsn_panel_axis *axis, double position)
{
    const double line = round((position - axis->first) / axis->pitch);

    return line >= 0 && line < axis->lines ? (int)line : -1;
}
