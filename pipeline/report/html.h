/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The parts of the page; html.c puts them together. Each writes into the text and leaves out what
 * the report does not have. */
#ifndef GSN_REPORT_HTML_H
#define GSN_REPORT_HTML_H

#include "pipeline/report/report.h"
#include "pipeline/report/text.h"

#ifdef __cplusplus
extern "C" {
#endif

/* html_alignment.c: the sections as they lie in the block, to scroll through. */
void gsn_html_alignment(struct gsn_report_text *text, const struct gsn_report *report);

/* html_viewer.c: the model to turn and ask; the scripts, which come last. */
void gsn_html_viewer(struct gsn_report_text *text, const struct gsn_report *report);
void gsn_html_script(struct gsn_report_text *text, const struct gsn_report *report);

/* html_sheet.c: every slot of every panel, as laid out on the glass. */
void gsn_html_sheet(struct gsn_report_text *text, const struct gsn_report *report);

/* html_tables.c: the poses that a person may choose from, and what people decided. */
void gsn_html_choices(struct gsn_report_text *text, const struct gsn_report *report);
void gsn_html_decisions(struct gsn_report_text *text, const struct gsn_report *report);
int gsn_html_has_choices(const struct gsn_report *report);

/* html_tables.c */
void gsn_html_named(struct gsn_report_text *text, const struct gsn_report *report);
void gsn_html_volumes(struct gsn_report_text *text, const struct gsn_report *report);
void gsn_html_tile(struct gsn_report_text *text, const struct gsn_report *report);
void gsn_html_measures(struct gsn_report_text *text, const struct gsn_report *report);
void gsn_html_exclusions(struct gsn_report_text *text, const struct gsn_report *report);
/* What was done, in words for a manuscript, and how to cite the run. */
void gsn_html_methods(struct gsn_report_text *text, const struct gsn_report *report);
void gsn_html_provenance(struct gsn_report_text *text, const struct gsn_report *report);

#ifdef __cplusplus
}
#endif
#endif
