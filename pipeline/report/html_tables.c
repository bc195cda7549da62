/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The parts of the page that are lists: measures, exclusions, choices, decisions, provenance; and
 * beside it a paragraph of methods to paste into a manuscript, and how to cite the run.
 *
 * Method: each part writes into one growing text and leaves out what the report does not have;
 * texts of people go through one escape (text.h). A state is told by a word, never by colour alone.
 * The methods say what was done to this specimen and nothing that was not: how sections were
 * placed, by which dye vectors the density is, against which baseline the loss is, and of what its
 * interval is.
 *
 * Failure: the text remembers that memory ran out, and html.c asks it once, at the end.
 * Cost: linear in the rows. */
#include "pipeline/report/html.h"

#include <math.h>
#include <string.h>

#include "pipeline/report/html_elements.h"

/* --- choices and decisions --- */

int gsn_html_has_choices(const struct gsn_report *report)
{
    for (size_t i = 0; i < report->section_count; i++)
        if (report->sections[i].candidate_count > 0)
            return 1;
    return 0;
}

static void add_facts(struct gsn_report_text *text, const struct gsn_report_candidate *c)
{
    gsn_report_text_raw(text, "<p>");
    gsn_report_text_escape(text, c->differs);
    gsn_report_text_raw(text, "</p>\n<p class=\"soft\">");
    if (isfinite(c->share) && c->share < 0.001) {
        gsn_report_text_raw(text, "under 0.1 % likely");
    } else if (isfinite(c->share)) {
        gsn_report_text_number(text, 100 * c->share, 1);
        gsn_report_text_raw(text, " % likely");
    } else {
        gsn_report_text_raw(text, "how likely is not known");
    }
    if (isfinite(c->predicted_tre_um)) {
        gsn_report_text_raw(text, " \xC2\xB7 <span class=\"nowrap\">TRE ");
        gsn_report_text_number(text, c->predicted_tre_um, 1);
        gsn_report_text_raw(text, " \xC2\xB5m</span>");
    }
    gsn_report_text_raw(text, "</p>\n");
    if (c->flipped)
        gsn_report_text_raw(text, "<p class=\"turned\">\xE2\x87\x84 turned over</p>\n");
    if (c->rotated180)
        gsn_report_text_raw(text, "<p class=\"turned\">\xE2\x86\xBB turned by 180\xC2\xB0</p>\n");
}

static void add_candidate(struct gsn_report_text *text, const struct gsn_report_section *section,
                          size_t i)
{
    const struct gsn_report_candidate *c = &section->candidates[i];

    gsn_report_text_print(text, "<div class=\"choice%s\">",
                          section->chosen == i + 1 ? " taken" : "");
    if (c->picture.size) {
        gsn_html_image(text, &c->picture, c->differs);
        gsn_report_text_raw(text, "\n");
    }
    gsn_report_text_print(text, "<p class=\"who\"><b>%u</b>", (unsigned)i + 1);
    if (section->chosen == i + 1)
        gsn_report_text_raw(text, " <span class=\"state\">\xE2\x9C\x93 chosen</span>");
    gsn_report_text_raw(text, "</p>\n");
    add_facts(text, c);
    gsn_report_text_raw(text, "</div>\n");
}

static void add_section(struct gsn_report_text *text, const struct gsn_report *report,
                        const struct gsn_report_section *section)
{
    gsn_report_text_print(text, "<div class=\"panel\"><h3>Section %u.%u</h3>\n<p>", section->panel,
                          section->slot + 1);
    for (size_t i = 0; section->compared_with && i < report->section_count; i++)
        if (report->sections[i].serial + 1 == section->compared_with)
            gsn_report_text_print(text, "The blue line is the outline of section %u.%u. ",
                                  report->sections[i].panel, report->sections[i].slot + 1);
    if (gsn_html_is_said(section->command)) {
        gsn_report_text_raw(text, "To choose: <code>");
        gsn_report_text_escape(text, section->command);
        gsn_report_text_raw(text, " <i>number</i></code>");
    }
    gsn_report_text_raw(text, "</p>\n<div class=\"choices\">\n");
    for (size_t i = 0; i < section->candidate_count; i++)
        add_candidate(text, section, i);
    gsn_report_text_raw(text, "</div></div>\n");
}

void gsn_html_choices(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (!gsn_html_has_choices(report))
        return;
    gsn_report_text_raw(text,
                        "<section id=\"choices\"><h2>Poses to choose from</h2>\n"
                        "<p class=\"lead\">Sections whose pose a person should settle, as each "
                        "candidate would lay them in the block.</p>\n");
    for (size_t i = 0; i < report->section_count; i++)
        if (report->sections[i].candidate_count > 0)
            add_section(text, report, &report->sections[i]);
    gsn_report_text_raw(text, "</section>\n");
}

static void add_cell(struct gsn_report_text *text, const char *said)
{
    gsn_report_text_raw(text, "<td>");
    gsn_report_text_escape(text, said);
    gsn_report_text_raw(text, "</td>");
}

void gsn_html_decisions(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (report->decision_count == 0)
        return;
    gsn_report_text_raw(
        text, "<section id=\"decisions\"><h2>Decided by people</h2>\n"
              "<div class=\"table scroll\"><table><thead><tr><th>Where</th><th>What</th>"
              "<th>By</th><th>When</th><th>Why</th><th>Effect</th></tr></thead><tbody>\n");
    for (size_t i = 0; i < report->decision_count; i++) {
        const struct gsn_report_decision *d = &report->decisions[i];

        gsn_report_text_print(text, "<tr><th scope=\"row\" class=\"name\">panel %u", d->panel);
        if (d->slot)
            gsn_report_text_print(text, ", slot %u", d->slot);
        gsn_report_text_raw(text, "</th>");
        add_cell(text, d->answer);
        add_cell(text, d->actor);
        add_cell(text, d->time);
        add_cell(text, gsn_html_is_said(d->reason) ? d->reason : "\xE2\x80\x93");
        add_cell(text, gsn_html_is_said(d->effect) ? d->effect : "\xE2\x80\x93");
        gsn_report_text_raw(text, "</tr>\n");
    }
    gsn_report_text_raw(text, "</tbody></table></div></section>\n");
}

/* --- tables --- */

static void open_table(struct gsn_report_text *text, const char *style, const char *columns)
{
    gsn_report_text_print(
        text, "<div class=\"table %s scroll\"><table><thead><tr>%s</tr></thead><tbody>\n", style,
        columns);
}

static void close_table(struct gsn_report_text *text)
{
    gsn_report_text_raw(text, "</tbody></table></div>\n");
}

static void open_row(struct gsn_report_text *text, const char *name)
{
    gsn_report_text_raw(text, "<tr><th scope=\"row\" class=\"name\">");
    gsn_report_text_escape(text, name);
    gsn_report_text_raw(text, "</th>");
}

static void row_number(struct gsn_report_text *text, const char *name, double value, int decimals,
                       const char *unit)
{
    open_row(text, name);
    gsn_report_text_raw(text, "<td class=\"num\">");
    gsn_report_text_number(text, value, decimals);
    gsn_report_text_raw(text, "</td><td>");
    gsn_html_unit(text, unit);
    gsn_report_text_raw(text, "</td></tr>\n");
}

static void row_interval(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (!report->loss_interval || !isfinite(report->loss_percent))
        return;
    gsn_report_text_raw(text, "<tr><th scope=\"row\" class=\"name\">Its interval (");
    gsn_report_text_escape(text, report->loss_interval);
    gsn_report_text_raw(text, ")</th><td class=\"num\">");
    gsn_report_text_number(text, report->loss_lower, 2);
    gsn_report_text_raw(text, " to ");
    gsn_report_text_number(text, report->loss_upper, 2);
    gsn_report_text_raw(text, "</td><td>%</td></tr>\n");
}

static void row_digits(struct gsn_report_text *text, const char *name, double value,
                       const char *unit)
{
    open_row(text, name);
    gsn_report_text_raw(text, "<td class=\"num\">");
    gsn_report_text_digits(text, value, 4);
    gsn_report_text_raw(text, "</td><td>");
    gsn_html_unit(text, unit);
    gsn_report_text_raw(text, "</td></tr>\n");
}

/* A setting, with the digits it was given. */
static void row_plain(struct gsn_report_text *text, const char *name, double value,
                      const char *unit)
{
    open_row(text, name);
    gsn_report_text_raw(text, "<td class=\"num\">");
    gsn_report_text_plain(text, value);
    gsn_report_text_raw(text, "</td><td>");
    gsn_html_unit(text, unit);
    gsn_report_text_raw(text, "</td></tr>\n");
}

static void row_count(struct gsn_report_text *text, const char *name, size_t count)
{
    open_row(text, name);
    gsn_report_text_raw(text, "<td class=\"num\">");
    gsn_report_text_count(text, count);
    gsn_report_text_raw(text, "</td><td></td></tr>\n");
}

static void row_text(struct gsn_report_text *text, const struct gsn_report_value *row)
{
    open_row(text, row->name);
    gsn_report_text_raw(text, "<td colspan=\"2\">");
    gsn_report_text_escape(text, row->text);
    gsn_report_text_raw(text, " ");
    gsn_html_unit(text, row->unit);
    gsn_report_text_raw(text, "</td></tr>\n");
}

/* What has no unit and no fraction was counted. */
static int is_count(const struct gsn_report_value *row)
{
    return (!row->unit || !row->unit[0]) && row->value >= 1 && row->value < 1e15 &&
           row->value == floor(row->value);
}

static void row_measure(struct gsn_report_text *text, const struct gsn_report_value *row)
{
    if (row->text)
        row_text(text, row);
    else if (is_count(row))
        row_count(text, row->name, (size_t)row->value);
    else
        row_digits(text, row->name, row->value, row->unit);
}

/* "0.51 to 0.52", in brackets or not. */
static void put_range(struct gsn_report_text *text, const char *open, double lower, double upper,
                      int digits, const char *close)
{
    gsn_report_text_raw(text, open);
    gsn_report_text_digits(text, lower, digits);
    gsn_report_text_raw(text, " to ");
    gsn_report_text_digits(text, upper, digits);
    gsn_report_text_raw(text, close);
}

void gsn_html_volumes(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (report->volume_count == 0)
        return;
    gsn_report_text_raw(
        text, "<section id=\"volumes\"><h2>Volumes above a density</h2>\n"
              "<p class=\"lead\">Of the tissue: an estimate and its 95 % interval, at the stain as "
              "it was "
              "read; a dash where it would be wider than 10 % either way, or cannot be told. Of "
              "the fitted "
              "model: bounds that are guaranteed, and do not say how far the model is from the "
              "tissue.</p>\n");
    open_table(text, "figures",
               "<th class=\"num\">Density above</th><th class=\"num\">Tissue, mm\xC2\xB3</th>"
               "<th class=\"num\">Fitted model, mm\xC2\xB3</th>"
               "<th class=\"num\">Share of the region</th>");
    for (size_t i = 0; i < report->volume_count; i++) {
        const struct gsn_report_volume *volume = &report->volumes[i];
        const int given = isfinite(volume->estimate_mm3);
        const double middle =
            given ? volume->estimate_mm3 : (volume->lower_mm3 + volume->upper_mm3) / 2;

        gsn_report_text_raw(text, "<tr><td class=\"num\">");
        gsn_report_text_plain(text, volume->threshold);
        gsn_report_text_raw(text, "</td><td class=\"num\">");
        gsn_report_text_digits(text, volume->estimate_mm3, 4);
        if (given)
            put_range(text, " (", volume->interval_lower_mm3, volume->interval_upper_mm3, 4, ")");
        gsn_report_text_raw(text, "</td><td class=\"num\">");
        put_range(text, "", volume->lower_mm3, volume->upper_mm3, 5, "");
        gsn_report_text_raw(text, "</td><td class=\"num\">");
        gsn_report_text_number(text, 100 * middle / report->region.volume_mm3, 1);
        gsn_report_text_raw(text, " %</td></tr>\n");
    }
    close_table(text);
    gsn_report_text_raw(text, "</section>\n");
}

/* The loss of a named region and its interval, or why there is none. */
static void put_named_loss(struct gsn_report_text *text, const struct gsn_report_named *named)
{
    if (isfinite(named->loss_percent)) {
        gsn_report_text_number(text, named->loss_percent, 1);
        gsn_report_text_raw(text, " %");
        if (named->loss_interval) {
            gsn_report_text_raw(text, " (");
            gsn_report_text_number(text, named->loss_lower, 1);
            gsn_report_text_raw(text, " to ");
            gsn_report_text_number(text, named->loss_upper, 1);
            gsn_report_text_raw(text, ")");
        }
        return;
    }
    gsn_report_text_escape(text, gsn_html_is_said(named->verdict_reason) ? named->verdict_reason
                                                                         : named->loss_reason);
}

void gsn_html_named(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (report->named_count == 0)
        return;
    gsn_report_text_raw(
        text,
        "<section id=\"regions\"><h2>Regions</h2>\n"
        "<p class=\"lead\">Each as if it were the only one of the job; its own page, which lies "
        "beside this one, has its cuts, its model and its warnings. A loss is against the "
        "regions of the same name in the baseline.</p>\n");
    open_table(text, "figures",
               "<th>Region</th><th>Laid by</th><th class=\"num\">Volume, mm\xC2\xB3</th>"
               "<th class=\"num\">With data</th><th class=\"num\">Mean density</th>"
               "<th class=\"num\">Loss (95 %)</th><th class=\"num\">Warnings</th>");
    for (size_t i = 0; i < report->named_count; i++) {
        const struct gsn_report_named *named = &report->named[i];

        gsn_report_text_raw(text, "<tr><td><a href=\"");
        gsn_report_text_escape(text, named->page);
        gsn_report_text_raw(text, "\">");
        gsn_report_text_escape(text, named->name);
        gsn_report_text_raw(text, "</a></td><td>");
        gsn_report_text_escape(text, named->region.description);
        gsn_report_text_raw(text, "</td><td class=\"num\">");
        gsn_report_text_digits(text, named->region.volume_mm3, 4);
        gsn_report_text_raw(text, "</td><td class=\"num\">");
        gsn_report_text_number(text, 100 * named->region.coverage, 1);
        gsn_report_text_raw(text, " %</td><td class=\"num\">");
        gsn_report_text_number(text, named->region.mean_density, 3);
        if (isfinite(named->density_error)) {
            gsn_report_text_raw(text, " \xC2\xB1 ");
            gsn_report_text_number(text, 1.96 * named->density_error, 3);
        }
        gsn_report_text_raw(text, "</td><td class=\"num\">");
        put_named_loss(text, named);
        gsn_report_text_print(text, "</td><td class=\"num\">%zu</td></tr>\n", named->warnings);
    }
    close_table(text);
    gsn_report_text_raw(text, "</section>\n");
}

void gsn_html_tile(struct gsn_report_text *text, const struct gsn_report *report)
{
    const struct gsn_report_tile *tile = report->tile;

    if (!tile)
        return;
    gsn_report_text_raw(text, "<section id=\"tile\"><h2>Collagen map</h2>\n");
    open_table(text, "figures", "<th>Measure</th><th class=\"num\">Value</th><th>Unit</th>");
    row_number(text, "Collagen, of the tissue area", 100 * tile->area_fraction, 2, "%");
    row_number(text, "Mean density of the tissue", tile->mean_density, 4, "");
    row_number(text, "95 % interval, lower end", tile->mean_lower, 4, "");
    row_number(text, "95 % interval, upper end", tile->mean_upper, 4, "");
    row_number(text, "Red of all dye in the tissue", 100 * tile->red_share, 2, "%");
    row_digits(text, "Threshold of the map", tile->threshold, "");
    if (tile->compared) {
        row_number(text, "Dice with the mask", tile->dice, 4, "");
        row_number(text, "Map, of the whole picture", 100 * tile->map_fraction, 2, "%");
        row_number(text, "Mask, of the whole picture", 100 * tile->mask_fraction, 2, "%");
        row_number(text, "Of the map, not in the mask", 100 * tile->false_positive, 2, "%");
        row_number(text, "Of the mask, not in the map", 100 * tile->false_negative, 2, "%");
    }
    close_table(text);
    gsn_report_text_raw(text, "</section>\n");
}

static void add_registration(struct gsn_report_text *text,
                             const struct gsn_report_registration *done)
{
    row_count(text, "Sections expected", done->sections_expected);
    row_count(text, "Sections in place", done->sections_posed);
    if (isnan(done->comparison_um)) {
        row_number(text, "Localisation error of one mark (FLE)", done->fle_um, 2, "um");
        row_number(text, "Residual of the marks, root mean square", done->rms_residual_um, 2, "um");
        row_number(text, "Residual of the marks, largest", done->worst_residual_um, 2, "um");
    } else {
        row_number(text, "Error of laying one section on the next by tissue", done->comparison_um,
                   2, "um");
    }
    row_number(text, "Predicted error at the region (TRE), mean", done->mean_tre_um, 2, "um");
    row_number(text, "Predicted error at the region (TRE), largest", done->worst_tre_um, 2, "um");
}

static void add_fit(struct gsn_report_text *text, const struct gsn_report_fit *fit)
{
    row_count(text, "Degree of the spline", fit->degree);
    row_count(text, "Micro-units (tetrahedra of the model)", fit->tets);
    row_count(text, "Micro-units in which no sample lies", fit->empty_tets);
    if (fit->tets > 0)
        row_number(text, "Share of the micro-units in which no sample lies",
                   100 * (double)fit->empty_tets / (double)fit->tets, 1, "%");
    row_count(text, "Unknowns of the fit", fit->unknowns);
    row_count(text, "Samples", fit->samples);
    row_digits(text, "Residual of the fit, root mean square", fit->rms, "density");
    row_digits(text, "Residual of the fit, largest", fit->worst, "density");
    row_plain(text, "Smoothing", fit->smoothing, "");
    row_plain(text, "Tolerance in each micro-unit", fit->tolerance, "density");
    row_count(text, "Micro-units with samples that are within the tolerance",
              fit->tets_in_tolerance);
}

static void add_units(struct gsn_report_text *text, const struct gsn_report_units *units)
{
    row_number(text, "Micro-units, lowest density", units->smallest, 4, "density");
    row_number(text, "Micro-units, median density", units->median, 4, "density");
    row_number(text, "Micro-units, highest density", units->largest, 4, "density");
}

void gsn_html_measures(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(
        text,
        "<section id=\"measures\"><h2>Measures</h2>\n<p class=\"lead\">All figures. Quote the "
        "loss with its interval, the mean density and the share of the region with data; the "
        "rest says how far to trust them. A predicted error (TRE) above the thickness of the "
        "structures that matter: more or better marks. Names such as BV/TV are those of "
        "ASBMR; they have no interval.</p>\n");
    open_table(text, "figures", "<th>Measure</th><th class=\"num\">Value</th><th>Unit</th>");
    if (!report->tile) {
        if (report->baseline && *report->baseline) {
            row_number(text, "Collagen loss, relative", report->loss_percent, 3, "%");
            row_interval(text, report);
            row_number(text, "Collagen loss, absolute", report->loss_points, 3, "points");
            row_number(text, "Mean density of the baseline", report->baseline_mean, 5, "density");
            row_number(text, "What no collagen reads as", report->zero_density, 3, "density");
        }
        row_number(text, "Mean density of the region", report->region.mean_density, 5, "density");
        row_number(text, "Volume of the region", report->region.volume_mm3, 5, "mm3");
        row_number(text, "Region with data", 100 * report->region.coverage, 2, "%");
    }
    if (report->area_figure.name)
        row_measure(text, &report->area_figure);
    if (report->registration)
        add_registration(text, report->registration);
    if (report->fit)
        add_fit(text, report->fit);
    if (report->units)
        add_units(text, report->units);
    for (size_t i = 0; i < report->measure_count; i++)
        row_measure(text, &report->measures[i]);
    close_table(text);
    gsn_report_text_raw(text, "</section>\n");
}

void gsn_html_exclusions(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (report->exclusion_count == 0)
        return;
    gsn_report_text_raw(text, "<section id=\"exclusions\"><h2>Left out, and why</h2>\n");
    open_table(text, "", "<th>What</th><th>Reason</th>");
    for (size_t i = 0; i < report->exclusion_count; i++) {
        open_row(text, report->exclusions[i].what);
        gsn_report_text_raw(text, "<td class=\"reason\">");
        gsn_report_text_escape(text, report->exclusions[i].reason);
        gsn_report_text_raw(text, "</td></tr>\n");
    }
    close_table(text);
    gsn_report_text_raw(text, "</section>\n");
}

/* --- methods: what was done to this specimen, and nothing that was not --- */

static void say_sections(struct gsn_report_text *text, const struct gsn_report *report)
{
    const struct gsn_report_registration *const done = report->registration;
    const int by_tissue = done && done->by && strcmp(done->by, "tissue") == 0;

    if (report->kind == GSN_REPORT_VOLUME) {
        gsn_report_text_raw(text, "Densities were taken from an imported volume. ");
        return;
    }
    if (report->kind == GSN_REPORT_TILE || !done) {
        gsn_report_text_raw(text, "Collagen was measured in a stained section. ");
        return;
    }
    gsn_report_text_print(text,
                          "Of %u serial sections %u were stacked by rigid registration (rotation "
                          "and shift, no warping) on %s",
                          done->sections_expected, done->sections_posed,
                          by_tissue ? "what their tissue has in common"
                                    : "three fiducial marks burnt through the block by laser");
    if (isfinite(done->mean_tre_um)) {
        gsn_report_text_raw(text, "; the predicted registration error in the region was ");
        gsn_report_text_number(text, done->mean_tre_um, 1);
        gsn_report_text_raw(text, " \xC2\xB5m");
    }
    gsn_report_text_raw(text, ". ");
}

static void say_density(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (report->kind != GSN_REPORT_VOLUME) {
        gsn_report_text_raw(text, "Density is the ");
        gsn_report_text_escape(text, report->density_name);
        gsn_report_text_raw(text, ", unmixed in optical density with the dye vectors ");
        gsn_report_text_escape(text, report->density_version);
        gsn_report_text_raw(text, ". ");
    }
    if (report->fit && report->region.description) {
        gsn_report_text_raw(text, "A trivariate simplex spline was fitted to the region (");
        gsn_report_text_escape(text, report->region.description);
        gsn_report_text_raw(text, "), and its mean is reported. ");
    }
}

static void say_loss(struct gsn_report_text *text, const struct gsn_report *report)
{
    if (!isfinite(report->loss_percent))
        return;
    gsn_report_text_raw(text, "The loss is 100 (1 \xE2\x88\x92 density / density of the control ");
    gsn_report_text_escape(text, report->baseline);
    gsn_report_text_raw(text, ")");
    if (report->loss_interval) {
        gsn_report_text_raw(text, "; its interval (");
        gsn_report_text_escape(text, report->loss_interval);
        gsn_report_text_raw(text, ") is of this measurement, and holds nothing of how animals "
                                  "differ");
    }
    gsn_report_text_raw(text, ". ");
}

void gsn_html_methods(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(text,
                        "<section id=\"methods\"><h2>Methods, to paste</h2>\n<p class=\"lead\">");
    say_sections(text, report);
    say_density(text, report);
    say_loss(text, report);
    gsn_report_text_raw(text, "Computed with gieson ");
    gsn_report_text_escape(text, report->version);
    gsn_report_text_raw(text, ".</p>\n<p class=\"lead\">To cite this run: <i>gieson ");
    gsn_report_text_escape(text, report->version);
    gsn_report_text_raw(text, ": collagen loss from stained serial sections</i> (computer program, "
                              "AGPL-3.0-or-later), run ");
    gsn_report_text_escape_short(text, report->key, 64);
    gsn_report_text_raw(text, " of ");
    gsn_report_text_escape_short(text, report->specimen, 80);
    gsn_report_text_raw(text, ". The key is a hash of inputs, parameters and version: the same key "
                              "gives the same figures.</p>\n</section>\n");
}

/* --- provenance --- */

static void add_files(struct gsn_report_text *text, const char *title,
                      const struct gsn_report_input *files, size_t count)
{
    gsn_report_text_raw(text, "<details open><summary>");
    gsn_report_text_escape(text, title);
    gsn_report_text_raw(text, "</summary><div class=\"scroll\"><table><thead><tr><th>File</th><th "
                              "class=\"num\">Bytes</th><th>SHA-256</th></tr>"
                              "</thead><tbody>\n");
    for (size_t i = 0; i < count; i++) {
        open_row(text, files[i].name);
        gsn_report_text_raw(text, "<td class=\"num\">");
        gsn_report_text_count(text, files[i].size);
        gsn_report_text_raw(text, "</td><td class=\"hash\">");
        gsn_report_text_escape(text, files[i].sha256);
        gsn_report_text_raw(text, "</td></tr>\n");
    }
    gsn_report_text_raw(text, "</tbody></table></div></details>\n");
}

static void add_parameters(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(text,
                        "<details open><summary>Parameters</summary><div class=\"scroll\"><table>"
                        "<thead><tr><th>Name</th><th class=\"num\">Value</th><th>Unit</th></tr>"
                        "</thead><tbody>\n");
    for (size_t i = 0; i < report->parameter_count; i++) {
        const struct gsn_report_value *row = &report->parameters[i];

        if (row->text)
            row_text(text, row);
        else
            row_plain(text, row->name, row->value, row->unit);
    }
    gsn_report_text_raw(text, "</tbody></table></div></details>\n");
}

void gsn_html_provenance(struct gsn_report_text *text, const struct gsn_report *report)
{
    gsn_report_text_raw(text,
                        "<section id=\"provenance\"><h2>Provenance</h2>\n"
                        "<p class=\"lead\">The same inputs, parameters and version give this page "
                        "again, byte for byte.</p>\n");
    open_table(text, "", "<th>What</th><th>Value</th>");
    open_row(text, "Run");
    gsn_report_text_raw(text, "<td class=\"hash\">");
    gsn_report_text_escape(text, report->key);
    gsn_report_text_raw(text, "</td></tr>\n");
    open_row(text, "Program");
    gsn_report_text_raw(text, "<td>gieson ");
    gsn_report_text_escape(text, report->version);
    gsn_report_text_raw(text, "</td></tr>\n");
    open_row(text, "Density");
    gsn_report_text_raw(text, "<td class=\"reason\">");
    gsn_report_text_escape(text, report->density_name);
    gsn_report_text_raw(text, " (");
    gsn_report_text_escape(text, report->density_version);
    gsn_report_text_raw(text, ")</td></tr>\n");
    close_table(text);
    gsn_report_text_raw(text, "<p></p>\n");
    if (report->input_count)
        add_files(text, "Input files", report->inputs, report->input_count);
    if (report->output_count)
        add_files(text, "Files beside this report", report->outputs, report->output_count);
    if (report->parameter_count)
        add_parameters(text, report);
    gsn_report_text_raw(text, "</section>\n");
}
