/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The report as one HTML file that fetches nothing.
 *
 * Method: parts are appended to one text in the order of the page; what others wrote passes one
 * escape (text.h).
 *
 * Steps: (1) head with the policy (html_elements.c); (2) title and contents, a link for each part
 * that is there; (3) verdict, the one figure that is asked for, cards; (4) warnings, where it was
 * lost, volumes, model, pictures, charts, contact sheet, lists, methods, provenance, each left out
 * where the report has nothing for it; (5) foot and script.
 *
 * Failure: the text remembers that memory ran out, and is asked once. Cost: linear in what is
 * shown; pictures grow by a third as base64. */
#include "pipeline/report/html.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "pipeline/report/chart.h"
#include "pipeline/report/html_elements.h"

static void add_id(struct gsn_report_text *text, const char *name, const char *value)
{
    if (!gsn_html_is_said(value))
        return;
    gsn_report_text_print(text, "<li>%s <b>", name);
    gsn_report_text_escape(text, value);
    gsn_report_text_raw(text, "</b></li>\n");
}

static void add_title(struct gsn_report_text *text, const struct gsn_report *report)
{
    static const char *const what[] = { "collagen report", "volume report", "tile report" };

    gsn_report_text_print(text,
                          "<header class=\"top\">\n<p class=\"brand\"><b>gieson</b> %s</p>\n<h1>",
                          what[report->kind]);
    gsn_report_text_escape(text, report->specimen);
    gsn_report_text_raw(text, "</h1>\n<ul class=\"ids\">\n");
    add_id(text, "Study", report->study);
    add_id(text, "Group", report->group);
    add_id(text, "Animal", report->animal);
    add_id(text, "Week", report->week);
    gsn_report_text_raw(text, "</ul>\n");
}

static void add_link(struct gsn_report_text *text, const char *id, const char *name, int there)
{
    if (there)
        gsn_report_text_print(text, "<li><a href=\"#%s\">%s</a></li>\n", id, name);
}

static int has_charts(const struct gsn_report *report)
{
    return (report->registration && report->section_count > 0) || report->units;
}

static int has_loss_map(const struct gsn_report *report)
{
    return report->loss_map || gsn_html_is_said(report->loss_map_reason);
}

static void add_contents(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(text, "<nav aria-label=\"Contents\"><ul>\n");
    add_link(text, "warnings", "Warnings", report->warning_count > 0);
    add_link(text, "lost", "Where it was lost", has_loss_map(report));
    add_link(text, "regions", "Regions", report->named_count > 0);
    add_link(text, "volumes", "Volumes", report->volume_count > 0);
    add_link(text, "model", "Model", report->model != NULL);
    add_link(text, "pictures", "Pictures", report->picture_count > 0);
    add_link(text, "tile", "Collagen map", report->tile != NULL);
    add_link(text, "charts", "Charts", has_charts(report));
    add_link(text, "alignment", "Aligned sections", report->aligned != NULL);
    add_link(text, "sheet", "Contact sheet", report->section_count > 0);
    add_link(text, "choices", "Poses to choose from", gsn_html_has_choices(report));
    add_link(text, "decisions", "Decided by people", report->decision_count > 0);
    add_link(text, "measures", "Measures", 1);
    add_link(text, "exclusions", "Left out", report->exclusion_count > 0);
    add_link(text, "methods", "Methods", 1);
    add_link(text, "provenance", "Provenance", 1);
    gsn_report_text_raw(text, "</ul></nav>\n</header>\n");
}

static void add_verdict(struct gsn_report_text *text, const struct gsn_report *report)
{
    static const char *const style[] = { "is-ok", "is-warn", "is-bad" };
    static const char *const said[] = { "\xE2\x9C\x93 Reported", "! Reported with warnings",
                                        "\xE2\x9C\x95 Withheld" };

    gsn_report_text_print(text, "<div class=\"verdict %s\"><p class=\"state\">%s</p>",
                          style[report->verdict], said[report->verdict]);
    if (gsn_html_is_said(report->verdict_reason)) {
        gsn_report_text_raw(text, "<p>");
        gsn_report_text_escape(text, report->verdict_reason);
        gsn_report_text_raw(text, "</p>");
    }
    gsn_report_text_raw(text, "</div>\n");
}

/* That two regions are not of one size, where they are not. */
static void add_regions(struct gsn_report_text *text, const struct gsn_report *report)
{
    const double here = report->region.volume_mm3, there = report->baseline_volume_mm3;

    if (!isfinite(report->loss_percent) || !(there > 0))
        return;
    gsn_report_text_raw(text, "<p class=\"soft\">One rule (");
    gsn_report_text_escape(text, report->region.description);
    gsn_report_text_raw(text, ") laid regions of unlike size: ");
    gsn_report_text_digits(text, here, 3);
    gsn_report_text_raw(text, " mm\xC2\xB3 here, ");
    gsn_report_text_digits(text, there, 3);
    gsn_report_text_raw(text, " mm\xC2\xB3 in the baseline (");
    gsn_report_text_number(text, 100 * (here / there - 1), 0);
    gsn_report_text_raw(text, " %). Their densities are compared, not their amounts.</p>\n");
}

/* The two bars and what they stand for. */
static void add_comparison(struct gsn_report_text *text, const struct gsn_report *report)
{
    const double own = report->region.mean_density;

    gsn_report_text_raw(text, "<div><p class=\"label\">Mean density in the region</p>\n");
    if (isfinite(report->baseline_mean) && isfinite(own))
        gsn_chart_loss(text, report->baseline_mean, own);
    gsn_report_text_raw(
        text, "<table class=\"pair\">\n<tr><td><span class=\"key base\"></span>Baseline ");
    gsn_report_text_escape(text, report->baseline);
    gsn_report_text_raw(text, "</td><td>");
    gsn_report_text_number(text, report->baseline_mean, 3);
    gsn_report_text_raw(
        text, "</td></tr>\n<tr><td><span class=\"key own\"></span>This specimen</td><td>");
    gsn_report_text_number(text, own, 3);
    gsn_report_text_raw(text, "</td></tr>\n");
    if (isfinite(report->zero_density)) {
        gsn_report_text_raw(text, "<tr><td>No collagen, from which both are counted</td><td>");
        gsn_report_text_number(text, report->zero_density, 3);
        gsn_report_text_raw(text, "</td></tr>\n");
    }
    if (isfinite(report->loss_points)) {
        gsn_report_text_raw(text, "<tr><td>Difference, on a scale of 0 to 100</td><td>");
        gsn_report_text_number(text, report->loss_points, 1);
        gsn_report_text_raw(text, " points</td></tr>\n");
    }
    gsn_report_text_raw(text, "</table>\n");
    add_regions(text, report);
    gsn_report_text_raw(text, "</div>\n");
}

static void add_interval(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (!report->loss_interval)
        return;
    gsn_report_text_raw(text, "<p class=\"range\">");
    gsn_report_text_number(text, report->loss_lower, 1);
    gsn_report_text_raw(text, " to ");
    gsn_report_text_number(text, report->loss_upper, 1);
    gsn_report_text_raw(text, " % <span class=\"soft\">(");
    gsn_report_text_escape(text, report->loss_interval);
    gsn_report_text_raw(text, ")</span></p>\n");
}

static void add_loss(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(text,
                        "<div class=\"hero\">\n<div><p class=\"label\">Collagen loss against ");
    if (report->baseline_page) {
        gsn_report_text_raw(text, "<a href=\"");
        gsn_report_text_escape(text, report->baseline_page);
        gsn_report_text_raw(text, "\">");
    }
    gsn_report_text_escape(text, report->baseline);
    gsn_report_text_raw(text, report->baseline_page ? "</a></p>\n" : "</p>\n");
    if (isfinite(report->loss_percent)) {
        gsn_report_text_raw(text, "<p class=\"big\">");
        gsn_report_text_number(text, report->loss_percent, 1);
        gsn_report_text_raw(text, "<small>%</small></p>\n");
        add_interval(text, report);
        gsn_report_text_raw(text, "<p class=\"soft\">Relative per cent: of the mean "
                                  "density that ");
        gsn_report_text_escape(text, report->baseline);
        gsn_report_text_raw(text,
                            " has in this region, so much is missing here. Points are the plain "
                            "difference of the two densities.</p>\n");
    } else {
        gsn_report_text_raw(text, "<p class=\"big word\">withheld</p>\n<p>");
        gsn_report_text_escape(text, gsn_html_is_said(report->loss_reason) ? report->loss_reason
                                                                           : "No reason given.");
        gsn_report_text_raw(text, "</p>\n");
    }
    gsn_report_text_raw(text, "</div>\n");
    add_comparison(text, report);
    gsn_report_text_raw(text, "</div>\n");
}

static void add_density(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(text,
                        "<div class=\"hero\">\n<div><p class=\"label\">Mean density in the region"
                        "</p>\n<p class=\"big\">");
    gsn_report_text_number(text, report->region.mean_density, 3);
    gsn_report_text_raw(text, "</p>\n<p class=\"soft\">");
    gsn_report_text_escape(text, gsn_html_is_said(report->loss_reason)
                                     ? report->loss_reason
                                     : "No baseline is named, so there is no loss to report.");
    gsn_report_text_raw(text, "</p></div>\n</div>\n");
}

static void add_area(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(text,
                        "<div class=\"hero\">\n<div><p class=\"label\">Collagen, of the tissue area"
                        "</p>\n<p class=\"big\">");
    gsn_report_text_number(text, 100 * report->tile->area_fraction, 1);
    gsn_report_text_raw(text, "<small>%</small></p></div>\n");
    if (report->tile->compared) {
        gsn_report_text_raw(text, "<div><p class=\"label\">Agreement with ");
        gsn_report_text_escape(text, report->tile->mask_name);
        gsn_report_text_raw(text, "</p>\n<p class=\"big\">");
        gsn_report_text_number(text, report->tile->dice, 3);
        gsn_report_text_raw(text,
                            "</p>\n<p class=\"soft\">Dice: twice the common area over the sum of "
                            "both; 1 is the same map.</p></div>\n");
    }
    gsn_report_text_raw(text, "</div>\n");
}

static void open_card(struct gsn_report_text *text, const char *name)
{
    gsn_report_text_print(text, "<div><p class=\"label\">%s</p><p class=\"value\">", name);
}

static void close_card(struct gsn_report_text *text, const char *trusted, const char *said)
{
    gsn_report_text_print(text, "</p><p class=\"soft\">%s", trusted);
    gsn_report_text_escape(text, said);
    gsn_report_text_raw(text, "</p></div>\n");
}

static void add_area_card(struct gsn_report_text *text, const struct gsn_report_value *area)
{
    if (!area->name)
        return;
    open_card(text, "Area figure");
    if (area->text)
        gsn_report_text_escape(text, area->text);
    else
        gsn_report_text_digits(text, area->value, 3);
    gsn_report_text_raw(text, " <small>");
    gsn_html_unit(text, area->unit);
    gsn_report_text_raw(text, "</small>");
    close_card(text, "", area->name);
}

/* by: as in report.json. */
static const char *words_of_way(const char *by)
{
    if (by && strcmp(by, "tissue") == 0)
        return "by their tissue";
    return by && strcmp(by, "marks+tissue") == 0 ? "by their laser marks and their tissue"
                                                 : "by their three laser marks";
}

static void add_cards(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(text, "<div class=\"cards\">\n");
    open_card(text, "Mean density");
    gsn_report_text_number(
        text, report->tile ? report->tile->mean_density : report->region.mean_density, 3);
    gsn_report_text_raw(text, "</p><p class=\"soft\">");
    if (report->tile) {
        gsn_report_text_raw(text, "95 %: ");
        gsn_report_text_number(text, report->tile->mean_lower, 2);
        gsn_report_text_raw(text, " to ");
        gsn_report_text_number(text, report->tile->mean_upper, 2);
        gsn_report_text_raw(text, " (white, detail, dye vectors; not the strength of the stain); ");
    }
    gsn_report_text_escape(text, report->density_name);
    if (gsn_html_is_said(report->density_version)) {
        gsn_report_text_raw(text, ", ");
        gsn_report_text_escape(text, report->density_version);
    }
    gsn_report_text_raw(text, "</p></div>\n");
    if (isfinite(report->region.volume_mm3)) {
        open_card(text, "Region");
        gsn_report_text_number(text, report->region.volume_mm3, 4);
        gsn_report_text_raw(text, " <small>mm\xC2\xB3</small>");
        close_card(text, "", report->region.description);
    }
    if (isfinite(report->region.coverage)) {
        open_card(text, "Region with data");
        gsn_report_text_number(text, 100 * report->region.coverage, 1);
        gsn_report_text_raw(text, "<small> %</small>");
        close_card(text, "of its volume; the rest is left out, not guessed", "");
    }
    if (report->registration) {
        open_card(text, "Sections in place");
        gsn_report_text_count(text, report->registration->sections_posed);
        gsn_report_text_raw(text, " <small>of ");
        gsn_report_text_count(text, report->registration->sections_expected);
        gsn_report_text_raw(text, "</small>");
        close_card(text, words_of_way(report->registration->by), "");
    }
    /* Where volumes are given their table has the share of the region, of the tissue and not of
     * single voxels: one quantity, one number. */
    if (report->volume_count == 0)
        add_area_card(text, &report->area_figure);
    gsn_report_text_raw(text, "</div>\n");
}

static void add_summary(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(text, "<main>\n<div class=\"summary\" id=\"summary\">\n");
    add_verdict(text, report);
    if (report->tile)
        add_area(text, report);
    else if (gsn_html_is_said(report->baseline))
        add_loss(text, report);
    else
        add_density(text, report);
    add_cards(text, report);
    gsn_report_text_raw(text, "</div>\n");
}

static void add_warnings(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (report->warning_count == 0)
        return;
    gsn_report_text_raw(text,
                        "<section id=\"warnings\"><h2>Warnings</h2>\n<ul class=\"warnings\">\n");
    for (size_t i = 0; i < report->warning_count; i++) {
        gsn_report_text_raw(text, "<li>");
        gsn_report_text_escape(text, report->warnings[i]);
        gsn_report_text_raw(text, "</li>\n");
    }
    gsn_report_text_raw(text, "</ul></section>\n");
}

/* Of a column of pictures on a wide screen. */
enum { COLUMN_PX = 560 };

/* A wide picture takes the whole width and scrolls in its own box where that is narrow; one of few
 * pixels would only be blown up. */
static void add_image(struct gsn_report_text *text, const struct gsn_report_picture *picture)
{
    const bool wide = 10 * (size_t)picture->png.width > 16 * (size_t)picture->png.height &&
                      picture->png.width > COLUMN_PX;

    gsn_report_text_raw(text, wide ? "<figure class=\"wide\"><div class=\"scroll\">" : "<figure>");
    if (picture->png.size)
        gsn_html_image(text, &picture->png, picture->title);
    if (wide)
        gsn_report_text_raw(text, "</div>");
}

static void add_images(struct gsn_report_text *text, const struct gsn_report_picture *pictures,
                       size_t count)
{
    gsn_report_text_raw(text, "<div class=\"pictures\">\n");
    for (size_t i = 0; i < count; i++) {
        add_image(text, &pictures[i]);
        gsn_report_text_raw(text, "<figcaption><h3>");
        gsn_report_text_escape(text, pictures[i].title);
        gsn_report_text_raw(text, "</h3><p>");
        gsn_report_text_escape(text, pictures[i].caption);
        gsn_report_text_raw(text, "</p></figcaption></figure>\n");
    }
    gsn_report_text_raw(text, "</div>");
}

static void add_pictures(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (report->picture_count == 0)
        return;
    gsn_report_text_print(text, "<section id=\"pictures\"><h2>%s</h2>\n",
                          report->tile ? "Picture and map" : "Pictures");
    if (!report->tile)
        gsn_report_text_raw(
            text,
            "<p class=\"lead\">Good: data and model look alike, and the line of the region "
            "follows the tissue that it should. The line lies elsewhere: correct "
            "<code>region</code> in job.json. A step between rows of a cut through the stack: "
            "look at those sections in the contact sheet.</p>\n");
    add_images(text, report->pictures, report->picture_count);
    gsn_report_text_raw(text, "</section>\n");
}

/* Where it was lost, or why that is not known. */
static void add_loss_map(struct gsn_report_text *text, const struct gsn_report *report)
{
    const struct gsn_report_loss_map *const map = report->loss_map;

    if (!has_loss_map(report))
        return;
    gsn_report_text_raw(text,
                        "<section id=\"lost\"><h2>Where it was lost</h2>\n<p class=\"lead\">");
    if (!map) {
        gsn_report_text_raw(text, "There is no map of the loss: ");
        gsn_report_text_escape(text, report->loss_map_reason);
        gsn_report_text_raw(text, ".</p></section>\n");
        return;
    }
    gsn_html_figure(text, "Half of the baseline's collagen lies where more than ", map->median, 1,
                    " % of it was lost; ");
    gsn_html_figure(text, "a twentieth where less than ", map->low, 1, " % was, ");
    gsn_html_figure(text, "a twentieth where more than ", map->high, 1, " % was. ");
    if (isfinite(map->noise))
        gsn_html_figure(
            text, "Sections alone make one cell uncertain by ", map->noise, 1,
            " points (standard error): a spread not much wider than that says nothing of "
            "the tissue. ");
    gsn_report_text_raw(text, "The cells are ");
    gsn_report_text_count(text, map->cells);
    gsn_report_text_print(text,
                          " tetrahedra, six a cube of %g \xC2\xB5m, the same in every specimen; ",
                          map->edge_um);
    gsn_html_figure(text, "they hold ", 100 * map->shared, 1, " % of this region. ");
    gsn_report_text_raw(text,
                        "A cell is one piece of the block, laid by the marks: where two animals "
                        "differ in shape, an edge of tissue shows as loss or gain. All of them are "
                        "in <code>base-cells.csv</code> beside this page.</p>\n");
    add_images(text, map->pictures, map->picture_count);
    gsn_report_text_raw(text, "</section>\n");
}

static void add_charts(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (!has_charts(report))
        return;
    gsn_report_text_raw(
        text,
        "<section id=\"charts\"><h2>Charts</h2>\n<p class=\"lead\">Good: a level row of small "
        "residuals. One section far above its neighbours: look at it in the contact sheet, and "
        "leave it out by <code>gieson decide</code> if its marks are wrong. A whole panel above "
        "the others: scan it again.</p>\n<div class=\"charts\">\n");
    if (report->registration && report->section_count > 0) {
        gsn_report_text_raw(text, "<figure><div class=\"drawing\">\n");
        gsn_chart_residuals(text, report);
        gsn_report_text_raw(
            text, "</div><figcaption><h3>Marks, section by section</h3><p>Distance of each "
                  "laser mark from the common triangle. Small values show that nothing "
                  "went grossly wrong; they are not the error at the region. Grey: a "
                  "section without a pose.</p></figcaption></figure>\n");
    }
    if (report->units) {
        gsn_report_text_raw(text, "<figure><div class=\"drawing\">\n");
        gsn_chart_densities(text, report->units);
        gsn_report_text_raw(
            text, "</div><figcaption><h3>Micro-units by density</h3><p>Mean density of each "
                  "tetrahedron of the model.</p></figcaption></figure>\n");
    }
    gsn_report_text_raw(text, "</div></section>\n");
}

static void add_foot(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(text, "</main>\n<footer><p>gieson ");
    gsn_report_text_escape(text, report->version);
    if (report->kind != GSN_REPORT_VOLUME)
        gsn_report_text_raw(text,
                            ". Density is what the dye shows: young fibrils take less fuchsin than "
                            "mature collagen, and figures of different stains must not be pooled");
    gsn_report_text_raw(
        text, ". This file holds everything it shows and fetches nothing.</p></footer>\n");
    gsn_html_script(text, report);
    gsn_report_text_raw(text, "</body>\n</html>\n");
}

int gsn_report_html(const struct gsn_report *report, char **ret_text, size_t *ret_size,
                    struct gsn_error *err)
{
    gsn_auto_report_text text = { .bytes = NULL };
    const unsigned scripts =
        (report->model ? GSN_HTML_MODEL : 0) | (report->aligned ? GSN_HTML_ALIGNMENT : 0);
    const int r = gsn_html_head(&text, report->specimen, "", scripts, err);

    if (r < 0)
        return r;
    add_title(&text, report);
    add_contents(&text, report);
    add_summary(&text, report);
    add_warnings(&text, report);
    add_loss_map(&text, report);
    gsn_html_named(&text, report);
    gsn_html_volumes(&text, report);
    gsn_html_viewer(&text, report);
    add_pictures(&text, report);
    gsn_html_tile(&text, report);
    add_charts(&text, report);
    gsn_html_alignment(&text, report);
    gsn_html_sheet(&text, report);
    gsn_html_choices(&text, report);
    gsn_html_decisions(&text, report);
    gsn_html_measures(&text, report);
    gsn_html_exclusions(&text, report);
    gsn_html_methods(&text, report);
    gsn_html_provenance(&text, report);
    add_foot(&text, report);
    if (text.failed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the report's page");
    gsn_report_text_give(&text, ret_text, ret_size);
    return GSN_OK;
}
