/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The page beside the report: each section that is in the model, large, with what of it is masked
 * and its density as layers.
 *
 * Method: one figure a section in a row: the picture, and hidden behind it what glass.js lays over
 * it on a canvas; without scripts the pictures follow each other. Pictures and policy are those of
 * the report's page (html_elements.c), which links here by the sections' serial numbers.
 *
 * Failure: GSN_E_NOMEM. Cost: linear in the sections; a third more than the pictures' bytes. */
#include "pipeline/report/html.h"

#include <math.h>

#include "pipeline/report/html_elements.h"

static void add_layer(struct gsn_report_text *text, const char *name,
                      const struct gsn_report_png *png)
{
    if (!png->size)
        return;
    gsn_report_text_print(text, "<div hidden=\"\" class=\"%s\">", name);
    gsn_html_image(text, png, "");
    gsn_report_text_raw(text, "</div>");
}

static void add_section(struct gsn_report_text *text, const struct gsn_report_section *section)
{
    gsn_report_text_print(text,
                          "<figure id=\"section-%u\" data-serial=\"%u\" data-z=\"%.9g\" "
                          "data-state=\"",
                          section->serial, section->serial, section->z_um);
    gsn_report_text_escape(text, section->state);
    gsn_report_text_raw(text, "\"");
    gsn_html_marks(text, section);
    gsn_report_text_raw(text, ">");
    gsn_html_image(text, &section->glass, "");
    add_layer(text, "masked", &section->masked_map);
    add_layer(text, "density", &section->density_map);
    gsn_report_text_print(text, "<figcaption><b>%u.%u</b> z ", section->panel, section->slot + 1);
    gsn_report_text_number(text, section->z_um, fmod(section->z_um, 1) == 0 ? 0 : 1);
    gsn_report_text_raw(text, " \xC2\xB5m");
    for (size_t i = 0; i < section->flag_count; i++) {
        gsn_report_text_raw(text, " <span class=\"flag\">");
        gsn_report_text_escape(text, section->flags[i]);
        gsn_report_text_raw(text, "</span>");
    }
    gsn_report_text_raw(text, "</figcaption></figure>\n");
}

static void add_controls(struct gsn_report_text *text)
{
    gsn_report_text_raw(
        text,
        "<div class=\"controls\">\n"
        "<label>Section <output id=\"glass-section-said\"></output>"
        "<input type=\"range\" id=\"glass-section\" min=\"0\" max=\"0\" value=\"0\"></label>\n"
        "<p class=\"buttons\"><button type=\"button\" id=\"glass-back\" aria-label=\"One section "
        "back\">\xE2\x80\xB9</button><button type=\"button\" id=\"glass-on\" aria-label=\"One "
        "section on\">\xE2\x80\xBA</button>"
        "<button type=\"button\" id=\"glass-home\">As at first</button></p>\n"
        "<label class=\"tick\"><input type=\"checkbox\" id=\"glass-marks\" checked=\"\"> laser "
        "marks</label>\n"
        "<label class=\"tick\"><input type=\"checkbox\" id=\"glass-masked\"> what is not "
        "measured</label>\n"
        "<label class=\"tick\"><input type=\"checkbox\" id=\"glass-region\" checked=\"\"> outline "
        "of the region</label>\n"
        "<label>Density <output id=\"glass-density-said\"></output>"
        "<input type=\"range\" id=\"glass-density\" min=\"0\" max=\"100\" value=\"0\"></label>\n"
        "<label>Flicker against <select id=\"glass-with\"><option value=\"0\">nothing</option>"
        "<option value=\"1\">the next</option><option value=\"-1\">the one before</option>"
        "</select></label>\n"
        "<label>Enlarged <output id=\"glass-size-said\"></output>"
        "<input type=\"range\" id=\"glass-size\" min=\"10\" max=\"60\" value=\"10\"></label>\n"
        "</div>\n");
}

static void add_frame(struct gsn_report_text *text, const struct gsn_report_glass *glass)
{
    gsn_report_text_print(
        text,
        "<div id=\"glass\" class=\"viewer\" hidden=\"\" data-x=\"%.9g\" data-y=\"%.9g\" "
        "data-um=\"%.9g\" data-masked-um=\"%.9g\" data-density-x=\"%.9g\" data-density-y=\"%.9g\" "
        "data-density-um-x=\"%.9g\" data-density-um-y=\"%.9g\" data-low=\"%.9g\" "
        "data-high=\"%.9g\" data-reasons=\"",
        glass->corner_um.x, glass->corner_um.y, glass->um_per_px, glass->masked_um_per_px,
        glass->density_corner_um.x, glass->density_corner_um.y, glass->density_um_per_px.x,
        glass->density_um_per_px.y, glass->density_low, glass->density_high);
    for (size_t i = 0; i < glass->reason_count; i++) {
        gsn_report_text_raw(text, i ? "," : "");
        gsn_report_text_escape(text, glass->reasons[i]);
    }
    gsn_report_text_raw(
        text,
        "\">\n<div class=\"look\">\n<div id=\"glass-stage\"><canvas id=\"glass-view\" "
        "tabindex=\"0\" role=\"img\" aria-label=\"The section. Arrow keys go to the next section "
        "and back, Home and End to the ends, plus and minus enlarge and reduce, f flickers "
        "against the next section, m shows what is not measured, d the density.\"></canvas></div>\n"
        "<canvas id=\"glass-scale\" role=\"img\" aria-label=\"Colour scale of the "
        "density\"></canvas>\n</div>\n<div class=\"side\">\n");
    add_controls(text);
    gsn_report_text_raw(text, "<div id=\"glass-told\" class=\"cell\" aria-live=\"polite\"></div>\n"
                              "</div>\n</div>\n");
}

static void add_top(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(
        text, "<header class=\"top\">\n<p class=\"brand\"><b>gieson</b> sections, large</p>\n<h1>");
    gsn_report_text_escape(text, report->specimen);
    gsn_report_text_raw(text,
                        "</h1>\n</header>\n<main>\n<p class=\"lead\"><a href=\"report.html\">Its "
                        "report</a>. Each section in the model as its pose lays it in the block, ");
    gsn_report_text_number(text, report->glass->um_per_px, 1);
    gsn_report_text_raw(
        text, " \xC2\xB5m a pixel; sections that were left out are in the report's contact sheet. "
              "Good: what is not measured lies on folds, tears and dirt and nowhere else, the "
              "density follows the red, and little moves when neighbours flicker.</p>\n");
}

int gsn_report_glass_page(const struct gsn_report *report, char **ret_text, size_t *ret_size,
                          struct gsn_error *err)
{
    gsn_auto_report_text text = { .bytes = NULL };
    const int r = gsn_html_head(&text, report->specimen, ", sections", GSN_HTML_GLASS, err);

    if (r < 0)
        return r;
    add_top(&text, report);
    add_frame(&text, report->glass);
    gsn_report_text_raw(&text, "<div id=\"glass-row\" class=\"plates\">\n");
    for (size_t i = 0; i < report->section_count; i++)
        if (report->sections[i].glass.size)
            add_section(&text, &report->sections[i]);
    gsn_report_text_raw(&text, "</div>\n</main>\n<footer><p>gieson ");
    gsn_report_text_escape(&text, report->version);
    gsn_report_text_raw(
        &text, ". This file holds everything it shows and fetches nothing.</p></footer>\n");
    gsn_html_run(&text, gsn_html_glass_script, gsn_html_glass_script_size);
    gsn_report_text_raw(&text, "</body>\n</html>\n");
    if (text.failed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the page of the sections");
    gsn_report_text_give(&text, ret_text, ret_size);
    return GSN_OK;
}
