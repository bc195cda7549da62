/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The sections as they lie in the block, to judge a registration by.
 *
 * Method: one small picture a section, all of the same square of the block, in a row that scrolls:
 * side by side they are what a browser without scripts shows. alignment.js takes them from there
 * onto a canvas and lays neighbours over each other; what it says of a section stands in data-
 * attributes: the depth, the marks' places in the block with their residuals, what the neighbours'
 * tissue says. Figures are those of the contact sheet.
 *
 * Failure: the text remembers that memory ran out. Cost: linear in the sections; a third more than
 * the pictures' bytes, as base64. */
#include "pipeline/report/html.h"

#include <math.h>

#include "pipeline/report/html_elements.h"

static void add_section(struct gsn_report_text *text, const struct gsn_report_section *section)
{
    gsn_report_text_print(text, "<figure data-serial=\"%u\" data-z=\"%.9g\" data-state=\"",
                          section->serial, section->z_um);
    gsn_report_text_escape(text, section->state);
    gsn_report_text_raw(text, "\"");
    gsn_html_marks(text, section);
    if (isfinite(section->predicted_tre_um))
        gsn_report_text_print(text, " data-tre=\"%.1f\"", section->predicted_tre_um);
    if (isfinite(section->tissue_apart_um))
        gsn_report_text_print(text, " data-tissue=\"%.1f %.1f\"", section->tissue_apart_um,
                              section->tissue_limit_um);
    gsn_report_text_raw(text, ">");
    gsn_html_image(text, &section->aligned, "");
    gsn_report_text_print(text, "<figcaption><b>%u.%u</b> z ", section->panel, section->slot + 1);
    gsn_report_text_number(text, section->z_um, fmod(section->z_um, 1) == 0 ? 0 : 1);
    gsn_report_text_raw(text, " \xC2\xB5m</figcaption></figure>\n");
}

static void add_controls(struct gsn_report_text *text)
{
    gsn_report_text_raw(
        text,
        "<div class=\"controls\">\n"
        "<label>Section <output id=\"align-section-said\"></output>"
        "<input type=\"range\" id=\"align-section\" min=\"0\" max=\"0\" value=\"0\"></label>\n"
        "<p class=\"buttons\"><button type=\"button\" id=\"align-back\" aria-label=\"One section "
        "back\">\xE2\x80\xB9</button><button type=\"button\" id=\"align-play\">Play</button>"
        "<button type=\"button\" id=\"align-on\" aria-label=\"One section "
        "on\">\xE2\x80\xBA</button>"
        "<button type=\"button\" id=\"align-home\">As at first</button></p>\n"
        "<label>Show <select id=\"align-show\"><option value=\"board\">checkerboard of two</option>"
        "<option value=\"colours\">two, magenta and green</option>"
        "<option value=\"blend\">two, one through the other</option>"
        "<option value=\"flicker\">two in turn</option>"
        "<option value=\"alone\">one section</option></select></label>\n"
        "<label>with <select id=\"align-with\"><option value=\"1\">the next</option>"
        "<option value=\"-1\">the one before</option><option value=\"middle\">the middle of the "
        "stack</option></select></label>\n"
        "<label>Square <output id=\"align-square-said\"></output>"
        "<input type=\"range\" id=\"align-square\" min=\"2\" max=\"24\" value=\"8\"></label>\n"
        "<label>Side view at y <output id=\"align-side-said\"></output>"
        "<input type=\"range\" id=\"align-side\" min=\"0\" max=\"1000\" value=\"500\"></label>\n"
        "<label class=\"tick\"><input type=\"checkbox\" id=\"align-arrows\" checked=\"\"> "
        "residuals of the marks as arrows</label>\n</div>\n");
}

static void add_stage(struct gsn_report_text *text)
{
    gsn_report_text_raw(
        text,
        "<div class=\"look\">\n<canvas id=\"align-view\" tabindex=\"0\" role=\"img\" "
        "aria-label=\"The aligned sections. Arrow keys go to the next section and back, Page Up "
        "and Page Down ten at a time, Home and End to the ends, space plays, plus and minus "
        "enlarge and reduce, c changes how two sections are shown, 0 shows them as at first."
        "\"></canvas>\n"
        "<canvas id=\"align-slice\" role=\"img\" aria-label=\"All sections from the side, z "
        "downwards\"></canvas>\n"
        "<canvas id=\"align-strip\" role=\"img\" aria-label=\"Residuals of the marks along the "
        "stack\"></canvas>\n</div>\n");
}

void gsn_html_alignment(struct gsn_report_text *text, const struct gsn_report *report)
{
    const struct gsn_report_aligned *aligned = report->aligned;

    if (!aligned)
        return;
    gsn_report_text_raw(
        text, "<section id=\"alignment\"><h2>Aligned sections</h2>\n<p class=\"lead\">Each section "
              "as its pose lays it, all in the same square of the block. Good: tissue runs on "
              "across the squares of the checkerboard, the side view has no steps, and no arrow is "
              "much longer than the others. Marks that fit do not show that a section is the right "
              "way round or not torn: the tissue does.</p>\n");
    gsn_report_text_print(text,
                          "<div id=\"align\" class=\"viewer\" hidden=\"\" data-x=\"%.9g\" "
                          "data-y=\"%.9g\" data-um=\"%.9g\">\n",
                          aligned->corner_um.x, aligned->corner_um.y, aligned->um_per_px);
    add_stage(text);
    gsn_report_text_raw(text, "<div class=\"side\">\n");
    add_controls(text);
    gsn_report_text_raw(text, "<div id=\"align-told\" class=\"cell\" aria-live=\"polite\"></div>\n"
                              "</div>\n</div>\n<div id=\"align-row\" class=\"row\" tabindex=\"0\" "
                              "role=\"group\" aria-label=\"All aligned sections\">\n");
    for (size_t i = 0; i < report->section_count; i++)
        if (report->sections[i].aligned.size)
            add_section(text, &report->sections[i]);
    gsn_report_text_raw(text, "</div>\n</section>\n");
}
