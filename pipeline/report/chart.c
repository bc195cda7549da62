/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Charts as SVG: one linear map from data to the drawing for each, axes ticked at 1, 2 or 5 times a
 * power of ten (P. Heckbert, "Nice numbers for graph labels", 1990), and shapes that tell apart
 * without colour; dots and columns have a title each, which a pointer or a screen reader finds.
 *
 * Failure: the text remembers that memory ran out. A histogram or a figure by the day that has no
 * values is not drawn. Cost: linear in the values. */
#include "pipeline/report/chart.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"

#include <math.h>
#include <time.h>

/* Data to drawing: a rectangle of user units with the data's ranges along its sides. */
struct frame {
    double left, top, right, bottom;
    double x0, x1, y0, y1;
};

static double place_x(const struct frame *frame, double x)
{
    return frame->left + (x - frame->x0) / (frame->x1 - frame->x0) * (frame->right - frame->left);
}

static double place_y(const struct frame *frame, double y)
{
    return frame->bottom - (y - frame->y0) / (frame->y1 - frame->y0) * (frame->bottom - frame->top);
}

double gsn_chart_step(double range, unsigned parts)
{
    static const double nice[] = { 1, 2, 5 };
    const double rough = range / parts;
    const double power = pow(10, floor(log10(rough)));

    for (int i = 0; i < 3; i++)
        if (nice[i] * power >= rough * (1 - 1e-9))
            return nice[i] * power;
    return 10 * power;
}

static int decimals_of(double step)
{
    const int decimals = -(int)floor(log10(step) + 1e-9);

    return decimals > 0 ? decimals : 0;
}

static void open_svg(struct gsn_report_text *text, double width, double height, const char *title)
{
    gsn_report_text_print(
        text, "<svg viewBox=\"0 0 %.0f %.0f\" role=\"img\" class=\"chart\"><title>", width, height);
    gsn_report_text_escape(text, title);
    gsn_report_text_raw(text, "</title>\n");
}

static void write_label(struct gsn_report_text *text, double x, double y, const char *anchor,
                        double value, int decimals)
{
    gsn_report_text_print(text, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\">", x, y, anchor);
    gsn_report_text_number(text, value, decimals);
    gsn_report_text_raw(text, "</text>\n");
}

static void axis_x(struct gsn_report_text *text, const struct frame *frame, double step,
                   const char *name)
{
    const long first = lround(ceil(frame->x0 / step)), last = lround(floor(frame->x1 / step));

    for (long i = first; i <= last; i++)
        write_label(text, place_x(frame, (double)i * step), frame->bottom + 15, "middle",
                    (double)i * step, decimals_of(step));
    gsn_report_text_print(
        text,
        "<path class=\"axis\" d=\"M%.1f %.1fH%.1f\"/>\n"
        "<text class=\"name\" x=\"%.1f\" y=\"%.1f\" text-anchor=\"end\">%s</text>\n",
        frame->left, frame->bottom, frame->right, frame->right, frame->bottom + 31, name);
}

static void axis_y(struct gsn_report_text *text, const struct frame *frame, double step,
                   const char *name)
{
    const long last = lround(floor(frame->y1 / step + 1e-9));

    for (long i = 0; i <= last; i++) {
        const double y = place_y(frame, (double)i * step);

        gsn_report_text_print(text, "<path class=\"grid\" d=\"M%.1f %.1fH%.1f\"/>\n", frame->left,
                              y, frame->right);
        write_label(text, frame->left - 6, y + 4, "end", (double)i * step, decimals_of(step));
    }
    gsn_report_text_print(text, "<text class=\"name\" x=\"%.1f\" y=\"%.1f\">%s</text>\n", 2.0,
                          frame->top - 10, name);
}

/* Marks differ by shape as well as by colour. */
static void draw_dot(struct gsn_report_text *text, int mark, double x, double y,
                     const struct gsn_report_section *section)
{
    switch (mark) {
    case 0:
        gsn_report_text_print(text, "<circle class=\"m1\" cx=\"%.1f\" cy=\"%.1f\" r=\"3\">", x, y);
        break;
    case 1:
        gsn_report_text_print(
            text, "<rect class=\"m2\" x=\"%.1f\" y=\"%.1f\" width=\"5.4\" height=\"5.4\">", x - 2.7,
            y - 2.7);
        break;
    default:
        gsn_report_text_print(text, "<path class=\"m3\" d=\"M%.1f %.1fl3.4 6h-6.8z\">", x, y - 3.6);
    }
    gsn_report_text_print(text, "<title>Section %u.%u, mark %d: ", section->panel,
                          section->slot + 1, mark + 1);
    gsn_report_text_number(text, section->residual_um[mark], 2);
    gsn_report_text_print(text, " \xC2\xB5m</title></%s>\n",
                          mark == 0   ? "circle"
                          : mark == 1 ? "rect"
                                      : "path");
}

static void draw_legend(struct gsn_report_text *text, double x, double y)
{
    gsn_report_text_print(text,
                          "<circle class=\"m1\" cx=\"%.1f\" cy=\"%.1f\" r=\"3\"/>"
                          "<text x=\"%.1f\" y=\"%.1f\">mark 1</text>\n",
                          x, y - 4, x + 8, y);
    gsn_report_text_print(text,
                          "<rect class=\"m2\" x=\"%.1f\" y=\"%.1f\" width=\"5.4\" height=\"5.4\"/>"
                          "<text x=\"%.1f\" y=\"%.1f\">mark 2</text>\n",
                          x + 57, y - 6.7, x + 68, y);
    gsn_report_text_print(text,
                          "<path class=\"m3\" d=\"M%.1f %.1fl3.4 6h-6.8z\"/>"
                          "<text x=\"%.1f\" y=\"%.1f\">mark 3</text>\n",
                          x + 120, y - 7.6, x + 128, y);
}

static double largest_residual(const struct gsn_report *report)
{
    double most = 0;

    for (size_t i = 0; i < report->section_count; i++)
        for (int k = 0; k < 3; k++)
            if (report->sections[i].marker_found[k] && report->sections[i].posed)
                most = fmax(most, report->sections[i].residual_um[k]);
    return most;
}

static unsigned last_serial(const struct gsn_report *report)
{
    unsigned last = 0;

    for (size_t i = 0; i < report->section_count; i++)
        if (report->sections[i].serial > last)
            last = report->sections[i].serial;
    return last;
}

void gsn_chart_residuals(struct gsn_report_text *text, const struct gsn_report *report)
{
    const double most = fmax(largest_residual(report), 0.5);
    const double step = gsn_chart_step(most, 5);
    const double last = last_serial(report);
    struct frame frame = { 44, 34, 546, 214, -0.5, last + 0.5, 0, step * ceil(most / step) };

    open_svg(text, 560, 252, "Distance of every mark from the common triangle, by section");
    axis_y(text, &frame, step, "\xC2\xB5m");
    axis_x(text, &frame, fmax(gsn_chart_step(last + 1, 12), 1), "serial number of the section");
    draw_legend(text, 374, 18);
    for (size_t i = 0; i < report->section_count; i++) {
        const struct gsn_report_section *section = &report->sections[i];

        if (!section->posed) {
            gsn_report_text_print(
                text,
                "<rect class=\"gap\" x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" "
                "height=\"%.1f\"><title>Section %u.%u has no pose</title></rect>\n",
                place_x(&frame, section->serial - 0.5), frame.top,
                place_x(&frame, 1) - place_x(&frame, 0), frame.bottom - frame.top, section->panel,
                section->slot + 1);
            continue;
        }
        for (int k = 0; k < 3; k++)
            if (section->marker_found[k] && isfinite(section->residual_um[k]))
                draw_dot(text, k, place_x(&frame, section->serial),
                         place_y(&frame, section->residual_um[k]), section);
    }
    gsn_report_text_raw(text, "</svg>\n");
}

static size_t find_fullest(const struct gsn_report_units *units)
{
    size_t most = 1;

    for (size_t i = 0; i < units->bin_count; i++)
        if (units->bin[i] > most)
            most = units->bin[i];
    return most;
}

void gsn_chart_densities(struct gsn_report_text *text, const struct gsn_report_units *units)
{
    const double most = (double)find_fullest(units);
    const double step = fmax(gsn_chart_step(most, 5), 1);
    const int usable = units->bin_count > 0 && units->last > units->first;
    struct frame frame = {
        52, 34, 546, 214, units->first, units->last, 0, step * ceil(most / step)
    };

    if (!usable)
        return;
    open_svg(text, 560, 252, "How many micro-units have which mean density");
    axis_y(text, &frame, step, "micro-units");
    axis_x(text, &frame, gsn_chart_step(units->last - units->first, 10), "mean density");
    for (size_t i = 0; i < units->bin_count; i++) {
        const double width = (units->last - units->first) / (double)units->bin_count;
        const double from = units->first + (double)i * width;
        const double x = place_x(&frame, from), y = place_y(&frame, (double)units->bin[i]);

        if (units->bin[i] == 0)
            continue;
        gsn_report_text_print(
            text,
            "<rect class=\"bar\" x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\">"
            "<title>",
            x + 0.5, y, fmax(place_x(&frame, from + width) - x - 1, 0.5), frame.bottom - y);
        gsn_report_text_number(text, from, 3);
        gsn_report_text_raw(text, " to ");
        gsn_report_text_number(text, from + width, 3);
        gsn_report_text_raw(text, ": ");
        gsn_report_text_count(text, units->bin[i]);
        gsn_report_text_raw(text, "</title></rect>\n");
    }
    if (units->median >= units->first && units->median <= units->last) {
        const double x = place_x(&frame, units->median);

        gsn_report_text_print(
            text,
            "<path class=\"median\" d=\"M%.1f %.1fV%.1f\"/>\n"
            "<text class=\"strong\" x=\"%.1f\" y=\"%.1f\" text-anchor=\"middle\">median ",
            x, frame.top - 6, frame.bottom, x, frame.top - 12);
        gsn_report_text_number(text, units->median, 3);
        gsn_report_text_raw(text, "</text>\n");
    }
    gsn_report_text_raw(text, "</svg>\n");
}

static void loss_bar(struct gsn_report_text *text, double y, double density, double scale,
                     const char *style)
{
    gsn_report_text_print(
        text,
        "<rect class=\"track\" x=\"0\" y=\"%.0f\" width=\"400\" height=\"14\" rx=\"3\"/>"
        "<rect class=\"%s\" x=\"0\" y=\"%.0f\" width=\"%.1f\" height=\"14\" "
        "rx=\"3\"/>\n",
        y, style, y, 400 * fmin(fmax(density / scale, 0), 1));
}

void gsn_chart_loss(struct gsn_report_text *text, double baseline, double specimen)
{
    const double scale = fmax(fmax(baseline, specimen), 1);

    open_svg(text, 400, 38, "Mean density of the baseline above, of this specimen below");
    loss_bar(text, 0, baseline, scale, "base");
    loss_bar(text, 22, specimen, scale, "own");
    gsn_report_text_raw(text, "</svg>\n");
}

/* ---- a figure by the day --------------------------------------------------------------------- */

enum { SECONDS_A_DAY = 86400 };

/* The days and the values that there are, with some room; 0: fewer than two of them. */
static int find_ranges(const struct gsn_chart_dot *dot, size_t count, struct frame *frame)
{
    size_t seen = 0;

    frame->x0 = frame->y0 = INFINITY;
    frame->x1 = frame->y1 = -INFINITY;
    for (size_t i = 0; i < count; i++) {
        const double day = (double)dot[i].when / SECONDS_A_DAY;

        if (!isfinite(dot[i].value) || dot[i].when <= 0)
            continue;
        seen++;
        frame->x0 = fmin(frame->x0, day);
        frame->x1 = fmax(frame->x1, day);
        frame->y0 = fmin(frame->y0, dot[i].value);
        frame->y1 = fmax(frame->y1, dot[i].value);
    }
    return seen >= 2;
}

static void write_day(struct gsn_report_text *text, const struct frame *frame, double day,
                      const char *anchor)
{
    const time_t when = (time_t)(day * SECONDS_A_DAY);
    struct tm at = { 0 };
    char said[16] = "";

    (void)gmtime_r(&when, &at);
    (void)strftime(said, sizeof said, "%Y-%m-%d", &at);
    gsn_report_text_print(text, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\">%s</text>\n",
                          place_x(frame, day), frame->bottom + 15, anchor, said);
}

/* Lines at whole steps between the ends. */
static void write_levels(struct gsn_report_text *text, const struct frame *frame, double step)
{
    const long first = lround(ceil(frame->y0 / step - 1e-9));
    const long last = lround(floor(frame->y1 / step + 1e-9));

    for (long i = first; i <= last; i++) {
        const double y = place_y(frame, (double)i * step);

        gsn_report_text_print(text, "<path class=\"grid\" d=\"M%.1f %.1fH%.1f\"/>\n", frame->left,
                              y, frame->right);
        write_label(text, frame->left - 6, y + 4, "end", (double)i * step, decimals_of(step));
    }
}

static void draw_median(struct gsn_report_text *text, const struct frame *frame,
                        const struct gsn_chart_dot *dot, size_t count)
{
    gsn_auto_mem(double) value = gsn_alloc_array(count, sizeof *value);
    size_t n = 0;
    double y;

    if (!value) {
        text->failed = 1;
        return;
    }
    for (size_t i = 0; i < count; i++)
        if (isfinite(dot[i].value) && dot[i].when > 0)
            value[n++] = dot[i].value;
    y = place_y(frame, gsn_median(value, n));
    gsn_report_text_print(text, "<path class=\"median\" d=\"M%.1f %.1fH%.1f\"/>\n", frame->left, y,
                          frame->right);
}

void gsn_chart_days(struct gsn_report_text *text, const char *what, const char *unit,
                    const struct gsn_chart_dot *dot, size_t count)
{
    struct frame frame = { 56, 34, 546, 150, 0, 0, 0, 0 };
    const int drawn = find_ranges(dot, count, &frame);
    double step;
    int one_day;

    if (!drawn)
        return;
    one_day = frame.x1 - frame.x0 < 1;
    if (one_day) {
        frame.x0 -= 0.5;
        frame.x1 += 0.5;
    }
    step = gsn_chart_step(fmax(frame.y1 - frame.y0, 1e-3 * fmax(fabs(frame.y1), 1e-3)), 4);
    frame.y0 = step * floor(frame.y0 / step - 0.25);
    frame.y1 = step * ceil(frame.y1 / step + 0.25);
    open_svg(text, 560, 176, what);
    gsn_report_text_print(text, "<text class=\"name\" x=\"2.0\" y=\"%.1f\">", frame.top - 14);
    gsn_report_text_escape(text, what);
    gsn_report_text_print(text, "%s%s</text>\n", *unit ? ", " : "", unit);
    write_levels(text, &frame, step);
    if (one_day) {
        write_day(text, &frame, (frame.x0 + frame.x1) / 2, "middle");
    } else {
        write_day(text, &frame, frame.x0, "start");
        write_day(text, &frame, frame.x1, "end");
    }
    draw_median(text, &frame, dot, count);
    for (size_t i = 0; i < count; i++) {
        if (!isfinite(dot[i].value) || dot[i].when <= 0)
            continue;
        gsn_report_text_print(text, "<circle class=\"m1\" cx=\"%.1f\" cy=\"%.1f\" r=\"3\"><title>",
                              place_x(&frame, (double)dot[i].when / SECONDS_A_DAY),
                              place_y(&frame, dot[i].value));
        gsn_report_text_escape(text, dot[i].name);
        gsn_report_text_raw(text, ": ");
        gsn_report_text_digits(text, dot[i].value, 4);
        gsn_report_text_print(text, "%s%s</title></circle>\n", *unit ? " " : "", unit);
    }
    gsn_report_text_raw(text, "</svg>\n");
}
