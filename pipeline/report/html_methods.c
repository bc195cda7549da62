/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A paragraph of methods to paste into a manuscript, and how to cite the run.
 *
 * It says what was done to this specimen and nothing that was not: how sections were placed, by
 * which dye vectors the density is, against which baseline the loss is, and of what its interval
 * is. Failure: the text remembers that memory ran out. Cost: a few lines. */
#include "pipeline/report/html.h"

#include <math.h>
#include <string.h>

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
    gsn_report_text_raw(text, "<section id=\"methods\"><h2>Methods, to paste</h2>\n<p class=\"lead\">");
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
