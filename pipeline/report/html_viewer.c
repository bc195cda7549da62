/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The model to turn, cut and click, in the page itself: the elements that viewer.js finds by their
 * names, the model as the exporter packed it, and the script, which reads the sections from the
 * contact sheet. Without WebGL2 or without scripts one sentence shows instead, and the pictures of
 * the page are all there is. */
#include "pipeline/report/html.h"

#include "pipeline/report/html_elements.h"

static void add_slider(struct gsn_report_text *text, const char *id, const char *label,
                       unsigned least, unsigned most, unsigned value)
{
    gsn_report_text_print(text,
                          "<label>%s <output id=\"viewer-%s-said\"></output><input type=\"range\" "
                          "id=\"viewer-%s\" min=\"%u\" max=\"%u\" value=\"%u\"></label>\n",
                          label, id, id, least, most, value);
}

static void add_controls(struct gsn_report_text *text)
{
    gsn_report_text_raw(
        text, "<div class=\"controls\">\n<label>Cut <select id=\"viewer-cut\">"
              "<option value=\"y\">across y</option><option value=\"x\">across x</option>"
              "<option value=\"z\">across z, as sectioned</option>"
              "<option value=\"eye\">facing you</option><option value=\"none\">none</option>"
              "</select></label>\n");
    add_slider(text, "place", "at", 0, 1000, 500);
    add_slider(text, "from", "Show from", 0, 1000, 0);
    add_slider(text, "to", "to", 0, 1000, 1000);
    add_slider(text, "shrink", "Cells", 20, 100, 100);
    add_slider(text, "opacity", "Opacity", 2, 100, 100);
    gsn_report_text_raw(
        text, "<label class=\"tick\"><input type=\"checkbox\" id=\"viewer-smooth\" checked=\"\"> "
              "the spline itself, not cell by cell</label>\n"
              "<label class=\"tick\"><input type=\"checkbox\" id=\"viewer-true\"> "
              "true colour</label>\n"
              "<label>Cell <input type=\"number\" id=\"viewer-number\" min=\"0\"></label>\n"
              "<button type=\"button\" id=\"viewer-home\">As at first</button>\n</div>\n");
}

static void add_stage(struct gsn_report_text *text)
{
    gsn_report_text_raw(
        text,
        "<div class=\"look\">\n<div class=\"stage\"><canvas id=\"viewer-back\" "
        "aria-hidden=\"true\"></canvas>"
        "<canvas id=\"viewer-model\" tabindex=\"0\" role=\"img\" aria-label=\"The model in three "
        "dimensions. Arrow keys turn it, plus and minus enlarge and reduce it, Page Up and Page "
        "Down "
        "move the cut, 0 shows it as at first.\"></canvas>"
        "<canvas id=\"viewer-front\" aria-hidden=\"true\"></canvas></div>\n"
        "<canvas id=\"viewer-scale\" role=\"img\" aria-label=\"Colour scale\"></canvas>\n</div>\n");
}

static void say_cells(struct gsn_report_text *text, const struct gsn_report_model *model)
{
    gsn_report_text_raw(text, "<p class=\"lead\">The fitted spline over ");
    gsn_report_text_count(text, model->cells);
    if (model->apart_um > 0) {
        gsn_report_text_raw(text, " of the ");
        gsn_report_text_count(text, model->of);
        gsn_report_text_raw(text, " cells (micro-units) with tissue of the region, which are more "
                                  "than a page can carry: corners nearer than ");
        gsn_report_text_number(text, model->apart_um, 0);
        gsn_report_text_raw(text,
                            " \xC2\xB5m were drawn together, and cells that lost their volume "
                            "left out; a cell's figures are its own");
    } else {
        gsn_report_text_raw(text, " cells (micro-units), all that hold tissue of the region");
    }
    gsn_report_text_raw(text, ". Drag to turn it, pinch or use + and \xE2\x88\x92 to enlarge it, "
                              "click a cell to ask it.</p>\n");
}

void gsn_html_viewer(struct gsn_report_text *text, const struct gsn_report *report)
{
    const struct gsn_report_model *model = report->model;

    if (!model)
        return;
    gsn_report_text_raw(text, "<section id=\"model\"><h2>The model in three dimensions</h2>\n");
    say_cells(text, model);
    gsn_report_text_raw(
        text, "<p id=\"viewer-none\">It needs scripts and WebGL2, which this browser does "
              "not give it. The pictures below show the same model.</p>\n"
              "<div id=\"viewer\" class=\"viewer\" hidden=\"\" data-unit=\"");
    gsn_report_text_escape(text, model->unit);
    gsn_report_text_raw(text, "\">\n");
    add_stage(text);
    gsn_report_text_raw(text, "<div class=\"side\">\n");
    add_controls(text);
    gsn_report_text_raw(text, "<div id=\"viewer-cell\" class=\"cell\" aria-live=\"polite\"></div>\n"
                              "</div>\n</div>\n"
                              "<script type=\"application/octet-stream\" id=\"viewer-data\">");
    gsn_report_text_base64(text, model->bytes, model->size);
    gsn_report_text_raw(text, "</script>\n</section>\n");
}

void gsn_html_script(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (report->model)
        gsn_html_run(text, gsn_html_viewer_script, gsn_html_viewer_script_size);
    if (report->aligned)
        gsn_html_run(text, gsn_html_alignment_script, gsn_html_alignment_script_size);
}
