/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/report/html.h"

#include <math.h>

static int is_said(const char *text)
{
    return text && *text;
}

int gsn_html_has_choices(const struct gsn_report *report)
{
    for (size_t i = 0; i < report->section_count; i++)
        if (report->sections[i].candidate_count > 0)
            return 1;
    return 0;
}

static void add_facts(struct gsn_text *text, const struct gsn_report_candidate *c)
{
    gsn_text_raw(text, "<p>");
    gsn_text_escape(text, c->differs);
    gsn_text_raw(text, "</p>\n<p class=\"soft\">");
    if (isfinite(c->share) && c->share < 0.001) {
        gsn_text_raw(text, "under 0.1 % likely");
    } else if (isfinite(c->share)) {
        gsn_text_number(text, 100 * c->share, 1);
        gsn_text_raw(text, " % likely");
    } else {
        gsn_text_raw(text, "how likely is not known");
    }
    if (isfinite(c->predicted_tre_um)) {
        gsn_text_raw(text, " \xC2\xB7 <span class=\"nowrap\">TRE ");
        gsn_text_number(text, c->predicted_tre_um, 1);
        gsn_text_raw(text, " \xC2\xB5m</span>");
    }
    gsn_text_raw(text, "</p>\n");
    if (c->flipped)
        gsn_text_raw(text, "<p class=\"turned\">\xE2\x87\x84 turned over</p>\n");
    if (c->rotated180)
        gsn_text_raw(text, "<p class=\"turned\">\xE2\x86\xBB turned by 180\xC2\xB0</p>\n");
}

static void add_candidate(struct gsn_text *text, const struct gsn_report_section *section, size_t i)
{
    const struct gsn_report_candidate *c = &section->candidates[i];

    gsn_text_print(text, "<div class=\"choice%s\">", section->chosen == i + 1 ? " taken" : "");
    if (c->picture.size) {
        gsn_html_image(text, &c->picture, c->differs);
        gsn_text_raw(text, "\n");
    }
    gsn_text_print(text, "<p class=\"who\"><b>%u</b>", (unsigned)i + 1);
    if (section->chosen == i + 1)
        gsn_text_raw(text, " <span class=\"state\">\xE2\x9C\x93 chosen</span>");
    gsn_text_raw(text, "</p>\n");
    add_facts(text, c);
    gsn_text_raw(text, "</div>\n");
}

static void add_section(struct gsn_text *text, const struct gsn_report *report,
                        const struct gsn_report_section *section)
{
    gsn_text_print(text, "<div class=\"panel\"><h3>Section %u.%u</h3>\n<p>", section->panel,
                   section->slot + 1);
    for (size_t i = 0; section->compared_with && i < report->section_count; i++)
        if (report->sections[i].serial + 1 == section->compared_with)
            gsn_text_print(text, "The blue line is the outline of section %u.%u. ",
                           report->sections[i].panel, report->sections[i].slot + 1);
    if (is_said(section->command)) {
        gsn_text_raw(text, "To choose: <code>");
        gsn_text_escape(text, section->command);
        gsn_text_raw(text, " <i>number</i></code>");
    }
    gsn_text_raw(text, "</p>\n<div class=\"choices\">\n");
    for (size_t i = 0; i < section->candidate_count; i++)
        add_candidate(text, section, i);
    gsn_text_raw(text, "</div></div>\n");
}

void gsn_html_choices(struct gsn_text *text, const struct gsn_report *report)
{
    if (!gsn_html_has_choices(report))
        return;
    gsn_text_raw(text, "<section id=\"choices\"><h2>Poses to choose from</h2>\n"
                       "<p class=\"lead\">Sections whose pose a person should settle, as each "
                       "candidate would lay them in the block.</p>\n");
    for (size_t i = 0; i < report->section_count; i++)
        if (report->sections[i].candidate_count > 0)
            add_section(text, report, &report->sections[i]);
    gsn_text_raw(text, "</section>\n");
}

static void add_cell(struct gsn_text *text, const char *said)
{
    gsn_text_raw(text, "<td>");
    gsn_text_escape(text, said);
    gsn_text_raw(text, "</td>");
}

void gsn_html_decisions(struct gsn_text *text, const struct gsn_report *report)
{
    if (report->decision_count == 0)
        return;
    gsn_text_raw(text, "<section id=\"decisions\"><h2>Decided by people</h2>\n"
                       "<div class=\"table scroll\"><table><thead><tr><th>Where</th><th>What</th>"
                       "<th>By</th><th>When</th><th>Why</th><th>Effect</th></tr></thead><tbody>\n");
    for (size_t i = 0; i < report->decision_count; i++) {
        const struct gsn_report_decision *d = &report->decisions[i];

        gsn_text_print(text, "<tr><th scope=\"row\" class=\"name\">panel %u", d->panel);
        if (d->slot)
            gsn_text_print(text, ", slot %u", d->slot);
        gsn_text_raw(text, "</th>");
        add_cell(text, d->answer);
        add_cell(text, d->actor);
        add_cell(text, d->time);
        add_cell(text, is_said(d->reason) ? d->reason : "\xE2\x80\x93");
        add_cell(text, is_said(d->effect) ? d->effect : "\xE2\x80\x93");
        gsn_text_raw(text, "</tr>\n");
    }
    gsn_text_raw(text, "</tbody></table></div></section>\n");
}
