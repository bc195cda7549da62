/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The contact sheet: a table for each panel with its slots as they lie on the glass, each with
 * picture, state, marks and flags. Panels are those that were delivered or that a section names,
 * ascending.
 *
 * Failure: the text remembers that memory ran out. Cost: panels times slots times sections. */
#include "pipeline/report/html.h"

#include <math.h>
#include <string.h>

#include "pipeline/report/html_elements.h"

/* A state is told by a symbol and a word, never by colour alone. */
struct look {
    const char *state, *style, *symbol, *meaning;
};

static const struct look looks[] = {
    { "used", "used", "\xE2\x9C\x93", "in the model" },
    { "doubtful", "doubtful", "!", "in the model, look at it" },
    { "held", "held", "\xE2\x9C\x95", "left out until somebody decides" },
    { "empty", "absent", "\xE2\x97\x8B", "no tissue in the slot" },
    { "missing", "absent", "\xE2\x80\x93", "not delivered" },
};

static const struct look *look_of(const char *state)
{
    static const struct look other = { "", "absent", "\xE2\x80\xA2", "" };

    for (size_t i = 0; state && i < sizeof looks / sizeof looks[0]; i++)
        if (strcmp(state, looks[i].state) == 0)
            return &looks[i];
    return &other;
}

static void add_legend(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(text, "<ul class=\"legend\">\n");
    for (size_t i = 0; i < sizeof looks / sizeof looks[0]; i++) {
        size_t count = 0;

        for (size_t k = 0; k < report->section_count; k++)
            count += look_of(report->sections[k].state) == &looks[i];
        if (count == 0)
            continue;
        gsn_report_text_print(text, "<li class=\"%s\"><span class=\"state\">%s ", looks[i].style,
                              looks[i].symbol);
        gsn_report_text_count(text, count);
        gsn_report_text_print(text, " %s</span> %s</li>\n", looks[i].state, looks[i].meaning);
    }
    gsn_report_text_raw(text, "<li>\xE2\x97\x8F mark found, with its residual</li>\n"
                              "<li>\xE2\x97\x8B mark not found</li>\n"
                              "<li>TRE: error predicted at the region</li>\n</ul>\n");
}

static void add_marks(struct gsn_report_text *text, const struct gsn_report_section *section)
{
    gsn_report_text_raw(text, "<p>");
    for (int i = 0; i < 3; i++) {
        if (!section->marker_found[i]) {
            gsn_report_text_raw(text, "<span class=\"nowrap\">\xE2\x97\x8B \xE2\x80\x93</span> ");
            continue;
        }
        gsn_report_text_raw(text, "<span class=\"nowrap\">\xE2\x97\x8F ");
        gsn_report_text_number(text, section->residual_um[i], 1);
        gsn_report_text_raw(text, "</span> ");
    }
    gsn_report_text_raw(text, "\xC2\xB5m</p>\n");
}

static void add_turns(struct gsn_report_text *text, const struct gsn_report_section *section)
{
    if (section->flipped)
        gsn_report_text_raw(text, "<p class=\"turned\">\xE2\x87\x84 turned over</p>\n");
    if (section->rotated180)
        gsn_report_text_raw(text, "<p class=\"turned\">\xE2\x86\xBB turned by 180\xC2\xB0</p>\n");
    for (size_t i = 0; i < section->flag_count; i++) {
        gsn_report_text_raw(text, "<p class=\"flag\">");
        gsn_report_text_escape(text, section->flags[i]);
        gsn_report_text_raw(text, "</p>\n");
    }
}

static void add_slot(struct gsn_report_text *text, const struct gsn_report *report,
                     const struct gsn_report_section *section)
{
    const struct look *look = look_of(section->state);
    const int any_mark =
        section->marker_found[0] || section->marker_found[1] || section->marker_found[2];

    gsn_report_text_print(text, "<td class=\"slot %s\"", look->style);
    if (section->posed) /* the viewer finds it by this */
        gsn_report_text_print(text, " id=\"section-%u\" data-z=\"%.9g\"", section->serial,
                              section->z_um);
    gsn_report_text_raw(text, ">");
    if (report->glass && section->glass.size) {
        gsn_report_text_print(text,
                              "<a class=\"glass\" href=\"" GSN_REPORT_GLASS_FILE "#section-%u\">",
                              section->serial);
        gsn_html_image(text, &section->thumbnail, "the section, large");
        gsn_report_text_raw(text, "</a>");
    } else if (section->thumbnail.size)
        gsn_html_image(text, &section->thumbnail, "");
    else
        gsn_report_text_raw(text, "<span class=\"none\"></span>");
    gsn_report_text_print(text, "<p class=\"who\"><b>%u.%u</b> <span class=\"state\">%s ",
                          section->panel, section->slot + 1, look->symbol);
    gsn_report_text_escape(text, section->state);
    gsn_report_text_raw(text, "</span></p>\n");
    if (any_mark || section->posed)
        add_marks(text, section);
    gsn_report_text_raw(text, "<p class=\"soft\"><span class=\"nowrap\">z ");
    gsn_report_text_number(text, section->z_um, fmod(section->z_um, 1) == 0 ? 0 : 1);
    gsn_report_text_raw(text, " \xC2\xB5m</span>");
    if (section->posed) {
        gsn_report_text_raw(text, " <span class=\"nowrap\">TRE ");
        gsn_report_text_number(text, section->predicted_tre_um, 1);
        gsn_report_text_raw(text, " \xC2\xB5m</span>");
    }
    gsn_report_text_raw(text, "</p>\n");
    add_turns(text, section);
    gsn_report_text_raw(text, "</td>\n");
}

/* The panel of a number, or NULL: of several scans the one that is used, which the sections shown
 * are from. */
static const struct gsn_report_panel *panel_of(const struct gsn_report *report, unsigned number)
{
    const struct gsn_report_panel *first = NULL;

    for (size_t i = 0; i < report->panel_count; i++) {
        const struct gsn_report_panel *panel = &report->panels[i];

        if (panel->number != number)
            continue;
        if (panel->state && strcmp(panel->state, "used") == 0)
            return panel;
        first = first ? first : panel;
    }
    return first;
}

/* The layout as stated, or as large as its sections need. */
static void layout_of(const struct gsn_report *report, unsigned number, unsigned *rows,
                      unsigned *columns)
{
    const struct gsn_report_panel *panel = panel_of(report, number);

    *rows = panel ? panel->rows : 0;
    *columns = panel ? panel->columns : 0;
    for (size_t i = 0; i < report->section_count; i++) {
        const struct gsn_report_section *section = &report->sections[i];

        if (section->panel != number)
            continue;
        if (section->row >= *rows)
            *rows = section->row + 1;
        if (section->column >= *columns)
            *columns = section->column + 1;
    }
}

static void add_place(struct gsn_report_text *text, const struct gsn_report *report,
                      unsigned number, unsigned row, unsigned column)
{
    size_t found = 0;

    for (size_t i = 0; i < report->section_count; i++) {
        const struct gsn_report_section *section = &report->sections[i];

        if (section->panel != number || section->row != row || section->column != column)
            continue;
        add_slot(text, report, section);
        found++;
    }
    if (found == 0)
        gsn_report_text_raw(text, "<td class=\"slot absent\"><span class=\"none\"></span></td>\n");
}

static void add_panel_head(struct gsn_report_text *text, const struct gsn_report_panel *panel)
{
    gsn_report_text_raw(text, "<p>");
    gsn_report_text_escape(text, panel->file);
    if (isfinite(panel->glass)) {
        gsn_report_text_raw(text, " \xC2\xB7 ");
        gsn_report_text_number(text, 100 * panel->glass, 0);
        gsn_report_text_raw(text, " % glass");
    }
    if (isfinite(panel->white[0])) {
        gsn_report_text_raw(text, ", white ");
        for (int c = 0; c < 3; c++) {
            gsn_report_text_raw(text, c ? " / " : "");
            gsn_report_text_number(text, panel->white[c], 0);
        }
    }
    if (panel->message && *panel->message) {
        gsn_report_text_raw(text, "<br><span class=\"flag\">");
        gsn_report_text_escape(text, panel->message);
        gsn_report_text_raw(text, "</span>");
    }
    gsn_report_text_raw(text, "</p>\n");
}

static void add_panel(struct gsn_report_text *text, const struct gsn_report *report,
                      unsigned number)
{
    const struct gsn_report_panel *panel = panel_of(report, number);
    unsigned rows, columns;

    layout_of(report, number, &rows, &columns);
    gsn_report_text_print(text, "<div class=\"panel\"><h3>Panel %u", number);
    if (panel && panel->state && strcmp(panel->state, "used") != 0) {
        gsn_report_text_raw(text, " <span class=\"flag\">");
        gsn_report_text_escape(text, panel->state);
        gsn_report_text_raw(text, "</span>");
    }
    gsn_report_text_raw(text, "</h3>\n");
    if (panel)
        add_panel_head(text, panel);
    else
        gsn_report_text_raw(text,
                            "<p><span class=\"flag\">no scan of it was delivered</span></p>\n");
    for (size_t i = 0; i < report->panel_count; i++)
        if (report->panels[i].number == number && &report->panels[i] != panel)
            add_panel_head(text, &report->panels[i]);
    gsn_report_text_raw(text, "<div class=\"scroll\"><table class=\"sheet\"><tbody>\n");
    for (unsigned row = 0; row < rows; row++) {
        gsn_report_text_raw(text, "<tr>\n");
        for (unsigned column = 0; column < columns; column++)
            add_place(text, report, number, row, column);
        gsn_report_text_raw(text, "</tr>\n");
    }
    gsn_report_text_raw(text, "</tbody></table></div></div>\n");
}

/* The next panel number above `last` that a panel or a section names; 0 when there is none. */
static unsigned next_number(const struct gsn_report *report, unsigned last)
{
    unsigned next = 0;

    for (size_t i = 0; i < report->panel_count; i++)
        if (report->panels[i].number > last && (next == 0 || report->panels[i].number < next))
            next = report->panels[i].number;
    for (size_t i = 0; i < report->section_count; i++)
        if (report->sections[i].panel > last && (next == 0 || report->sections[i].panel < next))
            next = report->sections[i].panel;
    return next;
}

void gsn_html_sheet(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (report->section_count == 0 && report->panel_count == 0)
        return;
    gsn_report_text_raw(text,
                        "<section id=\"sheet\"><h2>Contact sheet</h2>\n"
                        "<p class=\"lead\">Every slot as it lies on the glass, named PANEL.SLOT as "
                        "<code>gieson decide</code> takes it; slots count from 1 in the order of "
                        "mounting.</p>\n");
    add_legend(text, report);
    gsn_report_text_raw(text, "<div class=\"panels\">\n");
    for (unsigned number = next_number(report, 0); number; number = next_number(report, number))
        add_panel(text, report, number);
    gsn_report_text_raw(text, "</div></section>\n");
}
